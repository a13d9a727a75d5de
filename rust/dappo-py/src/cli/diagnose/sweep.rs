//! `dappo-batch diagnose sweep`: from nothing to Table 1. Each part is a command that a user could give as well.

use std::ffi::{OsStr, OsString};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use clap::ValueEnum;
use dappo_diagnose::dataset::Dataset;
use dappo_diagnose::sweep::{CellResult, Grid, SweepData, SweepObserver, Table, sweep};
use dappo_learn::Result;
use dappo_learn::config::Layers;
use dappo_learn::run_folder::RunFolder;
use dappo_sim::threads::available;
use pyo3::prelude::*;

use super::settings;
use crate::cli::args::{Command, DiagnoseCommand, SweepArgs, Threads};
use crate::cli::console::{note, print, print_line};
use crate::cli::{self, Caller, INTERRUPTED, train};
use crate::errors::{Kind, OrRaise, raise};
use crate::run_robot::RobotCopy;

/// Seed of the test rollouts; training rollouts have seed 0.
const TEST_SEED: &str = "1000000";

pub fn run(py: Python<'_>, arguments: &SweepArgs, caller: &Caller) -> PyResult<i32> {
    let grid = grid(arguments);
    let base = settings(Layers::default(), &arguments.set).or_raise()?;
    let (pairs, test) = (arguments.out.join("pairs"), arguments.out.join("test"));
    // Each part of the sweep keeps as many threads busy as the cells do.
    let jobs = arguments.jobs.map_or_else(available, Threads::count);
    let mut commands = Vec::new();
    let expert = arguments.expert.clone().unwrap_or_else(|| arguments.out.join("expert"));
    if arguments.expert.is_none() && !is_trained(&expert, arguments.expert_steps.wide()) {
        commands.push(expert_command(arguments, &expert, jobs));
    }
    let most = |numbers: &[usize]| numbers.iter().copied().max().unwrap_or(1).to_string();
    let collect = |rollouts: String, seed: &str, out: &Path| {
        let (steps, threads) = (most(&grid.timesteps), jobs.to_string());
        let sizes =
            ["--rollouts", &rollouts, "--timesteps", &steps, "--seed", seed, "--threads", &threads, "--out"];
        let begin = [OsStr::new("diagnose"), OsStr::new("collect"), expert.as_os_str()];
        let sizes = sizes.map(OsStr::new);
        begin.into_iter().chain(sizes).chain([out.as_os_str()]).map(OsStr::to_owned).collect::<Vec<_>>()
    };
    commands.push(collect(most(&grid.rollouts), "0", &pairs));
    commands.push(collect(arguments.test_rollouts.to_string(), TEST_SEED, &test));
    let changed = arguments.changed.robot_changed.and_then(|changed| changed.to_possible_value());
    for mut command in commands {
        // A new training has no robot that could have changed.
        if let Some(changed) = &changed
            && !command.iter().any(|argument| argument == "--run")
        {
            command.extend(["--robot-changed".into(), changed.get_name().into()]);
        }
        let code = give(py, &command, caller)?;
        if code != 0 {
            return Ok(code);
        }
    }
    let open = |folder: &Path| Dataset::open(folder).or_raise();
    let robot = RobotCopy::read(py, &pairs)?.map(|copy| copy.to_keep(py)).transpose()?;
    let (pairs, test) = (open(&pairs)?, open(&test)?);
    let subject = &pairs.header().subject;
    let watcher = Watcher { interrupted: caller.watch()? };
    let data = SweepData { subject, pairs: &pairs, test: &test, robot: robot.as_ref() };
    let results = py.detach(|| -> Result<Option<Table>> {
        let cells = arguments.out.join("cells");
        let Some(results) = sweep(&grid, &base, data, &cells, jobs, &watcher)? else {
            return Ok(None);
        };
        let table = Table::new(&subject.robot, &grid, &results);
        table.write(&arguments.out)?;
        Ok(Some(table))
    });
    let Some(table) = results.or_raise()? else {
        note!("interrupted; the same command goes on with the cells that are missing");
        return Ok(INTERRUPTED);
    };
    let (above, known) = table.at_or_above_the_paper();
    print(&table.text());
    print_line!("rows at or above the paper: {above} of {known}");
    print_line!("folder of the sweep: {}", arguments.out.display());
    Ok(0)
}

fn grid(arguments: &SweepArgs) -> Grid {
    Grid {
        timesteps: arguments.timesteps.iter().map(|steps| steps.count()).collect(),
        methods: arguments.methods.iter().map(|method| method.get()).collect(),
        rollouts: arguments.rollouts.iter().map(|rollouts| rollouts.count()).collect(),
        seeds: arguments.seeds.wide(),
        samples: arguments.samples.count(),
    }
}

/// Whether a training of at least so many env steps has come to its end, which is an evaluation.
fn is_trained(run: &Path, steps: u64) -> bool {
    let has_budget = RunFolder::open(run).is_ok_and(|(_, config)| config.total_steps >= steps);
    has_budget && run.join("eval").join("per_class.csv").exists()
}

/// Trains the expert, or goes on with it.
fn expert_command(arguments: &SweepArgs, expert: &Path, jobs: usize) -> Vec<OsString> {
    let (expert_text, steps) = (expert.into(), arguments.expert_steps.to_string());
    let mut command: Vec<OsString> = vec!["train".into()];
    if expert.join("config.toml").exists() {
        command.extend(["--resume".into(), expert_text]);
    } else {
        command.extend(["--run".into(), expert_text, "--healthy".into()]);
        if let Some(robot) = &arguments.robot {
            command.extend(["--robot".into(), robot.into()]);
        }
    }
    command.extend(["--steps".into(), steps.into(), "--threads".into(), jobs.to_string().into()]);
    command
}

/// Gives a command as a user would; returns its exit code.
fn give(py: Python<'_>, command: &[OsString], caller: &Caller) -> PyResult<i32> {
    let words = cli::words(command);
    note!("{}", words.join(" "));
    let cli = cli::parse(command).map_err(|error| raise(Kind::Config, error.to_string()))?;
    match &cli.command {
        Command::Train(arguments) => train::run(py, arguments, &words, caller),
        Command::Diagnose(arguments) => match &arguments.command {
            DiagnoseCommand::Collect(arguments) => super::collect::run(py, arguments, caller),
            _ => Ok(0),
        },
        _ => Ok(0),
    }
}

/// Says which cells are done and passes Ctrl-C on.
struct Watcher {
    interrupted: Arc<AtomicBool>,
}

impl SweepObserver for Watcher {
    fn finished(&self, result: &CellResult, done: usize, total: usize) {
        note!(
            "{done}/{total} {}: {:.2} % (validated {:.2} %), {} epochs",
            result.cell.name(),
            100.0 * result.accuracy,
            100.0 * result.validation_accuracy,
            result.epochs
        );
    }

    fn should_stop(&self) -> bool {
        self.interrupted.load(Ordering::Relaxed)
    }
}
