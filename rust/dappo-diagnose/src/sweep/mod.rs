//! Table 1 of Verma et al. (2019): many trainings over one dataset, each a cell of a grid.

mod grid;
mod paper;
mod table;

use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use dappo_learn::error::{LearnError, Result};
use dappo_learn::files::{self, io, own_folder, read_text, remove_folder, stem_of, write_atomically};
use dappo_learn::robot_files::{RobotFiles, keep};
use dappo_sim::ThreadPool;
use serde::{Deserialize, Serialize};

use super::train::{EpochMetrics, EpochProgress, Observer, train};
use super::{DiagnoserConfig, PairSource, Subject, TrainingFolder};
use crate::memory::check_diagnosers;

pub use grid::{Cell, Grid};
pub use paper::PaperResult;
pub use table::{Row, Table};

/// Stem of the files with a cell's results on the test rollouts.
const TEST: &str = "test";

/// The result of a cell.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CellResult {
    /// The cell.
    pub cell: Cell,
    /// Share of the test windows whose class was diagnosed correctly.
    pub accuracy: f64,
    /// Its standard error over test rollouts.
    pub standard_error: f64,
    /// The same of the validation windows, by which the epoch was chosen.
    pub validation_accuracy: f64,
    /// Mean of −ln p(true class) over the test windows.
    pub log_loss: f64,
    /// Mean distance of confidence and accuracy on the test windows.
    pub calibration_error: f64,
    /// Epochs trained.
    pub epochs: u64,
    /// The epoch whose weights were kept.
    pub best_epoch: u64,
}

/// Observer of a sweep; cells may be trained side by side.
pub trait SweepObserver: Sync {
    /// Called after every cell, those of earlier commands included.
    fn finished(&self, result: &CellResult, done: usize, total: usize);

    /// Whether to stop now; unfinished cells resume from their last epoch in a later command.
    fn should_stop(&self) -> bool;
}

/// The data of a sweep.
#[derive(Clone, Copy)]
pub struct SweepData<'a> {
    /// The robot and its classes.
    pub subject: &'a Subject,
    /// What is trained and validated on.
    pub pairs: &'a dyn PairSource,
    /// What is tested on: rollouts of another seed.
    pub test: &'a dyn PairSource,
    /// The files of the robot, for the diagnosers to keep; records of earlier versions have none.
    pub robot: Option<&'a RobotFiles>,
}

/// Trains and tests the cells that `folder` does not hold yet, `jobs` at a time with a thread each. `None` if it was
/// stopped.
pub fn sweep(
    grid: &Grid,
    base: &DiagnoserConfig,
    data: SweepData<'_>,
    folder: &Path,
    jobs: usize,
    observer: &dyn SweepObserver,
) -> Result<Option<Vec<CellResult>>> {
    let cells = grid.cells();
    let configs = cells.iter().map(|cell| cell.config(base, grid, data.subject.classes()));
    let configs: Vec<DiagnoserConfig> = configs.collect();
    for config in &configs {
        config.check()?;
        config.check_data(data.pairs)?;
    }
    check_diagnosers(&configs, jobs.max(1), data.pairs, data.subject)?;
    let (next, done, failed) = (AtomicUsize::new(0), AtomicUsize::new(0), AtomicBool::new(false));
    let results: Vec<Mutex<Option<Result<CellResult>>>> = cells.iter().map(|_| Mutex::new(None)).collect();
    let work = || {
        while !failed.load(Ordering::Relaxed) && !observer.should_stop() {
            let index = next.fetch_add(1, Ordering::Relaxed);
            let (Some(cell), Some(config)) = (cells.get(index), configs.get(index)) else { break };
            let stop = || failed.load(Ordering::Relaxed) || observer.should_stop();
            let result = match run_cell(cell, config, data, &folder.join(cell.name()), &stop) {
                Ok(None) => break,
                Ok(Some(result)) => {
                    observer.finished(&result, done.fetch_add(1, Ordering::Relaxed) + 1, cells.len());
                    Ok(result)
                }
                Err(error) => {
                    failed.store(true, Ordering::Relaxed);
                    Err(error)
                }
            };
            *results[index].lock().unwrap_or_else(std::sync::PoisonError::into_inner) = Some(result);
        }
    };
    let pools: Vec<ThreadPool> =
        (0..jobs.max(1)).map(|_| ThreadPool::new(Some(1))).collect::<std::result::Result<_, _>>()?;
    std::thread::scope(|scope| -> Result<()> {
        let waiting: Vec<_> = pools.iter().map(|pool| scope.spawn(|| pool.install(work))).collect();
        for waits in waiting {
            waits.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))?;
        }
        Ok(())
    })?;
    let results = results
        .into_iter()
        .map(|result| result.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner).transpose());
    // An error comes before a gap: the other workers stop because of it.
    let (errors, finished): (Vec<_>, Vec<_>) = results.partition(std::result::Result::is_err);
    errors.into_iter().next().unwrap_or(Ok(None))?;
    Ok(finished.into_iter().map(std::result::Result::ok).map(Option::flatten).collect())
}

