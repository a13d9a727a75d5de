//! What is kept of an episode.

use super::Event;

/// How much of every episode is kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kept {
    /// Sums over its steps: a few numbers, however long it is.
    Sums,
    /// These, and the forward velocity and the tracking in every step.
    Velocities,
    /// These, and the positions of the first robot, to draw them.
    Positions,
}

/// One episode of one robot.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Episode {
    /// Damage class of the episode.
    pub class: usize,
    /// Step at which the damage strikes.
    pub onset: usize,
    /// Steps up to its end.
    pub steps: usize,
    /// Σ forward velocity, m/s.
    pub forward_reward: f64,
    /// Σ reward.
    pub episode_return: f64,
    /// Σ of how well the commanded velocity was tracked, from 0 to 1 a step; 0 for a task without commands.
    pub tracking: f64,
    /// Whether it ended in failure.
    pub fell: bool,
    /// Whether it ended because the physics diverged.
    pub diverged: bool,
    /// What the controller did, if there was one.
    pub events: Vec<Event>,
    /// Forward velocity in every step, m/s, `[steps]`, or empty.
    pub velocities: Vec<f64>,
    /// How well the command was tracked in every step, from 0 to 1, `[steps]`; empty for a task without commands, too.
    pub trackings: Vec<f64>,
    /// What that would be for a robot at rest, `[steps]`, or empty.
    pub at_rest: Vec<f64>,
    /// Positions before every step and after the last, `[steps + 1, nq]`, or empty.
    pub positions: Vec<f64>,
}

/// The episodes of one agent in a trial.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Walks {
    /// One entry an episode, those of a row side by side.
    pub episodes: Vec<Episode>,
    /// The time that the agent took for each step of all robots, s.
    pub decision_seconds: Vec<f64>,
}
