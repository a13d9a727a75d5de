//! `dappo-batch evaluate`, and the table at the end of a training.

use std::sync::atomic::{AtomicBool, Ordering};

use dappo_learn::Ppo;
use dappo_learn::checkpoint::Checkpoint;
use dappo_learn::config::Config;
use dappo_learn::envs::EnvFactory;
use dappo_learn::evaluate::{Evaluation, evaluate};
use dappo_learn::run_folder::RunFolder;
use dappo_sim::{BackendKind, Precision};
use pyo3::prelude::*;

use super::args::EvaluateArgs;
use super::{INTERRUPTED, console, signals};
use crate::errors::{Kind, from_learn, from_sim, raise};
use crate::factory::TableFactory;

pub fn run(py: Python<'_>, arguments: &EvaluateArgs) -> PyResult<i32> {
    let (run, mut config) = RunFolder::open(&arguments.run).map_err(|error| from_learn(&error))?;
    config.env.threads = arguments.threads.map(|threads| threads as usize).or(config.env.threads);
    config.evaluation.episodes =
        arguments.episodes.map_or(config.evaluation.episodes, |episodes| episodes as usize);
    config.evaluation.seed = arguments.seed.unwrap_or(config.evaluation.seed);
    if let Some(backend) = &arguments.backend {
        config.env.backend = BackendKind::parse(backend).map_err(|error| from_sim(&error))?;
    }
    if let Some(precision) = &arguments.precision {
        config.evaluation.precision = Precision::parse(precision).map_err(|error| from_sim(&error))?;
    }
    let factory = TableFactory::compile(py, &config)?;
    if !arguments.json {
        console::note(&factory.describe(config.evaluation.precision));
    }
    let interrupted = signals::watch()?;
    let evaluation = py.detach(|| {
        let checkpoint = Checkpoint::newest(&run.checkpoints(), &factory.robot().name)?;
        let reward = config.env.reward.as_deref();
        let probe = factory.make(factory.env_config(&config)?, reward, config.evaluation.precision)?;
        let ppo = checkpoint.learner(&config.ppo, &probe)?;
        evaluate_and_save(&ppo, &config, &factory, &run, &interrupted)
    });
    let Some(evaluation) = evaluation.map_err(|error| from_learn(&error))? else { return Ok(INTERRUPTED) };
    if arguments.json {
        let text =
            serde_json::to_string(&evaluation).map_err(|error| raise(Kind::Config, error.to_string()))?;
        console::print_line(&text);
    } else {
        show(&evaluation);
    }
    Ok(0)
}

/// Evaluates a policy and writes `eval/per_class.csv`; `None` when it was interrupted.
pub fn evaluate_and_save(
    ppo: &Ppo,
    config: &Config,
    factory: &TableFactory,
    run: &RunFolder,
    interrupted: &AtomicBool,
) -> dappo_learn::Result<Option<Evaluation>> {
    let evaluation = evaluate(ppo, config, factory, &|| interrupted.load(Ordering::Relaxed))?;
    if let Some(evaluation) = &evaluation {
        run.write_evaluation("per_class.csv", &evaluation.to_csv())?;
    }
    Ok(evaluation)
}

/// Prints the per-class table.
pub fn show(evaluation: &Evaluation) {
    let width = evaluation.classes.iter().map(|class| class.name.len()).max().unwrap_or(0).max("name".len());
    console::print_line(&format!(
        "class  {:<width$}  {:<8} {:>14} {:>8} {:>8} {:>7}",
        "name", "group", "forward reward", "± s.e.", "length", "falls"
    ));
    for c in &evaluation.classes {
        let error =
            if c.standard_error.is_nan() { "–".to_owned() } else { format!("{:.1}", c.standard_error) };
        let falls = format!("{}/{}", c.falls, c.episodes);
        console::print_line(&format!(
            "{:>5}  {:<width$}  {:<8} {:>14.1} {error:>8} {:>8.0} {falls:>7}",
            c.class, c.name, c.group, c.forward_reward, c.episode_length
        ));
    }
    console::print_line(&format!(
        "mean forward reward over {} classes: {:.1} (backend {}, {})",
        evaluation.classes.len(),
        evaluation.mean_forward_reward(),
        evaluation.backend,
        evaluation.precision
    ));
}
