//! `dappo-batch train`.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{SystemTime, UNIX_EPOCH};

use dappo_learn::config::{Config, change};
use dappo_learn::envs::EnvFactory;
use dappo_learn::run_folder::{LockedRun, Meta, RunFolder};
use dappo_learn::train::{Resumption, train};
use dappo_learn::walk::Encoding;
use pyo3::prelude::*;

use super::args::{ConfigArgs, TrainArgs};
use super::evaluate::{evaluate_and_save, show};
use super::progress::Display;
use super::{Caller, INTERRUPTED, settings};
use crate::cli::console::{note, print_line};
use crate::errors::{Kind, OrRaise, raise};
use crate::factory::{TableFactory, mujoco_version};
use crate::pool::Pool;
use crate::run_robot::{OpenRun, RobotCopy};

pub fn run(py: Python<'_>, arguments: &TrainArgs, given: &[String], caller: &Caller) -> PyResult<i32> {
    let (mut config, resumed) = if let Some(folder) = &arguments.resume {
        let (run, resumption, config) = reopen(py, folder, arguments)?;
        (config, Some((run, resumption)))
    } else {
        // The command line knows that by itself.
        if arguments.robot_changed.is_some() {
            return Err(raise(Kind::Config, "robot_changed cannot be used without resume"));
        }
        (settings::resolve(py, &arguments.config)?, None)
    };
    let pool = Pool::new(config.env.threads)?;
    let factory = settings::ready(py, &mut config)?;
    // A later version of this program may choose otherwise, but a run goes on with the backend it began with.
    config.env.backend = factory.backend_kind();
    let (run, resumption) = match resumed {
        Some((run, resumption)) => (run, Some(resumption)),
        None => (create(py, arguments, &config, &factory, given, pool.num_threads())?, None),
    };
    if !arguments.json {
        note!("{}", describe(&config, &factory, &run));
        note!("{}", factory.describe(factory.training_physics()));
    }

    let interrupted = caller.watch()?;
    let objects = arguments.json.then_some(caller);
    let mut display = Display::new(&config, factory.control_period(), objects, Arc::clone(&interrupted));
    let outcome = pool.run(py, || train(&config, &factory, &run, resumption.as_ref(), &mut display));
    display.finish();
    let outcome = outcome?;
    if outcome.interrupted {
        note!(
            "interrupted and saved at {} env steps; go on with: dappo-batch train --resume {}",
            outcome.progress.env_steps,
            run.root().display()
        );
        return Ok(INTERRUPTED);
    }
    let evaluation = pool.run(py, || {
        evaluate_and_save(&outcome.policy, &config, Encoding::True, &factory, &run, &interrupted)
    })?;
    let Some(evaluation) = evaluation else {
        let root = run.root().display();
        note!("interrupted after the training; evaluate it with: dappo-batch evaluate {root}");
        return Ok(INTERRUPTED);
    };
    if !arguments.json {
        show(&evaluation);
        print_line!("run folder: {}", run.root().display());
    }
    Ok(0)
}

/// Opens a run to go on with; `--steps` may extend its budget, `--set` change some settings, and another machine may
/// have other threads and devices of networks. The last part is the configuration for this machine, with the robot to
/// compile.
fn reopen(py: Python<'_>, folder: &Path, arguments: &TrainArgs) -> PyResult<(LockedRun, Resumption, Config)> {
    let OpenRun { folder, config: simulated, robot, is_kept, .. } =
        OpenRun::open(py, folder, arguments.robot_changed)?;
    let run = folder.lock().or_raise()?;
    let robot = if is_kept { None } else { Some(robot.to_keep(py)?) };
    let (_, stored) = RunFolder::open(run.root()).or_raise()?;
    let ConfigArgs { total_steps, room, threads, learner, set, .. } = &arguments.config;
    let of_run = settings::flags([
        ("total_steps", total_steps.map(|steps| steps.get().into())),
        ("env.njmax", room.njmax.map(|room| room.get().into())),
        ("env.nconmax", room.nconmax.map(|room| room.get().into())),
    ]);
    let of_machine = settings::flags([
        ("env.threads", threads.map(|threads| threads.get().into())),
        ("ppo.device", learner.as_deref().map(Into::into)),
    ]);
    // As in a new run, an explicit `--set` wins over the flags.
    let changed = change(&stored, &[&of_run[..], set].concat()).or_raise()?;
    let mut config = change(&stored, &[&of_run[..], &of_machine, set].concat()).or_raise()?;
    config.robot_file = simulated.robot_file;
    Ok((run, Resumption { config: changed, robot }, config))
}

fn create(
    py: Python<'_>,
    arguments: &TrainArgs,
    config: &Config,
    factory: &TableFactory,
    given: &[String],
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
        mujoco: mujoco_version(py)?,
        simulator: factory.simulator(factory.training_physics()),
        reward: factory.reward_name(config),
        threads,
        platform: format!("{}-{}", std::env::consts::OS, std::env::consts::ARCH),
        command: given.to_vec(),
    };
    let robot = RobotCopy::of(py, config)?.to_keep(py)?;
    RunFolder::create(&root, config, &meta, &robot).or_raise()
}

fn describe(config: &Config, factory: &TableFactory, run: &RunFolder) -> String {
    format!(
        "{} · {} · PPO preset {} · {} envs × {} steps · reward {} · {} env steps → {}",
        factory.robot().name,
        config.learner(),
        config.ppo.preset_name().unwrap_or("changed"),
        config.env.num_envs,
        config.horizon,
        factory.reward_name(config),
        config.total_steps,
        run.root().display()
    )
}
