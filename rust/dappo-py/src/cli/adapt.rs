//! `dappo-batch adapt`.

use std::sync::atomic::{AtomicBool, Ordering};

use dappo_diagnose::adapt::{AdaptationSummary, Contest, trace};
use dappo_diagnose::controller::{ControllerConfig, Parts};
use dappo_learn::config::Config;
use dappo_learn::envs::EnvFactory;
use dappo_learn::files::write_given;
use dappo_learn::run_folder::RunFolder;
use dappo_learn::walk::{Kept, KnownClasses, MeanActions, Trial, onset_at};
use dappo_learn::{LearnError, Result, RunPolicy, Sizes};
use pyo3::prelude::*;
use serde_json::json;

use super::args::AdaptArgs;
use super::film::{self, Film, Walker};
use super::{Caller, INTERRUPTED, console, settings};
use crate::errors::{Kind, OrRaise, raise};
use crate::factory::TableFactory;
use crate::outside_policy::OutsidePolicy;
use crate::pool::Pool;
use crate::run_robot::OpenRun;

/// A robot, and the parts of its controller.
struct Scene {
    folder: RunFolder,
    config: Config,
    parts: Parts,
    /// What else walks.
    unaware: Option<Unaware>,
    /// Compiles the twins, with the damage classes of the controller.
    known: TableFactory,
    /// Compiles the robot: its damage may have no class of the controller.
    real: TableFactory,
    /// The damage classes of the robot, and which ones of the controller's they are.
    classes: KnownClasses,
}

/// A policy that observes no damage code, and the robot as it observes it.
struct Unaware {
    walker: UnawareWalker,
    real: TableFactory,
}

/// Where it comes from.
enum UnawareWalker {
    /// The run of `--unaware`.
    Run(Box<OpenRun>),
    /// The function of `--act`.
    Outside(OutsidePolicy),
}

pub fn run(py: Python<'_>, arguments: &AdaptArgs, caller: &Caller) -> PyResult<i32> {
    let wanted = arguments.controller.config().or_raise()?;
    if let Some(path) = &arguments.video {
        film::check(py, path, None)?;
    }
    let pool = Pool::new(arguments.simulation.threads())?;
    let scene = Scene::open(py, arguments)?;
    if arguments.video.is_some() {
        film::check_camera(py, &scene.real, &arguments.camera)?;
    }
    let trial = scene.trial(arguments).or_raise()?;
    let interrupted = caller.watch()?;
    let walked = pool.run(py, || scene.walk(wanted, &trial, &interrupted))?;
    let Some(contest) = walked else { return Ok(INTERRUPTED) };
    let summary = scene.conclude(arguments, &trial, &contest).or_raise()?;
    if arguments.json {
        let events: Vec<_> = if arguments.all_classes {
            Vec::new()
        } else {
            contest.adapted.episodes.iter().map(|episode| &episode.events).collect()
        };
        caller.object(&json!({ "trial": trial_json(&trial), "summary": summary, "events": events }));
    } else {
        let period = scene.real.control_period();
        console::print(&summary.text(&trial, &scene.classes, &contest, period));
    }
    // Last, so that nothing is lost where nothing can be drawn.
    if let (Some(path), Some(episode)) = (&arguments.video, contest.adapted.episodes.first()) {
        let walker = Walker::Controller(scene.classes.known_names.clone());
        let film = Film { episode, walker, factory: &scene.real };
        film.write(py, path, &arguments.camera, None, caller)?;
    }
    Ok(0)
}

fn trial_json(trial: &Trial) -> serde_json::Value {
    let Trial { classes, episodes, course, seed, .. } = trial;
    json!({ "classes": classes, "episodes": episodes, "onset": course.onset.first, "seed": seed })
}

impl Unaware {
    /// The policy, at the start of its episodes.
    fn policy(&self) -> Result<Box<dyn MeanActions + Sync + '_>> {
        let run = match &self.walker {
            UnawareWalker::Run(run) => run,
            UnawareWalker::Outside(policy) => return Ok(Box::new(policy)),
        };
        if run.config.env.observe_damage {
            return Err(LearnError::Invalid(format!(
                "the policy in {} observes the damage; --unaware takes one that was trained with --unaware",
                run.folder.root().display()
            )));
        }
        Ok(Box::new(RunPolicy::newest(&run.folder, &run.config, &self.real)?.policy))
    }
}

