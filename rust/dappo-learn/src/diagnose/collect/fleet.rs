//! A backend with room for what its envs return.

use dappo_sim::backend::{Backend, ObsRows, Reset, StepOutputs};

use crate::error::Result;

/// N robots.
pub(super) struct Fleet {
    backend: Box<dyn Backend>,
    /// Observations after the last step or reset, `[N, O]`.
    pub obs: Vec<f32>,
    /// Whether each robot is out of its range of heights, `[N]`.
    pub fallen: Vec<bool>,
    /// Divergences of the physics.
    pub divergences: u64,
    diverged: Vec<bool>,
    rewards: Vec<f64>,
    forward_velocity: Vec<f64>,
}

impl Fleet {
    pub fn new(backend: Box<dyn Backend>) -> Self {
        let (envs, width) = (backend.num_envs(), backend.task().obs_dim());
        Self {
            obs: vec![0.0; envs * width],
            fallen: vec![false; envs],
            divergences: 0,
            diverged: vec![false; envs],
            rewards: vec![0.0; envs],
            forward_velocity: vec![0.0; envs],
            backend,
        }
    }

    pub fn backend(&self) -> &dyn Backend {
        self.backend.as_ref()
    }

    /// Observation of one robot, `[O]`.
    pub fn row(&self, env: usize) -> &[f32] {
        let width = self.backend.task().obs_dim();
        &self.obs[env * width..(env + 1) * width]
    }

    pub fn reset(&mut self, resets: &[Reset]) -> Result<()> {
        let stride = self.backend.task().obs_dim();
        self.fallen.fill(false);
        Ok(self.backend.reset(resets, ObsRows { data: &mut self.obs, stride })?)
    }

    pub fn set_classes(&mut self, changes: &[(usize, usize)]) -> Result<()> {
        Ok(self.backend.set_classes(changes)?)
    }

    pub fn set_state(&mut self, qpos: &[f64], qvel: &[f64]) -> Result<()> {
        let stride = self.backend.task().obs_dim();
        Ok(self.backend.set_state(qpos, qvel, ObsRows { data: &mut self.obs, stride })?)
    }

    /// One step of all robots but those to skip. A robot that falls goes on: there is no reset here.
    pub fn step(&mut self, actions: &[f32], skip: &[bool]) -> Result<()> {
        let stride = self.backend.task().obs_dim();
        self.diverged.fill(false);
        let outputs = StepOutputs {
            obs: ObsRows { data: &mut self.obs, stride },
            rewards: &mut self.rewards,
            terminated: &mut self.fallen,
            forward_velocity: &mut self.forward_velocity,
            diverged: &mut self.diverged,
        };
        self.backend.step(actions, skip, outputs)?;
        self.divergences += self.diverged.iter().filter(|diverged| **diverged).count() as u64;
        Ok(())
    }
}
