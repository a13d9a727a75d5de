//! Lengths of what a learner sees and does.

/// Lengths of what a learner sees and does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Sizes {
    /// Length of an observation, privileged entries and the damage code included.
    pub obs_dim: usize,
    /// Number of entries before the damage code that the value net alone is given.
    pub privileged: usize,
    /// Length of the damage code in it; 0 when damage is not observed.
    pub code_length: usize,
    /// Length of an action.
    pub action_dim: usize,
}

impl Sizes {
    /// Length of what the policy observes, without the damage code.
    #[must_use]
    pub fn seen(&self) -> usize {
        self.obs_dim - self.privileged - self.code_length
    }
}
