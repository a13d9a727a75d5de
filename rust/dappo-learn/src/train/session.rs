//! Everything that a training run carries from one iteration to the next.

use std::collections::BTreeMap;

use dappo_nn::PolicyState;
use dappo_sim::task::Reflections;

use crate::checkpoint::{Checkpoint, EnvState, Progress};
use crate::config::Config;
use crate::engine::RolloutEngine;
use crate::envs::EnvFactory;
use crate::episodes::EpisodeTracker;
use crate::error::Result;
use crate::evaluate::{Evaluation, evaluate};
use crate::ppo::Ppo;
use crate::rollout::Rollout;
use crate::run_folder::{LockedRun, RunFolder};
use crate::sizes::Sizes;
use crate::walk::Encoding;

pub(super) struct Session {
    pub ppo: Ppo,
    pub episodes: EpisodeTracker,
    pub progress: Progress,
    /// What the policy remembers of the envs.
    memory: PolicyState,
    engine: Box<dyn RolloutEngine>,
    /// How observations and actions are reflected, if the networks are their own mirror images.
    mirror: Option<Reflections>,
    sizes: Sizes,
    num_envs: usize,
    robot: String,
    /// Names of the terms of the reward.
    reward_terms: Vec<String>,
    /// The metric of the term that rewards tracking of commanded velocities, and its weight, if there is one.
    tracking: Option<(String, f64)>,
    keep: usize,
    /// Divergences of the physics that have been reported.
    diverged: u64,
}

impl Session {
    /// A run before its first iteration.
    pub fn new(config: &Config, factory: &dyn EnvFactory) -> Result<Self> {
        let sizes = factory.sizes(config)?;
        let num_envs = config.env.num_envs;
        let device = config.ppo.device.open()?;
        let mirror = factory.mirror(config)?;
        let reward = factory.robot().reward(config.env.reward.as_deref())?;
        let metric = |name: &str| format!("reward_{name}");
        Ok(Self {
            engine: factory.engine(config)?,
            ppo: Ppo::new(&config.ppo, sizes, config.seed, &device)?.with_mirror(mirror.clone())?,
            mirror,
            memory: PolicyState::new(num_envs, config.ppo.memory()),
            episodes: EpisodeTracker::new(num_envs),
            progress: Progress { iteration: 0, env_steps: 0, stage: 0 },
            sizes,
            num_envs,
            robot: factory.robot().name.clone(),
            reward_terms: reward.terms.iter().map(|term| metric(&term.name)).collect(),
            tracking: reward.tracking().map(|(_, term)| (metric(&term.name), term.weight)),
            keep: config.checkpoint.keep,
            diverged: 0,
        })
    }

    /// Goes back to the newest checkpoint of the run.
    pub fn load(&mut self, run: &LockedRun, config: &Config) -> Result<()> {
        let checkpoint = Checkpoint::newest(&run.checkpoints(), &self.robot)?;
        let ppo = checkpoint.learner(&config.ppo, self.sizes, &config.ppo.device.open()?)?;
        self.ppo = ppo.with_mirror(self.mirror.clone())?;
        let (episodes, memory) = checkpoint.restore_envs(self.engine.as_mut(), config.ppo.memory())?;
        (self.episodes, self.memory) = (episodes, memory);
        self.progress = checkpoint.progress;
        // Stage 0 until `enter_stage` sees the difference and sets the class distribution.
        self.progress.stage = 0;
        run.rewind_metrics(self.progress.iteration)
    }

    /// Writes a checkpoint.
    pub fn save(&self, run: &RunFolder) -> Result<()> {
        Checkpoint::write(&run.checkpoints(), &self.robot, self.progress, self.keep, |folder| {
            self.ppo.save(folder)?;
            let (envs, episodes, memory) =
                (self.engine.snapshot()?, self.episodes.clone(), self.memory.clone());
            EnvState { envs, episodes, memory }.save(folder)
        })
    }

    /// Changes the damage distribution when a new stage begins; running episodes keep their class.
    pub fn enter_stage(&mut self, stage: usize, config: &Config, factory: &dyn EnvFactory) -> Result<()> {
        if stage != self.progress.stage {
            self.engine
                .set_class_distribution(config.curriculum[stage].mix.distribution(factory.space())?)?;
            self.progress.stage = stage;
        }
        Ok(())
    }

    /// The mean of each term of the reward since the last call.
    pub fn reward_terms(&mut self) -> BTreeMap<String, f64> {
        self.reward_terms.iter().cloned().zip(self.episodes.mean_reward_terms()).collect()
    }

    /// How well commanded velocities were tracked, from 0 to 1, from the means of the terms of the reward.
    pub fn tracking(&self, reward_terms: &BTreeMap<String, f64>) -> Option<f64> {
        let (metric, weight) = self.tracking.as_ref()?;
        reward_terms.get(metric).map(|mean| mean / weight)
    }

    /// How often the physics of an env has diverged since the last call.
    pub fn diverged(&mut self) -> u64 {
        let before = std::mem::replace(&mut self.diverged, self.engine.diverged());
        self.diverged - before
    }

    /// Evaluates the policy as it is now; `None` once `stop` returns true.
    pub fn evaluate(
        &self,
        config: &Config,
        factory: &dyn EnvFactory,
        stop: &dyn Fn() -> bool,
    ) -> Result<Option<Evaluation>> {
        evaluate(&self.ppo.frozen()?.policy, config, Encoding::True, factory, stop)
    }

    /// Collects one rollout.
    pub fn collect(&mut self) -> Result<Rollout> {
        let first_step = self.progress.env_steps / self.num_envs as u64;
        self.engine.collect(&self.ppo.frozen()?, &mut self.memory, &mut self.episodes, first_step)
    }
}
