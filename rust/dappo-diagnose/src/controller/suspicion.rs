//! When a diagnosis window of a walking robot must begin.

use std::collections::VecDeque;

use dappo_learn::statistics::{mean, upper_median};

use super::{ControllerConfig, Trigger};

/// A cool-down grows to at most this many times its length.
const LONGEST_REST: usize = 32;

/// Why a diagnosis window begins.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Evidence {
    /// Mean forward velocity over the last steps, m/s.
    pub forward_velocity: f64,
    /// Median residual over the last steps.
    pub residual: Option<f64>,
}

/// Measurements of a walking robot since its start or its last diagnosis window.
#[derive(Debug)]
pub(super) struct Suspicion {
    velocities: VecDeque<f64>,
    residuals: VecDeque<f64>,
    /// Steps left in which nothing is suspected.
    rest: usize,
    /// Consecutive diagnosis windows after none of which the robot moved as expected.
    futile: u32,
}

impl Suspicion {
    pub fn new(config: &ControllerConfig) -> Self {
        Self { velocities: VecDeque::new(), residuals: VecDeque::new(), rest: config.cooldown, futile: 0 }
    }

    /// Adds a step, and returns whether a diagnosis window must begin. What was not measured is not finite or
    /// `None`.
    pub fn weigh(
        &mut self,
        config: &ControllerConfig,
        velocity: f64,
        residual: Option<f64>,
        expected: f64,
    ) -> Option<Evidence> {
        if velocity.is_finite() {
            remember(&mut self.velocities, config.speed_window, velocity);
        }
        if let Some(residual) = residual {
            remember(&mut self.residuals, config.residual_window, residual);
        }
        if self.rest > 0 {
            self.rest -= 1;
            return None;
        }
        let evidence = Evidence {
            forward_velocity: mean(self.velocities.iter().copied()),
            residual: upper_median(self.residuals.iter().copied()),
        };
        let suspected = if config.trigger == Some(Trigger::Speed) {
            let is_full = self.velocities.len() == config.speed_window;
            is_full.then_some(evidence.forward_velocity < config.speed_fraction * expected)
        } else {
            let is_full = self.residuals.len() == config.residual_window;
            evidence.residual.filter(|_| is_full).map(|residual| residual > config.residual_threshold)
        };
        match suspected {
            Some(true) => Some(evidence),
            Some(false) => {
                self.futile = 0;
                None
            }
            None => None,
        }
    }

    /// Restarts after a diagnosis window.
    pub fn rest(&mut self, config: &ControllerConfig) {
        self.velocities.clear();
        self.residuals.clear();
        let factor = 2_usize.saturating_pow(self.futile).min(LONGEST_REST);
        self.rest = config.cooldown.saturating_mul(factor);
        self.futile = self.futile.saturating_add(1);
    }
}

fn remember(values: &mut VecDeque<f64>, most: usize, value: f64) {
    if values.len() == most {
        values.pop_front();
    }
    values.push_back(value);
}

#[cfg(test)]
mod tests {
    use super::*;

    fn config(trigger: Trigger) -> ControllerConfig {
        ControllerConfig {
            trigger: Some(trigger),
            speed_window: 4,
            speed_fraction: 0.5,
            residual_window: 5,
            residual_threshold: 0.1,
            cooldown: 3,
            ..ControllerConfig::default()
        }
    }

    /// The first step, from 0, at which these velocities (expected: 2 m/s) or residuals raise a suspicion.
    fn first(config: &ControllerConfig, steps: &[(f64, f64)]) -> Option<usize> {
        let mut suspicion = Suspicion::new(config);
        steps.iter().position(|&(velocity, residual)| {
            let residual = residual.is_finite().then_some(residual);
            suspicion.weigh(config, velocity, residual, 2.0).is_some()
        })
    }

    #[test]
    fn a_robot_is_too_slow_when_its_mean_velocity_over_a_window_is_below_the_share_of_the_expected_one() {
        let config = config(Trigger::Speed);
        // Means of four: 2, 1.5, 1 (not below 1), 0.5.
        let slowing: Vec<(f64, f64)> = [2.0, 2.0, 2.0, 2.0, 0.0, 0.0, 0.0].map(|v| (v, 0.0)).to_vec();
        assert_eq!(first(&config, &slowing), Some(6));
        // A window that is not full raises no suspicion, however long ago the cool-down ended.
        assert_eq!(first(&config, &[(0.0, 0.0), (f64::NAN, 0.0), (0.0, 0.0), (0.0, 0.0)]), None);
        assert_eq!(first(&config, &[(0.0, 9.0); 9]), Some(3));
    }

    #[test]
    fn single_residuals_are_outvoted_and_lasting_ones_are_not() {
        let config = config(Trigger::Residual);
        let steps = |residuals: [f64; 8]| residuals.map(|residual| (2.0, residual)).to_vec();
        assert_eq!(first(&config, &steps([0.0, 0.0, 0.0, 9.0, 0.0, 9.0, 0.0, 0.0])), None);
        assert_eq!(first(&config, &steps([0.0, 0.0, 0.0, 0.0, 0.0, 9.0, 9.0, 9.0])), Some(7));
        // Steps without a residual are no evidence.
        assert_eq!(first(&config, &steps([9.0, 9.0, 9.0, 9.0, f64::NAN, f64::NAN, 9.0, 0.0])), Some(6));
    }

    #[test]
    fn nothing_is_suspected_during_a_cool_down_which_doubles_until_there_is_peace() {
        let config = config(Trigger::Residual);
        let mut suspicion = Suspicion::new(&config);
        let mut until_suspected = |residual: f64| {
            let waited = (0..1000).find(|_| suspicion.weigh(&config, 2.0, Some(residual), 2.0).is_some());
            if waited.is_some() {
                suspicion.rest(&config);
            }
            waited
        };
        // The window of five is full at its fifth step, step 4 counted from 0; then the cool-down is what lasts.
        assert_eq!([9.0; 4].map(&mut until_suspected), [Some(4), Some(4), Some(6), Some(12)]);
        assert_eq!(until_suspected(0.0), None);
        // Three of five residuals are high again at the third step, and the next cool-down is a single one.
        assert_eq!([9.0; 2].map(&mut until_suspected), [Some(2), Some(4)]);
    }
}
