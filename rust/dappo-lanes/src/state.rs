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

    /// self ← other where the mask is true.
    #[inline(always)]
    pub fn replace(&mut self, mask: T::Mask, other: &Self) {
        replace(mask, &mut self.position.root, &other.position.root);
        replace(mask, &mut self.position.rotation, &other.position.rotation);
        replace(mask, self.position.joints.as_flattened_mut(), other.position.joints.as_flattened());
        self.velocity.replace(mask, &other.velocity);
        self.warm_start.replace(mask, &other.warm_start);
    }
}

#[inline(always)]
fn replace<T: Lane>(mask: T::Mask, own: &mut [T], other: &[T]) {
    for (own, &other) in own.iter_mut().zip(other) {
        *own = T::select(mask, other, *own);
    }
}
