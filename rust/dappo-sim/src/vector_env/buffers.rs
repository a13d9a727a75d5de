//! What a vector env shows of its envs.

use crate::task::Task;

/// What the last step or reset left, one entry an env.
#[derive(Debug, Clone, Default)]
pub struct Buffers {
    /// Observations, the damage code included, `[N, obs_dim]`.
    pub obs: Vec<f32>,
    /// Rewards, `[N]`.
    pub rewards: Vec<f64>,
    /// Terms of the reward with their weights, in the last step of each env, `[N, terms]`.
    pub reward_terms: Vec<f64>,
    /// Commands that hold in the next step, `[N, command_len]`.
    pub command: Vec<f64>,
    /// What the events have drawn for each episode, `[N, events]`.
    pub events: Vec<f64>,
    /// Failures, `[N]`.
    pub terminated: Vec<bool>,
    /// Time limits, `[N]`.
    pub truncated: Vec<bool>,
    /// Velocities of the main body along +x, m/s, `[N]`.
    pub forward_velocity: Vec<f64>,
    /// Whether the physics diverged in the last step of the env, which is then a failure, `[N]`.
    pub diverged: Vec<bool>,
    /// Active damage class, `[N]`; healthy before onset.
    pub damage_class: Vec<i64>,
    /// Step of the episode at which the damage strikes, `[N]`.
    pub damage_onset: Vec<i64>,
    /// Steps done in the episode, `[N]`.
    pub episode_step: Vec<i64>,
    /// Same-step mode: whether an episode ended in this step, `[N]`.
    pub final_mask: Vec<bool>,
    /// Same-step mode: last observations of ended episodes, `[N, obs_dim]`.
    pub final_obs: Vec<f32>,
    /// Same-step mode: damage class at the end of ended episodes, `[N]`.
    pub final_damage_class: Vec<i64>,
    /// Same-step mode: damage onset of ended episodes, `[N]`.
    pub final_damage_onset: Vec<i64>,
    /// Same-step mode: forward velocity in the last step of ended episodes, `[N]`.
    pub final_forward_velocity: Vec<f64>,
}

impl Buffers {
    pub(super) fn new(envs: usize, obs_dim: usize, task: &Task) -> Self {
        Self {
            obs: vec![0.0; envs * obs_dim],
            rewards: vec![0.0; envs],
            reward_terms: vec![0.0; envs * task.reward_len()],
            command: vec![0.0; envs * task.command_len()],
            events: vec![0.0; envs * task.event_names().len()],
            terminated: vec![false; envs],
            truncated: vec![false; envs],
            forward_velocity: vec![0.0; envs],
            diverged: vec![false; envs],
            damage_class: vec![0; envs],
            damage_onset: vec![0; envs],
            episode_step: vec![0; envs],
            final_mask: vec![false; envs],
            final_obs: vec![0.0; envs * obs_dim],
            final_damage_class: vec![0; envs],
            final_damage_onset: vec![0; envs],
            final_forward_velocity: vec![0.0; envs],
        }
    }
}
