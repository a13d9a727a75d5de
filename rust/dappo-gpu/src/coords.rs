//! Generalised coordinates, spread over the threads of a world: every thread has the six of the free root, and those
//! of its own limb's joints.

use cubecl::prelude::*;

use crate::math::{V3, lit};
use crate::shape::Shape;

/// Sum over the threads of a world. A butterfly: every thread adds the same numbers in the same order.
#[cube]
pub fn across<F: Float>(x: F, #[comptime] shape: Shape) -> F {
    let mut sum = x;
    #[unroll]
    for bit in 0..comptime!(shape.lanes.trailing_zeros()) {
        sum += plane_shuffle_xor(sum, comptime!(1u32 << bit));
    }
    sum
}

/// Sum over the threads of a world.
#[cube]
pub fn across3<F: Float>(v: V3<F>, #[comptime] shape: Shape) -> V3<F> {
    V3::<F>::new(across::<F>(v.x, shape), across::<F>(v.y, shape), across::<F>(v.z, shape))
}

/// A vector in the space of velocities, accelerations or forces.
///
/// The root's entries are linear, then angular. qvel and qacc have the angular ones along the root's own axes, as in
/// MuJoCo; inside the dynamics they are along the world's.
#[derive(CubeType)]
pub struct Coords<F: Float> {
    pub root: Array<F>,
    pub limb: Array<F>,
}

#[cube]
impl<F: Float> Coords<F> {
    pub fn room(#[comptime] shape: Shape) -> Coords<F> {
        Coords::<F> { root: Array::<F>::new(6usize), limb: Array::<F>::new(comptime!(shape.joints)) }
    }

    pub fn linear(&self) -> V3<F> {
        V3::<F>::new(self.root[0], self.root[1], self.root[2])
    }

    pub fn angular(&self) -> V3<F> {
        V3::<F>::new(self.root[3], self.root[4], self.root[5])
    }

    pub fn set_linear(&mut self, v: V3<F>) {
        self.root[0] = v.x;
        self.root[1] = v.y;
        self.root[2] = v.z;
    }

    pub fn set_angular(&mut self, v: V3<F>) {
        self.root[3] = v.x;
        self.root[4] = v.y;
        self.root[5] = v.z;
    }

    /// self ← 0.
    pub fn clear(&mut self, #[comptime] shape: Shape) {
        #[unroll]
        for i in 0..6usize {
            self.root[i] = lit::<F>(0.0);
        }
        #[unroll]
        for k in 0..comptime!(shape.joints) {
            self.limb[k] = lit::<F>(0.0);
        }
    }

    /// self ← other.
    pub fn copy_from(&mut self, other: &Coords<F>, #[comptime] shape: Shape) {
        #[unroll]
        for i in 0..6usize {
            self.root[i] = other.root[i];
        }
        #[unroll]
        for k in 0..comptime!(shape.joints) {
            self.limb[k] = other.limb[k];
        }
    }

    /// self ← a + factor · b.
    pub fn set_sum(&mut self, a: &Coords<F>, factor: F, b: &Coords<F>, #[comptime] shape: Shape) {
        #[unroll]
        for i in 0..6usize {
            self.root[i] = fma(b.root[i], factor, a.root[i]);
        }
        #[unroll]
        for k in 0..comptime!(shape.joints) {
            self.limb[k] = fma(b.limb[k], factor, a.limb[k]);
        }
    }

    /// self ← self + factor · other.
    pub fn add_scaled(&mut self, factor: F, other: &Coords<F>, #[comptime] shape: Shape) {
        #[unroll]
        for i in 0..6usize {
            self.root[i] = fma(other.root[i], factor, self.root[i]);
        }
        #[unroll]
        for k in 0..comptime!(shape.joints) {
            self.limb[k] = fma(other.limb[k], factor, self.limb[k]);
        }
    }

    /// self ← factor · self.
    pub fn scale(&mut self, factor: F, #[comptime] shape: Shape) {
        #[unroll]
        for i in 0..6usize {
            self.root[i] *= factor;
        }
        #[unroll]
        for k in 0..comptime!(shape.joints) {
            self.limb[k] *= factor;
        }
    }

    pub fn dot(&self, other: &Coords<F>, #[comptime] shape: Shape) -> F {
        let mut limb = lit::<F>(0.0);
        #[unroll]
        for k in 0..comptime!(shape.joints) {
            limb = fma(self.limb[k], other.limb[k], limb);
        }
        let mut sum = across::<F>(limb, shape);
        #[unroll]
        for i in 0..6usize {
            sum = fma(self.root[i], other.root[i], sum);
        }
        sum
    }

    /// Reads the row of coordinates that begins at `row`.
    pub fn read(&mut self, state: &[F], row: usize, lane: usize, #[comptime] shape: Shape) {
        #[unroll]
        for i in 0..6usize {
            self.root[i] = state[row + i];
        }
        let own = row + 6 + lane * comptime!(shape.joints);
        #[unroll]
        for k in 0..comptime!(shape.joints) {
            self.limb[k] = state[own + k];
        }
    }

    pub fn write(&self, state: &mut [F], row: usize, lane: usize, #[comptime] shape: Shape) {
        if lane == 0usize {
            #[unroll]
            for i in 0..6usize {
                state[row + i] = self.root[i];
            }
        }
        let own = row + 6 + lane * comptime!(shape.joints);
        #[unroll]
        for k in 0..comptime!(shape.joints) {
            state[own + k] = self.limb[k];
        }
    }
}
