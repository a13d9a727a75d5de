//! `dappo-batch diagnose test`.

use std::path::Path;
use std::sync::atomic::Ordering;

use dappo_diagnose::DiagnosisSummary;
use dappo_diagnose::evaluate::{Evaluated, Follower, evaluate};
use dappo_learn::RunPolicy;
use dappo_learn::config::Config;
use dappo_nn::Policy;
use pyo3::prelude::*;

use crate::cli::args::{Count, TestDiagnoserArgs, Threads};
use crate::cli::console::{Table, print_line};
use crate::cli::{Caller, INTERRUPTED};
use crate::factory::TableFactory;
use crate::pool::Pool;
use crate::run_robot::{OpenRun, RobotCopy};

pub fn run(py: Python<'_>, arguments: &TestDiagnoserArgs, caller: &Caller) -> PyResult<i32> {
    let pool = Pool::new(arguments.threads.map(Threads::count))?;
    let follower = arguments.policy.as_deref().map(|run| open_follower(py, &pool, run, arguments));
    let follower = follower.transpose()?;
    check_robots(py, arguments)?;
    let interrupted = caller.watch()?;
    let evaluated = pool.run(py, || {
        let follower = follower.as_ref();
        let follower = follower.map(|(policy, config, factory)| Follower { policy, config, factory });
        let stop = || interrupted.load(Ordering::Relaxed);
        evaluate(&arguments.models, &arguments.data, follower.as_ref(), &stop)
    })?;
    let Some(evaluated) = evaluated else { return Ok(INTERRUPTED) };
    if arguments.json {
        caller.object(&evaluated);
    } else if let [only] = evaluated.as_slice() {
        show_classes(only);
        show_summary(only);
    } else {
        evaluated.iter().for_each(show_summary);
        show_cross_table(&evaluated, arguments.data.len());
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

/// The policy that has the code of every diagnosis, and what evaluates it.
fn open_follower(
    py: Python<'_>,
    pool: &Pool,
    run: &Path,
    arguments: &TestDiagnoserArgs,
) -> PyResult<(Policy, Config, TableFactory)> {
    let run = OpenRun::open(py, run, arguments.robot.robot_changed)?;
    for model in &arguments.models {
        run.check_folder(py, model)?;
    }
    let OpenRun { folder, mut config, .. } = run;
    config.env.threads = Some(pool.num_threads());
    config.evaluation.episodes = arguments.episodes.map_or(config.evaluation.episodes, Count::count);
    let factory = TableFactory::compile(py, &config)?;
    let RunPolicy { policy, .. } = pool.run(py, || RunPolicy::newest(&folder, &config, &factory))?;
    Ok((policy, config, factory))
}

fn show_classes(evaluated: &Evaluated) {
    let mut table = Table::new(&["accuracy %", "<class"]);
    for (name, accuracy) in evaluated.classes.iter().zip(&evaluated.class_accuracy) {
        table.row([format!("{:.2}", 100.0 * accuracy), name.clone()]);
    }
    table.print();
}

fn show_summary(evaluated: &Evaluated) {
    let DiagnosisSummary {
        rollouts,
        windows,
        accuracy,
        standard_error,
        held_out_accuracy,
        calibration_error,
        ..
    } = evaluated.summary;
    let error =
        if standard_error.is_nan() { String::new() } else { format!(" ± {:.2}", 100.0 * standard_error) };
    print_line!("{} on {}", evaluated.model, evaluated.data);
    print_line!(
        "  accuracy {:.2}{error} % of {windows} windows, {rollouts} rollouts; calibration error {:.2} %",
        100.0 * accuracy,
        100.0 * calibration_error
    );
    if let Some(accuracy) = held_out_accuracy {
        print_line!("  on classes that it was not trained on: {:.2} %", 100.0 * accuracy);
    }
    if let Some(cost) = &evaluated.cost {
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
fn show_cross_table(evaluated: &[Evaluated], datasets: usize) {
    print_line!("accuracy %");
    for row in evaluated.chunks(datasets) {
        let cells: Vec<String> =
            row.iter().map(|evaluated| format!("{:>8.2}", 100.0 * evaluated.summary.accuracy)).collect();
        print_line!("{}  {}", cells.concat(), row[0].model);
    }
    let names: Vec<&str> = evaluated[..datasets].iter().map(|evaluated| evaluated.data.as_str()).collect();
    print_line!("columns: {}", names.join(", "));
}
