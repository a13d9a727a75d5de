//! The state of a world, spread over its threads.

use cubecl::prelude::*;

use crate::constants::root;
use crate::coords::Coords;
use crate::math::{Quat, V3, copied_in_kernels, lit, sin_cos};
use crate::shape::Shape;

/// Where the numbers of a thread are.
#[derive(CubeType, Clone, Copy)]
pub struct Place {
    /// Thread within its world: the index of its limb.
    pub lane: usize,
    /// Index of the world.
    pub world: usize,
    /// Whether the thread's results count; others compute the last world once more.
    pub counts: bool,
    /// Where the constants of the world's damage class begin.
    pub model: usize,
    /// Where those of the thread begin.
    pub limb: usize,
}
copied_in_kernels!(plain: PlaceExpand);

#[cube]
impl Place {
    /// The place of this thread, which computes a world.
    pub fn new(models: &[u32], world: usize, counts: bool, #[comptime] shape: Shape) -> Place {
        let lane = ABSOLUTE_POS % comptime!(shape.lanes);
        let model = models[world] as usize * comptime!(shape.row());
        let limb = model + comptime!(root::LEN) + lane * comptime!(shape.limb_len());
        Place { lane, world, counts, model, limb }
    }
}

/// Generalised positions: the root's place, its unit quaternion (w, x, y, z), and the joints of the limb.
#[derive(CubeType)]
pub struct Position<F: Float> {
    pub root: Array<F>,
    pub limb: Array<F>,
}

#[cube]
impl<F: Float> Position<F> {
    pub fn room(#[comptime] shape: Shape) -> Position<F> {
        Position::<F> { root: Array::<F>::new(7usize), limb: Array::<F>::new(comptime!(shape.joints)) }
    }

    pub fn rotation(&self) -> Quat<F> {
        Quat::<F> { w: self.root[3], v: V3::<F>::new(self.root[4], self.root[5], self.root[6]) }
    }

    pub fn copy_from(&mut self, other: &Position<F>, #[comptime] shape: Shape) {
        #[unroll]
        for i in 0..7usize {
            self.root[i] = other.root[i];
        }
        #[unroll]
        for k in 0..comptime!(shape.joints) {
            self.limb[k] = other.limb[k];
        }
    }

    /// self ← from, moved for a time with a constant velocity (`mj_integratePos`); the root turns about its own axes.
    pub fn set_moved(&mut self, from: &Position<F>, velocity: &Coords<F>, time: F, #[comptime] shape: Shape) {
        #[unroll]
        for i in 0..3usize {
            self.root[i] = fma(velocity.root[i], time, from.root[i]);
        }
        #[unroll]
        for k in 0..comptime!(shape.joints) {
            self.limb[k] = fma(velocity.limb[k], time, from.limb[k]);
        }
        let omega = velocity.angular();
        let speed = omega.dot(omega).sqrt();
        let turn = sin_cos::<F>(speed * time * lit::<F>(0.5));
        let still = speed < lit::<F>(1e-15);
        let factor = select(still, lit::<F>(0.0), turn.sin / select(still, lit::<F>(1.0), speed));
        let q = from.rotation().times(Quat::<F> { w: turn.cos, v: omega * factor }).normalized();
        self.root[3] = q.w;
        self.root[4] = q.v.x;
        self.root[5] = q.v.y;
        self.root[6] = q.v.z;
    }

    /// Reads the row of positions that begins at `row`.
    pub fn read(&mut self, state: &[F], row: usize, lane: usize, #[comptime] shape: Shape) {
        #[unroll]
        for i in 0..7usize {
            self.root[i] = state[row + i];
        }
        let own = row + 7 + lane * comptime!(shape.joints);
        #[unroll]
        for k in 0..comptime!(shape.joints) {
            self.limb[k] = state[own + k];
        }
    }

    pub fn write(&self, state: &mut [F], row: usize, lane: usize, #[comptime] shape: Shape) {
        if lane == 0usize {
            #[unroll]
            for i in 0..7usize {
                state[row + i] = self.root[i];
            }
        }
        let own = row + 7 + lane * comptime!(shape.joints);
        #[unroll]
        for k in 0..comptime!(shape.joints) {
            state[own + k] = self.limb[k];
        }
    }
}
