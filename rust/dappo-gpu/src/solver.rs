//! The constraint solver: Newton's method on MuJoCo's convex problem.
//! (Documentation: Computation, "Constraint solver": minimise ½ (a − a₀)ᵀ M (a − a₀) + s(J a − reference).)
//!
//! Every edge of a friction pyramid and every joint limit costs ½ D r² while its residual r is negative. As long as
//! the set of such rows does not change, the problem is quadratic and a Newton step solves it. So it is with dry
//! friction while the same joints stick.

use cubecl::prelude::*;

use crate::arrow::Arrow;
use crate::contact::{Contacts, along};
use crate::coords::{Coords, across};
use crate::dry_friction::Friction;
use crate::hessian::add_contact;
use crate::limit::Limit;
use crate::line_search::search;
use crate::math::{V3, is_double, lit};
use crate::pyramid::push;
use crate::shape::{Shape, lower};

/// More than any state needs: MuJoCo's own default is 100.
const MAX_ITERATIONS: u32 = 100;

/// The constraints of a thread.
#[derive(CubeType)]
pub struct Constraints<F: Float> {
    pub contacts: Contacts<F>,
    /// [joints]
    pub limits: Sequence<Limit<F>>,
    /// [joints]
    pub friction: Sequence<Friction<F>>,
}

/// One number or vector for each constraint of a thread.
#[derive(CubeType)]
pub struct Rows<F: Float> {
    /// Along n, μ t₁ and μ t₂, `[slots · 3]`.
    pub contacts: Array<F>,
    /// [joints]
    pub limits: Array<F>,
    /// [joints]
    pub friction: Array<F>,
}

#[cube]
impl<F: Float> Rows<F> {
    pub fn room(#[comptime] shape: Shape) -> Rows<F> {
        Rows::<F> {
            // An array has at least one entry.
            contacts: Array::<F>::new(comptime!((3 * shape.slots).max(1))),
            limits: Array::<F>::new(comptime!(shape.joints)),
            friction: Array::<F>::new(comptime!(shape.joints)),
        }
    }

    pub fn contact(&self, #[comptime] slot: usize) -> V3<F> {
        V3::<F>::new(
            self.contacts[comptime!(3 * slot)],
            self.contacts[comptime!(3 * slot + 1)],
            self.contacts[comptime!(3 * slot + 2)],
        )
    }

    fn set_contact(&mut self, #[comptime] slot: usize, v: V3<F>) {
        self.contacts[comptime!(3 * slot)] = v.x;
        self.contacts[comptime!(3 * slot + 1)] = v.y;
        self.contacts[comptime!(3 * slot + 2)] = v.z;
    }

    /// self ← J x.
    fn set_product(&mut self, constraints: &Constraints<F>, x: &Coords<F>, #[comptime] shape: Shape) {
        #[unroll]
        for slot in 0..comptime!(shape.slots) {
            let contact = constraints.contacts.rows[slot];
            if contact.weight > lit::<F>(0.0) {
                self.set_contact(slot, along::<F>(contact, &constraints.contacts.columns, x, slot, shape));
            }
        }
        #[unroll]
        for joint in 0..comptime!(shape.joints) {
            self.limits[joint] = constraints.limits[joint].sign * x.limb[joint];
            self.friction[joint] = x.limb[joint];
        }
    }

    /// self ← self − reference.
    fn subtract_reference(&mut self, constraints: &Constraints<F>, #[comptime] shape: Shape) {
        #[unroll]
        for slot in 0..comptime!(shape.slots) {
            let contact = constraints.contacts.rows[slot];
            let residual = self.contact(slot) - contact.reference;
            self.set_contact(slot, residual);
        }
        #[unroll]
        for joint in 0..comptime!(shape.joints) {
            self.limits[joint] -= constraints.limits[joint].reference;
            if comptime!(shape.joint[joint].dry_friction) {
                self.friction[joint] -= constraints.friction[joint].reference;
            }
        }
    }

    /// self ← self + factor · other.
    fn add_scaled(&mut self, factor: F, other: &Rows<F>, #[comptime] shape: Shape) {
        #[unroll]
        for i in 0..comptime!(3 * shape.slots) {
            self.contacts[i] = fma(other.contacts[i], factor, self.contacts[i]);
        }
        #[unroll]
        for joint in 0..comptime!(shape.joints) {
            self.limits[joint] = fma(other.limits[joint], factor, self.limits[joint]);
            self.friction[joint] = fma(other.friction[joint], factor, self.friction[joint]);
        }
    }
}

