//! Constants of envs whose physics differs from that of their damage class.

use dappo_lanes::Model;

use cubecl::prelude::*;

use super::plan::{JAM, Task};
use super::scene::clock;
use crate::constants::{link, point, root};
use crate::math::lit;
use crate::skeleton::Skeleton;

/// What varies a number of a model: the lowest byte; above it is the place of the joint.
pub mod kind {
    pub const SAME: u32 = 0;
    pub const FRICTION: u32 = 1;
    pub const RESISTANCE: u32 = 2;
    pub const DAMPING: u32 = 3;
    pub const ARMATURE: u32 = 4;
    pub const GAIN: u32 = 5;
    pub const CONSTANT: u32 = 6;
    pub const STIFFNESS: u32 = 7;
    pub const SLOPE: u32 = 8;
    pub const FORCE: u32 = 9;
    /// x, y and z follow each other.
    pub const LIFT: u32 = 10;
    pub const RANGE: u32 = 13;
}

/// Factors of a variation, in the order in which the events draw them.
mod factor {
    pub const FRICTION: usize = 0;
    pub const STRENGTH: usize = 1;
    pub const KP: usize = 2;
    pub const KD: usize = 3;
    pub const DAMPING: usize = 4;
    pub const ARMATURE: usize = 5;
    pub const GRAVITY: usize = 6;
}

/// What varies each number of a model, `[row]`.
pub fn kinds(skeleton: &Skeleton, model: &Model) -> Vec<u32> {
    let shape = &skeleton.shape;
    let mut kinds = vec![kind::SAME; shape.row()];
    for axis in 0..3 {
        kinds[root::LIFT + axis] = kind::LIFT + axis as u32;
    }
    for lane in 0..shape.lanes {
        let limb = root::LEN + lane * shape.limb_len();
        for (joint, part) in model.limbs.get(lane).into_iter().flatten().enumerate() {
            let at = limb + shape.link(joint);
            let place = (lane * shape.joints + joint) as u32;
            kinds[at + link::ARMATURE] = kind::ARMATURE;
            kinds[at + link::DAMPING] = kind::DAMPING;
            kinds[at + link::RANGE] = kind::RANGE | place << 8;
            kinds[at + link::RANGE + 1] = kind::RANGE | place << 8;
            if part.actuator.is_some() {
                kinds[at + link::GAIN] = kind::GAIN;
                kinds[at + link::BIAS] = kind::CONSTANT;
                kinds[at + link::BIAS + 1] = kind::STIFFNESS;
                kinds[at + link::BIAS + 2] = kind::SLOPE;
                kinds[at + link::FORCE_RANGE] = kind::FORCE;
                kinds[at + link::FORCE_RANGE + 1] = kind::FORCE;
            }
        }
        for (slot, index) in skeleton.points[lane].iter().enumerate() {
            if index.is_some() {
                let at = limb + shape.point(slot);
                kinds[at + point::FRICTION] = kind::FRICTION;
                kinds[at + point::RESISTANCE] = kind::RESISTANCE;
            }
        }
    }
    kinds
}

/// Computes the constants of the envs that have been given a damage class, one thread a number.
///
/// # Shapes
/// - `numbers`: `[models + envs, row]`; `kinds`: `[row]`
#[cube(launch_unchecked)]
pub fn vary<F: Float>(
    numbers: &mut [F],
    kinds: &[u32],
    memory: &[F],
    models: &[F],
    clocks: &[u32],
    envs: usize,
    count: usize,
    #[comptime] task: Task,
) {
    let length = comptime!(task.places.shape.row());
    let env = ABSOLUTE_POS / length;
    if env < envs {
        let chosen = clocks[env * comptime!(clock::LEN) + comptime!(clock::VARIES)];
        if chosen > 0u32 {
            let model = chosen as usize - 1;
            let entry = ABSOLUTE_POS % length;
            let at = model * length + entry;
            let value =
                varied::<F>(&*numbers, kinds[entry], memory, models, env, model, at, comptime!(task.clone()));
            numbers[(count + env) * length + entry] = value;
        }
    }
}

/// A number of an env, given where that of its model is.
#[cube]
fn varied<F: Float>(
    numbers: &[F],
    kind_and_place: u32,
    memory: &[F],
    models: &[F],
    env: usize,
    model: usize,
    at: usize,
    #[comptime] task: Task,
) -> F {
    let plan = comptime!(task.plan.clone());
    let kind = kind_and_place & 255u32;
    let value = numbers[at];
    let mut result = value;
    let row = env * comptime!(plan.row());
    if comptime!(plan.events.varies()) {
        let factors = row + comptime!(plan.memory.events.start);
        let strength = memory[factors + factor::STRENGTH];
        if kind == comptime!(kind::FRICTION) {
            result = value * memory[factors + factor::FRICTION];
        } else if kind == comptime!(kind::RESISTANCE) {
            // It has the factor μ² (1 + μ²).
            let scale = memory[factors + factor::FRICTION];
            let friction = numbers[at - comptime!(point::RESISTANCE - point::FRICTION)];
            let (before, square) = (friction * friction, scale * scale);
            let one = lit::<F>(1.0);
            result = value * square * (one + square * before) / (one + before);
        } else if kind == comptime!(kind::DAMPING) {
            result = value * memory[factors + factor::DAMPING];
        } else if kind == comptime!(kind::ARMATURE) {
            result = value * memory[factors + factor::ARMATURE];
        } else if kind == comptime!(kind::GAIN) {
            // Only a servo's gain is a stiffness.
            let is_motor = numbers[at + comptime!(link::BIAS + 1 - link::GAIN)] == lit::<F>(0.0);
            result = value * strength * select(is_motor, lit::<F>(1.0), memory[factors + factor::KP]);
        } else if kind == comptime!(kind::CONSTANT) {
            result = value * strength;
        } else if kind == comptime!(kind::STIFFNESS) {
            result = value * strength * memory[factors + factor::KP];
        } else if kind == comptime!(kind::SLOPE) {
            result = value * strength * memory[factors + factor::KD];
        } else if kind == comptime!(kind::FORCE) {
            result = value * strength;
        } else if comptime!(plan.events.gravity.is_some())
            && kind >= comptime!(kind::LIFT)
            && kind < comptime!(kind::RANGE)
        {
            let lift = at - (kind as usize - comptime!(kind::LIFT as usize));
            let (x, y, z) = (numbers[lift], numbers[lift + 1], numbers[lift + 2]);
            let size = (x * x + y * y + z * z).sqrt();
            result = -size
                * memory
                    [factors + comptime!(factor::GRAVITY) + (kind as usize - comptime!(kind::LIFT as usize))];
        }
    }
    if comptime!(plan.jams > 0) {
        if kind == comptime!(kind::RANGE) {
            let nq = comptime!(task.places.nq());
            let jams = model * comptime!(plan.model_len(nq)) + nq;
            #[unroll]
            for jam in 0..comptime!(plan.jams) {
                let place = u32::cast_from(models[jams + comptime!(jam * JAM)]);
                let shift = memory[row + comptime!(plan.memory.jams.start + jam)];
                result += select(place == kind_and_place >> 8u32, shift, lit::<F>(0.0));
            }
        }
    }
    result
}
