//! Dry friction of joints: constraints whose force is limited on both sides.
//! (Documentation: Computation, "Constraint model", friction loss.)

use cubecl::prelude::*;

use crate::constants::link;
use crate::coords::Coords;
use crate::math::{copied_in_kernels, lit};
use crate::shape::Shape;

/// One constraint: the joint's velocity should vanish. It costs ½ D r² while D |r| is below the largest torque, and
/// goes on linearly beyond.
#[derive(CubeType, Clone, Copy)]
pub struct Friction<F: Float> {
    /// Largest torque.
    pub most: F,
    /// D = 1/R.
    pub weight: F,
    /// Reference acceleration.
    pub reference: F,
}
copied_in_kernels!(FrictionExpand);

#[cube]
impl<F: Float> Friction<F> {
    /// 0 while the joint sticks, else the sign of the residual; 0 without friction.
    pub fn slips(self, residual: F) -> F {
        let zero = lit::<F>(0.0);
        let one = lit::<F>(1.0);
        let sticks = self.weight * residual.abs() < self.most || self.most == zero;
        select(sticks, zero, select(residual < zero, -one, one))
    }

    /// Derivative of the cost: minus the torque.
    pub fn gradient(self, residual: F) -> F {
        clamp(self.weight * residual, -self.most, self.most)
    }

    /// Second derivative of the cost.
    pub fn curvature(self, residual: F) -> F {
        select(self.weight * residual.abs() < self.most, self.weight, lit::<F>(0.0))
    }
}

/// Dry friction of a limb's joints.
#[cube]
pub fn dry_friction<F: Float>(
    numbers: &[F],
    limb: usize,
    velocity: &Coords<F>,
    #[comptime] shape: Shape,
) -> Sequence<Friction<F>> {
    let mut rows = Sequence::<Friction<F>>::new();
    #[unroll]
    for joint in 0..comptime!(shape.joints) {
        let at = limb + comptime!(shape.link(joint));
        rows.push(Friction::<F> {
            most: numbers[at + link::FRICTION_LOSS],
            weight: numbers[at + link::FRICTION_WEIGHT],
            reference: -(numbers[at + link::FRICTION_DAMPING] * velocity.limb[joint]),
        });
    }
    rows
}