/// Trains and tests one cell, or reads what an earlier command found; `None` if it was stopped.
fn run_cell(
    cell: &Cell,
    config: &DiagnoserConfig,
    data: SweepData<'_>,
    root: &Path,
    stop: &(dyn Fn() -> bool + Sync),
) -> Result<Option<CellResult>> {
    own_folder(root)?;
    let path = root.join("result.json");
    if path.exists() {
        let (folder, earlier) = TrainingFolder::open(root)?;
        check_same(&earlier, config, root)?;
        let result = read_result(&path)?;
        remove_checkpoints(&folder)?;
        return Ok(Some(result));
    }
    let resume = root.join("config.toml").exists();
    let folder = if resume {
        let (folder, earlier) = TrainingFolder::open(root)?;
        check_same(&earlier, config, root)?;
        folder.lock()?
    } else {
        let folder = TrainingFolder::create(root, config)?;
        data.robot.map_or(Ok(()), |robot| keep(root, robot))?;
        folder
    };
    let outcome = train(config, data.subject, data.pairs, &folder, resume, &mut Quiet { stop })?;
    let (false, Some((best, diagnoser))) = (outcome.interrupted, outcome.best) else { return Ok(None) };
    let rollouts: Vec<usize> = (0..data.test.rollouts()).collect();
    let report = diagnoser.evaluate(data.test, &rollouts)?;
    report.write(&root.join("eval"), TEST)?;
    let summary = report.summary();
    let result = CellResult {
        cell: *cell,
        accuracy: summary.accuracy,
        standard_error: summary.standard_error,
        validation_accuracy: best.validation_accuracy,
        log_loss: summary.log_loss,
        calibration_error: summary.calibration_error,
        epochs: outcome.epochs,
        best_epoch: best.epoch,
    };
    let text =
        serde_json::to_string_pretty(&result).map_err(|error| LearnError::Invalid(error.to_string()))?;
    write_atomically(&path, text.as_bytes())?;
    remove_checkpoints(&folder)?;
    Ok(Some(result))
}

/// Removes the checkpoints of a finished cell, and what a kill has left of them. The model stays; this
/// training is not resumed.
fn remove_checkpoints(folder: &TrainingFolder) -> Result<()> {
    let checkpoints = folder.checkpoints();
    files::sweep(folder.root(), |stem| stem == stem_of(&checkpoints));
    remove_folder(&checkpoints)
}

fn read_result(path: &Path) -> Result<CellResult> {
    let text = read_text(path).map_err(io(path))?;
    serde_json::from_str(&text)
        .map_err(|error| LearnError::Invalid(format!("{}: {error}; remove its folder", path.display())))
}

/// Refuses to resume a cell that an earlier command trained differently.
fn check_same(earlier: &DiagnoserConfig, config: &DiagnoserConfig, root: &Path) -> Result<()> {
    if earlier == config {
        return Ok(());
    }
    Err(LearnError::Invalid(format!(
        "{} holds a cell that was trained with other settings; choose another folder, or the settings of its config.toml",
        root.display()
    )))
}

/// Observes the training of a cell.
struct Quiet<'a> {
    stop: &'a (dyn Fn() -> bool + Sync),
}

impl Observer for Quiet<'_> {
    fn progress(&mut self, _: &EpochProgress) {}

    fn epoch(&mut self, _: &EpochMetrics) {}

    fn should_stop(&self) -> bool {
        (self.stop)()
    }
}
