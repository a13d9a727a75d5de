//! Generalised coordinates: six for the free root, then those of each limb's joints.

use crate::lane::Lane;

/// A vector in the space of velocities, accelerations or forces.
///
/// The root's entries are linear, then angular. qvel and qacc give the angular ones along the root's own
/// axes, as MuJoCo does; inside the dynamics they are along the world's.
#[derive(Clone, Copy)]
pub struct Coords<T, const L: usize, const J: usize> {
    pub root: [T; 6],
    pub limbs: [[T; J]; L],
}

impl<T: Lane, const L: usize, const J: usize> Coords<T, L, J> {
    #[inline(always)]
    pub fn zero() -> Self {
        Self { root: [T::zero(); 6], limbs: [[T::zero(); J]; L] }
    }

    #[inline(always)]
    pub fn angular(&self) -> [T; 3] {
        [self.root[3], self.root[4], self.root[5]]
    }

    /// The same vector with other angular entries.
    #[inline(always)]
    pub fn with_angular(mut self, angular: [T; 3]) -> Self {
        self.root[3..].copy_from_slice(&angular);
        self
    }

    #[inline(always)]
    pub fn map(mut self, f: impl Fn(T) -> T) -> Self {
        for entry in self.entries_mut() {
            *entry = f(*entry);
        }
        self
    }

    #[inline(always)]
    pub fn zip(mut self, other: &Self, f: impl Fn(T, T) -> T) -> Self {
        for (entry, &other) in self.entries_mut().zip(other.entries()) {
            *entry = f(*entry, other);
        }
        self
    }

    /// self · factor + addend.
    #[inline(always)]
    pub fn scale_add(self, factor: T, addend: &Self) -> Self {
        self.zip(addend, |entry, addend| entry.mul_add(factor, addend))
    }

    #[inline(always)]
    pub fn dot(&self, other: &Self) -> T {
        let mut sum = T::zero();
        for (&a, &b) in self.entries().zip(other.entries()) {
            sum = a.mul_add(b, sum);
        }
        sum
    }

    #[inline(always)]
    pub fn entries(&self) -> impl Iterator<Item = &T> {
        self.root.iter().chain(self.limbs.as_flattened())
    }

    #[inline(always)]
    pub fn entries_mut(&mut self) -> impl Iterator<Item = &mut T> {
        self.root.iter_mut().chain(self.limbs.as_flattened_mut())
    }
}
