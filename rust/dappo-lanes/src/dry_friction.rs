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

    /// Adds the cost at a residual to a sum.
    #[inline(always)]
    pub fn add_cost(&self, residual: T, sum: T) -> T {
        let half = T::of(0.5);
        let sticking = half * self.weight * residual * residual;
        let slipping = self.most * (residual.abs() - half * self.most / self.weight);
        sum + T::select(self.sticks(residual), sticking, slipping)
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

    /// Follows the velocities.
    #[inline(always)]
    pub fn update<const L: usize, const J: usize>(
        &mut self,
        skeleton: &Skeleton<T, L, J>,
        constants: &Constants<T, L, J>,
        velocities: &[[T; J]; L],
    ) {
        self.rows.clear();
        for limb in 0..L {
            for joint in 0..J {
                let link = &constants.links[limb][joint];
                let Some(damping) = skeleton.joints[limb][joint].dry_friction else {
                    continue;
                };
                self.rows.push(Friction {
                    joint: (limb, joint),
                    most: link.friction_loss,
                    weight: link.friction_weight,
                    reference: -(T::splat(damping) * velocities[limb][joint]),
                    residual: T::zero(),
                    slope: T::zero(),
                });
            }
        }
    }
}