/// The acceleration under constraints.
///
/// `force` is M a₀: all forces but those of the constraints. `acceleration` comes as a guess; `residuals` become
/// J a − reference.
#[cube]
pub fn solve<F: Float>(
    mass: &Arrow<F>,
    force: &Coords<F>,
    constraints: &Constraints<F>,
    scale: F,
    acceleration: &mut Coords<F>,
    residuals: &mut Rows<F>,
    #[comptime] shape: Shape,
) {
    let one = lit::<F>(1.0);
    let double = is_double::<F>();
    let tolerance = lit::<F>(comptime!(if double { 1e-14 } else { 1e-9 }));

    // M (a − a₀)
    let mut momentum = Coords::<F>::room(shape);
    mass.times(&*acceleration, &mut momentum, shape);
    momentum.add_scaled(-one, force, shape);
    residuals.set_product(constraints, &*acceleration, shape);
    residuals.subtract_reference(constraints, shape);

    let mut hessian = Arrow::<F>::room(shape);
    let mut gradient = Coords::<F>::room(shape);
    let mut step = Coords::<F>::room(shape);
    let mut mass_step = Coords::<F>::room(shape);
    let mut slopes = Rows::<F>::room(shape);
    let mut live = true;
    let mut iterations = 0u32;
    // All threads that exchange numbers stay together, until the last world of them has arrived.
    while plane_any(live) && iterations < MAX_ITERATIONS {
        iterations += 1u32;
        derivatives::<F>(mass, constraints, &*residuals, &momentum, &mut gradient, &mut hessian, shape);
        step.copy_from(&gradient, shape);
        hessian.solve(&mass.root, &mut step, shape);
        let decrement = step.dot(&gradient, shape);
        live = live && lit::<F>(0.5) * scale * decrement >= tolerance;
        step.scale(-one, shape);
        mass.times(&step, &mut mass_step, shape);
        slopes.set_product(constraints, &step, shape);
        let linear = momentum.dot(&step, shape);
        let square = mass_step.dot(&step, shape);
        let found = search::<F>(constraints, &*residuals, &slopes, linear, square, decrement, live, shape);
        if live {
            acceleration.add_scaled(found.length, &step, shape);
            momentum.add_scaled(found.length, &mass_step, shape);
            residuals.add_scaled(found.length, &slopes, shape);
        }
        live = live && !found.exact;
    }
}

/// Gradient, and Hessian whose root's block is this thread's share without the mass matrix.
#[cube]
fn derivatives<F: Float>(
    mass: &Arrow<F>,
    constraints: &Constraints<F>,
    residuals: &Rows<F>,
    momentum: &Coords<F>,
    gradient: &mut Coords<F>,
    hessian: &mut Arrow<F>,
    #[comptime] shape: Shape,
) {
    let zero = lit::<F>(0.0);
    hessian.set_limb(mass, shape);
    gradient.copy_from(momentum, shape);
    let mut share = Array::<F>::new(6usize);
    #[unroll]
    for i in 0..6usize {
        share[i] = zero;
    }
    #[unroll]
    for slot in 0..comptime!(shape.slots) {
        let contact = constraints.contacts.rows[slot];
        if contact.weight > zero {
            let push = push::<F>(contact.weight, residuals.contact(slot));
            let columns = &constraints.contacts.columns;
            add_contact::<F>(contact, columns, push, &mut share, gradient, hessian, slot, shape);
        }
    }
    #[unroll]
    for joint in 0..comptime!(shape.joints) {
        let limit = constraints.limits[joint];
        let residual = residuals.limits[joint];
        let weight = select(residual < zero, limit.weight, zero);
        gradient.limb[joint] = fma(weight * residual, limit.sign, gradient.limb[joint]);
        hessian.block[comptime!(lower(joint, joint))] += weight;
        if comptime!(shape.joint[joint].dry_friction) {
            let friction = constraints.friction[joint];
            let residual = residuals.friction[joint];
            gradient.limb[joint] += friction.gradient(residual);
            hessian.block[comptime!(lower(joint, joint))] += friction.curvature(residual);
        }
    }
    #[unroll]
    for i in 0..6usize {
        gradient.root[i] += across::<F>(share[i], shape);
    }
}
