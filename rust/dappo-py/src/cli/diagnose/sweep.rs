//! `dappo-batch diagnose sweep`: from nothing to Table 1. Each part is a command that a user could give as well.

use std::ffi::{OsStr, OsString};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use clap::ValueEnum;
use dappo_diagnose::DiagnoserConfig;
use dappo_diagnose::dataset::Dataset;
use dappo_diagnose::sweep::{CellResult, Grid, SweepData, SweepObserver, Table, sweep};
use dappo_learn::Result;
use dappo_learn::evaluate::MeanVelocities;
use dappo_learn::run_folder::RunFolder;
use dappo_sim::threads::available;
use pyo3::prelude::*;

use crate::cli::args::{SweepArgs, Threads};
use crate::cli::console::{note, print, print_line};
use crate::cli::{self, Caller, INTERRUPTED};
use crate::errors::{Kind, OrRaise, raise};
use crate::run_robot::RobotCopy;

/// Seed of the test rollouts; training rollouts have seed 0.
const TEST_SEED: &str = "1000000";

pub fn run(py: Python<'_>, arguments: &SweepArgs, caller: &Caller) -> PyResult<i32> {
    let grid = grid(arguments);
    let base = DiagnoserConfig::with(&arguments.set).or_raise()?;
    // Each part of the sweep keeps as many threads busy as the cells do.
    let jobs = arguments.jobs.map_or_else(available, Threads::count);
    let (pairs, test) = (arguments.out.join("pairs"), arguments.out.join("test"));
    for command in commands(arguments, &grid, jobs, [&pairs, &test]) {
        let words = cli::words(&command);
        note!("{}", words.join(" "));
        let parsed = cli::parse(&command).map_err(|error| raise(Kind::Config, error.to_string()))?;
        let code = cli::run(py, &parsed.command, &words, caller)?;
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
        note!("interrupted; resume with the same command");
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

/// What comes before the cells: the training of the expert, unless there is one, and the two datasets.
fn commands(
    arguments: &SweepArgs,
    grid: &Grid,
    jobs: usize,
    [pairs, test]: [&Path; 2],
) -> Vec<Vec<OsString>> {
    let words = |words: &[&dyn AsRef<OsStr>]| -> Vec<OsString> {
        words.iter().map(|word| word.as_ref().to_owned()).collect()
    };
    let changed = arguments.changed.robot_changed.and_then(|changed| changed.to_possible_value());
    let changed = changed.map_or_else(Vec::new, |changed| words(&[&"--robot-changed", &changed.get_name()]));
    let jobs = jobs.to_string();
    let expert = arguments.expert.clone().unwrap_or_else(|| arguments.out.join("expert"));
    let mut commands = Vec::new();
    if arguments.expert.is_none() && !is_trained(&expert, arguments.expert_steps.wide()) {
        let mut train = if expert.join("config.toml").exists() {
            [words(&[&"train", &"--resume", &expert]), changed.clone()].concat()
        } else {
            // A new training has no robot that could have changed.
            let robot = arguments.robot.as_ref().map(|robot| words(&[&"--robot", robot]));
            [words(&[&"train", &"--run", &expert, &"--healthy"]), robot.unwrap_or_default()].concat()
        };
        let steps = arguments.expert_steps.to_string();
        train.extend(words(&[&"--steps", &steps, &"--threads", &jobs]));
        commands.push(train);
    }
    let most = |numbers: &[usize]| numbers.iter().copied().max().unwrap_or(1).to_string();
    let steps = most(&grid.timesteps);
    let test_rollouts = arguments.test_rollouts.to_string();
    for (out, rollouts, seed) in [(pairs, most(&grid.rollouts), "0"), (test, test_rollouts, TEST_SEED)] {
        let mut collect = words(&[&"diagnose", &"collect", &expert, &"--out", &out]);
        collect.extend(words(&[&"--rollouts", &rollouts, &"--timesteps", &steps]));
        collect.extend(words(&[&"--seed", &seed, &"--threads", &jobs, &"--preset", &"paper"]));
        commands.push([collect, changed.clone()].concat());
    }
    commands
}

/// Whether a training of at least this many env steps has finished, which ends with an evaluation.
fn is_trained(run: &Path, steps: u64) -> bool {
    RunFolder::open(run).is_ok_and(|(run, config)| {
        config.total_steps >= steps && MeanVelocities::read(&run).is_ok_and(|found| found.is_some())
    })
}

/// Prints which cells are done and forwards Ctrl-C.
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
