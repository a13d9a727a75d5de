//! Commands: what an episode asks the robot to do.

use serde::Deserialize;

use super::draws::within;
use crate::rng::Stream;

/// The section `[commands]`.
#[derive(Debug, Clone, Copy, PartialEq, Default, Deserialize)]
pub struct Commands {
    /// A velocity of the main body.
    #[serde(default)]
    pub velocity: Option<VelocityCommand>,
}

/// A velocity in the frame of the main body, drawn at the start of an episode and again after a while.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
pub struct VelocityCommand {
    /// Range of the forward velocity, m/s.
    pub lin_vel_x: [f64; 2],
    /// Range of the velocity to the left, m/s.
    pub lin_vel_y: [f64; 2],
    /// Range of the rate of turn to the left, rad/s.
    pub ang_vel_z: [f64; 2],
    /// Share of commands to stand still.
    #[serde(default)]
    pub standing: f64,
    /// Range of the time from one command to the next, s.
    pub resample_every: [f64; 2],
}

/// The section `[curriculum]`: what becomes harder while a policy is trained.
#[derive(Debug, Clone, Copy, PartialEq, Default, Deserialize)]
pub struct Curriculum {
    /// Commands.
    #[serde(default)]
    pub commands: Option<Ramp>,
}

/// A share that grows linearly to 1.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
pub struct Ramp {
    /// The share at the start.
    pub start: f64,
    /// Steps of each env until it is 1.
    pub steps: u64,
}

impl Ramp {
    /// The share after so many steps of an env.
    pub(super) fn at(self, step: f64) -> f64 {
        (self.start + (1.0 - self.start) * step / self.steps as f64).min(1.0)
    }
}

/// Numbers in a command: forward, to the left, rate of turn.
pub(super) const COMMAND: usize = 3;

impl VelocityCommand {
    /// Draws a command whose ranges are multiplied by `share`, and its duration, s.
    pub(super) fn draw(&self, stream: &mut Stream, share: f64) -> ([f64; COMMAND], f64) {
        let duration = within(stream, self.resample_every);
        let stands = within(stream, [0.0, 1.0]) < self.standing;
        let command =
            [self.lin_vel_x, self.lin_vel_y, self.ang_vel_z].map(|range| share * within(stream, range));
        (if stands { [0.0; COMMAND] } else { command }, duration)
    }
}
