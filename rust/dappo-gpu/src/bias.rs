//! Bias forces: what gravity and velocities alone demand of every coordinate (recursive Newton–Euler).
//! (Documentation: Computation, "General framework"; `qfrc_bias`.)

use cubecl::prelude::*;

use crate::constants::{body, link, root};
use crate::coords::{Coords, across3};
use crate::inertia::Wrench;
use crate::kinematics::LinkPose;
use crate::math::{Axes, Sym3, V3, copied_in_kernels, sym3_at, v3_at};
use crate::shape::Shape;

/// Rotation and acceleration of a frame, seen from the root's origin moving along with it.
#[derive(CubeType, CubeTypeMut, Clone, Copy)]
struct Motion<F: Float> {
    omega: V3<F>,
    alpha: V3<F>,
    /// Acceleration of the frame's origin; gravity is a floor that accelerates upwards.
    acceleration: V3<F>,
}
copied_in_kernels!(MotionExpand);

#[cube]
impl<F: Float> Motion<F> {
    /// Acceleration of a point fixed in the frame.
    fn at(self, offset: V3<F>) -> V3<F> {
        self.acceleration + (self.alpha.cross(offset) + self.omega.cross(self.omega.cross(offset)))
    }

    /// Torque about the centre of mass: I α + ω × I ω (Euler's equation).
    fn euler(self, tensor: Sym3<F>) -> V3<F> {
        tensor.times(self.alpha) + self.omega.cross(tensor.times(self.omega))
    }
}

/// out ← forces that would hold all accelerations at zero; `velocity` is along the world's axes.
#[cube]
pub fn bias<F: Float>(
    numbers: &[F],
    model: usize,
    limb: usize,
    axes: Axes<F>,
    links: &Sequence<LinkPose<F>>,
    velocity: &Coords<F>,
    out: &mut Coords<F>,
    #[comptime] shape: Shape,
) {
    let lift = v3_at::<F>(numbers, model + root::LIFT);
    let still = Motion::<F> { omega: velocity.angular(), alpha: V3::<F>::zero(), acceleration: lift };
    let mut wrenches = Sequence::<Wrench<F>>::new();
    let mut motion = still;
    let mut origin = V3::<F>::zero();
    #[unroll]
    for joint in 0..comptime!(shape.joints) {
        let pose = links[joint];
        let rate = velocity.limb[joint];
        let turn = motion.omega.cross(pose.axes.z) * rate;
        motion = Motion::<F> {
            acceleration: motion.at(pose.anchor - origin),
            alpha: motion.alpha + turn,
            omega: pose.axes.z.times_plus(rate, motion.omega),
        };
        origin = pose.anchor;
        let force = motion.at(pose.com - pose.anchor) * pose.mass;
        let torque = motion.euler(pose.tensor) + pose.com.cross(force);
        let mass = limb + comptime!(shape.link(joint) + link::BODY);
        wrenches.push(compensated::<F>(numbers, mass, pose.axes, pose.anchor, lift, force, torque, shape));
    }
    let mut force = V3::<F>::zero();
    let mut torque = V3::<F>::zero();
    #[unroll]
    for back in 0..comptime!(shape.joints) {
        let joint = comptime!(shape.joints - 1 - back);
        let pose = links[joint];
        force = force + wrenches[joint].force;
        torque = torque + wrenches[joint].torque;
        out.limb[joint] = pose.axes.z.dot(torque) + pose.sweep.dot(force);
    }
    let mass = model + root::BODY;
    let com = axes.rotate(v3_at::<F>(numbers, mass + body::COM));
    let push = still.at(com) * numbers[mass + body::MASS];
    let tensor = axes.rotate_sym(sym3_at::<F>(numbers, mass + body::TENSOR));
    let turn = still.euler(tensor) + com.cross(push);
    let own = compensated::<F>(numbers, mass, axes, V3::<F>::zero(), lift, push, turn, shape);
    out.set_linear(own.force + across3::<F>(force, shape));
    out.set_angular(own.torque + across3::<F>(torque, shape));
}

/// A force and a torque, less those that compensate the weight of a body (`gravcomp`).
#[cube]
fn compensated<F: Float>(
    numbers: &[F],
    mass: usize,
    axes: Axes<F>,
    origin: V3<F>,
    lift: V3<F>,
    force: V3<F>,
    torque: V3<F>,
    #[comptime] shape: Shape,
) -> Wrench<F> {
    if comptime!(shape.compensates) {
        let weight = lift * numbers[mass + body::COMPENSATED];
        let center = origin + axes.rotate(v3_at::<F>(numbers, mass + body::COMPENSATED_COM));
        Wrench::<F> { force: force - weight, torque: torque - center.cross(weight) }
    } else {
        Wrench::<F> { force, torque }
    }
}
