//! The mass matrix: composite rigid bodies, with spatial quantities about the root's origin.
//! (Documentation: Computation, "General framework"; Featherstone, "Rigid Body Dynamics Algorithms", ch. 6.)

use cubecl::prelude::*;

use crate::arrow::Arrow;
use crate::constants::{body, link, root};
use crate::coords::{across, across3};
use crate::kinematics::LinkPose;
use crate::math::{Axes, Sym3, V3, copied_in_kernels, lit, sym3_at, v3_at};
use crate::shape::{Shape, lower};

/// Several rigid bodies moved as one: mass, first moment and inertia about the root's origin.
#[derive(CubeType, CubeTypeMut, Clone, Copy)]
pub struct Composite<F: Float> {
    pub mass: F,
    pub moment: V3<F>,
    pub inertia: Sym3<F>,
}
copied_in_kernels!(CompositeExpand);

/// Force and torque about the root's origin.
#[derive(CubeType, CubeTypeMut, Clone, Copy)]
pub struct Wrench<F: Float> {
    pub force: V3<F>,
    pub torque: V3<F>,
}
copied_in_kernels!(WrenchExpand);

#[cube]
impl<F: Float> Composite<F> {
    pub fn nothing() -> Composite<F> {
        Composite::<F> { mass: lit::<F>(0.0), moment: V3::<F>::zero(), inertia: Sym3::<F>::zero() }
    }

    /// With a body whose inertia about its centre of mass, along the world's axes, is `tensor`.
    pub fn with_body(self, mass: F, com: V3<F>, tensor: Sym3<F>) -> Composite<F> {
        Composite::<F> {
            mass: self.mass + mass,
            moment: com.times_plus(mass, self.moment),
            inertia: (self.inertia + tensor).with_point_mass(mass, com),
        }
    }

    /// What accelerates it, at rest, by a turn of 1 rad/s² about `axis` which moves the origin with `sweep`.
    pub fn wrench(self, axis: V3<F>, sweep: V3<F>) -> Wrench<F> {
        Wrench::<F> {
            force: sweep.times_plus(self.mass, axis.cross(self.moment)),
            torque: self.inertia.times(axis) + self.moment.cross(sweep),
        }
    }

    /// Sum over the threads of a world.
    fn across(self, #[comptime] shape: Shape) -> Composite<F> {
        Composite::<F> {
            mass: across::<F>(self.mass, shape),
            moment: across3::<F>(self.moment, shape),
            inertia: Sym3::<F> {
                xx: across::<F>(self.inertia.xx, shape),
                yy: across::<F>(self.inertia.yy, shape),
                zz: across::<F>(self.inertia.zz, shape),
                xy: across::<F>(self.inertia.xy, shape),
                xz: across::<F>(self.inertia.xz, shape),
                yz: across::<F>(self.inertia.yz, shape),
            },
        }
    }
}

/// Fills the mass matrix, armature included, and returns the centre of mass from the root's origin.
#[cube]
pub fn mass_matrix<F: Float>(
    numbers: &[F],
    model: usize,
    limb: usize,
    axes: Axes<F>,
    links: &Sequence<LinkPose<F>>,
    matrix: &mut Arrow<F>,
    #[comptime] shape: Shape,
) -> V3<F> {
    let mut outer = Composite::<F>::nothing();
    #[unroll]
    for back in 0..comptime!(shape.joints) {
        let joint = comptime!(shape.joints - 1 - back);
        let pose = links[joint];
        outer = outer.with_body(pose.mass, pose.com, pose.tensor);
        let w = outer.wrench(pose.axes.z, pose.sweep);
        matrix.coupling[comptime!(6 * joint)] = w.force.x;
        matrix.coupling[comptime!(6 * joint + 1)] = w.force.y;
        matrix.coupling[comptime!(6 * joint + 2)] = w.force.z;
        matrix.coupling[comptime!(6 * joint + 3)] = w.torque.x;
        matrix.coupling[comptime!(6 * joint + 4)] = w.torque.y;
        matrix.coupling[comptime!(6 * joint + 5)] = w.torque.z;
        #[unroll]
        for inner in 0..comptime!(joint + 1) {
            let other = links[inner];
            let mut entry = other.axes.z.dot(w.torque) + other.sweep.dot(w.force);
            if comptime!(inner == joint) {
                entry += numbers[limb + comptime!(shape.link(joint) + link::ARMATURE)];
            }
            matrix.block[comptime!(lower(joint, inner))] = entry;
        }
    }
    let mass = model + root::BODY;
    let robot = outer.across(shape).with_body(
        numbers[mass + body::MASS],
        axes.rotate(v3_at::<F>(numbers, mass + body::COM)),
        axes.rotate_sym(sym3_at::<F>(numbers, mass + body::TENSOR)),
    );
    root_block::<F>(robot, numbers[model + root::ARMATURE], &mut matrix.root);
    robot.moment * (lit::<F>(1.0) / robot.mass)
}

/// The lower triangle of [m·1, ·; [c]ₓ, I] with the robot's mass, first moment c and inertia.
#[cube]
fn root_block<F: Float>(robot: Composite<F>, armature: F, block: &mut Array<F>) {
    let c = robot.moment;
    #[unroll]
    for i in 0..21usize {
        block[i] = lit::<F>(0.0);
    }
    #[unroll]
    for i in 0..3usize {
        block[comptime!(lower(i, i))] = robot.mass + armature;
    }
    block[comptime!(lower(3, 1))] = -c.z;
    block[comptime!(lower(3, 2))] = c.y;
    block[comptime!(lower(4, 0))] = c.z;
    block[comptime!(lower(4, 2))] = -c.x;
    block[comptime!(lower(5, 0))] = -c.y;
    block[comptime!(lower(5, 1))] = c.x;
    block[comptime!(lower(3, 3))] = robot.inertia.xx + armature;
    block[comptime!(lower(4, 4))] = robot.inertia.yy + armature;
    block[comptime!(lower(5, 5))] = robot.inertia.zz + armature;
    block[comptime!(lower(4, 3))] = robot.inertia.xy;
    block[comptime!(lower(5, 3))] = robot.inertia.xz;
    block[comptime!(lower(5, 4))] = robot.inertia.yz;
}
