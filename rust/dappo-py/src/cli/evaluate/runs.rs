//! Opens the runs of an evaluation and refuses those that cannot be compared.

use std::path::{Path, PathBuf};

use dappo_learn::config::{Assignment, Change, Config, changes};
use dappo_learn::envs::EnvFactory;
use dappo_learn::evaluate::{Conditions, Evaluation, RunEvaluation, check_seeds};
use dappo_learn::run_folder::{EvaluationFolder, RunFolder, decides_episodes};
use dappo_learn::walk::Encoding;
use dappo_learn::{LearnError, RunPolicy};
use dappo_nn::Policy;
use pyo3::prelude::*;

use crate::cli::args::{AtLeast, Count, EvaluateArgs};
use crate::cli::settings;
use crate::errors::{Kind, OrRaise, raise};
use crate::factory::TableFactory;
use crate::outside_policy::{Function, OutsidePolicy};
use crate::pool::Pool;
use crate::run_robot::{OpenRun, RobotCopy};

/// What chooses the actions.
pub enum Actor {
    /// The policy of the run, and the env steps that it was trained for.
    Own(Box<Policy>, u64),
    /// A policy of another learner in its place.
    Outside(OutsidePolicy),
}

/// A run with everything that its evaluation needs.
pub struct LoadedRun {
    pub folder: RunFolder,
    pub config: Config,
    pub factory: TableFactory,
    pub actor: Actor,
    /// The files of its robot.
    robot: RobotCopy,
    /// What the evaluation simulates; all runs of a command must agree.
    conditions: Conditions,
}

/// Loads the runs of one learner, or one run with `act` in the place of its policy. `reference`, or else the first of them,
/// decides how all are evaluated.
pub fn load(
    py: Python<'_>,
    pool: &Pool,
    arguments: &EvaluateArgs,
    folders: &[PathBuf],
    act: Option<&Function>,
    encoding: Encoding,
    reference: Option<&LoadedRun>,
) -> PyResult<Vec<LoadedRun>> {
    if act.is_some() && folders.len() > 1 {
        let message =
            format!("a function takes the place of the policy of one run, got {} runs", folders.len());
        return Err(raise(Kind::Config, message));
    }
    let mut loaded: Vec<LoadedRun> = Vec::with_capacity(folders.len());
    for folder in folders {
        let run = LoadedRun::open(py, pool, arguments, folder, act, encoding, reference.or(loaded.first()))?;
        check_seeds(loaded.iter().map(|one| (one.name(), &one.config)), (&run.name(), &run.config))
            .or_raise()?;
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
        act: Option<&Function>,
        encoding: Encoding,
        reference: Option<&Self>,
    ) -> PyResult<Self> {
        let OpenRun { folder, config, robot, .. } = OpenRun::open(py, folder, arguments.robot.robot_changed)?;
        let mut config = with_other_episodes(&config, &arguments.set).or_raise()?;
        match reference {
            None => apply(arguments, &mut config).or_raise()?,
            Some(reference) => {
                config.env.backend = reference.config.env.backend;
                config.env.threads = reference.config.env.threads;
                config.evaluation = reference.config.evaluation.clone();
                arguments.simulation.room.lay_over(&mut config.env);
            }
        }
        let factory = TableFactory::compile(py, &config)?;
        let conditions = Conditions::new(&config, &factory).or_raise()?;
        if let Some(reference) = reference {
            let name = folder.root().display().to_string();
            let checked = reference.conditions.check(&reference.name(), &name, &conditions);
            checked.or_raise()?;
            let other = (folder.root(), &robot);
            // Otherwise the damage of all is that of the trainings.
            let with_damage = arguments.set.is_empty();
            reference.robot.check_same(py, reference.folder.root(), other, with_damage)?;
        }
        let sizes = factory.sizes(&config).or_raise()?;
        let actor = if let Some(function) = act {
            encoding.check(sizes.code_length, factory.space().classes().len()).or_raise()?;
            Actor::Outside(OutsidePolicy::new(py, function, sizes)?)
        } else {
            let found = pool.run(py, || load_policy(&folder, &config, encoding, &factory))?;
            Actor::Own(Box::new(found.policy), found.env_steps)
        };
        Ok(Self { folder, config, factory, actor, robot, conditions })
    }

    /// Its run folder, as the user wrote it.
    pub fn name(&self) -> String {
        self.folder.root().display().to_string()
    }

    /// The folder for what its evaluation finds.
    pub fn evaluation(&self) -> dappo_learn::Result<EvaluationFolder> {
        let outside = match &self.actor {
            Actor::Own(..) => None,
            Actor::Outside(policy) => Some(policy.folder()),
        };
        self.folder.evaluation_with(&self.config, outside)
    }

    /// What was evaluated: the run and its seed, or the policy that took its place.
    pub fn result(&self, evaluation: Evaluation) -> RunEvaluation {
        match &self.actor {
            Actor::Own(_, env_steps) => {
                let (seed, env_steps) = (Some(self.config.seed), Some(*env_steps));
                RunEvaluation { run: self.name(), seed, env_steps, evaluation }
            }
            Actor::Outside(policy) => {
                RunEvaluation { run: policy.name().to_owned(), seed: None, env_steps: None, evaluation }
            }
        }
    }

    /// A line about the backend.
    pub fn describe(&self) -> String {
        self.factory.describe(self.factory.evaluation_physics())
    }

    /// A line above its table.
    pub fn heading(&self) -> String {
        let (run, learner, seed) = (self.name(), self.config.learner(), self.config.seed);
        match &self.actor {
            Actor::Own(_, env_steps) => format!("{run} · {learner} · seed {seed} · {env_steps} env steps"),
            Actor::Outside(policy) => format!("{} in the place of the policy of {run}", policy.name()),
        }
    }
}

/// Lays the flags over the configuration of the run.
fn apply(arguments: &EvaluateArgs, config: &mut Config) -> dappo_learn::Result<()> {
    config.evaluation.episodes = arguments.episodes.map_or(config.evaluation.episodes, Count::count);
    config.evaluation.seed = arguments.seed.map_or(config.evaluation.seed, AtLeast::wide);
    settings::simulate_with(&arguments.simulation, config)
}

/// The configuration of a run with settings of the user's, which may change the episodes of an evaluation alone.
fn with_other_episodes(config: &Config, set: &[Assignment]) -> dappo_learn::Result<Config> {
    let changed = config.clone().with(set)?;
    for Change { key, .. } in changes(config, &changed)? {
        if !decides_episodes(&key) {
            return Err(LearnError::Invalid(format!(
                "`{key}` cannot be set for an evaluation; expected a setting of [damage], `env.max_episode_steps` or \
                 `env.physics`; episodes, seed and simulation have flags"
            )));
        }
        if key == "damage.types" && config.env.observe_damage {
            return Err(LearnError::Invalid(
                "`damage.types` cannot be set for a policy that observes the damage, whose codes are those of the types \
                 it was trained with; `adapt --set` has damage without a code"
                    .into(),
            ));
        }
    }
    Ok(changed)
}

/// The newest policy of a run, if it can be given `encoding`.
fn load_policy(
    run: &RunFolder,
    config: &Config,
    encoding: Encoding,
    factory: &TableFactory,
) -> dappo_learn::Result<RunPolicy> {
    let found = RunPolicy::newest(run, config, factory)?;
    let named = |error| LearnError::Invalid(format!("{}: {error}", found.run));
    encoding.check(found.policy.code_length(), factory.space().classes().len()).map_err(named)?;
    Ok(found)
}
