//! `dappo-batch adapt`.

mod show;

use std::sync::atomic::{AtomicBool, Ordering};

use dappo_learn::adapt::{Contest, Pilot, Summary, Trial, Vocabulary, trace};
use dappo_learn::config::{Config, Layers};
use dappo_learn::controller::ControllerConfig;
use dappo_learn::envs::EnvFactory;
use dappo_learn::run_folder::RunFolder;
use dappo_learn::{LearnError, Ppo, Result};
use pyo3::prelude::*;
use serde_json::json;

use super::args::AdaptArgs;
use super::film::{self, Film, Walker};
use super::{Caller, INTERRUPTED, policy, settings};
use crate::controller::Parts;
use crate::errors::from_learn;
use crate::factory::TableFactory;
use crate::pool::Pool;
use crate::run_robot::OpenRun;

/// A robot, and what its controller believes about it.
struct Scene {
    folder: RunFolder,
    config: Config,
    parts: Parts,
    /// The run of `--unaware`.
    unaware: Option<OpenRun>,
    /// Compiles the twins: what the controller knows.
    known: TableFactory,
    /// Compiles the robot: it may be damaged in ways that the controller does not know.
    real: TableFactory,
    /// The one's damage in the words of the other.
    vocabulary: Vocabulary,
}

pub fn run(py: Python<'_>, arguments: &AdaptArgs, caller: &Caller) -> PyResult<i32> {
    let wanted = arguments.controller.config().map_err(|error| from_learn(&error))?;
    if let Some(path) = &arguments.video {
        film::check(py, path)?;
    }
    let pool = Pool::new(arguments.simulation.threads())?;
    let scene = Scene::open(py, arguments)?;
    let trial = scene.trial(arguments).map_err(|error| from_learn(&error))?;
    let interrupted = caller.watch()?;
    let walked = pool.run(py, || scene.walk(wanted, &trial, &interrupted))?;
    let Some(contest) = walked else { return Ok(INTERRUPTED) };
    let summary = scene.conclude(arguments, &trial, &contest).map_err(|error| from_learn(&error))?;
    if arguments.json {
        let events: Vec<_> = if arguments.all_classes {
            Vec::new()
        } else {
            contest.adapted.episodes.iter().map(|walk| &walk.events).collect()
        };
        caller.object(&json!({ "trial": trial_json(&trial), "summary": summary, "events": events }));
    } else {
        show::show(&summary, &contest, &trial, &scene.vocabulary.known_names);
    }
    // Last, so that nothing is lost where nothing can be drawn.
    if let (Some(path), Some(walk)) = (&arguments.video, contest.adapted.episodes.first()) {
        let walker = Walker::Controller(scene.vocabulary.known_names.clone());
        let film = Film { walk, onset: trial.onset, walker, factory: &scene.real };
        film.write(py, path, caller)?;
    }
    Ok(0)
}

fn trial_json(trial: &Trial) -> serde_json::Value {
    json!({ "classes": trial.classes, "episodes": trial.episodes, "onset": trial.onset, "seed": trial.seed })
}

impl Scene {
    fn open(py: Python<'_>, arguments: &AdaptArgs) -> PyResult<Self> {
        let run = OpenRun::open(py, &arguments.run, arguments.robot.robot_changed)?;
        let parts = arguments.controller.parts(py, &run)?;
        let unaware = arguments.unaware.as_deref();
        let unaware = unaware.map(|unaware| run.open_beside(py, unaware, false)).transpose()?;
        let OpenRun { folder, mut config, .. } = run;
        settings::simulate_with(&arguments.simulation, &mut config).map_err(|error| from_learn(&error))?;
        let known = TableFactory::compile(py, &config)?;
        let config = with_settings(config, &arguments.set).map_err(|error| from_learn(&error))?;
        let real = TableFactory::compile(py, &config)?;
        if known.robot().name != real.robot().name {
            return Err(from_learn(&LearnError::Invalid(format!(
                "--set makes the robot `{}`, but the policy controls `{}`",
                real.robot().name,
                known.robot().name
            ))));
        }
        let vocabulary = Vocabulary::new(known.space(), real.space());
        Ok(Self { folder, config, parts, unaware, known, real, vocabulary })
    }

    fn trial(&self, arguments: &AdaptArgs) -> Result<Trial> {
        let space = self.real.space();
        let classes = match &arguments.damage {
            Some(damage) => vec![space.parse(damage)?],
            None => (0..space.classes().len()).collect(),
        };
        Ok(Trial {
            classes,
            episodes: arguments.episodes as usize,
            onset: arguments.at as usize,
            seed: arguments.seed as u64,
            filmed: arguments.video.is_some(),
        })
    }

    /// Lets all pilots walk; `None` when interrupted.
    fn walk(
        &self,
        wanted: ControllerConfig,
        trial: &Trial,
        interrupted: &AtomicBool,
    ) -> Result<Option<Contest>> {
        let robots = trial.classes.len() * trial.episodes;
        let mut controller = self.parts.assemble(&self.folder, &self.config, &self.known, wanted, robots)?;
        let unaware = self.unaware.as_ref().map(|run| self.load_unaware(run)).transpose()?;
        let stop = || interrupted.load(Ordering::Relaxed);
        let run = |mut pilot: Pilot<'_>| trial.run(&mut pilot, &self.config, &self.real, &stop);
        let Some(adapted) = run(Pilot::Controller(&mut controller))? else { return Ok(None) };
        let policy = controller.policy();
        let Some(oracle) = run(Pilot::Oracle(policy, &self.vocabulary))? else { return Ok(None) };
        let Some(unadapted) = run(Pilot::Unadapted(policy, &self.vocabulary))? else { return Ok(None) };
        let unaware = match &unaware {
            None => None,
            Some(policy) => match run(Pilot::Unaware(policy))? {
                None => return Ok(None),
                walks => walks,
            },
        };
        Ok(Some(Contest { adapted, oracle, unadapted, unaware }))
    }

    fn load_unaware(&self, run: &OpenRun) -> Result<Ppo> {
        let policy = policy::load(&run.folder, &run.config, &self.known)?.ppo;
        if policy.normalizer().code_length() > 0 {
            return Err(LearnError::Invalid(format!(
                "the policy in {} observes the damage; --unaware takes one that was trained with --unaware",
                run.folder.root().display()
            )));
        }
        Ok(policy)
    }

    /// Forms the summary and writes the files that were asked for.
    fn conclude(&self, arguments: &AdaptArgs, trial: &Trial, contest: &Contest) -> Result<Summary> {
        let summary = Summary::new(trial, &self.vocabulary, contest)?;
        if arguments.all_classes {
            self.folder.write_evaluation("adapt.csv", &summary.csv())?;
            let text = serde_json::to_string_pretty(&summary)
                .map_err(|error| LearnError::Invalid(error.to_string()))?;
            self.folder.write_evaluation("adapt.json", &text)?;
        }
        if let (Some(path), Some(walk)) = (&arguments.log, contest.adapted.episodes.first()) {
            let io = |source| LearnError::Io { path: path.clone(), source };
            std::fs::write(path, trace(walk, trial.onset, &self.vocabulary)).map_err(io)?;
        }
        Ok(summary)
    }
}

/// Lays `--set` over the configuration of a run.
fn with_settings(config: Config, set: &[String]) -> Result<Config> {
    if set.is_empty() {
        return Ok(config);
    }
    let mut layers = Layers::default();
    layers.add_toml(&config.to_toml()?, "the run's config.toml")?;
    for assignment in set {
        layers.set_assignment(assignment)?;
    }
    layers.resolve()
}
