//! Forces of motors, servos, joint damping and springs.
//! (Documentation: Computation, "Actuation model" and "Passive forces".)

use crate::constants::Constants;
use crate::lane::Lane;
use crate::model::Integrator;
use crate::skeleton::Skeleton;

/// Forces on the joints, and how they fall with velocity.
pub struct Actuation<T, const L: usize, const J: usize> {
    pub force: [[T; J]; L],
    /// Forces of the motors and servos alone, along their own lengths.
    pub motor: [[T; J]; L],
    /// −∂force/∂velocity through damping alone: what Euler treats implicitly.
    pub damping: [[T; J]; L],
    /// The same through damping and actuators: what implicitfast treats implicitly.
    pub drag: [[T; J]; L],
}

impl<T: Lane, const L: usize, const J: usize> Actuation<T, L, J> {
    pub fn zero() -> Self {
        let zero = [[T::zero(); J]; L];
        Self { force: zero, motor: zero, damping: zero, drag: zero }
    }
}

#[inline(always)]
pub fn actuation<T: Lane, const L: usize, const J: usize>(
    skeleton: &Skeleton<T, L, J>,
    constants: &Constants<T, L, J>,
    positions: &[[T; J]; L],
    velocities: &[[T; J]; L],
    ctrl: &[[T; J]; L],
) -> Actuation<T, L, J> {
    let mut out = Actuation::zero();
    let clamped_without_derivative =
        skeleton.integrator == Integrator::ImplicitFast { clamped_without_derivative: true };
    for limb in 0..L {
        for joint in 0..J {
            let (link, shared) = (&constants.links[limb][joint], &skeleton.joints[limb][joint]);
            let (position, velocity) = (positions[limb][joint], velocities[limb][joint]);
            let motor = &link.motor;
            let mut force = T::zero();
            let mut drag = link.damping;
            if shared.actuator.is_some() {
                let [lowest, highest] = motor.force_range;
                force = motor.gain * ctrl[limb][joint].clamp(motor.ctrl_range[0], motor.ctrl_range[1]);
                if shared.servo {
                    let [constant, stiffness, slope] = motor.bias;
                    let (length, speed) = (motor.gear * position, motor.gear * velocity);
                    force += stiffness.mul_add(length, slope.mul_add(speed, constant));
                    // A saturated actuator does not answer to velocity.
                    let mut free = lowest.lt(force) & force.lt(highest);
                    if shared.limited_torque && clamped_without_derivative {
                        let torque = motor.gear * force;
                        free = free & link.actuator_range[0].lt(torque) & torque.lt(link.actuator_range[1]);
                    }
                    drag -= (motor.gear * motor.gear * slope).keep(free);
                }
                force = force.clamp(lowest, highest);
                out.motor[limb][joint] = force;
                force = motor.gear * force;
                if shared.limited_torque {
                    force = force.clamp(link.actuator_range[0], link.actuator_range[1]);
                }
            }
            if shared.spring {
                force = link.stiffness.neg_mul_add(position - link.spring_reference, force);
            }
            out.force[limb][joint] = link.damping.neg_mul_add(velocity, force);
            out.damping[limb][joint] = link.damping;
            out.drag[limb][joint] = drag;
        }
    }
    out
}
