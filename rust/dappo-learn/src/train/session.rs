//! Everything that a training run carries from one iteration to the next.

use dappo_sim::VectorEnv;
use dappo_sim::vector_env::ResetOptions;

use crate::checkpoint::{Checkpoint, EnvState, Progress};
use crate::config::Config;
use crate::cpu;
use crate::envs::EnvFactory;
use crate::episodes::EpisodeTracker;
use crate::error::Result;
use crate::ppo::Ppo;
use crate::rollout::Rollout;
use crate::run_folder::RunFolder;
use crate::train::collect;

pub(super) struct Session {
    pub env: VectorEnv,
    pub ppo: Ppo,
    pub episodes: EpisodeTracker,
    pub progress: Progress,
    noise_keys: Vec<u64>,
    robot: String,
    keep: usize,
    /// Divergences of the physics that have been reported.
    diverged: u64,
}

impl Session {
    /// A run before its first iteration.
    pub fn new(config: &Config, factory: &dyn EnvFactory) -> Result<Self> {
        let env_config = factory.env_config(config)?;
        let noise_keys = env_config.keys.clone();
        let mut env = factory.make(env_config, config.env.reward.as_deref(), config.env.precision)?;
        env.reset(ResetOptions::default())?;
        let ppo =
            Ppo::new(&config.ppo, env.obs_dim(), env.code_length(), env.action_dim(), config.seed, &cpu())?;
        Ok(Self {
            episodes: EpisodeTracker::new(env.num_envs()),
            env,
            ppo,
            progress: Progress { iteration: 0, env_steps: 0, stage: 0 },
            noise_keys,
            robot: factory.robot().name.clone(),
            keep: config.checkpoint.keep,
            diverged: 0,
        })
    }

    /// Goes back to the newest checkpoint of the run.
    pub fn load(&mut self, run: &RunFolder, config: &Config) -> Result<()> {
        let checkpoint = Checkpoint::newest(&run.checkpoints(), &self.robot)?;
        self.ppo = checkpoint.learner(&config.ppo, &self.env)?;
        self.episodes = checkpoint.restore_envs(&mut self.env)?;
        self.progress = checkpoint.progress;
        // Stage 0 until `enter_stage` sees the difference and sets the class distribution.
        self.progress.stage = 0;
        run.rewind_metrics(self.progress.iteration)
    }

    /// Writes a checkpoint.
    pub fn save(&self, run: &RunFolder) -> Result<()> {
        Checkpoint::write(&run.checkpoints(), &self.robot, self.progress, self.keep, |folder| {
            self.ppo.save(folder)?;
            EnvState { envs: self.env.snapshot(), episodes: self.episodes.clone() }.save(folder)
        })
    }

    /// Changes the damage distribution when a new stage begins; running episodes keep their class.
    pub fn enter_stage(&mut self, stage: usize, config: &Config, factory: &dyn EnvFactory) -> Result<()> {
        if stage != self.progress.stage {
            self.env.set_class_distribution(config.curriculum[stage].mix.distribution(factory.space())?)?;
            self.progress.stage = stage;
        }
        Ok(())
    }

    /// How often the physics of an env has diverged since the last call.
    pub fn diverged(&mut self) -> u64 {
        let before = std::mem::replace(&mut self.diverged, self.env.diverged());
        self.diverged - before
    }

    /// Collects one rollout.
    pub fn collect(&mut self, horizon: usize) -> Result<Rollout> {
        let first_step = self.progress.env_steps / self.env.num_envs() as u64;
        collect(&mut self.env, &self.ppo, &mut self.episodes, &self.noise_keys, first_step, horizon)
    }
}
