//! Dry friction of joints: constraints whose force is limited on both sides.
//! (Documentation: Computation, "Constraint model", friction loss.)

use crate::constants::{Constants, Skeleton};
use crate::lane::Lane;

/// Dry friction of all joints that have it in some lane.
pub struct DryFriction<T> {
    pub rows: Vec<Friction<T>>,
}

/// One constraint: the joint's velocity should vanish. It costs ½ D r² while D |r| is below the largest
/// torque, and goes on linearly beyond.
#[derive(Clone, Copy)]
pub struct Friction<T> {
    /// Limb and joint.
    pub joint: (usize, usize),
    /// Largest torque.
    pub most: T,
    /// D = 1/R.
    pub weight: T,
    /// Reference acceleration.
    pub reference: T,
    /// a − reference at the solver's present point.
    pub residual: T,
    /// Change of the residual along the solver's search direction.
    pub slope: T,
}

impl<T: Lane> Friction<T> {
    /// Lanes in which the joint sticks: the torque is below the largest.
    #[inline(always)]
    pub fn sticks(&self, residual: T) -> T::Mask {
        (self.weight * residual.abs()).lt(self.most)
    }

    /// Derivative of the cost: minus the torque.
    #[inline(always)]
    pub fn gradient(&self, residual: T) -> T {
        (self.weight * residual).clamp(-self.most, self.most)
    }

    /// What the Hessian of the cost demands for the reference, less the gradient that does not vanish with
    /// the residual.
    #[inline(always)]
    pub fn demand(&self) -> T {
        let sticks = self.sticks(self.residual);
        T::select(sticks, self.weight * self.reference, -self.gradient(self.residual))
    }

    /// Lanes in which the joint does not stick at both residuals, or slip in the same direction.
    #[inline(always)]
    pub fn changes(&self, from: T, to: T) -> T::Mask {
        let zero = T::zero();
        let (here, there) = (self.sticks(from), self.sticks(to));
        (here ^ there) | (!here & (from.lt(zero) ^ to.lt(zero)))
    }
}

impl<T: Lane> DryFriction<T> {
    /// Room for the joints of a robot.
    pub fn new(joints: usize) -> Self {
        Self { rows: Vec::with_capacity(joints) }
    }

    /// Forgets the evaluation before.
    #[inline(always)]
    pub fn forget(&mut self) {
        self.rows.clear();
    }

    /// Follows the velocities. The residuals are those of the evaluation before, or without one, those without
    /// acceleration.
    #[inline(always)]
    pub fn update<const L: usize, const J: usize>(
        &mut self,
        skeleton: &Skeleton<T, L, J>,
        constants: &Constants<T, L, J>,
        velocities: &[[T; J]; L],
    ) {
        let mut index = 0;
        for limb in 0..L {
            for joint in 0..J {
                let link = &constants.links[limb][joint];
                let Some(damping) = skeleton.joints[limb][joint].dry_friction else {
                    continue;
                };
                let reference = -(T::splat(damping) * velocities[limb][joint]);
                if let Some(row) = self.rows.get_mut(index) {
                    row.reference = reference;
                } else {
                    self.rows.push(Friction {
                        joint: (limb, joint),
                        most: link.friction_loss,
                        weight: link.friction_weight,
                        reference,
                        residual: -reference,
                        slope: T::zero(),
                    });
                }
                index += 1;
            }
        }
    }
}
