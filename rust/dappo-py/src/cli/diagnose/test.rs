//! `dappo-batch diagnose test`.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use dappo_diagnose::cost::{Cost, cost};
use dappo_diagnose::dataset::Dataset;
use dappo_diagnose::{Diagnoser, DiagnosisSummary, PairSource, Report, TrainingFolder};
use dappo_learn::{LearnError, Result};
use dappo_nn::Policy;
use pyo3::prelude::*;
use serde_json::json;

use crate::cli::args::{Count, TestDiagnoserArgs, Threads};
use crate::cli::console::{Table, print_line};
use crate::cli::{Caller, INTERRUPTED, policy};
use crate::factory::TableFactory;
use crate::pool::Pool;
use crate::run_robot::{OpenRun, RobotCopy};

/// A diagnoser on a dataset.
struct Tested {
    model: String,
    data: String,
    summary: DiagnosisSummary,
    report: Report,
    cost: Option<Cost>,
}

pub fn run(py: Python<'_>, arguments: &TestDiagnoserArgs, caller: &Caller) -> PyResult<i32> {
    let pool = Pool::new(arguments.threads.map(Threads::count))?;
    let follower =
        arguments.policy.as_deref().map(|run| Follower::open(py, &pool, run, arguments)).transpose()?;
    check_robots(py, arguments)?;
    let interrupted = caller.watch()?;
    let tested = pool.run(py, || test_all(arguments, follower.as_ref(), &interrupted))?;
    let Some(tested) = tested else { return Ok(INTERRUPTED) };
    if arguments.json {
        let objects: Vec<_> = tested
            .iter()
            .map(|tested| {
                json!({
                    "model": tested.model, "data": tested.data, "summary": tested.summary, "cost": tested.cost,
                    "classes": tested.report.class_names, "class_accuracy": tested.report.class_accuracy(),
                })
            })
            .collect();
        caller.object(&objects);
    } else if let [only] = tested.as_slice() {
        show_classes(&only.report);
        show_summary(only);
    } else {
        tested.iter().for_each(show_summary);
        show_cross_table(&tested, arguments.data.len());
    }
    Ok(0)
}

/// Fails unless all diagnosers and records are of one robot; how it is damaged may differ.
fn check_robots(py: Python<'_>, arguments: &TestDiagnoserArgs) -> PyResult<()> {
    let mut first: Option<(&Path, RobotCopy)> = None;
    for folder in arguments.models.iter().chain(&arguments.data) {
        let Some(copy) = RobotCopy::read(py, folder)? else { continue };
        match &first {
            Some((root, robot)) => robot.check_same(py, root, (folder, &copy), false)?,
            None => first = Some((folder, copy)),
        }
    }
    Ok(())
}

/// Every diagnoser on every dataset; `None` when it was interrupted.
fn test_all(
    arguments: &TestDiagnoserArgs,
    follower: Option<&Follower>,
    interrupted: &Arc<AtomicBool>,
) -> Result<Option<Vec<Tested>>> {
    let open = |folder: &PathBuf| {
        TrainingFolder::open(folder).and_then(|(folder, _)| Ok((Diagnoser::load(&folder.model())?, folder)))
    };
    // All are opened before the first one is tested: a mistake shows at once.
    let models: Vec<_> = arguments.models.iter().map(open).collect::<Result<_>>()?;
    let datasets: Vec<Dataset> =
        arguments.data.iter().map(|data| Dataset::open(data)).collect::<Result<_>>()?;
    let stop = || interrupted.load(Ordering::Relaxed);
    let mut tested = Vec::new();
    for (diagnoser, folder) in &models {
        for (data, path) in datasets.iter().zip(&arguments.data) {
            if stop() {
                return Ok(None);
            }
            check_subject(diagnoser, data, folder, path)?;
            let report = diagnoser.evaluate(data, &(0..data.rollouts()).collect::<Vec<_>>())?;
            let cost = match follower {
                None => None,
                Some(follower) => match follower.cost(&report, &stop)? {
                    None => return Ok(None),
                    cost => cost,
                },
            };
            let name =
                path.file_name().map_or_else(|| "data".into(), |name| name.to_string_lossy().into_owned());
            report.write(&folder.eval(), &name)?;
            tested.push(Tested {
                model: folder.root().display().to_string(),
                data: path.display().to_string(),
                summary: report.summary(),
                report,
                cost,
            });
        }
    }
    Ok(Some(tested))
}

