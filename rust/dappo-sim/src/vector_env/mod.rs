//! The vector env: N episodes with damage draws, onset, time limit and autoreset, over any backend.

mod autoreset;
mod buffers;
mod episode;
mod snapshot;

use crate::backend::{Backend, ObsRows, Reset, StepOutputs};
use crate::curriculum::ClassDistribution;
use crate::damage::DamageSpace;
use crate::error::{SimError, expect_len};

pub use autoreset::Autoreset;
pub use buffers::Buffers;
pub use episode::{DamageCourse, StepRange};
use episode::{Episode, EpisodeStart};
pub use snapshot::VectorEnvSnapshot;

/// How episodes begin and end.
#[derive(Debug, Clone)]
pub struct VectorEnvConfig {
    /// Random key of each env; episode e of an env is a function of (key, e).
    pub keys: Vec<u64>,
    /// Whether the damage code follows the observation (true = DA-PPO, false = PPO-Unaware).
    pub observe_damage: bool,
    /// What happens at the end of an episode.
    pub autoreset: Autoreset,
    /// Steps after which an episode is truncated.
    pub max_episode_steps: usize,
    /// Probabilities of the damage classes.
    pub classes: ClassDistribution,
    /// Steps for which an env has its class at least: episodes that end sooner are followed by others of the same class;
    /// with 0 or 1 each episode draws its class.
    pub min_class_steps: usize,
    /// When the damage is active.
    pub course: DamageCourse,
}

/// What an explicit reset fixes; `None` leaves it to the env's streams.
#[derive(Debug, Clone, Copy, Default)]
pub struct ResetOptions<'a> {
    /// New random keys, `[N]`; episodes count from 0 again.
    pub keys: Option<&'a [u64]>,
    /// Envs to reset, `[N]`; all for `None`.
    pub mask: Option<&'a [bool]>,
    /// Damage class of each env, `[N]`; `None` entries are drawn.
    pub classes: Option<&'a [Option<usize>]>,
    /// Step at which each env's damage strikes, `[N]`; `None` entries are drawn.
    pub onsets: Option<&'a [Option<usize>]>,
    /// Steps for which each env's damage lasts, `[N]`, 0 for good; `None` entries are drawn.
    pub durations: Option<&'a [Option<usize>]>,
    /// Steps from its end until it returns, `[N]`, 0 for never; `None` entries are drawn.
    pub pauses: Option<&'a [Option<usize>]>,
}

/// N damage-randomised episodes.
pub struct VectorEnv {
    backend: Box<dyn Backend>,
    config: VectorEnvConfig,
    /// Damage codes of all classes, `[classes, code_length]`.
    codes: Vec<f32>,
    code_length: usize,
    obs_dim: usize,
    episodes: Vec<Episode>,
    buffers: Buffers,
    diverged: u64,
    started: bool,
}

impl VectorEnv {
    /// Wraps a backend whose class table was compiled from `space`.
    pub fn new(
        backend: Box<dyn Backend>,
        space: &DamageSpace,
        config: VectorEnvConfig,
    ) -> Result<Self, SimError> {
        let envs = backend.num_envs();
        expect_len("keys", config.keys.len(), envs)?;
        expect_len("class weights", config.classes.len(), space.classes().len())?;
        expect_len("class table", backend.num_classes(), space.classes().len())?;
        config.course.check()?;
        if config.max_episode_steps == 0 {
            return Err(SimError::Config("max_episode_steps must be at least 1, got 0".into()));
        }
        let code_length = if config.observe_damage { space.code_length() } else { 0 };
        let obs_dim = backend.task().obs_dim() + code_length;
        Ok(Self {
            episodes: config.keys.iter().map(|&key| Episode::before_the_first(key)).collect(),
            buffers: Buffers::new(envs, obs_dim, backend.task()),
            codes: space.codes(),
            backend,
            config,
            code_length,
            obs_dim,
            diverged: 0,
            started: false,
        })
    }

    /// Number of envs.
    #[must_use]
    pub fn num_envs(&self) -> usize {
        self.episodes.len()
    }

    /// Length of an observation, the damage code included.
    #[must_use]
    pub fn obs_dim(&self) -> usize {
        self.obs_dim
    }

    /// Length of the damage code inside the observation; 0 when damage is not observed.
    #[must_use]
    pub fn code_length(&self) -> usize {
        self.code_length
    }

    /// Length of an action.
    #[must_use]
    pub fn action_dim(&self) -> usize {
        self.backend.task().layout().nu
    }

    /// The backend.
    #[must_use]
    pub fn backend(&self) -> &dyn Backend {
        self.backend.as_ref()
    }

