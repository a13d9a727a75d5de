//! Where a diagnoser's samples come from.

use dappo_learn::error::Result;

use super::Twin;

/// One sample's raw rows: T post-step observations of the damaged robot and of its healthy twin, and the damaged
/// robot's actions.
#[derive(Debug, Clone, Default)]
pub struct Window {
    /// Observations of the damaged robot, `[T, O]`.
    pub damaged: Vec<f32>,
    /// Observations of its healthy twin, `[T, O]`; empty without one.
    pub twin: Vec<f32>,
    /// Actions of the damaged robot, `[T, A]`.
    pub actions: Vec<f32>,
}

/// Windows by rollout and damage class.
pub trait PairSource: Sync {
    /// Number of rollouts; each has a window of every class.
    fn rollouts(&self) -> usize;

    /// Number of damage classes.
    fn classes(&self) -> usize;

    /// Steps of a window, T.
    fn timesteps(&self) -> usize;

    /// Length of an observation, O.
    fn obs_dim(&self) -> usize;

    /// Length of an action, A.
    fn action_dim(&self) -> usize;

    /// Mode of the twins of the windows; `None` for windows without.
    fn twin(&self) -> Option<Twin> {
        Some(Twin::default())
    }

    /// Reads the first `timesteps` rows of a sample into `window`, whose vectors are resized.
    fn read(&self, rollout: usize, class: usize, timesteps: usize, window: &mut Window) -> Result<()>;
}
