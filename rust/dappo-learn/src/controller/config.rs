//! Settings of the run-time loop.

use serde::{Deserialize, Serialize};

use crate::error::{LearnError, Result};

/// What makes a controller suspect damage.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Trigger {
    /// The robot walks too slowly for the class that the policy is told.
    Speed,
    /// The robot moves differently from a twin with the class that the policy is told. Needs a faithful simulation,
    /// and then notices damage that slows nothing down, wrong diagnoses, and damage that has been repaired.
    Residual,
}

impl Trigger {
    /// The names of all triggers; the first is the default.
    pub const NAMES: [&'static str; 2] = ["residual", "speed"];

    /// The trigger of this name.
    pub fn parse(name: &str) -> Result<Self> {
        match name {
            "speed" => Ok(Self::Speed),
            "residual" => Ok(Self::Residual),
            _ => Err(LearnError::Config {
                key: "trigger",
                got: format!("`{name}`"),
                expected: "`residual` or `speed`",
            }),
        }
    }
}

/// When a controller suspects damage and what it believes. Times are in control steps.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ControllerConfig {
    /// What makes it suspect damage.
    pub trigger: Trigger,
    /// Steps over which the forward velocity is averaged.
    pub speed_window: usize,
    /// Share of the expected forward velocity below which a robot is too slow.
    pub speed_fraction: f64,
    /// Steps over which the median of the residual is taken.
    pub residual_window: usize,
    /// Residual above which a robot differs from its twin: root mean square over the entries of an observation, in
    /// standard deviations of the training.
    pub residual_threshold: f64,
    /// Steps after a start or a diagnosis in which nothing is suspected. Each examination that does not bring peace
    /// doubles the time to the next one.
    pub cooldown: usize,
    /// Probability that a diagnosis needs to be believed.
    pub confidence: f64,
    /// Steps with a residual after which a diagnosis is withdrawn, if the twin with the named damage is no closer to
    /// the robot than the healthy one was; 0 for never. Needs the trigger `residual` and a diagnoser whose twins are
    /// put beside the robot before every step.
    pub probation: usize,
}

impl Default for ControllerConfig {
    fn default() -> Self {
        Self {
            trigger: Trigger::Residual,
            speed_window: 50,
            speed_fraction: 0.5,
            residual_window: 10,
            residual_threshold: 0.05,
            cooldown: 50,
            confidence: 0.5,
            probation: 10,
        }
    }
}

impl ControllerConfig {
    /// Fails at the first setting outside its range.
    pub fn check(&self) -> Result<()> {
        let rule = |key, value: f64, expected, holds: bool| {
            if holds && value.is_finite() {
                return Ok(());
            }
            Err(LearnError::Config { key, got: value.to_string(), expected })
        };
        rule("speed_window", self.speed_window as f64, "at least 1", self.speed_window > 0)?;
        rule("speed_fraction", self.speed_fraction, "a number above 0", self.speed_fraction > 0.0)?;
        rule("residual_window", self.residual_window as f64, "at least 1", self.residual_window > 0)?;
        rule(
            "residual_threshold",
            self.residual_threshold,
            "a number above 0",
            self.residual_threshold > 0.0,
        )?;
        rule("confidence", self.confidence, "a number in [0, 1]", (0.0..=1.0).contains(&self.confidence))
    }
}
