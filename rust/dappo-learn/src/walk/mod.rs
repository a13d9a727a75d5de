//! Paired episodes: every agent walks the same ones, from the same starts and with the same damage.
//! Evaluations, trials of controllers, the cost of mistakes and films read them.

mod agent;
mod classes;
mod encoding;
mod episode;
mod event;

use std::time::Instant;

use dappo_sim::memory::Bytes;
use dappo_sim::rng::env_keys;
use dappo_sim::vector_env::{Autoreset, DamageCourse, ResetOptions, StepRange, VectorEnv, VectorEnvConfig};

use crate::config::Config;
use crate::envs::EnvFactory;
use crate::error::{LearnError, Result};

pub use agent::{Agent, MeanActions, Onboard};
pub use classes::KnownClasses;
pub use encoding::Encoding;
pub use episode::{Episode, Kept, Walks};
pub use event::{Event, EventKind};

/// The same number of episodes of each of some damage classes; a class is a row. Episode e of every row
/// starts from the same state.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Trial {
    /// Damage class of each row.
    pub classes: Vec<usize>,
    /// Episodes of each row.
    pub episodes: usize,
    /// When the damage is active.
    pub course: DamageCourse,
    /// Seed of the initial states.
    pub seed: u64,
    /// What is kept of every episode.
    pub kept: Kept,
}

/// Damage that strikes every robot at one step and stays; fails if the episodes end before.
pub fn onset_at(step: usize, config: &Config, factory: &dyn EnvFactory) -> Result<DamageCourse> {
    let steps = config.env.max_episode_steps.unwrap_or(factory.robot().max_episode_steps);
    if step >= steps {
        return Err(LearnError::Invalid(format!(
            "the damage is to strike at step {step}, but an episode has {steps} steps"
        )));
    }
    Ok(DamageCourse { onset: StepRange { first: step, last: step }, ..DamageCourse::default() })
}

impl Trial {
    /// The episodes of an evaluation of these damage classes, with the settings of the section
    /// `[evaluation]`.
    #[must_use]
    pub fn of_evaluation(classes: Vec<usize>, config: &Config) -> Self {
        Self {
            classes,
            episodes: config.evaluation.episodes,
            course: config.damage.course(),
            seed: config.evaluation.seed,
            kept: Kept::Sums,
        }
    }

    /// Runs all episodes to their end with an agent, at once.
    ///
    /// `stop` is called before every step; once it returns true, the result is `None`.
    pub fn run(
        &self,
        agent: &mut Agent<'_>,
        config: &Config,
        factory: &dyn EnvFactory,
        stop: &dyn Fn() -> bool,
    ) -> Result<Option<Walks>> {
        let all = Bytes::of(self.classes.len(), size_of::<Episode>() + 64).times(self.episodes);
        // Episodes, keys and classes; the envs are checked where they are made.
        all.require(&format!("{} episodes a damage class", self.episodes))?;
        let starts = env_keys(self.seed, self.episodes);
        let keys: Vec<u64> = self.classes.iter().flat_map(|_| &starts).copied().collect();
        let rows = self.classes.iter().flat_map(|&class| std::iter::repeat_n(class, self.episodes));
        let classes: Vec<usize> = rows.collect();
        let mut codes = agent.codes(&keys, &classes);
        let mut state = agent.initial_state(classes.len());
        let mut env = self.envs(keys, &classes, config, factory)?;
        let episode = |(&class, &onset)| Episode { class, onset: onset as usize, ..Episode::default() };
        let onsets = &env.buffers().damage_onset;
        let mut walks = Walks {
            episodes: classes.iter().zip(onsets).map(episode).collect(),
            decision_seconds: Vec::new(),
        };
        let mut walking = vec![true; classes.len()];
        self.film(&env, &mut walks)?;
        while walking.contains(&true) {
            if stop() {
                return Ok(None);
            }
            let start = Instant::now();
            let actions = agent.act(&mut codes, &mut state, &env)?;
            walks.decision_seconds.push(start.elapsed().as_secs_f64());
            for event in agent.take_events().into_iter().filter(|event| walking[event.robot]) {
                walks.episodes[event.robot].events.push(event);
            }
            let command = env.buffers().command.clone();
            env.step(&actions)?;
            if walking[0] {
                self.film(&env, &mut walks)?;
            }
            self.count(&env, &command, &mut walks.episodes, &mut walking);
        }
        Ok(Some(walks))
    }

    /// The envs at the start of their episodes. Damage codes come from the agent, not from them.
    fn envs(
        &self,
        keys: Vec<u64>,
        classes: &[usize],
        config: &Config,
        factory: &dyn EnvFactory,
    ) -> Result<VectorEnv> {
        let mut env = factory.make(
            VectorEnvConfig {
                keys,
                observe_damage: false,
                autoreset: Autoreset::Disabled,
                course: self.course,
                ..factory.env_config(config)?
            },
            config.env.reward.as_deref(),
            factory.evaluation_physics(),
        )?;
        let assigned: Vec<Option<usize>> = classes.iter().copied().map(Some).collect();
        env.reset(ResetOptions { classes: Some(&assigned), ..ResetOptions::default() })?;
        Ok(env)
    }

    /// Adds the last step to the episodes that it belongs to, and notes which of them it ended. `command` is what held in
    /// this step, `[N, command_len]`.
    fn count(&self, env: &VectorEnv, command: &[f64], episodes: &mut [Episode], walking: &mut [bool]) {
        let buffers = env.buffers();
        let task = env.backend().task();
        for (index, episode) in episodes.iter_mut().enumerate().filter(|(index, _)| walking[*index]) {
            episode.steps += 1;
            episode.forward_reward += buffers.forward_velocity[index];
            episode.episode_return += buffers.rewards[index];
            if let Some((term, weight)) = task.tracking() {
                let tracking = buffers.reward_terms[index * task.reward_len() + term] / weight;
                episode.tracking += tracking;
                if self.kept != Kept::Sums {
                    let length = task.command_len();
                    episode.trackings.push(tracking);
                    episode.at_rest.extend(task.tracking_at_rest(&command[index * length..][..length]));
                }
            }
            episode.fell = buffers.terminated[index];
            episode.diverged = buffers.diverged[index];
            if self.kept != Kept::Sums {
                episode.velocities.push(buffers.forward_velocity[index]);
            }
        }
        for (index, walks) in walking.iter_mut().enumerate() {
            *walks &= !(buffers.terminated[index] || buffers.truncated[index]);
        }
    }

    /// Keeps the positions of the first robot.
    fn film(&self, env: &VectorEnv, walks: &mut Walks) -> Result<()> {
        let (Kept::Positions, Some(episode)) = (self.kept, walks.episodes.first_mut()) else { return Ok(()) };
        let (robots, layout) = (env.num_envs(), env.backend().task().layout());
        let (mut qpos, mut qvel) = (vec![0.0; robots * layout.nq], vec![0.0; robots * layout.nv]);
        env.state(&mut qpos, &mut qvel)?;
        episode.positions.extend_from_slice(&qpos[..layout.nq]);
        Ok(())
    }
}
