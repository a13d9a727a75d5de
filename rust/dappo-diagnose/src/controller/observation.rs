//! Diagnosis without twins: the last T observations of every robot are diagnosed again and again while it walks, and a
//! class that several diagnoses in a row agree on is assumed.

use std::collections::VecDeque;

use dappo_learn::error::Result;
use dappo_learn::walk::EventKind;

use super::common::{Common, Robot};
use super::{CodeSource, ControllerConfig};
use crate::head::best;

/// The evidence for the damage of N robots.
pub(super) struct Observation {
    robots: Vec<Recent>,
    /// Steps of a window, T.
    timesteps: usize,
}

/// What was observed of one robot.
#[derive(Debug, Clone, Default)]
struct Recent {
    /// The last T observations or fewer, one after the other.
    obs: VecDeque<f32>,
    agreement: Agreement,
}

/// Diagnoses in a row that contradict the assumed class.
#[derive(Debug, Clone, Default)]
struct Agreement {
    class: usize,
    count: usize,
}

impl Agreement {
    /// Takes in a diagnosis; returns whether it is to be accepted.
    fn weigh(&mut self, config: &ControllerConfig, assumed: usize, class: usize, confidence: f32) -> bool {
        if class == assumed || !config.accepts(confidence) {
            *self = Self::default();
            return false;
        }
        let count = if class == self.class { self.count + 1 } else { 1 };
        *self = Self { class, count };
        if count < config.agreement {
            return false;
        }
        *self = Self::default();
        true
    }
}

impl Observation {
    pub fn new(robots: usize, timesteps: usize) -> Self {
        Self { robots: vec![Recent::default(); robots], timesteps }
    }

    pub fn reset(&mut self, index: usize) {
        self.robots[index] = Recent::default();
    }

    /// Judges all robots by their last steps, and chooses their next actions.
    pub fn step(&mut self, common: &mut Common) -> Result<()> {
        self.remember(common);
        let due: Vec<usize> = (0..self.robots.len()).filter(|&index| self.is_due(common, index)).collect();
        if !due.is_empty() {
            self.diagnose(common, &due)?;
        }
        let everyone: Vec<usize> = (0..self.robots.len()).collect();
        common.walk(&everyone)
    }

    /// Adds the last observations.
    fn remember(&mut self, common: &Common) {
        let full = self.timesteps * common.obs_dim();
        for (index, recent) in self.robots.iter_mut().enumerate() {
            let row = common.row(index);
            if recent.obs.len() == full {
                recent.obs.drain(..row.len());
            }
            recent.obs.extend(row);
        }
    }

    /// Whether a robot is diagnosed in this step. Without a reading there is nothing new to diagnose.
    fn is_due(&self, common: &Common, index: usize) -> bool {
        let Robot { step, is_blind, .. } = common.robots[index];
        // The first window is full after step T − 1, counted from 0.
        let since_full = (step + 1).checked_sub(self.timesteps as u64);
        since_full.is_some_and(|steps| steps.is_multiple_of(common.config.diagnose_every as u64)) && !is_blind
    }

    /// Diagnoses several robots at once.
    fn diagnose(&mut self, common: &mut Common, due: &[usize]) -> Result<()> {
        // Method A: the input of the network is the observations themselves.
        let windows: Vec<f32> = due.iter().flat_map(|&index| &self.robots[index].obs).copied().collect();
        let probabilities = common.skills.diagnoser.probabilities(&windows)?;
        let classes = probabilities.len() / due.len();
        for (&index, probabilities) in due.iter().zip(probabilities.chunks_exact(classes)) {
            if common.config.code == CodeSource::Expected {
                common.expect(index, probabilities);
            }
            let class = best(probabilities);
            let confidence = probabilities[class];
            let assumed = common.robots[index].class;
            if self.robots[index].agreement.weigh(&common.config, assumed, class, confidence) {
                common.event(index, EventKind::Diagnosed { class, confidence, accepted: true });
                common.assume(index, class);
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_class_is_accepted_once_enough_confident_diagnoses_in_a_row_agree_on_it() {
        let config = ControllerConfig { agreement: 3, confidence: Some(0.6), ..ControllerConfig::default() };
        // The step, from 0, at which a class is accepted by a controller that assumes class 1.
        let accepted = |diagnoses: &[(usize, f32)]| {
            let mut agreement = Agreement::default();
            diagnoses.iter().position(|&(class, confidence)| agreement.weigh(&config, 1, class, confidence))
        };
        assert_eq!(accepted(&[(2, 0.9); 3]), Some(2));
        // The healthy class is one like any other, whose number a robot without diagnoses has stored.
        assert_eq!(accepted(&[(0, 0.9); 3]), Some(2));
        // Another class, the assumed one, or too little confidence in between.
        let between = |class, confidence| {
            [(2, 0.9), (2, 0.9), (class, confidence), (2, 0.9), (2, 0.9), (2, 0.9)].to_vec()
        };
        for (class, confidence) in [(3, 0.9), (1, 0.9), (2, 0.5)] {
            assert_eq!(accepted(&between(class, confidence)), Some(5), "class {class}, {confidence}");
        }
        assert_eq!(accepted(&[(1, 1.0); 9]), None);
    }
}
