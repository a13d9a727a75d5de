//! A backend with room for what its envs return.

use dappo_sim::backend::{Backend, ObsRows, Reset, StepOutputs};

use crate::error::{LearnError, Result};

const NOT_OBSERVED: &str = "the robot's observation does not determine its state, so a twin cannot be \
                            re-synchronised with it; add `qpos` (with `skip` of at most 2) and `qvel` to \
                            `observation.policy.terms`, or do without a twin (preset `observation`)";

/// N robots.
pub struct Fleet {
    backend: Box<dyn Backend>,
    /// Observations after the last step or reset, `[N, O]`.
    pub obs: Vec<f32>,
    /// Whether each robot is out of its range of heights, `[N]`.
    pub fallen: Vec<bool>,
    /// Whether the physics of each robot diverged in the last step, `[N]`.
    pub diverged: Vec<bool>,
    /// Divergences so far.
    pub divergences: u64,
    rewards: Vec<f64>,
    reward_terms: Vec<f64>,
    forward_velocity: Vec<f64>,
}

impl Fleet {
    /// Robots without an episode.
    #[must_use]
    pub fn new(backend: Box<dyn Backend>) -> Self {
        let (envs, width) = (backend.num_envs(), backend.task().obs_dim());
        Self {
            obs: vec![0.0; envs * width],
            fallen: vec![false; envs],
            diverged: vec![false; envs],
            divergences: 0,
            rewards: vec![0.0; envs],
            reward_terms: vec![0.0; envs * backend.task().reward_len()],
            forward_velocity: vec![0.0; envs],
            backend,
        }
    }

    /// The backend that simulates them.
    #[must_use]
    pub fn backend(&self) -> &dyn Backend {
        self.backend.as_ref()
    }

    /// Observation of one robot, `[O]`.
    #[must_use]
    pub fn row(&self, env: usize) -> &[f32] {
        let width = self.backend.task().obs_dim();
        &self.obs[env * width..(env + 1) * width]
    }

    /// Begins new episodes.
    pub fn reset(&mut self, resets: &[Reset]) -> Result<()> {
        let stride = self.backend.task().obs_dim();
        self.fallen.fill(false);
        Ok(self.backend.reset(resets, ObsRows { data: &mut self.obs, stride })?)
    }

    /// Changes the damage classes of robots, given as (robot, class).
    pub fn set_classes(&mut self, changes: &[(usize, usize)]) -> Result<()> {
        Ok(self.backend.set_classes(changes)?)
    }

    /// Refuses a robot whose observation does not determine its state: no twin can be re-synchronised with
    /// it.
    pub fn check_twins(&self) -> Result<()> {
        let hidden = &self.backend.task().layout().hidden_state;
        if !hidden.is_empty() {
            return Err(LearnError::Invalid(format!(
                "the state of the robot is more than positions and velocities, so its observation does not \
                 determine it and a twin cannot be re-synchronised with it: {hidden}. Change that in the MJCF, \
                 use the preset `paper`, whose twins begin with the episode, or do without a twin (preset \
                 `observation`)"
            )));
        }
        if !self.backend.task().is_observed() {
            return Err(LearnError::Invalid(NOT_OBSERVED.into()));
        }
        Ok(())
    }

    /// Sets all robots but those to skip to the states in observations. Their own observations are then these
    /// very ones: a state contains no contact forces.
    ///
    /// # Shapes
    /// - `shown`: `[N, O]`, `skip`: `[N]`
    pub fn resync(&mut self, shown: &[f32], skip: &[bool]) -> Result<()> {
        let task = self.backend.task();
        let (nq, nv, width) = (task.layout().nq, task.layout().nv, task.obs_dim());
        let envs = self.fallen.len();
        let (mut qpos, mut qvel) = (vec![0.0; envs * nq], vec![0.0; envs * nv]);
        let states = qpos.chunks_exact_mut(nq).zip(qvel.chunks_exact_mut(nv));
        for ((qpos, qvel), row) in states.zip(shown.chunks_exact(width)) {
            if !task.read_state(row, qpos, qvel) {
                return Err(LearnError::Invalid(NOT_OBSERVED.into()));
            }
        }
        self.backend.set_state(&qpos, &qvel, skip, ObsRows { data: &mut self.obs, stride: width })?;
        let rows = self.obs.chunks_exact_mut(width).zip(shown.chunks_exact(width));
        for ((own, shown), _) in rows.zip(skip).filter(|(_, skip)| !**skip) {
            own.copy_from_slice(shown);
        }
        Ok(())
    }

    /// One step of all robots but those to skip. A robot that falls continues: there is no reset here.
    ///
    /// # Shapes
    /// - `actions`: `[N, A]`, `skip`: `[N]`
    pub fn step(&mut self, actions: &[f32], skip: &[bool]) -> Result<()> {
        let stride = self.backend.task().obs_dim();
        self.diverged.fill(false);
        let outputs = StepOutputs {
            obs: ObsRows { data: &mut self.obs, stride },
            rewards: &mut self.rewards,
            reward_terms: &mut self.reward_terms,
            terminated: &mut self.fallen,
            forward_velocity: &mut self.forward_velocity,
            diverged: &mut self.diverged,
        };
        self.backend.step(actions, skip, outputs)?;
        self.divergences += self.diverged.iter().filter(|diverged| **diverged).count() as u64;
        Ok(())
    }
}
