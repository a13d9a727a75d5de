//! `dappo-batch diagnose collect`.

use std::path::Path;
use std::time::Instant;

use dappo_diagnose::Preset;
use dappo_diagnose::collect::{ActingPolicy, CollectConfig, CollectObserver, check, collect};
use dappo_diagnose::dataset::{DatasetHeader, Shard};
use dappo_learn::config::Config;
use dappo_learn::envs::EnvFactory;
use dappo_learn::fleet::Fleet;
use dappo_learn::robot_files::keep_first;
use dappo_learn::run_folder::RunFolder;
use dappo_learn::{FileKind, LearnError, Result, RunPolicy};
use dappo_sim::Severity;
use pyo3::prelude::*;
use serde_json::json;

use crate::cli::args::{CollectArgs, OneOf};
use crate::cli::console::{note, print_line};
use crate::cli::progress::Watch;
use crate::cli::{Caller, INTERRUPTED, settings};
use crate::errors::OrRaise;
use crate::factory::TableFactory;
use crate::outside_policy::OutsidePolicy;
use crate::pool::Pool;
use crate::run_robot::{OpenRun, RobotCopy};

/// What acts while robots are recorded.
enum Expert {
    Run(Box<RunPolicy>),
    Outside(OutsidePolicy),
}

pub fn run(py: Python<'_>, arguments: &CollectArgs, caller: &Caller) -> PyResult<i32> {
    let run = OpenRun::open(py, &arguments.expert, arguments.robot.robot_changed)?;
    let policy = arguments.policy.as_deref();
    let policy = policy.map(|policy| run.open_other(py, policy, false)).transpose()?;
    let OpenRun { folder, mut config, robot, .. } = run;
    settings::simulate_with(&arguments.simulation, &mut config).or_raise()?;
    // Before the robot is compiled, which takes time.
    arguments.check().or_raise()?;
    let pool = Pool::new(arguments.simulation.threads())?;
    let factory = TableFactory::compile(py, &config)?;
    let preset = match arguments.preset {
        Some(preset) => preset.get(),
        None => preset_for(&factory, arguments.json).or_raise()?,
    };
    let wanted = arguments.collection(preset, config.damage.severity).or_raise()?;
    let sizes = factory.sizes(&config).or_raise()?;
    let of_run = |folder: &RunFolder, config: &Config| RunPolicy::stateless(folder, config, &factory);
    let expert = match &arguments.act {
        Some(function) => Expert::Outside(OutsidePolicy::new(py, function, sizes)?),
        None => Expert::Run(Box::new(pool.run(py, || of_run(&folder, &config))?)),
    };
    let expert = match &expert {
        Expert::Outside(policy) => ActingPolicy::of_other(policy, policy.name(), sizes),
        Expert::Run(policy) => ActingPolicy::of_run(policy),
    };
    let policy = policy.map(|run| pool.run(py, || of_run(&run.folder, &run.config))).transpose()?;
    let policy = policy.as_ref().map(ActingPolicy::of_run);
    pool.run(py, || check(&wanted, &factory, policy.as_ref()))?;
    keep_robot(py, &arguments.out, (folder.root(), &robot))?;
    if !arguments.json {
        note!("{}", describe(arguments, &wanted, &factory));
    }
    let watch = Watch::new(0, arguments.json, caller)?;
    let steps = factory.space().classes().len() * wanted.timesteps;
    let mut display = Display { watch, out: &arguments.out, steps, begun: None };
    let start = Instant::now();
    let collected =
        pool.run(py, || collect(&wanted, &factory, &expert, policy.as_ref(), &arguments.out, &mut display));
    display.watch.finish();
    let collected = collected?;
    let seconds = start.elapsed().as_secs_f64();
    let (out, rollouts) = (arguments.out.display(), collected.rollouts);
    if arguments.json {
        caller.object(&json!({
            "data": out.to_string(), "rollouts": rollouts, "classes": factory.space().classes().len(),
            "seconds": seconds, "diverged": collected.diverged, "interrupted": collected.interrupted,
        }));
    } else {
        if collected.diverged > 0 {
            note!(
                "divergences of the physics: {}; each robot continued from its reference pose",
                collected.diverged
            );
        }
        if collected.interrupted {
            note!("interrupted after {rollouts} rollouts; resume with the same command");
        } else {
            print_line!("dataset: {out} with {rollouts} rollouts, {seconds:.1} s");
        }
    }
    Ok(if collected.interrupted { INTERRUPTED } else { 0 })
}

