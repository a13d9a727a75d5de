//! What contacts do to bodies and touch sensors, and what else a world shows of an evaluation.

use cubecl::prelude::*;

use crate::contact::Contact;
use crate::inertia::Wrench;
use crate::math::{V3, lit};
use crate::pyramid::push;
use crate::shape::Shape;
use crate::solver::{Constraints, Rows};
use crate::state::Place;

/// Writes the external forces on the bodies (`cfrc_ext` of `mj_rnePostConstraint`): torque about the robot's centre of
/// mass, then force, along the world's axes.
#[cube]
pub fn write_bodies<F: Float>(
    readings: &mut [F],
    place: Place,
    constraints: &Constraints<F>,
    residuals: &Rows<F>,
    center: V3<F>,
    #[comptime] shape: Shape,
) {
    let mut bodies = Array::<F>::new(comptime!((6 * shape.bodies).max(1)));
    #[unroll]
    for i in 0..comptime!(6 * shape.bodies) {
        bodies[i] = lit::<F>(0.0);
    }
    #[unroll]
    for slot in 0..comptime!(shape.slots) {
        let contact = constraints.contacts.rows[slot];
        if contact.weight > lit::<F>(0.0) {
            let w = wrench::<F>(contact, residuals.contact(slot), center);
            let at = comptime!(6 * shape.slot[slot].body);
            bodies[at] += w.torque.x;
            bodies[comptime!(at + 1)] += w.torque.y;
            bodies[comptime!(at + 2)] += w.torque.z;
            bodies[comptime!(at + 3)] += w.force.x;
            bodies[comptime!(at + 4)] += w.force.y;
            bodies[comptime!(at + 5)] += w.force.z;
        }
    }
    let row = place.world * comptime!(shape.readings()) + comptime!(shape.body_readings());
    let own = row + place.lane * comptime!(6 * shape.bodies);
    #[unroll]
    for i in 0..comptime!(6 * shape.bodies) {
        readings[own + i] = bodies[i];
    }
}

/// Force of a contact, and torque about `center`.
#[cube]
fn wrench<F: Float>(contact: Contact<F>, residual: V3<F>, center: V3<F>) -> Wrench<F> {
    let push = push::<F>(contact.weight, residual);
    let force = contact.world(push.gradient) * lit::<F>(-1.0);
    Wrench::<F> { force, torque: (contact.at - center).cross(force) }
}

/// Writes the touch sensors: the sum of the normal forces they feel (documentation: XML reference, "sensor/touch").
#[cube]
pub fn write_touch<F: Float>(
    readings: &mut [F],
    place: Place,
    constraints: &Constraints<F>,
    residuals: &Rows<F>,
    #[comptime] shape: Shape,
) {
    let mut sums = Array::<F>::new(comptime!(shape.touches.max(1)));
    #[unroll]
    for i in 0..comptime!(shape.touches) {
        sums[i] = lit::<F>(0.0);
    }
    #[unroll]
    for slot in 0..comptime!(shape.slots) {
        if comptime!(shape.slot[slot].touch.is_some()) {
            let sensor = comptime!(shape.slot[slot].touch.unwrap_or(0));
            let contact = constraints.contacts.rows[slot];
            if contact.weight > lit::<F>(0.0) {
                let push = push::<F>(contact.weight, residuals.contact(slot));
                sums[sensor] -= push.gradient.x;
            }
        }
    }
    let row = place.world * comptime!(shape.readings()) + comptime!(shape.touch_readings());
    let own = row + place.lane * comptime!(shape.touches);
    #[unroll]
    for i in 0..comptime!(shape.touches) {
        readings[own + i] = sums[i];
    }
}

/// Writes the forces of motors and servos along their own lengths, and x of the root.
#[cube]
pub fn write_motors<F: Float>(
    readings: &mut [F],
    place: Place,
    x: F,
    motor: &Array<F>,
    #[comptime] shape: Shape,
) {
    let row = place.world * comptime!(shape.readings());
    if place.lane == 0usize {
        readings[row] = x;
    }
    let own = row + 1 + place.lane * comptime!(shape.joints);
    #[unroll]
    for k in 0..comptime!(shape.joints) {
        readings[own + k] = motor[k];
    }
}
