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
        [self.root[3], self.root[4], self.root[5]] = angular;
        self
    }

    /// self ← −self where the mask is true, 0 elsewhere.
    #[inline(always)]
    pub fn negate(&mut self, mask: T::Mask) {
        self.for_each(
            #[inline(always)]
            |entry| *entry = (-*entry).keep(mask),
        );
    }

    /// self ← self − other.
    #[inline(always)]
    pub fn subtract(&mut self, other: &Self) {
        self.for_each_pair(
            other,
            #[inline(always)]
            |entry, other| *entry -= other,
        );
    }

    /// self ← self + factor · other.
    #[inline(always)]
    pub fn add_scaled(&mut self, factor: T, other: &Self) {
        self.for_each_pair(
            other,
            #[inline(always)]
            |entry, other| *entry = other.mul_add(factor, *entry),
        );
    }

    /// self ← other where the mask is true.
    #[inline(always)]
    pub fn replace(&mut self, mask: T::Mask, other: &Self) {
        self.for_each_pair(
            other,
            #[inline(always)]
            |entry, other| *entry = T::select(mask, other, *entry),
        );
    }

    #[inline(always)]
    pub fn dot(&self, other: &Self) -> T {
        let mut sum = T::zero();
        for i in 0..6 {
            sum = self.root[i].mul_add(other.root[i], sum);
        }
        for limb in 0..L {
            for joint in 0..J {
                sum = self.limbs[limb][joint].mul_add(other.limbs[limb][joint], sum);
            }
        }
        sum
    }

    #[inline(always)]
    fn for_each(&mut self, mut visit: impl FnMut(&mut T)) {
        for i in 0..6 {
            visit(&mut self.root[i]);
        }
        for limb in 0..L {
            for joint in 0..J {
                visit(&mut self.limbs[limb][joint]);
            }
        }
    }

    #[inline(always)]
    fn for_each_pair(&mut self, other: &Self, mut visit: impl FnMut(&mut T, T)) {
        for i in 0..6 {
            visit(&mut self.root[i], other.root[i]);
        }
        for limb in 0..L {
            for joint in 0..J {
                visit(&mut self.limbs[limb][joint], other.limbs[limb][joint]);
            }
        }
    }
}
