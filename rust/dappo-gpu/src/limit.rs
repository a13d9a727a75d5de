//! Joint limits as one-sided soft constraints.
//! (Documentation: Computation, "Constraint model", limits.)

use cubecl::prelude::*;

use crate::constants::{link, softness};
use crate::coords::Coords;
use crate::impedance::impedance;
use crate::math::{copied_in_kernels, lit};
use crate::shape::Shape;

/// The limit that a joint is nearer to: sign · velocity of the joint may not fall below a reference. Its weight is 0
/// while it does not act.
#[derive(CubeType, Clone, Copy)]
pub struct Limit<F: Float> {
    /// +1 at the lower limit, −1 at the upper one.
    pub sign: F,
    /// 1/R.
    pub weight: F,
    /// Reference acceleration.
    pub reference: F,
}
copied_in_kernels!(LimitExpand);

/// The limits of a limb's joints.
#[cube]
pub fn limits<F: Float>(
    numbers: &[F],
    limb: usize,
    positions: &Array<F>,
    velocity: &Coords<F>,
    #[comptime] shape: Shape,
) -> Sequence<Limit<F>> {
    let zero = lit::<F>(0.0);
    let one = lit::<F>(1.0);
    let mut limits = Sequence::<Limit<F>>::new();
    #[unroll]
    for joint in 0..comptime!(shape.joints) {
        let at = limb + comptime!(shape.link(joint));
        let below = positions[joint] - numbers[at + link::RANGE];
        let above = numbers[at + link::RANGE + 1] - positions[joint];
        let distance = min(below, above) - numbers[at + link::MARGIN];
        let near = distance < zero;
        let sign = select(below < above, one, -one);
        let soft = at + link::LIMIT;
        let power = comptime!(shape.joint[joint].limit_power);
        let d = impedance::<F>(numbers, soft, distance.abs(), power);
        let weight = d / ((one - d) * numbers[at + link::INVERSE_WEIGHT]);
        let brake = numbers[soft + softness::DAMPING] * sign * velocity.limb[joint];
        let pull = numbers[soft + softness::STIFFNESS] * d * distance;
        limits.push(Limit::<F> {
            sign,
            weight: select(near, weight, zero),
            // A joint may have no limit: its distance is then very large.
            reference: select(near, -brake - pull, zero),
        });
    }
    limits
}