    /// The damage class whose code belongs to the last observation of an env, whether it is observed or not: that of the
    /// active damage, or of the one before while the code is late.
    #[must_use]
    pub fn class_of_code(&self, env: usize) -> usize {
        self.episodes[env].class_of_last_code()
    }

    /// How often the physics of an env has diverged since the env was made.
    #[must_use]
    pub fn diverged(&self) -> u64 {
        self.diverged
    }

    /// Results of the last step or reset.
    #[must_use]
    pub fn buffers(&self) -> &Buffers {
        &self.buffers
    }

    /// Ends the env and hands over its buffers.
    #[must_use]
    pub fn into_buffers(self) -> Buffers {
        self.buffers
    }

    /// Changes the class distribution from the next episode of each env on.
    pub fn set_class_distribution(&mut self, classes: ClassDistribution) -> Result<(), SimError> {
        expect_len("class weights", classes.len(), self.config.classes.len())?;
        self.config.classes = classes;
        Ok(())
    }

    /// Starts new episodes in all envs or those of a mask.
    pub fn reset(&mut self, options: ResetOptions<'_>) -> Result<(), SimError> {
        let envs = self.num_envs();
        options.keys.map_or(Ok(()), |keys| expect_len("seeds", keys.len(), envs))?;
        options.mask.map_or(Ok(()), |mask| expect_len("reset mask", mask.len(), envs))?;
        options.classes.map_or(Ok(()), |classes| expect_len("damage classes", classes.len(), envs))?;
        for (name, values) in [
            ("onsets", options.onsets),
            ("damage durations", options.durations),
            ("damage pauses", options.pauses),
        ] {
            values.map_or(Ok(()), |values| expect_len(name, values.len(), envs))?;
        }
        let selected = |env: usize| options.mask.is_none_or(|mask| mask[env]);
        if !self.started && !(0..envs).all(selected) {
            return Err(SimError::Config(
                "the first reset must reset every env, got a mask that leaves some out".into(),
            ));
        }
        let classes = self.config.classes.len();
        if let Some(class) = options.classes.into_iter().flatten().flatten().find(|class| **class >= classes)
        {
            return Err(SimError::Config(format!(
                "damage class {class} does not exist; the classes are 0 to {}",
                classes - 1
            )));
        }
        let mut resets = Vec::with_capacity(envs);
        for env in (0..envs).filter(|&env| selected(env)) {
            if let Some(keys) = options.keys {
                self.episodes[env] = Episode::before_the_first(keys[env]);
            }
            let fixed = EpisodeStart {
                class: options.classes.and_then(|classes| classes[env]),
                onset: options.onsets.and_then(|onsets| onsets[env]),
                duration: options.durations.and_then(|durations| durations[env]),
                pause: options.pauses.and_then(|pauses| pauses[env]),
            };
            resets.push(self.begin_episode(env, fixed));
        }
        self.buffers.final_mask.fill(false);
        for reset in &resets {
            self.buffers.rewards[reset.env] = 0.0;
            self.buffers.terminated[reset.env] = false;
            self.buffers.truncated[reset.env] = false;
            self.buffers.diverged[reset.env] = false;
        }
        self.run_resets(&resets)?;
        self.started = true;
        self.show_task();
        Ok(())
    }

    /// Advances every env by one step.
    ///
    /// # Shapes
    /// - `actions`: `[N, action_dim]`, finite, clipped to ±1
    pub fn step(&mut self, actions: &[f32]) -> Result<(), SimError> {
        self.check_actions(actions)?;
        self.strike()?;
        let pending = self.pending_resets();
        let buffers = &mut self.buffers;
        self.backend.step(
            actions,
            &pending,
            StepOutputs {
                obs: ObsRows { data: &mut buffers.obs, stride: self.obs_dim },
                rewards: &mut buffers.rewards,
                reward_terms: &mut buffers.reward_terms,
                terminated: &mut buffers.terminated,
                forward_velocity: &mut buffers.forward_velocity,
                diverged: &mut buffers.diverged,
            },
        )?;
        for (env, episode) in self.episodes.iter_mut().enumerate().filter(|(env, _)| !pending[*env]) {
            episode.step += 1;
            self.buffers.episode_step[env] = episode.step as i64;
            self.diverged += u64::from(self.buffers.diverged[env]);
            // As Gymnasium's TimeLimit: a failure in the last step is both terminated and truncated.
            self.buffers.truncated[env] = episode.step >= self.config.max_episode_steps;
        }
        self.autoreset(&pending)?;
        self.show_task();
        Ok(())
    }

