//! Damage in mid-walk: what a controller makes of it, beside a policy that is told the truth and ones that are not.
//!
//! Every [`Pilot`] walks the same episodes: the same starts, and the same damage at the same step.

mod class;
mod outcome;
mod pilot;
mod summary;
mod trace;
mod vocabulary;

use std::time::Instant;

use dappo_sim::rng::env_keys;
use dappo_sim::vector_env::{Autoreset, Onset, ResetOptions, VectorEnv, VectorEnvConfig};

use crate::config::Config;
use crate::controller::Event;
use crate::envs::EnvFactory;
use crate::error::{LearnError, Result};

pub use class::{ClassOutcome, Told};
pub use outcome::{EpisodeOutcome, RECOVERED};
pub use pilot::Pilot;
pub use summary::{DecisionTime, Summary};
pub use trace::trace;
pub use vocabulary::Vocabulary;

/// Episodes of some damage classes, all struck at one step.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Trial {
    /// Damage classes of the robots.
    pub classes: Vec<usize>,
    /// Episodes of each class.
    pub episodes: usize,
    /// Steps that the robot walks healthily.
    pub onset: usize,
    /// Seed of the initial states.
    pub seed: u64,
    /// Whether the positions of the first episode are kept, to draw them.
    pub filmed: bool,
}

/// How a pilot fared in one episode.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Walk {
    /// Damage class that struck.
    pub class: usize,
    /// Forward velocity in every step up to the end of the episode, m/s.
    pub velocities: Vec<f64>,
    /// Whether the episode ended in failure.
    pub fell: bool,
    /// What the controller did, if there was one.
    pub events: Vec<Event>,
    /// Positions before every step and after the last, `[steps + 1, nq]`; empty if nobody films.
    pub positions: Vec<f64>,
}

/// How a pilot fared in a trial.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Walks {
    /// One entry an episode, those of a class side by side.
    pub episodes: Vec<Walk>,
    /// The time that the pilot took for each step of all robots, s.
    pub decision_seconds: Vec<f64>,
}

/// The walks of all pilots of one trial.
pub struct Contest {
    /// The controller's.
    pub adapted: Walks,
    /// Those of the policy that is told the truth.
    pub oracle: Walks,
    /// Those of the policy that takes every robot for healthy.
    pub unadapted: Walks,
    /// Those of PPO-Unaware.
    pub unaware: Option<Walks>,
}

impl Trial {
    /// The envs of the trial, those of a class side by side: robot e of every class starts from the same state.
    pub fn envs(&self, config: &Config, factory: &dyn EnvFactory) -> Result<VectorEnv> {
        let steps = config.env.max_episode_steps.unwrap_or(factory.robot().max_episode_steps);
        if self.onset >= steps {
            return Err(LearnError::Invalid(format!(
                "the damage is to strike at step {}, but an episode has {steps} steps",
                self.onset
            )));
        }
        let starts = env_keys(self.seed, self.episodes);
        let keys = self.classes.iter().flat_map(|_| &starts).copied().collect();
        let mut env = factory.make(
            VectorEnvConfig {
                keys,
                observe_damage: false,
                autoreset: Autoreset::Disabled,
                onset: Onset { first: self.onset, last: self.onset },
                ..factory.env_config(config)?
            },
            config.env.reward.as_deref(),
            config.evaluation.compute(),
        )?;
        let assigned: Vec<Option<usize>> =
            self.classes.iter().flat_map(|&class| std::iter::repeat_n(Some(class), self.episodes)).collect();
        env.reset(ResetOptions { classes: Some(&assigned), ..ResetOptions::default() })?;
        Ok(env)
    }

    /// The episodes of the class in row `row` that did not end before its damage struck; all of healthy robots.
    fn struck(&self, row: usize, walks: &Walks) -> Vec<usize> {
        let is_struck = |walk: &Walk| walk.class == 0 || walk.velocities.len() > self.onset;
        let of_class = row * self.episodes..(row + 1) * self.episodes;
        of_class.filter(|&episode| is_struck(&walks.episodes[episode])).collect()
    }

    /// Lets a pilot walk all episodes to their end; `None` once `stop` says so.
    pub fn run(
        &self,
        pilot: &mut Pilot<'_>,
        config: &Config,
        factory: &dyn EnvFactory,
        stop: &dyn Fn() -> bool,
    ) -> Result<Option<Walks>> {
        let mut env = self.envs(config, factory)?;
        let classes = self.classes.iter().flat_map(|&class| std::iter::repeat_n(class, self.episodes));
        let mut decision_seconds = Vec::new();
        let mut walks: Vec<Walk> = classes.map(|class| Walk { class, ..Walk::default() }).collect();
        let mut walking = vec![true; walks.len()];
        self.film(&env, &mut walks)?;
        while walking.contains(&true) {
            if stop() {
                return Ok(None);
            }
            let start = Instant::now();
            let actions = pilot.act(&env)?;
            decision_seconds.push(start.elapsed().as_secs_f64());
            let events = pilot.take_events();
            for event in events.into_iter().filter(|event| walking[event.robot]) {
                walks[event.robot].events.push(event);
            }
            env.step(&actions)?;
            if walking[0] {
                self.film(&env, &mut walks)?;
            }
            let buffers = env.buffers();
            for (index, walk) in walks.iter_mut().enumerate() {
                if !walking[index] {
                    continue;
                }
                walk.velocities.push(buffers.forward_velocity[index]);
                walk.fell = buffers.terminated[index];
                walking[index] = !(buffers.terminated[index] || buffers.truncated[index]);
            }
        }
        Ok(Some(Walks { episodes: walks, decision_seconds }))
    }

    /// Keeps the positions of the first robot.
    fn film(&self, env: &VectorEnv, walks: &mut [Walk]) -> Result<()> {
        let (true, Some(walk)) = (self.filmed, walks.first_mut()) else { return Ok(()) };
        let (robots, layout) = (env.num_envs(), env.backend().task().layout());
        let (mut qpos, mut qvel) = (vec![0.0; robots * layout.nq], vec![0.0; robots * layout.nv]);
        env.state(&mut qpos, &mut qvel)?;
        walk.positions.extend_from_slice(&qpos[..layout.nq]);
        Ok(())
    }
}
