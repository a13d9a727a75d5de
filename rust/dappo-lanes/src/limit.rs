//! Joint limits as one-sided soft constraints.
//! (Documentation: Computation, "Constraint model", limits.)

use crate::constants::Constants;
use crate::lane::{Lane, Mask};
use crate::skeleton::Skeleton;

/// The limits of all joints. A joint is near at most one of its two limits.
pub struct Limits<T: Lane, const L: usize, const J: usize> {
    pub rows: [[Limit<T>; J]; L],
}

/// One constraint: sign · velocity of the joint may not fall below a reference.
#[derive(Clone, Copy)]
pub struct Limit<T: Lane> {
    /// Whether any lane has it.
    pub somewhere: bool,
    /// +1 at the lower limit, −1 at the upper one.
    pub sign: T,
    /// 1/R, and 0 in lanes without the constraint.
    pub weight: T,
    /// Reference acceleration.
    pub reference: T,
    /// J a − reference at the solver's present point.
    pub residual: T,
    /// Change of the residual along the solver's search direction.
    pub slope: T,
    /// Lanes in which it pushed when the derivatives were last computed.
    pub active: T::Mask,
}

impl<T: Lane> Limit<T> {
    /// Lanes that have it and in which it pushes at one residual but not at the other.
    #[inline(always)]
    pub fn changes(&self, residual: T) -> T::Mask {
        let zero = T::zero();
        (residual.lt(zero) ^ self.active) & zero.lt(self.weight)
    }

    fn absent() -> Self {
        let zero = T::zero();
        Self {
            somewhere: false,
            sign: zero,
            weight: zero,
            reference: zero,
            residual: zero,
            slope: zero,
            active: T::Mask::none(),
        }
    }
}

impl<T: Lane, const L: usize, const J: usize> Limits<T, L, J> {
    pub fn none() -> Self {
        Self { rows: [[Limit::absent(); J]; L] }
    }

    /// Forgets the evaluation before.
    #[inline(always)]
    pub fn forget(&mut self) {
        for row in self.rows.as_flattened_mut() {
            row.weight = T::zero();
        }
    }

    /// Finds the limits that push. Their residuals are those of the evaluation before, or where a limit is new,
    /// those without acceleration.
    #[inline(always)]
    pub fn update(
        &mut self,
        skeleton: &Skeleton<T, L, J>,
        constants: &Constants<T, L, J>,
        positions: &[[T; J]; L],
        velocities: &[[T; J]; L],
    ) {
        let (zero, one) = (T::zero(), T::of(1.0));
        for limb in 0..L {
            for joint in 0..J {
                let (link, row) = (&constants.links[limb][joint], &mut self.rows[limb][joint]);
                let softness = &skeleton.joints[limb][joint].limit;
                let (position, velocity) = (positions[limb][joint], velocities[limb][joint]);
                let (below, above) = (position - link.range[0], link.range[1] - position);
                let lower = below.lt(above);
                let margin = T::splat(skeleton.joints[limb][joint].margin);
                let distance = T::select(lower, below, above) - margin;
                let near = distance.lt(zero);
                row.somewhere = near.any();
                if !row.somewhere {
                    row.weight = zero;
                    continue;
                }
                let sign = T::select(lower, one, -one).keep(near);
                let known = zero.lt(row.weight) & zero.lt(sign * row.sign);
                let impedance = softness.at(distance.abs());
                let pull = T::splat(softness.stiffness) * impedance * distance;
                row.sign = sign;
                row.weight = (impedance / ((one - impedance) * link.inverse_weight)).keep(near);
                // A joint may have no limit in another lane: its distance is then infinite.
                row.reference = (-(T::splat(softness.damping) * sign * velocity) - pull).keep(near);
                row.residual = T::select(known, row.residual, -row.reference);
            }
        }
    }
}