/// The preset of a robot for which none was given.
fn preset_for(factory: &TableFactory, json: bool) -> Result<Preset> {
    let robot = factory.backend(1, None, factory.evaluation_physics())?;
    if Fleet::new(robot).check_twins().is_ok() {
        return Ok(Preset::Residual);
    }
    if !json {
        note!(
            "{} does not observe its whole state, which a twin would need: preset observation, without twins",
            factory.robot().name
        );
    }
    Ok(Preset::Observation)
}

impl CollectArgs {
    /// Fails with what is wrong for every preset.
    fn check(&self) -> Result<()> {
        self.collection(self.preset.map_or(Preset::Residual, OneOf::get), Severity::Same(1.0)).map(drop)
    }

    fn collection(&self, preset: Preset, severity: Severity) -> Result<CollectConfig> {
        let mut protocol = preset.protocol();
        protocol.timing.onset = self.onset.unwrap_or(protocol.timing.onset);
        protocol.timing.delay = self.delay.unwrap_or(protocol.timing.delay);
        protocol.timing.check()?;
        match &mut protocol.twin {
            Some(twin) => {
                twin.action = self.twin_action.map_or(twin.action, OneOf::get);
                twin.resync = self.resync.map_or(twin.resync, |steps| steps.get() as u32);
            }
            None if self.twin_action.is_some() || self.resync.is_some() => {
                return Err(LearnError::Invalid(
                    "there is no twin with the preset observation; leave out --twin-action and --resync"
                        .into(),
                ));
            }
            None => {}
        }
        Ok(CollectConfig {
            rollouts: self.rollouts.count(),
            timesteps: self.timesteps.count(),
            seed: self.seed.wide(),
            protocol,
            shard: Shard::parse(&self.shard)?,
            severity,
        })
    }
}

/// Keeps a copy of the robot in a new dataset; fails if the records of an earlier one are of another robot.
fn keep_robot(py: Python<'_>, out: &Path, (run, robot): (&Path, &RobotCopy)) -> PyResult<()> {
    // The records of earlier versions contain no robot.
    if !DatasetHeader::exists(out) {
        keep_first(out, &robot.to_keep(py)?).or_raise()?;
    }
    match RobotCopy::read(py, out)? {
        Some(kept) => robot.check_same(py, run, (out, &kept), true),
        None => Ok(()),
    }
}

fn describe(arguments: &CollectArgs, wanted: &CollectConfig, factory: &TableFactory) -> String {
    format!(
        "{} · {} rollouts × {} classes × {} steps · preset {} · {} → {}",
        factory.robot().name,
        wanted.shard.range(wanted.rollouts).len(),
        factory.space().classes().len(),
        wanted.timesteps,
        wanted.protocol.name(),
        factory.describe(factory.evaluation_physics()),
        arguments.out.display()
    )
}

/// Shows progress, and checks the free space on the disk.
struct Display<'a> {
    watch: Watch<'a>,
    out: &'a Path,
    /// Recorded steps a rollout.
    steps: usize,
    begun: Option<(usize, Instant)>,
}

impl CollectObserver for Display<'_> {
    fn begin(&mut self, missing: usize, bytes: u64) -> Result<()> {
        self.begun = Some((missing, Instant::now()));
        let Some(free) = free_space(self.out).filter(|&free| free < bytes) else { return Ok(()) };
        let gigabytes = |bytes: u64| bytes as f64 / 1e9;
        Err(FileKind::Dataset.unusable(
            self.out,
            format!(
                "{missing} rollouts take {:.1} GB, but only {:.1} GB are free; make room, choose another disk, or collect fewer",
                gigabytes(bytes),
                gigabytes(free)
            ),
        ))
    }

    fn collected(&mut self, done: usize, total: usize) {
        self.watch.set_length(total as u64);
        if let Some((missing, start)) = self.begun {
            let steps = (done + missing).saturating_sub(total) * self.steps;
            let rate = steps as f64 / start.elapsed().as_secs_f64() / 1000.0;
            let message = format!("rollout {done}/{total} · {rate:.0} k recorded steps/s");
            self.watch.step(done as u64, message);
        }
    }

    fn should_stop(&self) -> bool {
        self.watch.is_interrupted()
    }
}

/// Free bytes on the disk of a folder, if Python can determine it.
fn free_space(folder: &Path) -> Option<u64> {
    Python::attach(|py| {
        let usage = py.import("shutil").ok()?.call_method1("disk_usage", (folder,)).ok()?;
        usage.getattr("free").ok()?.extract().ok()
    })
}
