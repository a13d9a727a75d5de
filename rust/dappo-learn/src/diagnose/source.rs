//! Where a diagnoser's samples come from.

use crate::error::Result;

/// One sample's raw rows: T observations after a step of the damaged robot and of its healthy twin, and the
/// damaged robot's actions in these steps.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Window {
    /// The damaged robot, `[T, O]`.
    pub damaged: Vec<f32>,
    /// The healthy twin, `[T, O]`.
    pub twin: Vec<f32>,
    /// Actions of the damaged robot, `[T, A]`.
    pub actions: Vec<f32>,
}

/// Windows by rollout and damage class.
pub trait PairSource: Sync {
    /// Number of rollouts; each has one window of every class.
    fn rollouts(&self) -> usize;

    /// Number of damage classes.
    fn classes(&self) -> usize;

    /// Steps in a window.
    fn timesteps(&self) -> usize;

    /// Length of an observation, without damage code.
    fn obs_dim(&self) -> usize;

    /// Length of an action.
    fn action_dim(&self) -> usize;

    /// Reads the first `timesteps` rows of a sample into `window`, whose vectors are resized.
    fn read(&self, rollout: usize, class: usize, timesteps: usize, window: &mut Window) -> Result<()>;
}
