//! The state of the worlds of a group.

use crate::coords::Coords;
use crate::lane::Lane;
use crate::math::Vec3;

/// Generalised positions.
#[derive(Clone, Copy)]
pub struct Position<T, const L: usize, const J: usize> {
    pub root: Vec3<T>,
    /// Unit quaternion (w, x, y, z).
    pub rotation: [T; 4],
    pub joints: [[T; J]; L],
}

/// Everything that evolves.
#[derive(Clone, Copy)]
pub struct State<T, const L: usize, const J: usize> {
    pub position: Position<T, L, J>,
    /// qvel: the root's angular velocity is along its own axes.
    pub velocity: Coords<T, L, J>,
    /// qacc of the last evaluation, the solver's first guess (`qacc_warmstart`).
    pub warm_start: Coords<T, L, J>,
}

impl<T: Lane, const L: usize, const J: usize> State<T, L, J> {
    pub fn zero() -> Self {
        let zero = T::zero();
        let position = Position { root: [zero; 3], rotation: [zero; 4], joints: [[zero; J]; L] };
        Self { position, velocity: Coords::zero(), warm_start: Coords::zero() }
    }

    /// This state where the mask is true, another elsewhere.
    #[inline(always)]
    pub fn select(mut self, mask: T::Mask, other: &Self) -> Self {
        let choose = |own: &mut [T], other: &[T]| {
            for (own, &other) in own.iter_mut().zip(other) {
                *own = T::select(mask, *own, other);
            }
        };
        choose(&mut self.position.root, &other.position.root);
        choose(&mut self.position.rotation, &other.position.rotation);
        choose(self.position.joints.as_flattened_mut(), other.position.joints.as_flattened());
        self.velocity = self.velocity.zip(&other.velocity, |own, other| T::select(mask, own, other));
        self.warm_start = self.warm_start.zip(&other.warm_start, |own, other| T::select(mask, own, other));
        self
    }
}
