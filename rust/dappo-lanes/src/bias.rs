//! Bias forces: what gravity and velocities alone demand of every coordinate (recursive Newton–Euler).
//! (Documentation: Computation, "General framework"; `qfrc_bias`.)

use crate::constants::{Body, Constants};
use crate::coords::Coords;
use crate::inertia::Tensors;
use crate::kinematics::Kinematics;
use crate::lane::Lane;
use crate::math::{Axes, Vec3, add, cross, dot, rotate, scale, scale_add, sub, sym_mul, zero3};
use crate::skeleton::Skeleton;

/// Rotation and acceleration of a frame, seen from the root's origin moving along with it.
#[derive(Clone, Copy)]
struct Motion<T> {
    angular_velocity: Vec3<T>,
    angular_acceleration: Vec3<T>,
    /// Acceleration of the frame's origin; gravity is a floor that accelerates upwards.
    acceleration: Vec3<T>,
}

impl<T: Lane> Motion<T> {
    /// Acceleration of a point fixed in the frame.
    #[inline(always)]
    fn acceleration_at(&self, offset: Vec3<T>) -> Vec3<T> {
        let centripetal = cross(self.angular_velocity, cross(self.angular_velocity, offset));
        add(self.acceleration, add(cross(self.angular_acceleration, offset), centripetal))
    }
}

/// Forces that would hold all accelerations at zero; `velocity` is along the world's axes.
#[inline(always)]
pub fn bias<T: Lane, const L: usize, const J: usize>(
    skeleton: &Skeleton<T, L, J>,
    constants: &Constants<T, L, J>,
    kinematics: &Kinematics<T, L, J>,
    tensors: &Tensors<T, L, J>,
    velocity: &Coords<T, L, J>,
) -> Coords<T, L, J> {
    let root = Motion {
        angular_velocity: velocity.angular(),
        angular_acceleration: zero3(),
        acceleration: constants.lift,
    };
    let mut forces = Coords::zero();
    let mut total_force = scale(root.acceleration_at(kinematics.root_com), constants.root.mass);
    let mut total_torque = add(euler(&root, &tensors.root), cross(kinematics.root_com, total_force));
    if skeleton.compensates {
        let (force, torque) = compensation(constants.lift, &constants.root, &kinematics.root, zero3());
        total_force = sub(total_force, force);
        total_torque = sub(total_torque, torque);
    }
    for limb in 0..L {
        let poses = &kinematics.links[limb];
        let mut wrenches = [(zero3(), zero3()); J];
        let (mut motion, mut origin) = (root, zero3());
        for joint in 0..J {
            let pose = &poses[joint];
            let rate = velocity.limbs[limb][joint];
            let acceleration = motion.acceleration_at(sub(pose.anchor, origin));
            let turn = scale(cross(motion.angular_velocity, pose.hinge()), rate);
            motion = Motion {
                angular_velocity: scale_add(pose.hinge(), rate, motion.angular_velocity),
                angular_acceleration: add(motion.angular_acceleration, turn),
                acceleration,
            };
            origin = pose.anchor;
            let at_com = motion.acceleration_at(sub(pose.com, pose.anchor));
            let force = scale(at_com, constants.links[limb][joint].body.mass);
            let torque = add(euler(&motion, &tensors.links[limb][joint]), cross(pose.com, force));
            wrenches[joint] = (force, torque);
            if skeleton.compensates {
                let body = &constants.links[limb][joint].body;
                let (lift, turn) = compensation(constants.lift, body, &pose.axes, pose.anchor);
                wrenches[joint] = (sub(force, lift), sub(torque, turn));
            }
        }
        let (mut force, mut torque) = (zero3(), zero3());
        for joint in (0..J).rev() {
            force = add(force, wrenches[joint].0);
            torque = add(torque, wrenches[joint].1);
            forces.limbs[limb][joint] = dot(poses[joint].hinge(), torque) + dot(poses[joint].sweep, force);
        }
        total_force = add(total_force, force);
        total_torque = add(total_torque, torque);
    }
    let ([x, y, z], [tx, ty, tz]) = (total_force, total_torque);
    forces.root = [x, y, z, tx, ty, tz];
    forces
}

/// Torque about the centre of mass: I α + ω × I ω (Euler's equation).
#[inline(always)]
fn euler<T: Lane>(motion: &Motion<T>, tensor: &[T; 6]) -> Vec3<T> {
    let gyroscopic = cross(motion.angular_velocity, sym_mul(tensor, motion.angular_velocity));
    add(sym_mul(tensor, motion.angular_acceleration), gyroscopic)
}

/// Force and torque about the root's origin that compensate the weight of a body (`gravcomp`).
#[inline(always)]
fn compensation<T: Lane>(
    lift: Vec3<T>,
    body: &Body<T>,
    axes: &Axes<T>,
    origin: Vec3<T>,
) -> (Vec3<T>, Vec3<T>) {
    let force = scale(lift, body.compensated);
    (force, cross(add(origin, rotate(axes, body.compensated_com)), force))
}