impl Scene {
    fn open(py: Python<'_>, arguments: &AdaptArgs) -> PyResult<Self> {
        let run = OpenRun::open(py, &arguments.run, arguments.robot.robot_changed)?;
        let parts = arguments.controller.parts(py, &run)?;
        let other = arguments.unaware.as_deref();
        let other = other.map(|other| run.open_other(py, other, false)).transpose()?;
        let OpenRun { folder, mut config, .. } = run;
        settings::simulate_with(&arguments.simulation, &mut config).or_raise()?;
        let known = TableFactory::compile(py, &config)?;
        let config = config.with(&arguments.set).or_raise()?;
        let real = TableFactory::compile(py, &config)?;
        if known.robot().name != real.robot().name {
            let (real, known) = (&real.robot().name, &known.robot().name);
            let message = format!("--set makes the robot `{real}`, but the policy controls `{known}`");
            return Err(raise(Kind::Config, message));
        }
        let unaware = match (other, &arguments.act) {
            (Some(run), _) => {
                let mut config = config.clone();
                config.env.history = run.config.env.history;
                let real = TableFactory::compile(py, &config)?;
                Some(Unaware { walker: UnawareWalker::Run(Box::new(run)), real })
            }
            (None, Some(function)) => {
                let real = TableFactory::compile(py, &config)?;
                let sizes = real.sizes(&config).or_raise()?;
                let sizes = Sizes { obs_dim: sizes.obs_dim - sizes.code_length, code_length: 0, ..sizes };
                let policy = OutsidePolicy::new(py, function, sizes)?;
                policy.reset(py)?;
                Some(Unaware { walker: UnawareWalker::Outside(policy), real })
            }
            (None, None) => None,
        };
        let classes = KnownClasses::new(known.space(), real.space());
        Ok(Self { folder, config, parts, unaware, known, real, classes })
    }

    fn trial(&self, arguments: &AdaptArgs) -> Result<Trial> {
        let space = self.real.space();
        let classes = match &arguments.damage {
            Some(damage) => vec![space.parse(damage)?],
            None if arguments.all_classes => (0..space.classes().len()).collect(),
            // The command line checks this itself.
            None => {
                return Err(LearnError::Invalid(
                    "give a damage, or all_classes for every one in turn".into(),
                ));
            }
        };
        Ok(Trial {
            classes,
            episodes: arguments.episodes.count(),
            course: onset_at(arguments.at.count(), &self.config, &self.real)?,
            seed: arguments.seed.wide(),
            kept: if arguments.video.is_some() { Kept::Positions } else { Kept::Velocities },
        })
    }

    /// Runs all agents; `None` when interrupted.
    fn walk(
        &self,
        wanted: ControllerConfig,
        trial: &Trial,
        interrupted: &AtomicBool,
    ) -> Result<Option<Contest>> {
        let robots = trial.classes.len() * trial.episodes;
        let mut controller = self.parts.assemble(&self.folder, &self.config, &self.known, wanted, robots)?;
        let policy = self.unaware.as_ref().map(Unaware::policy).transpose()?;
        let unaware = policy.as_deref().zip(self.unaware.as_ref());
        let unaware = unaware.map(|(policy, unaware)| (policy as &dyn MeanActions, &unaware.real as _));
        let stop = || interrupted.load(Ordering::Relaxed);
        let real: (&Config, &dyn EnvFactory) = (&self.config, &self.real);
        Contest::run(trial, &mut controller, unaware, &self.classes, real, &stop)
    }

    /// Forms the summary and writes the requested files.
    fn conclude(&self, arguments: &AdaptArgs, trial: &Trial, contest: &Contest) -> Result<AdaptationSummary> {
        let summary = AdaptationSummary::new(trial, &self.classes, contest)?;
        if arguments.all_classes {
            summary.write(&self.folder)?;
        }
        if let (Some(path), Some(episode)) = (&arguments.log, contest.adapted.episodes.first()) {
            write_given(path, trace(episode, &self.classes).as_bytes())?;
        }
        Ok(summary)
    }
}
