//! Opens the runs of an evaluation and refuses those that cannot stand beside each other.

use std::path::{Path, PathBuf};

use dappo_learn::config::Config;
use dappo_learn::envs::EnvFactory;
use dappo_learn::evaluate::Encoding;
use dappo_learn::run_folder::RunFolder;
use dappo_learn::{LearnError, Ppo};
use pyo3::prelude::*;

use crate::cli::args::EvaluateArgs;
use crate::cli::policy::{self, LoadedPolicy};
use crate::cli::settings;
use crate::errors::{Kind, from_learn, raise};
use crate::factory::TableFactory;
use crate::pool::Pool;
use crate::run_robot::{OpenRun, RobotCopy};

/// A run with everything that its evaluation needs.
pub struct LoadedRun {
    pub folder: RunFolder,
    pub config: Config,
    pub factory: TableFactory,
    pub ppo: Ppo,
    /// Env steps that the policy was trained for.
    pub env_steps: u64,
    /// The files of its robot.
    robot: RobotCopy,
    /// What the evaluation simulates, by name; all runs of a command must agree.
    conditions: Vec<(&'static str, String)>,
}

/// Loads the runs of one learner. `reference`, or else the first of them, decides how all are evaluated.
pub fn load(
    py: Python<'_>,
    pool: &Pool,
    arguments: &EvaluateArgs,
    folders: &[PathBuf],
    encoding: Encoding,
    reference: Option<&LoadedRun>,
) -> PyResult<Vec<LoadedRun>> {
    let mut loaded: Vec<LoadedRun> = Vec::with_capacity(folders.len());
    for folder in folders {
        let run = LoadedRun::open(py, pool, arguments, folder, encoding, reference.or(loaded.first()))?;
        if let Some(first) = loaded.first() {
            check_learner(first, &run)?;
        }
        if let Some(same) = loaded.iter().find(|same| same.config.seed == run.config.seed) {
            return Err(raise(
                Kind::Config,
                format!(
                    "{} and {} were both trained with seed {}; the runs of one learner must differ in their seeds",
                    same.name(),
                    run.name(),
                    run.config.seed
                ),
            ));
        }
        loaded.push(run);
    }
    Ok(loaded)
}

impl LoadedRun {
    fn open(
        py: Python<'_>,
        pool: &Pool,
        arguments: &EvaluateArgs,
        folder: &Path,
        encoding: Encoding,
        reference: Option<&Self>,
    ) -> PyResult<Self> {
        let OpenRun { folder, mut config, robot, .. } =
            OpenRun::open(py, folder, arguments.robot.robot_changed)?;
        match reference {
            None => apply(arguments, &mut config).map_err(|error| from_learn(&error))?,
            Some(reference) => {
                config.env.backend = reference.config.env.backend;
                config.env.threads = reference.config.env.threads;
                config.evaluation = reference.config.evaluation.clone();
            }
        }
        let factory = TableFactory::compile(py, &config)?;
        let conditions = conditions(&config, &factory)?;
        if let Some(reference) = reference {
            check_conditions(reference, folder.root(), &conditions)?;
            let other = (folder.root(), &robot);
            reference.robot.check_same(py, reference.folder.root(), other, true)?;
        }
        let LoadedPolicy { ppo, env_steps, .. } =
            pool.run(py, || load_policy(&folder, &config, encoding, &factory))?;
        Ok(Self { folder, config, factory, ppo, env_steps, robot, conditions })
    }

    /// Its run folder, as the user wrote it.
    pub fn name(&self) -> String {
        self.folder.root().display().to_string()
    }

    /// A line about the backend.
    pub fn describe(&self) -> String {
        self.factory.describe(self.config.evaluation.compute())
    }

    /// A line above its table.
    pub fn heading(&self) -> String {
        let (learner, seed) = (learner(&self.config), self.config.seed);
        format!("{} · {learner} · seed {seed} · {} env steps", self.name(), self.env_steps)
    }
}

fn learner(config: &Config) -> &'static str {
    if config.env.observe_damage { "DA-PPO" } else { "PPO-Unaware" }
}

/// Lays the flags over the configuration of the run.
fn apply(arguments: &EvaluateArgs, config: &mut Config) -> dappo_learn::Result<()> {
    config.evaluation.episodes =
        arguments.episodes.map_or(config.evaluation.episodes, |episodes| episodes as usize);
    config.evaluation.seed = arguments.seed.unwrap_or(config.evaluation.seed);
    settings::simulate_with(&arguments.simulation, config)
}

/// The newest policy of a run, if it can be told what `encoding` says.
fn load_policy(
    run: &RunFolder,
    config: &Config,
    encoding: Encoding,
    factory: &TableFactory,
) -> dappo_learn::Result<LoadedPolicy> {
    let policy = policy::load(run, config, factory)?;
    let named = |error| LearnError::Invalid(format!("{}: {error}", run.root().display()));
    encoding.check(policy.ppo.normalizer().code_length(), factory.space()).map_err(named)?;
    Ok(policy)
}

/// The settings that decide what an episode of each damage class is.
fn conditions(config: &Config, factory: &TableFactory) -> PyResult<Vec<(&'static str, String)>> {
    let (space, damage) = (factory.space(), &config.damage);
    let steps = factory.env_config(config).map_err(|error| from_learn(&error))?.max_episode_steps;
    Ok(vec![
        ("robot", factory.robot().name.clone()),
        ("damage.types", space.types().join(", ")),
        ("damage.max_damaged_limbs", space.max_damaged_limbs().to_string()),
        ("damage.severity", damage.severity.to_string()),
        ("damage.onset", format!("{} to {}", damage.onset.first, damage.onset.last)),
        ("damage.options", damage.options.to_string().trim().to_owned()),
        ("env.physics", factory.simulator(config.evaluation.compute()).physics),
        ("env.max_episode_steps", steps.to_string()),
    ])
}

/// Refuses a run whose episodes are other ones than those of the reference.
fn check_conditions(
    reference: &LoadedRun,
    folder: &Path,
    conditions: &[(&'static str, String)],
) -> PyResult<()> {
    let differs = |(one, other): &(&(&str, String), &(&str, String))| one != other;
    let Some(((name, expected), (_, got))) = reference.conditions.iter().zip(conditions).find(differs) else {
        return Ok(());
    };
    Err(raise(
        Kind::Config,
        format!(
            "{} cannot be evaluated beside {}: its `{name}` is `{got}`, expected `{expected}`",
            folder.display(),
            reference.name(),
        ),
    ))
}

/// Refuses to average over different learners.
fn check_learner(first: &LoadedRun, other: &LoadedRun) -> PyResult<()> {
    if first.config.env.observe_damage == other.config.env.observe_damage {
        return Ok(());
    }
    Err(raise(
        Kind::Config,
        format!(
            "{} is a run of {} and {} one of {}; several runs are seeds of one learner, another one goes behind --compare",
            first.name(),
            learner(&first.config),
            other.name(),
            learner(&other.config)
        ),
    ))
}