    /// Copies what the task remembers of the envs and others may see.
    fn show_task(&mut self) {
        let (task, buffers) = (self.backend.task(), &mut self.buffers);
        let rows =
            |width: usize| (0..self.episodes.len()).map(move |env| (env, env * width..(env + 1) * width));
        if !buffers.command.is_empty() {
            for (env, row) in rows(task.command_len()) {
                buffers.command[row].copy_from_slice(task.command(self.backend.memory(env)));
            }
        }
        if !buffers.events.is_empty() {
            for (env, row) in rows(buffers.events.len() / self.episodes.len()) {
                let drawn = task.events(self.backend.memory(env));
                let mut shown = buffers.events[row].iter_mut();
                drawn.for_each(|value| shown.next().into_iter().for_each(|shown| *shown = value));
            }
        }
    }

    fn check_actions(&self, actions: &[f32]) -> Result<(), SimError> {
        if !self.started {
            return Err(SimError::Config("the env must be reset before its first step".into()));
        }
        let width = self.action_dim();
        expect_len("actions", actions.len(), self.num_envs() * width)?;
        match actions.iter().position(|action| !action.is_finite()) {
            None => Ok(()),
            Some(at) => {
                Err(SimError::NonFiniteAction { env: at / width, component: at % width, value: actions[at] })
            }
        }
    }

    /// Changes the damage of envs in which it strikes or ends. One that waits for its reset stays as its episode ended.
    fn strike(&mut self) -> Result<(), SimError> {
        let changes: Vec<(usize, usize)> = self
            .episodes
            .iter()
            .enumerate()
            .filter_map(|(env, episode)| Some((env, episode.changes_to()?)))
            .collect();
        if !changes.is_empty() {
            self.backend.set_classes(&changes)?;
        }
        for (env, class) in changes {
            self.buffers.damage_class[env] = class as i64;
        }
        for env in 0..self.episodes.len() {
            if let Some(class) = self.episodes[env].code_changes_to() {
                self.show_code(env, class);
            }
        }
        Ok(())
    }

    /// Opens the next episode of an env and returns the reset that the backend has to do.
    fn begin_episode(&mut self, env: usize, fixed: EpisodeStart) -> Reset {
        let episode = &mut self.episodes[env];
        episode.next(&self.config, fixed);
        let (class, class_of_code) = (episode.class_in_force(), episode.class_of_code());
        let (key, number) = (episode.key, episode.number);
        self.buffers.damage_onset[env] = episode.onset as i64;
        self.buffers.episode_step[env] = 0;
        self.buffers.forward_velocity[env] = 0.0;
        self.buffers.damage_class[env] = class as i64;
        self.show_code(env, class_of_code);
        Reset { env, class, key, episode: number }
    }

    fn run_resets(&mut self, resets: &[Reset]) -> Result<(), SimError> {
        if resets.is_empty() {
            return Ok(());
        }
        self.backend.reset(resets, ObsRows { data: &mut self.buffers.obs, stride: self.obs_dim })
    }

    /// Writes the code of a damage class into the observation.
    fn show_code(&mut self, env: usize, class: usize) {
        if self.code_length > 0 {
            let end = (env + 1) * self.obs_dim;
            let code = &self.codes[class * self.code_length..(class + 1) * self.code_length];
            self.buffers.obs[end - self.code_length..end].copy_from_slice(code);
        }
    }

    /// Positions and velocities of all envs.
    ///
    /// # Shapes
    /// - `qpos`: `[N, nq]`, `qvel`: `[N, nv]`
    pub fn state(&self, qpos: &mut [f64], qvel: &mut [f64]) -> Result<(), SimError> {
        self.backend.state(qpos, qvel)
    }

    /// Sets every env to a given state and refreshes the observations. Episodes continue.
    ///
    /// Everything else that the state of a robot may hold, such as activations of its actuators, is that of a
    /// robot at rest. Since this is another state than the one that positions and velocities were read from,
    /// a robot with more than these is refused unless `at_rest` is set; [`VectorEnv::restore`] restores
    /// all of it.
    ///
    /// # Shapes
    /// - `qpos`: `[N, nq]`, `qvel`: `[N, nv]`
    pub fn set_state(&mut self, qpos: &[f64], qvel: &[f64], at_rest: bool) -> Result<(), SimError> {
        if !self.started {
            return Err(SimError::Config("the env must be reset before its state can be set".into()));
        }
        let hidden = &self.backend.task().layout().hidden_state;
        if !at_rest && !hidden.is_empty() {
            return Err(SimError::Config(format!(
                "the state of this robot is more than positions and velocities: {hidden}. Save all of it with \
                 save_state and restore it with restore_state, or pass at_rest=True to begin with it as after a reset"
            )));
        }
        let skip = vec![false; self.num_envs()];
        self.backend.set_state(
            qpos,
            qvel,
            &skip,
            ObsRows { data: &mut self.buffers.obs, stride: self.obs_dim },
        )
    }
}
