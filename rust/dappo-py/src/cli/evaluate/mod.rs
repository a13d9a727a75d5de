//! `dappo-batch evaluate`, and the evaluation at the end of a training.

mod runs;

use std::sync::atomic::Ordering;

use dappo_learn::config::Config;
use dappo_learn::evaluate::{Comparison, Evaluation, RunEvaluation, evaluate, seeds_text};
use dappo_learn::run_folder::EvaluationFolder;
use dappo_learn::walk::{Encoding, MeanActions};
use pyo3::prelude::*;
use serde_json::json;

use super::args::EvaluateArgs;
use super::{Caller, INTERRUPTED, console};
use crate::errors::OrRaise;
use crate::factory::TableFactory;
use crate::pool::Pool;
use runs::{Actor, LoadedRun};

pub fn run(py: Python<'_>, arguments: &EvaluateArgs, caller: &Caller) -> PyResult<i32> {
    let encoding = arguments.encoding.get();
    let pool = Pool::new(arguments.simulation.threads())?;
    let interrupted = caller.watch()?;
    let stop = || interrupted.load(Ordering::Relaxed);
    // Every run is loaded before the first one is evaluated: a mistake shows at once.
    let runs = runs::load(py, &pool, arguments, &arguments.runs, arguments.act.as_ref(), encoding, None)?;
    let others = runs::load(py, &pool, arguments, &arguments.compare, None, Encoding::True, runs.first())?;
    if !arguments.json {
        console::write_note(&runs[0].describe());
    }
    let several = runs.len() + others.len() > 1;
    let evaluate = |runs: &[LoadedRun], encoding| {
        evaluate_all(py, &pool, runs, encoding, &stop, |run, evaluation| {
            if arguments.json {
                return;
            }
            if several {
                // The tables of many runs would hide their comparison; each run folder holds its own.
                console::write_line(&run.heading());
                console::print(&evaluation.group_text());
            } else {
                console::print(&evaluation.text());
            }
        })
    };
    let Some(evaluations) = evaluate(&runs, encoding)? else { return Ok(INTERRUPTED) };
    let Some(other_evaluations) = evaluate(&others, Encoding::True)? else { return Ok(INTERRUPTED) };
    let comparison = if others.is_empty() {
        None
    } else {
        let seed = runs[0].config.evaluation.seed;
        let comparison = Comparison::new(&evaluations, &other_evaluations, seed);
        let folder = runs[0].evaluation().or_raise()?;
        let comparison = comparison.and_then(|found| found.write(&folder, encoding).map(|()| found));
        Some(comparison.or_raise()?)
    };
    if arguments.json {
        caller.object(&json!({ "runs": evaluations, "others": other_evaluations, "comparison": comparison }));
    } else if let Some(comparison) = comparison {
        console::print(&comparison.summary.text());
    } else if several {
        console::print(&seeds_text(&evaluations));
    }
    Ok(0)
}

/// Evaluates the runs of one learner, one after the other; `None` when it was interrupted.
fn evaluate_all(
    py: Python<'_>,
    pool: &Pool,
    runs: &[LoadedRun],
    encoding: Encoding,
    stop: &(dyn Fn() -> bool + Sync),
    report: impl Fn(&LoadedRun, &Evaluation),
) -> PyResult<Option<Vec<RunEvaluation>>> {
    let mut evaluations = Vec::with_capacity(runs.len());
    for run in runs {
        let policy: &(dyn MeanActions + Sync) = match &run.actor {
            Actor::Own(policy, _) => policy.as_ref(),
            Actor::Outside(policy) => {
                policy.reset(py)?;
                policy
            }
        };
        let evaluation = pool.run(py, || {
            evaluate_and_save(policy, &run.config, encoding, &run.factory, &run.evaluation()?, stop)
        })?;
        let Some(evaluation) = evaluation else { return Ok(None) };
        report(run, &evaluation);
        evaluations.push(run.result(evaluation));
    }
    Ok(Some(evaluations))
}

/// Evaluates a policy and writes what was found into a folder; `None` when it was interrupted.
pub fn evaluate_and_save(
    policy: &dyn MeanActions,
    config: &Config,
    encoding: Encoding,
    factory: &TableFactory,
    folder: &EvaluationFolder,
    stop: &dyn Fn() -> bool,
) -> dappo_learn::Result<Option<Evaluation>> {
    let evaluation = evaluate(policy, config, encoding, factory, stop)?;
    if let Some(evaluation) = &evaluation {
        evaluation.write(folder)?;
    }
    Ok(evaluation)
}
