//! Contacts with sliding friction in a pyramid: four edges, each of which costs ½ D r² while it pushes.
//! (Documentation: Computation, "Contact", friction cones.)

use crate::contact::Contact;
use crate::coords::Coords;
use crate::lane::{Lane, Mask};
use crate::math::{Vec3, negate, scale_add, select3};

/// A contact with the solver's numbers about it.
#[derive(Clone, Copy)]
pub struct Pyramid<T: Lane, const J: usize, const W: usize> {
    pub contact: Contact<T, J, W>,
    /// J a − reference at the solver's present point.
    pub residual: Vec3<T>,
    /// Change of the residual along the solver's search direction.
    slope: Vec3<T>,
    /// Lanes in which each edge pushed when the derivatives were last computed.
    active: [T::Mask; 4],
}

/// Derivatives of a contact's cost by its residuals along n, μ t₁ and μ t₂.
pub struct Push<T: Lane> {
    /// Gradient along n, μ t₁, μ t₂.
    pub gradient: Vec3<T>,
    /// Hessian: nn, 11, 22, n1, n2.
    pub stiffness: [T; 5],
    /// Entry 12 of the Hessian; a pyramid has none.
    pub skew: Option<T>,
}

impl<T: Lane, const J: usize, const W: usize> Pyramid<T, J, W> {
    /// A contact whose residual is that of the evaluation before, or where it is new, that without
    /// acceleration.
    #[inline(always)]
    pub fn new(contact: Contact<T, J, W>, before: Option<&Self>) -> Self {
        let mut residual = negate(contact.reference);
        if let Some(before) = before {
            let known = T::zero().lt(before.contact.weight);
            residual = select3(known, before.residual, residual);
        }
        Self { contact, residual, slope: residual, active: [T::Mask::none(); 4] }
    }

    /// Adds the acceleration's effect to the residual; returns the lanes in which other edges push than when
    /// the derivatives were last computed.
    #[inline(always)]
    pub fn set_acceleration<const L: usize>(&mut self, acceleration: &Coords<T, L, J>) -> T::Mask {
        self.residual = self.contact.residual(acceleration);
        changes(self.contact.weight, &self.active, &pushing(self.residual))
    }

    /// The derivatives at the present residual. The Hessian times a difference of residuals is a difference of
    /// gradients: with `reference` instead of the residual, the gradient is what the reference demands.
    #[inline(always)]
    pub fn push(&mut self, with_reference: bool) -> Push<T> {
        self.active = pushing(self.residual);
        let at = if with_reference { self.contact.reference } else { self.residual };
        push(self.contact.weight, &self.active, at)
    }

    /// Gradient of the cost at the present residual.
    #[inline(always)]
    pub fn gradient(&self) -> Vec3<T> {
        push(self.contact.weight, &pushing(self.residual), self.residual).gradient
    }

    /// Begins a line search along a step.
    #[inline(always)]
    pub fn set_step<const L: usize>(&mut self, step: &Coords<T, L, J>) {
        self.slope = self.contact.along(step);
    }

    /// Moves the residual by a length of the step.
    #[inline(always)]
    pub fn advance(&mut self, length: T) {
        self.residual = scale_add(self.slope, length, self.residual);
    }

    /// First and second derivative of the cost along the step, at a length of it from the present residual,
    /// each added to a sum, and the lanes in which the cost is not the same quadratic function there.
    #[inline(always)]
    pub fn add_along(&self, length: T, sums: (T, T)) -> (T, T, T::Mask) {
        add_along(self.contact.weight, &self.active, (self.residual, self.slope), length, sums)
    }
}

/// The residuals of a pyramid's edges n ± μ t₁ and n ± μ t₂, from those along n, μ t₁ and μ t₂.
#[inline(always)]
fn edges<T: Lane>([normal, first, second]: Vec3<T>) -> [T; 4] {
    [normal + first, normal - first, normal + second, normal - second]
}

/// Lanes in which each edge pushes.
#[inline(always)]
pub fn pushing<T: Lane>(residual: Vec3<T>) -> [T::Mask; 4] {
    let [a, b, c, d] = edges(residual);
    let zero = T::zero();
    [a.lt(zero), b.lt(zero), c.lt(zero), d.lt(zero)]
}

/// Lanes that have a contact and in which some edge changes.
#[inline(always)]
fn changes<T: Lane>(weight: T, from: &[T::Mask; 4], to: &[T::Mask; 4]) -> T::Mask {
    let mut changed = T::Mask::none();
    for edge in 0..4 {
        changed = changed | (from[edge] ^ to[edge]);
    }
    changed & T::zero().lt(weight)
}

/// Derivatives where some edges push, the gradient at `at`.
#[inline(always)]
pub fn push<T: Lane>(weight: T, active: &[T::Mask; 4], at: Vec3<T>) -> Push<T> {
    let zero = T::zero();
    let along = edges(at);
    let (mut weights, mut f) = ([zero; 4], [zero; 4]);
    for edge in 0..4 {
        weights[edge] = weight.keep(active[edge]);
        f[edge] = weights[edge] * along[edge];
    }
    let (first, second) = (weights[0] + weights[1], weights[2] + weights[3]);
    Push {
        gradient: [(f[0] + f[1]) + (f[2] + f[3]), f[0] - f[1], f[2] - f[3]],
        stiffness: [first + second, first, second, weights[0] - weights[1], weights[2] - weights[3]],
        skew: None,
    }
}

/// See [`Pyramid::add_along`].
#[inline(always)]
pub fn add_along<T: Lane>(
    weight: T,
    active: &[T::Mask; 4],
    (residual, slope): (Vec3<T>, Vec3<T>),
    length: T,
    (mut first, mut second): (T, T),
) -> (T, T, T::Mask) {
    let there = scale_add(slope, length, residual);
    let (residuals, slopes, now) = (edges(there), edges(slope), pushing(there));
    for edge in 0..4 {
        let weighted = (weight * slopes[edge]).keep(now[edge]);
        first = weighted.mul_add(residuals[edge], first);
        second = weighted.mul_add(slopes[edge], second);
    }
    (first, second, changes(weight, active, &now))
}
