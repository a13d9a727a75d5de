//! Settings of the run-time loop.

use dappo_learn::config::{Assignment, Layers};
use dappo_learn::error::Result;
use dappo_learn::faults::Faults;
use serde::{Deserialize, Serialize};
use strum::{EnumString, IntoStaticStr, VariantNames};

/// Steps of a window at most, which is kept for every robot.
const MOST_WINDOW: u64 = 1_000_000;
/// Steps at most that something waits for; the time to the next diagnosis window doubles.
const MOST_WAIT: u64 = 1 << 31;

/// What makes a controller suspect damage.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[derive(EnumString, IntoStaticStr, VariantNames)]
#[strum(serialize_all = "lowercase")]
pub enum Trigger {
    /// The robot moves differently from a twin with the assumed class. Needs an accurate simulation, and then
    /// also detects damage without loss of speed, wrong diagnoses, and repairs.
    Residual,
    /// The robot walks too slowly for the assumed class.
    Speed,
}

/// When a controller suspects damage and which diagnoses it accepts. Times are in control steps.
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
    /// Steps after a start or a diagnosis in which nothing is suspected. Each diagnosis window that does not
    /// remove the suspicion doubles the time to the next one.
    pub cooldown: usize,
    /// Least probability of a diagnosis that is accepted.
    pub confidence: f64,
    /// Steps with a residual after which a diagnosis is withdrawn, if the twin with the diagnosed damage is
    /// no closer to the robot than the healthy one was; 0 for never. Needs the trigger `residual` and a
    /// diagnoser whose twins are re-synchronised before every step.
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
    /// The defaults with these settings laid over them.
    pub fn with(settings: &[Assignment]) -> Result<Self> {
        let config: Self = Layers::of(settings)?.typed()?;
        config.check()?;
        Ok(config)
    }

    /// Fails with all settings outside their range.
    pub fn check(&self) -> Result<()> {
        let mut faults = Faults::default();
        for (key, window) in [("speed_window", self.speed_window), ("residual_window", self.residual_window)]
        {
            faults.count(key, window as u64, MOST_WINDOW);
        }
        for (key, steps) in [("cooldown", self.cooldown), ("probation", self.probation)] {
            let expected = format!("a whole number from 0 to {MOST_WAIT}");
            faults.rule(key, steps, &expected, steps as u64 <= MOST_WAIT);
        }
        faults.positive("speed_fraction", self.speed_fraction, 1e9);
        faults.positive("residual_threshold", self.residual_threshold, 1e9);
        let confidence = self.confidence;
        faults.rule("confidence", confidence, "a number in [0, 1]", (0.0..=1.0).contains(&confidence));
        Ok(faults.end()?)
    }
}
