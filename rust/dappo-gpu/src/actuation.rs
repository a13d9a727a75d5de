//! Forces of motors, servos, joint damping and springs.
//! (Documentation: Computation, "Actuation model" and "Passive forces".)

use cubecl::prelude::*;
use dappo_lanes::model::Integrator;

use crate::constants::link;
use crate::coords::Coords;
use crate::math::lit;
use crate::shape::Shape;

/// Forces on the joints of a limb, and how they fall with velocity.
#[derive(CubeType)]
pub struct Actuation<F: Float> {
    pub force: Array<F>,
    /// Forces of the motors and servos alone, along their own lengths.
    pub motor: Array<F>,
    /// −∂force/∂velocity, as far as the integrator treats it implicitly: through damping alone with Euler, through
    /// damping and actuators with implicitfast.
    pub drag: Array<F>,
}

#[cube]
pub fn actuation<F: Float>(
    numbers: &[F],
    limb: usize,
    positions: &Array<F>,
    velocity: &Coords<F>,
    ctrl: &Array<F>,
    #[comptime] shape: Shape,
) -> Actuation<F> {
    let zero = lit::<F>(0.0);
    let mut forces = Array::<F>::new(comptime!(shape.joints));
    let mut motors = Array::<F>::new(comptime!(shape.joints));
    let mut drags = Array::<F>::new(comptime!(shape.joints));
    #[unroll]
    for joint in 0..comptime!(shape.joints) {
        let own = comptime!(shape.joint[joint]);
        let at = limb + comptime!(shape.link(joint));
        let damping = numbers[at + link::DAMPING];
        let speed = velocity.limb[joint];
        let mut force = zero;
        let mut drag = damping;
        motors[joint] = zero;
        if comptime!(own.actuated) {
            let gear = numbers[at + link::GEAR];
            let lowest = numbers[at + link::FORCE_RANGE];
            let highest = numbers[at + link::FORCE_RANGE + 1];
            let control =
                clamp(ctrl[joint], numbers[at + link::CTRL_RANGE], numbers[at + link::CTRL_RANGE + 1]);
            force = numbers[at + link::GAIN] * control;
            if comptime!(own.servo) {
                let slope = numbers[at + link::BIAS + 2];
                let passive = fma(slope, gear * speed, numbers[at + link::BIAS]);
                force += fma(numbers[at + link::BIAS + 1], gear * positions[joint], passive);
                if comptime!(matches!(shape.integrator, Integrator::ImplicitFast { .. })) {
                    // A saturated actuator does not answer to velocity.
                    let mut free = lowest < force && force < highest;
                    if comptime!(own.limited_torque && clamped_without_derivative(shape)) {
                        let torque = gear * force;
                        free = free
                            && numbers[at + link::ACTUATOR_RANGE] < torque
                            && torque < numbers[at + link::ACTUATOR_RANGE + 1];
                    }
                    drag -= select(free, gear * gear * slope, zero);
                }
            }
            force = clamp(force, lowest, highest);
            motors[joint] = force;
            force = gear * force;
            if comptime!(own.limited_torque) {
                force =
                    clamp(force, numbers[at + link::ACTUATOR_RANGE], numbers[at + link::ACTUATOR_RANGE + 1]);
            }
        }
        if comptime!(own.spring) {
            let stretch = positions[joint] - numbers[at + link::SPRING_REFERENCE];
            force = fma(-numbers[at + link::STIFFNESS], stretch, force);
        }
        forces[joint] = fma(-damping, speed, force);
        drags[joint] = drag;
    }
    Actuation::<F> { force: forces, motor: motors, drag: drags }
}

fn clamped_without_derivative(shape: Shape) -> bool {
    shape.integrator == Integrator::ImplicitFast { clamped_without_derivative: true }
}
