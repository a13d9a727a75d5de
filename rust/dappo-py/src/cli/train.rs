//! `dappo-batch train`.

use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use dappo_learn::Result;
use dappo_learn::config::{Assignment, Config, change};
use dappo_learn::envs::EnvFactory;
use dappo_learn::episodes::EpisodeSummary;
use dappo_learn::metrics::Metrics;
use dappo_learn::run_folder::{LockedRun, Meta, RunFolder};
use dappo_learn::train::{Observer, Resumption, train};
use dappo_learn::walk::Encoding;
use dappo_sim::simd;
use pyo3::prelude::*;

use super::args::{ConfigArgs, TrainArgs};
use super::evaluate::evaluate_and_save;
use super::progress::Watch;
use super::{Caller, INTERRUPTED, console, settings};
use crate::cli::console::{note, print_line};
use crate::errors::{Kind, OrRaise, raise};
use crate::factory::{TableFactory, mujoco_version};
use crate::keywords::Flags;
use crate::pool::Pool;
use crate::run_robot::{OpenRun, RobotCopy};

/// Settings that are no part of a run: another machine may resume it.
const OF_MACHINE: [&str; 2] = ["env.threads", "ppo.device"];

pub fn run(py: Python<'_>, arguments: &TrainArgs, given: &[String], caller: &Caller) -> PyResult<i32> {
    let (mut config, resumed) = if let Some(folder) = &arguments.resume {
        let (run, resumption, config) = reopen(py, folder, arguments)?;
        (config, Some((run, resumption)))
    } else {
        // The command line checks this itself.
        if arguments.robot_changed.is_some() {
            return Err(raise(Kind::Config, "robot_changed cannot be used without resume"));
        }
        (settings::resolve(py, &arguments.config)?, None)
    };
    let pool = Pool::new(config.env.threads)?;
    let factory = settings::ready(py, &mut config)?;
    // A later version of this program may choose otherwise, but a run keeps the backend it began with.
    config.env.backend = factory.backend_kind();
    let (run, resumption) = match resumed {
        Some((run, resumption)) => (run, Some(resumption)),
        None => (create(py, arguments, &config, &factory, given, pool.num_threads())?, None),
    };
    if !arguments.json {
        note!("{}", describe(&config, &factory, &run).or_raise()?);
        note!("{}", factory.describe(factory.training_physics()));
        if let Some(why) = factory.task_note(&config).or_raise()? {
            note!("{why}");
        }
        if let Some(why) = factory.asymmetry() {
            note!("without symmetry: {why}");
        }
    }

    let watch = Watch::new(config.total_steps, arguments.json, caller)?;
    let mut display = Display::new(&config, &factory, &watch);
    let outcome = pool.run(py, || train(&config, &factory, &run, resumption.as_ref(), &mut display));
    watch.finish();
    if display.diverged > 0 && !arguments.json {
        note!(
            "divergences of the physics: {}; each ended its episode, see `diverged` in metrics.jsonl",
            display.diverged
        );
    }
    let outcome = outcome?;
    if outcome.interrupted {
        note!(
            "interrupted and saved at {} env steps; resume with: dappo-batch train --resume {}",
            outcome.progress.env_steps,
            run.root().display()
        );
        return Ok(INTERRUPTED);
    }
    let evaluation = pool.run(py, || {
        let stop = || watch.is_interrupted();
        evaluate_and_save(&outcome.policy, &config, Encoding::True, &factory, &run.evaluation(), &stop)
    })?;
    let Some(evaluation) = evaluation else {
        let root = run.root().display();
        note!("interrupted after the training; evaluate it with: dappo-batch evaluate {root}");
        return Ok(INTERRUPTED);
    };
    if !arguments.json {
        console::print(&evaluation.text());
        print_line!("run folder: {}", run.root().display());
    }
    Ok(0)
}

