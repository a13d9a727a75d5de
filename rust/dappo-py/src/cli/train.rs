//! `dappo-batch train`.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::{SystemTime, UNIX_EPOCH};

use dappo_learn::config::Config;
use dappo_learn::run_folder::{Meta, RunFolder};
use dappo_learn::train::train;
use pyo3::prelude::*;
use signal_hook::consts::{SIGINT, SIGTERM};

use super::args::TrainArgs;
use super::evaluate::{evaluate_and_save, show};
use super::progress::Display;
use super::{INTERRUPTED, console, settings};
use crate::errors::{Kind, from_learn, raise};
use crate::factory::TableFactory;

pub fn run(py: Python<'_>, arguments: &TrainArgs, argv: &[String]) -> PyResult<i32> {
    let (config, run) = match &arguments.resume {
        Some(folder) => reopen(folder.clone(), arguments)?,
        None => {
            let config = settings::resolve(&arguments.config)?;
            (config, None)
        }
    };
    let factory = TableFactory::compile(py, &config)?;
    let resume = run.is_some();
    let run = match run {
        Some(run) => run,
        None => create(py, arguments, &config, &factory, argv)?,
    };
    if !arguments.json {
        console::note(&describe(&config, &factory, &run));
    }

    let interrupted = Arc::new(AtomicBool::new(false));
    watch_signals(&interrupted)?;
    let mut display = Display::new(&config, arguments.json, interrupted);
    let outcome = py.detach(|| train(&config, &factory, &run, resume, &mut display));
    display.finish();
    let outcome = outcome.map_err(|error| from_learn(&error))?;
    if outcome.interrupted {
        console::note(&format!(
            "interrupted and saved at {} env steps; go on with: dappo-batch train --resume {}",
            outcome.progress.env_steps,
            run.root().display()
        ));
        return Ok(INTERRUPTED);
    }
    let (episodes, seed) = (config.evaluation.episodes, config.evaluation.seed);
    let evaluation = py.detach(|| evaluate_and_save(&outcome.ppo, &config, &factory, &run, episodes, seed));
    if !arguments.json {
        show(&evaluation.map_err(|error| from_learn(&error))?);
        console::print_line(&format!("run folder: {}", run.root().display()));
    }
    Ok(0)
}

/// Opens a run to go on with; `--steps` may extend its budget.
fn reopen(folder: PathBuf, arguments: &TrainArgs) -> PyResult<(Config, Option<RunFolder>)> {
    let (run, mut config) = RunFolder::open(&folder).map_err(|error| from_learn(&error))?;
    if let Some(steps) = arguments.config.steps {
        config.total_steps = u64::try_from(steps)
            .map_err(|_| raise(Kind::Config, format!("--steps is {steps}, expected a positive number")))?;
        run.write_config(&config).map_err(|error| from_learn(&error))?;
    }
    if let Some(threads) = arguments.config.threads {
        config.env.threads = usize::try_from(threads).ok().filter(|&threads| threads > 0);
    }
    Ok((config, Some(run)))
}

fn create(
    py: Python<'_>,
    arguments: &TrainArgs,
    config: &Config,
    factory: &TableFactory,
    argv: &[String],
) -> PyResult<RunFolder> {
    let seconds = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |time| time.as_secs());
    let robot = dappo_learn::envs::EnvFactory::robot(factory).name.clone();
    let root = arguments
        .run
        .clone()
        .unwrap_or_else(|| PathBuf::from("runs").join(format!("{robot}-{}-{seconds}", config.seed)));
    let meta = Meta {
        version: env!("CARGO_PKG_VERSION").into(),
        mujoco: py.import("mujoco")?.getattr("__version__")?.extract()?,
        backend: "mujoco".into(),
        physics: factory.integrator(py)?,
        reward: factory.reward_name(config),
        threads: config
            .env
            .threads
            .unwrap_or_else(|| std::thread::available_parallelism().map_or(1, usize::from)),
        platform: format!("{}-{}", std::env::consts::OS, std::env::consts::ARCH),
        command: std::iter::once("dappo-batch".to_owned()).chain(argv.iter().cloned()).collect(),
    };
    let run = RunFolder::create(&root, config).map_err(|error| from_learn(&error))?;
    run.write_meta(&meta).map_err(|error| from_learn(&error))?;
    Ok(run)
}

fn describe(config: &Config, factory: &TableFactory, run: &RunFolder) -> String {
    format!(
        "{} · {} · {} envs × {} steps · reward {} · {} env steps → {}",
        config.robot,
        if config.env.observe_damage { "DA-PPO" } else { "PPO-Unaware" },
        config.env.num_envs,
        config.horizon,
        factory.reward_name(config),
        config.total_steps,
        run.root().display()
    )
}

/// The first Ctrl-C or `kill` asks the training to save and stop, the second ends the program at once.
fn watch_signals(interrupted: &Arc<AtomicBool>) -> PyResult<()> {
    let failed = |error: std::io::Error| raise(Kind::Simulation, format!("cannot watch for Ctrl-C: {error}"));
    for signal in [SIGINT, SIGTERM] {
        signal_hook::flag::register_conditional_shutdown(signal, INTERRUPTED, Arc::clone(interrupted))
            .map_err(failed)?;
        signal_hook::flag::register(signal, Arc::clone(interrupted)).map_err(failed)?;
    }
    Ok(())
}
