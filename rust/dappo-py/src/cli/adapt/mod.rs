//! `dappo-batch adapt`.

mod show;

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

use dappo_learn::adapt::{Contest, Pilot, Summary, Trial, trace};
use dappo_learn::config::{Config, Layers};
use dappo_learn::controller::{Controller, ControllerConfig};
use dappo_learn::envs::EnvFactory;
use dappo_learn::run_folder::RunFolder;
use dappo_learn::{LearnError, Ppo, Result};
use pyo3::prelude::*;
use serde_json::json;

use super::args::AdaptArgs;
use super::{INTERRUPTED, console, policy, settings, signals};
use crate::controller::{self, Parts};
use crate::errors::from_learn;
use crate::factory::TableFactory;

/// A robot, and what its controller believes about it.
struct Scene {
    folder: RunFolder,
    config: Config,
    /// Compiles the twins: what the controller knows.
    known: TableFactory,
    /// Compiles the robot: it may be damaged in ways that the controller does not know.
    real: TableFactory,
}

pub fn run(py: Python<'_>, arguments: &AdaptArgs) -> PyResult<i32> {
    let wanted = controller::settings(&arguments.trigger, &arguments.controller)
        .map_err(|error| from_learn(&error))?;
    let scene = Scene::open(py, arguments)?;
    let trial = scene.trial(arguments).map_err(|error| from_learn(&error))?;
    let interrupted = signals::watch()?;
    let walked = py.detach(|| scene.walk(arguments, wanted, &trial, &interrupted));
    let Some(contest) = walked.map_err(|error| from_learn(&error))? else { return Ok(INTERRUPTED) };
    let summary = scene.conclude(arguments, &trial, &contest).map_err(|error| from_learn(&error))?;
    if arguments.json {
        let events: Vec<_> = if arguments.all_classes {
            Vec::new()
        } else {
            contest.adapted.episodes.iter().map(|walk| &walk.events).collect()
        };
        console::print_line(
            &json!({ "trial": trial_json(&trial), "summary": summary, "events": events }).to_string(),
        );
    } else {
        show::show(&summary, &contest, &trial, &scene.names());
    }
    Ok(0)
}

fn trial_json(trial: &Trial) -> serde_json::Value {
    json!({ "classes": trial.classes, "episodes": trial.episodes, "onset": trial.onset, "seed": trial.seed })
}

impl Scene {
    fn open(py: Python<'_>, arguments: &AdaptArgs) -> PyResult<Self> {
        let (folder, mut config) = RunFolder::open(&arguments.run).map_err(|error| from_learn(&error))?;
        settings::simulate_with(&arguments.simulation, &mut config).map_err(|error| from_learn(&error))?;
        let known = TableFactory::compile(py, &config)?;
        let config = with_settings(config, &arguments.set).map_err(|error| from_learn(&error))?;
        let real = TableFactory::compile(py, &config)?;
        let same = |factory: &TableFactory| {
            factory.space().classes().iter().map(|c| c.name.clone()).collect::<Vec<_>>()
        };
        if same(&known) != same(&real) {
            return Err(from_learn(&LearnError::Invalid(format!(
                "--set makes {} damage classes of the robot, the policy knows {}; change their details, not their kinds",
                real.space().classes().len(),
                known.space().classes().len()
            ))));
        }
        Ok(Self { folder, config, known, real })
    }

    fn names(&self) -> Vec<String> {
        self.known.space().classes().iter().map(|class| class.name.clone()).collect()
    }

    fn trial(&self, arguments: &AdaptArgs) -> Result<Trial> {
        let space = self.known.space();
        let classes = match &arguments.damage {
            Some(damage) => vec![space.parse(damage)?],
            None => (0..space.classes().len()).collect(),
        };
        Ok(Trial {
            classes,
            episodes: arguments.episodes as usize,
            onset: arguments.at as usize,
            seed: arguments.seed as u64,
        })
    }

    /// Lets all pilots walk; `None` when interrupted.
    fn walk(
        &self,
        arguments: &AdaptArgs,
        wanted: ControllerConfig,
        trial: &Trial,
        interrupted: &AtomicBool,
    ) -> Result<Option<Contest>> {
        let parts = Parts { expert: arguments.expert.as_deref(), diagnoser: &arguments.diagnoser };
        let (skills, _) = parts.load(&self.folder, &self.config, &self.known)?;
        let unaware = arguments.unaware.as_deref().map(|run| self.load_unaware(run)).transpose()?;
        let robots = trial.classes.len() * trial.episodes;
        let twins = self.known.backend(robots, None, self.config.evaluation.precision)?;
        let mut controller = Controller::new(skills, wanted, twins)?;
        let stop = || interrupted.load(Ordering::Relaxed);
        let run = |mut pilot: Pilot<'_>| trial.run(&mut pilot, &self.config, &self.real, &stop);
        let Some(adapted) = run(Pilot::Controller(&mut controller))? else { return Ok(None) };
        let policy = controller.policy();
        let Some(oracle) = run(Pilot::Oracle(policy))? else { return Ok(None) };
        let Some(unadapted) = run(Pilot::Unadapted(policy))? else { return Ok(None) };
        let unaware = match &unaware {
            None => None,
            Some(policy) => match run(Pilot::Unaware(policy))? {
                None => return Ok(None),
                walks => walks,
            },
        };
        Ok(Some(Contest { adapted, oracle, unadapted, unaware }))
    }

    fn load_unaware(&self, run: &Path) -> Result<Ppo> {
        let (folder, config) = RunFolder::open(run)?;
        let policy = policy::load(&folder, &config, &self.known)?.ppo;
        if policy.normalizer().code_length() > 0 {
            return Err(LearnError::Invalid(format!(
                "the policy in {} observes the damage; --unaware takes one that was trained with --unaware",
                run.display()
            )));
        }
        Ok(policy)
    }

    /// Forms the summary and writes the files that were asked for.
    fn conclude(&self, arguments: &AdaptArgs, trial: &Trial, contest: &Contest) -> Result<Summary> {
        let names = self.names();
        let summary = Summary::new(trial, &names, contest)?;
        if arguments.all_classes {
            self.folder.write_evaluation("adapt.csv", &summary.csv())?;
            let text = serde_json::to_string_pretty(&summary)
                .map_err(|error| LearnError::Invalid(error.to_string()))?;
            self.folder.write_evaluation("adapt.json", &text)?;
        }
        if let (Some(path), Some(walk)) = (&arguments.log, contest.adapted.episodes.first()) {
            let io = |source| LearnError::Io { path: path.clone(), source };
            std::fs::write(path, trace(walk, trial.onset, &names)).map_err(io)?;
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