/// Opens a run to resume; `--steps` may extend its budget, `--set` change some settings, and another machine
/// may have other threads and devices of networks. The last part is the configuration for this machine, with
/// the robot to compile.
fn reopen(py: Python<'_>, folder: &Path, arguments: &TrainArgs) -> PyResult<(LockedRun, Resumption, Config)> {
    let OpenRun { folder, config: simulated, robot, is_kept, .. } =
        OpenRun::open(py, folder, arguments.robot_changed)?;
    let run = folder.lock().or_raise()?;
    let robot = if is_kept { None } else { Some(robot.to_keep(py)?) };
    let (_, stored) = RunFolder::open(run.root()).or_raise()?;
    let ConfigArgs { room, set, .. } = &arguments.config;
    let flags = [arguments.config.flags(), room.flags()].concat();
    let is_of_run = |flag: &&Assignment| match flag {
        Assignment::Value(key, _) => !OF_MACHINE.contains(&key.as_str()),
        Assignment::Text(_) => true,
    };
    let of_run: Vec<Assignment> = flags.iter().filter(is_of_run).cloned().collect();
    // As in a new run, an explicit `--set` wins over the flags.
    let changed = change(&stored, &[&of_run[..], set].concat()).or_raise()?;
    let mut config = change(&stored, &[&flags[..], set].concat()).or_raise()?;
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
        cpu: py.import("dappo_batch.machine")?.call_method0("cpu_name")?.extract()?,
        simd: simd::chosen().or_raise()?.name().into(),
        command: given.to_vec(),
    };
    let robot = RobotCopy::of(py, config)?.to_keep(py)?;
    RunFolder::create(&root, config, &meta, &robot).or_raise()
}

fn describe(config: &Config, factory: &TableFactory, run: &RunFolder) -> Result<String> {
    let (preset, changed) = config.ppo.closest_preset()?;
    let changed =
        if changed.is_empty() { String::new() } else { format!(", changed: {}", changed.join(", ")) };
    Ok(format!(
        "{} · {} · PPO preset {preset}{changed} · {} envs × {} steps · reward {} · {} env steps → {}",
        factory.robot().name,
        config.learner(),
        config.env.num_envs,
        config.horizon,
        factory.reward_name(config),
        config.total_steps,
        run.root().display()
    ))
}

/// Shows iterations.
struct Display<'a> {
    watch: &'a Watch<'a>,
    iterations: u64,
    steps_an_iteration: u64,
    /// Duration of an env step, s.
    control_period: f64,
    last_walked: String,
    diverged: u64,
}

impl<'a> Display<'a> {
    fn new(config: &Config, factory: &TableFactory, watch: &'a Watch<'a>) -> Self {
        let steps_an_iteration = (config.env.num_envs * config.horizon) as u64;
        let iterations = config.total_steps.div_ceil(steps_an_iteration);
        Self {
            watch,
            iterations,
            steps_an_iteration,
            control_period: factory.control_period(),
            last_walked: "no episode has ended".to_owned(),
            diverged: 0,
        }
    }
}

impl Observer for Display<'_> {
    fn iteration(&mut self, metrics: &Metrics) {
        self.diverged += metrics.diverged;
        if self.watch.object(metrics) {
            return;
        }
        let EpisodeSummary { forward_reward, episode_length, .. } = metrics.episodes;
        if let Some(share) = metrics.tracking {
            self.last_walked = format!("tracking {share:.2}");
        } else if let Some((reward, length)) = forward_reward.zip(episode_length) {
            let (velocity, distance) = (reward / length, reward * self.control_period);
            self.last_walked = format!("forward reward {reward:.0} ({velocity:.2} m/s, {distance:.1} m)");
        }
        let rate = self.steps_an_iteration as f64 / (metrics.rollout_seconds + metrics.update_seconds);
        let message = format!(
            "iteration {}/{} · {} · {} · {:.1} k steps/s (rollout {:.2} s, update {:.2} s)",
            metrics.iteration,
            self.iterations,
            metrics.stage,
            self.last_walked,
            rate / 1000.0,
            metrics.rollout_seconds,
            metrics.update_seconds
        );
        if metrics.iteration.is_multiple_of(20) || metrics.iteration == self.iterations {
            self.watch.line(&message);
        }
        self.watch.step(metrics.env_steps, message);
    }

    fn should_stop(&self) -> bool {
        self.watch.is_interrupted()
    }
}
