//! `dappo-batch train`.

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{SystemTime, UNIX_EPOCH};

use dappo_learn::LearnerDevice;
use dappo_learn::config::{Config, change};
use dappo_learn::envs::EnvFactory;
use dappo_learn::evaluate::Encoding;
use dappo_learn::run_folder::{LockedRun, Meta, RunFolder};
use dappo_learn::train::{Resumption, train};
use pyo3::prelude::*;

use super::args::TrainArgs;
use super::evaluate::{evaluate_and_save, show};
use super::progress::Display;
use super::{Caller, INTERRUPTED, console, settings};
use crate::errors::from_learn;
use crate::factory::TableFactory;
use crate::pool::Pool;
use crate::run_robot::{OpenRun, RobotCopy};

pub fn run(py: Python<'_>, arguments: &TrainArgs, argv: &[OsString], caller: &Caller) -> PyResult<i32> {
    let (mut config, resumed) = if let Some(folder) = &arguments.resume {
        let (run, resumption, config) = reopen(py, folder, arguments)?;
        (config, Some((run, resumption)))
    } else {
        (settings::resolve(py, &arguments.config)?, None)
    };
    let pool = Pool::new(config.env.threads)?;
    let factory = settings::ready(py, &mut config)?;
    // A later version of this program may choose otherwise, but a run goes on with the backend it began with.
    config.env.backend = factory.backend_kind();
    let (run, resumption) = match resumed {
        Some((run, resumption)) => (run, Some(resumption)),
        None => (create(py, arguments, &config, &factory, argv, pool.num_threads())?, None),
    };
    if !arguments.json {
        console::note(&describe(&config, &factory, &run));
        console::note(&factory.describe(config.env.compute()));
    }

    let interrupted = caller.watch()?;
    let objects = arguments.json.then_some(caller);
    let mut display = Display::new(&config, objects, Arc::clone(&interrupted));
    let outcome = pool.run(py, || train(&config, &factory, &run, resumption.as_ref(), &mut display));
    display.finish();
    let outcome = outcome?;
    if outcome.interrupted {
        console::note(&format!(
            "interrupted and saved at {} env steps; go on with: dappo-batch train --resume {}",
            outcome.progress.env_steps,
            run.root().display()
        ));
        return Ok(INTERRUPTED);
    }
    let evaluation = pool
        .run(py, || evaluate_and_save(&outcome.ppo, &config, Encoding::True, &factory, &run, &interrupted))?;
    let Some(evaluation) = evaluation else {
        let root = run.root().display();
        console::note(&format!(
            "interrupted after the training; evaluate it with: dappo-batch evaluate {root}"
        ));
        return Ok(INTERRUPTED);
    };
    if !arguments.json {
        show(&evaluation);
        console::print_line(&format!("run folder: {}", run.root().display()));
    }
    Ok(0)
}

/// Opens a run to go on with; `--steps` may extend its budget, `--set` change some settings, and another machine may
/// have other threads and devices of networks. The last part is the configuration for this machine, with the robot to
/// compile.
fn reopen(py: Python<'_>, folder: &Path, arguments: &TrainArgs) -> PyResult<(LockedRun, Resumption, Config)> {
    let OpenRun { folder, config: simulated, robot, is_kept, .. } =
        OpenRun::open(py, folder, arguments.robot_changed)?;
    let run = folder.lock().map_err(|error| from_learn(&error))?;
    let robot = if is_kept { None } else { Some(robot.to_keep(py)?) };
    let (_, stored) = RunFolder::open(run.root()).map_err(|error| from_learn(&error))?;
    let mut changed = change(&stored, &arguments.config.set).map_err(|error| from_learn(&error))?;
    if let Some(steps) = arguments.config.steps {
        changed.total_steps = steps as u64;
    }
    let mut config = changed.clone();
    if let Some(threads) = arguments.config.threads {
        config.env.threads = Some(threads as usize);
    }
    if let Some(device) = &arguments.config.learner {
        config.ppo.device = LearnerDevice::parse(device).map_err(|error| from_learn(&error))?;
    }
    config.robot_file = simulated.robot_file;
    Ok((run, Resumption { config: changed, robot }, config))
}

fn create(
    py: Python<'_>,
    arguments: &TrainArgs,
    config: &Config,
    factory: &TableFactory,
    argv: &[OsString],
    threads: usize,
) -> PyResult<LockedRun> {
    let seconds = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |time| time.as_secs());
    let robot = factory.robot().name.clone();
    let root = arguments
        .run
        .clone()
        .unwrap_or_else(|| PathBuf::from("runs").join(format!("{robot}-{}-{seconds}", config.seed)));
    let meta = Meta {
        version: env!("CARGO_PKG_VERSION").into(),
        mujoco: py.import("mujoco")?.getattr("__version__")?.extract()?,
        simulator: factory.simulator(config.env.compute()),
        reward: factory.reward_name(config),
        threads,
        platform: format!("{}-{}", std::env::consts::OS, std::env::consts::ARCH),
        command: std::iter::once("dappo-batch".to_owned())
            .chain(argv.iter().map(|text| text.to_string_lossy().into()))
            .collect(),
    };
    let robot = RobotCopy::of(py, config)?.to_keep(py)?;
    RunFolder::create(&root, config, &meta, &robot).map_err(|error| from_learn(&error))
}

fn describe(config: &Config, factory: &TableFactory, run: &RunFolder) -> String {
    format!(
        "{} · {} · {} envs × {} steps · reward {} · {} env steps → {}",
        factory.robot().name,
        if config.env.observe_damage { "DA-PPO" } else { "PPO-Unaware" },
        config.env.num_envs,
        config.horizon,
        factory.reward_name(config),
        config.total_steps,
        run.root().display()
    )
}
