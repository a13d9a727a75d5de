//! Bias forces: what gravity and velocities alone demand of every coordinate (recursive Newton–Euler).
//! (Documentation: Computation, "General framework"; `qfrc_bias`.)

use crate::constants::{Body, Constants};
use crate::coords::Coords;
use crate::inertia::Tensors;
use crate::kinematics::{Kinematics, LinkPose};
use crate::lane::Lane;
use crate::math::{Axes, Vec3, add, cross, dot, rotate, scale, scale_add, sub, sym_mul, zero3};
use crate::skeleton::Skeleton;

/// Force, and torque about the root's origin.
type Wrench<T> = (Vec3<T>, Vec3<T>);

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
pub fn bias<T: Lane, const L: usize, const J: usize, const W: usize>(
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
    let force = scale(root.acceleration_at(kinematics.root_com), constants.root.mass);
    let mut total = (force, add(euler(&root, &tensors.root), cross(kinematics.root_com, force)));
    if skeleton.compensates {
        let (lift, turn) = compensation(constants.lift, &constants.root, &kinematics.root, zero3());
        total = (sub(total.0, lift), sub(total.1, turn));
    }
    // The trunk, limb 0, waits for what hangs on it.
    let mut trunk_motions = [(root, zero3()); W];
    let mut trunk_wrenches = [(zero3(), zero3()); J];
    for limb in 0..L {
        let poses = &kinematics.links[limb];
        let mut wrenches = [(zero3(), zero3()); J];
        let (mut motion, mut origin) = match skeleton.parents[limb] {
            Some(link) if W > 0 => trunk_motions[link],
            _ => (root, zero3()),
        };
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
            if limb == 0 && joint < W {
                trunk_motions[joint] = (motion, origin);
            }
        }
        if W > 0 && limb == 0 {
            trunk_wrenches = wrenches;
            continue;
        }
        let (force, torque) = project(poses, &wrenches, &mut forces.limbs[limb]);
        match skeleton.parents[limb] {
            Some(link) if W > 0 => add_wrench(&mut trunk_wrenches[link], (force, torque)),
            _ => add_wrench(&mut total, (force, torque)),
        }
    }
    if W > 0 {
        add_wrench(&mut total, project(&kinematics.links[0], &trunk_wrenches, &mut forces.limbs[0]));
    }
    let ([x, y, z], [tx, ty, tz]) = total;
    forces.root = [x, y, z, tx, ty, tz];
    forces
}

/// Turns the forces on the links of a limb into those on its joints, and returns their sum.
#[inline(always)]
fn project<T: Lane, const J: usize>(
    poses: &[LinkPose<T>; J],
    wrenches: &[Wrench<T>; J],
    forces: &mut [T; J],
) -> Wrench<T> {
    let mut total = (zero3(), zero3());
    for joint in (0..J).rev() {
        add_wrench(&mut total, wrenches[joint]);
        forces[joint] = dot(poses[joint].hinge(), total.1) + dot(poses[joint].sweep, total.0);
    }
    total
}

#[inline(always)]
fn add_wrench<T: Lane>(sum: &mut Wrench<T>, (force, torque): Wrench<T>) {
    *sum = (add(sum.0, force), add(sum.1, torque));
}

/// Torque about the centre of mass: I α + ω × I ω (Euler's equation).
#[inline(always)]
fn euler<T: Lane>(motion: &Motion<T>, tensor: &[T; 6]) -> Vec3<T> {
    let gyroscopic = cross(motion.angular_velocity, sym_mul(tensor, motion.angular_velocity));
    add(sym_mul(tensor, motion.angular_acceleration), gyroscopic)
}

/// What compensates the weight of a body (`gravcomp`).
#[inline(always)]
fn compensation<T: Lane>(lift: Vec3<T>, body: &Body<T>, axes: &Axes<T>, origin: Vec3<T>) -> Wrench<T> {
    let force = scale(lift, body.compensated);
    (force, cross(add(origin, rotate(axes, body.compensated_com)), force))
}
