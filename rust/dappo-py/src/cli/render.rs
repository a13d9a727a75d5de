//! `dappo-batch render` and `dappo-batch view`: one walk, in a file, a window or a browser.

use std::sync::atomic::{AtomicBool, Ordering};

use dappo_diagnose::controller::{ControllerConfig, Parts};
use dappo_learn::config::Config;
use dappo_learn::envs::EnvFactory;
use dappo_learn::run_folder::RunFolder;
use dappo_learn::walk::{Agent, Encoding, Kept, KnownClasses, Trial, Walks, onset_at};
use dappo_learn::{Result, RunPolicy};
use pyo3::prelude::*;

use super::args::{RenderArgs, ViewArgs, WalkArgs};
use super::film::{self, Film, Walker};
use super::{Caller, INTERRUPTED, settings};
use crate::controller::open_parts;
use crate::errors::OrRaise;
use crate::factory::TableFactory;
use crate::pool::Pool;
use crate::run_robot::OpenRun;

pub fn run(py: Python<'_>, arguments: &RenderArgs, caller: &Caller) -> PyResult<i32> {
    let (camera, strip) = (arguments.walk.camera.as_str(), arguments.strip.count());
    film::check(py, &arguments.out, Some(strip))?;
    film_walk(py, &arguments.walk, caller, |film| film.write(py, &arguments.out, camera, Some(strip), caller))
}

pub fn view(py: Python<'_>, arguments: &ViewArgs, caller: &Caller) -> PyResult<i32> {
    let (host, port, camera) = (&arguments.host, arguments.port, &arguments.walk.camera);
    if arguments.browser {
        film::check_browser(py, host, port)?;
        return film_walk(py, &arguments.walk, caller, |film| film.serve(py, (host, port), camera, caller));
    }
    film::check_screen(py)?;
    film_walk(py, &arguments.walk, caller, |film| film.show(py, camera, caller))
}

/// Simulates a walk and passes it to `show`.
fn film_walk(
    py: Python<'_>,
    arguments: &WalkArgs,
    caller: &Caller,
    show: impl FnOnce(&Film<'_>) -> PyResult<()>,
) -> PyResult<i32> {
    let run = OpenRun::open(py, &arguments.run, arguments.robot.robot_changed)?;
    let parts = match &arguments.diagnoser {
        Some(diagnoser) => Some(open_parts(py, &run, arguments.expert.as_deref(), diagnoser)?),
        None => None,
    };
    let OpenRun { folder, mut config, .. } = run;
    settings::simulate_with(&arguments.simulation, &mut config).or_raise()?;
    let pool = Pool::new(arguments.simulation.threads())?;
    config.env.max_episode_steps = Some(arguments.steps.count());
    let factory = TableFactory::compile(py, &config)?;
    film::check_camera(py, &factory, &arguments.camera)?;
    let trial = Trial {
        classes: vec![factory.space().parse(&arguments.damage).or_raise()?],
        episodes: 1,
        course: onset_at(arguments.at.count(), &config, &factory).or_raise()?,
        seed: arguments.seed.wide(),
        kept: Kept::Positions,
    };
    let interrupted = caller.watch()?;
    let walked = pool.run(py, || walk(parts.as_ref(), (&folder, &config, &factory), &trial, &interrupted))?;
    let Some((walks, walker)) = walked else { return Ok(INTERRUPTED) };
    if let Some(episode) = walks.episodes.first() {
        show(&Film { episode, walker, factory: &factory })?;
    }
    Ok(0)
}

/// Simulates a walk of the controller if there is a diagnoser, else of the policy; `None` when interrupted.
fn walk(
    parts: Option<&Parts>,
    (folder, config, factory): (&RunFolder, &Config, &TableFactory),
    trial: &Trial,
    interrupted: &AtomicBool,
) -> Result<Option<(Walks, Walker)>> {
    let stop = || interrupted.load(Ordering::Relaxed);
    let run = |mut agent: Agent<'_>| trial.run(&mut agent, config, factory, &stop);
    if let Some(parts) = parts {
        let mut controller = parts.assemble(folder, config, factory, ControllerConfig::default(), 1)?;
        let walker = Walker::Controller(controller.class_names().to_vec());
        return Ok(run(Agent::Onboard(&mut controller))?.map(|walks| (walks, walker)));
    }
    let policy = RunPolicy::newest(folder, config, factory)?.policy;
    let known = KnownClasses::of(factory.space());
    let (agent, walker) = if policy.code_length() > 0 {
        (
            Agent::Encoded(&policy, &known, Encoding::True),
            Walker::Policy("damage-aware policy, true damage code"),
        )
    } else {
        (Agent::Unaware(&policy), Walker::Policy("policy without damage code"))
    };
    Ok(run(agent)?.map(|walks| (walks, walker)))
}
