//! Positions and velocities in observations.

use super::{ObservationTerm, Quantity, Task};

impl Task {
    /// Reads positions and velocities back from an observation; what it leaves out (x and y of the root) becomes 0.
    /// False, with nothing written, if the observation shows no more than a part of them.
    ///
    /// # Shapes
    /// - `obs`: `[obs_dim]`, `qpos`: `[nq]`, `qvel`: `[nv]`
    pub fn read_state(&self, obs: &[f32], qpos: &mut [f64], qvel: &mut [f64]) -> bool {
        let (mut positions, mut velocities) = (None, None);
        for (term, block) in self.policy.blocks() {
            // The floor is level: a robot moves at (0, 0) as it does anywhere else.
            if term.shows_positions() {
                positions = Some(&obs[block]);
            } else if term.shows_velocities() {
                velocities = Some(&obs[block]);
            }
        }
        let (Some(positions), Some(velocities)) = (positions, velocities) else { return false };
        let (unseen, seen) = qpos.split_at_mut(self.layout.nq - positions.len());
        unseen.fill(0.0);
        for (state, shown) in [(seen, positions), (qvel, velocities)] {
            state.iter_mut().zip(shown).for_each(|(state, shown)| *state = f64::from(*shown));
        }
        true
    }

    /// Whether observations show all positions, but for x and y of the root, and all velocities.
    #[must_use]
    pub fn is_observed(&self) -> bool {
        let has = |wanted: fn(&ObservationTerm) -> bool| self.policy.blocks().any(|(term, _)| wanted(term));
        has(ObservationTerm::shows_positions) && has(ObservationTerm::shows_velocities)
    }

    /// Whether each entry of an observation is a position or a velocity, `[obs_dim]`.
    #[must_use]
    pub fn shows_state(&self) -> Vec<bool> {
        let is_state = |quantity: &Quantity| matches!(quantity, Quantity::Qpos { .. } | Quantity::Qvel);
        self.policy
            .blocks()
            .flat_map(|(term, block)| std::iter::repeat_n(is_state(&term.quantity), block.len()))
            .collect()
    }
}