fn check_subject(diagnoser: &Diagnoser, data: &Dataset, folder: &TrainingFolder, path: &Path) -> Result<()> {
    if diagnoser.description().subject == data.header().subject {
        return Ok(());
    }
    Err(LearnError::Invalid(format!(
        "the diagnoser in {} knows {} damage classes of robot `{}`, the records in {} are of {} classes of `{}`; \
         they must be the same",
        folder.root().display(),
        diagnoser.description().subject.classes(),
        diagnoser.description().subject.robot,
        path.display(),
        data.header().subject.classes(),
        data.header().subject.robot
    )))
}

/// The policy that believes a diagnosis.
struct Follower {
    policy: Policy,
    config: dappo_learn::config::Config,
    factory: TableFactory,
}

impl Follower {
    fn open(py: Python<'_>, pool: &Pool, run: &Path, arguments: &TestDiagnoserArgs) -> PyResult<Self> {
        let run = OpenRun::open(py, run, arguments.robot.robot_changed)?;
        for model in &arguments.models {
            run.check_folder(py, model)?;
        }
        let OpenRun { folder, mut config, .. } = run;
        config.env.threads = Some(pool.num_threads());
        config.evaluation.episodes = arguments.episodes.map_or(config.evaluation.episodes, Count::count);
        let factory = TableFactory::compile(py, &config)?;
        let loaded = pool.run(py, || policy::load(&folder, &config, &factory))?;
        Ok(Self { policy: loaded.policy, config, factory })
    }

    fn cost(&self, report: &Report, stop: &dyn Fn() -> bool) -> Result<Option<Cost>> {
        cost(report, &self.policy, &self.config, &self.factory, stop)
    }
}

fn show_classes(report: &Report) {
    let mut table = Table::new(&["accuracy %", "<class"]);
    for (name, accuracy) in report.class_names.iter().zip(report.class_accuracy()) {
        table.row([percent(accuracy), name.clone()]);
    }
    table.print();
}

fn percent(share: f64) -> String {
    format!("{:.2}", 100.0 * share)
}

fn show_summary(tested: &Tested) {
    let DiagnosisSummary {
        rollouts,
        windows,
        accuracy,
        standard_error,
        held_out_accuracy,
        calibration_error,
        ..
    } = tested.summary;
    let error =
        if standard_error.is_nan() { String::new() } else { format!(" ± {:.2}", 100.0 * standard_error) };
    print_line!("{} on {}", tested.model, tested.data);
    print_line!(
        "  accuracy {:.2}{error} % of {windows} windows, {rollouts} rollouts; calibration error {:.2} %",
        100.0 * accuracy,
        100.0 * calibration_error
    );
    if let Some(accuracy) = held_out_accuracy {
        print_line!("  on classes that it was not trained on: {:.2} %", 100.0 * accuracy);
    }
    if let Some(cost) = &tested.cost {
        print_line!(
            "  forward reward of the policy: {:.1} told the truth, {:.1} told the diagnosis: gait-equivalent accuracy {:.2} %",
            cost.true_reward,
            cost.diagnosed_reward,
            100.0 * cost.gait_equivalent_accuracy
        );
        for mistake in cost.mistakes.iter().take(3) {
            print_line!(
                "    {:.1} % of {} are called {}, which changes the reward from {:.0} to {:.0}",
                100.0 * mistake.share,
                mistake.class,
                mistake.named,
                mistake.true_reward,
                mistake.mistaken_reward
            );
        }
    }
}

/// Accuracies in per cent: a row a diagnoser, a column a dataset.
fn show_cross_table(tested: &[Tested], datasets: usize) {
    print_line!("accuracy %");
    for row in tested.chunks(datasets) {
        let cells: Vec<String> =
            row.iter().map(|tested| format!("{:>8.2}", 100.0 * tested.summary.accuracy)).collect();
        print_line!("{}  {}", cells.concat(), row[0].model);
    }
    let names: Vec<&str> = tested[..datasets].iter().map(|tested| tested.data.as_str()).collect();
    print_line!("columns: {}", names.join(", "));
}
