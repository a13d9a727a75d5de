//! Terms that Python functions compute.

use super::observation::ObservationGroup;
use super::{Measure, Quantity, Task};

impl Task {
    /// Terms of the observation that Python functions compute: the function, and which entries it writes.
    pub fn python_observations(&self) -> impl Iterator<Item = (&str, std::ops::Range<usize>)> {
        let critic = self.critic.iter().flat_map(ObservationGroup::blocks);
        let critic = critic
            .map(|(term, block)| (term, block.start + self.policy.len()..block.end + self.policy.len()));
        self.policy.blocks().chain(critic).filter_map(|(term, block)| match &term.quantity {
            Quantity::Python { function, .. } => Some((function.as_str(), block)),
            _ => None,
        })
    }

    /// Terms of the reward that Python functions compute: the function, the index of the term, and its weight.
    pub fn python_rewards(&self) -> impl Iterator<Item = (&str, usize, f64)> {
        self.rewards.iter().enumerate().filter_map(|(index, term)| match &term.measure {
            Measure::Python { function } => Some((function.as_str(), index, term.weight)),
            _ => None,
        })
    }

    /// Python functions that return failures.
    #[must_use]
    pub fn python_failures(&self) -> &[String] {
        &self.python_failures
    }
}
