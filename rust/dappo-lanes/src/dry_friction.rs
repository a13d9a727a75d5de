//! Dry friction of joints: constraints whose force is limited on both sides.
//! (Documentation: Computation, "Constraint model", friction loss.)

use crate::constants::Constants;
use crate::lane::{Lane, Mask};
use crate::skeleton::Skeleton;

/// Dry friction of all joints that have it in some lane.
pub struct DryFriction<T: Lane> {
    pub rows: Vec<Friction<T>>,
}

/// One constraint: the joint's velocity should vanish. It costs ½ D r² while D |r| is below the largest
/// torque, and goes on linearly beyond.
#[derive(Clone, Copy)]
pub struct Friction<T: Lane> {
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
    /// Lanes in which the derivatives are those of a joint that sticks; in the others it slips against the residual.
    pub sticking: T::Mask,
    /// Change of the residual along the solver's search direction.
    pub slope: T,
}

impl<T: Lane> Friction<T> {
    /// Lanes in which the joint sticks at a residual: the torque is below the largest.
    #[inline(always)]
    fn sticks(&self, residual: T) -> T::Mask {
        (self.weight * residual.abs()).lt(self.most)
    }

    /// Torque of a joint that slips, with the sign of a residual: minus its own.
    #[inline(always)]
    fn slipping(&self, residual: T) -> T {
        T::select(residual.lt(T::zero()), -self.most, self.most)
    }

    /// Derivative of the cost: minus the torque.
    #[inline(always)]
    pub fn gradient(&self) -> T {
        T::select(self.sticking, self.weight * self.residual, self.slipping(self.residual))
    }

    /// What the Hessian of the cost demands for the reference, less the gradient that does not vanish with
    /// the residual.
    #[inline(always)]
    pub fn demand(&self) -> T {
        T::select(self.sticking, self.weight * self.reference, -self.slipping(self.residual))
    }

    /// Second derivative of the cost.
    #[inline(always)]
    pub fn curvature(&self) -> T {
        self.weight.keep(self.sticking)
    }

    /// Takes over the residual of a whole step; returns the lanes in which other derivatives hold there.
    ///
    /// A joint that slipped one way and would now slip the other way sticks in the next step: taken at its word, it
    /// would slip to and fro for ever around a solution in which it sticks.
    #[inline(always)]
    pub fn set_residual(&mut self, residual: T) -> T::Mask {
        let sticks = self.sticks(residual);
        let turned = !(self.sticking | sticks) & self.turns(residual);
        let changed = (self.sticking ^ sticks) | turned;
        self.sticking = sticks | turned;
        self.residual = residual;
        changed
    }

    /// Lanes in which another residual has another sign.
    #[inline(always)]
    fn turns(&self, residual: T) -> T::Mask {
        self.residual.lt(T::zero()) ^ residual.lt(T::zero())
    }

    /// Takes the derivatives at the residual itself, as line searches need them.
    #[inline(always)]
    pub fn settle(&mut self) {
        self.sticking = self.sticks(self.residual);
    }

    /// Moves the residual by a length of the step.
    #[inline(always)]
    pub fn advance(&mut self, length: T) {
        self.residual = self.slope.mul_add(length, self.residual);
        self.settle();
    }

    /// First and second derivative of the cost along the step, at a length of it from the present residual,
    /// each added to a sum, and the lanes in which the cost is not the same quadratic function there.
    #[inline(always)]
    pub fn add_along(&self, length: T, (first, second): (T, T)) -> (T, T, T::Mask) {
        let there = self.slope.mul_add(length, self.residual);
        let sticks = self.sticks(there);
        let changed = (self.sticking ^ sticks) | (!sticks & self.turns(there));
        let gradient = T::select(sticks, self.weight * there, self.slipping(there));
        let weighted = (self.weight * self.slope).keep(sticks);
        (gradient.mul_add(self.slope, first), weighted.mul_add(self.slope, second), changed)
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
                    row.settle();
                } else {
                    self.rows.push(Friction {
                        joint: (limb, joint),
                        most: link.friction_loss,
                        weight: link.friction_weight,
                        reference,
                        residual: -reference,
                        sticking: T::Mask::none(),
                        slope: T::zero(),
                    });
                    self.rows[index].settle();
                }
                index += 1;
            }
        }
    }
}
