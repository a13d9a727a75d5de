//! The mass matrix: composite rigid bodies, with spatial quantities about the root's origin.
//! (Documentation: Computation, "General framework"; Featherstone, "Rigid Body Dynamics Algorithms", ch. 6.)

use crate::arrow::Arrow;
use crate::constants::{Body, Constants};
use crate::kinematics::Kinematics;
use crate::lane::Lane;
use crate::math::{
    Sym3, Vec3, add, add_point_mass, cross, dot, scale, scale_add, sym_mul, sym_rotate, zero3,
};
use crate::skeleton::Skeleton;

/// Several rigid bodies moved as one: mass, first moment and inertia about the root's origin.
#[derive(Clone, Copy)]
pub struct Composite<T> {
    pub mass: T,
    pub moment: Vec3<T>,
    pub inertia: Sym3<T>,
}

impl<T: Lane> Composite<T> {
    #[inline(always)]
    fn nothing() -> Self {
        Self { mass: T::zero(), moment: zero3(), inertia: [T::zero(); 6] }
    }

    /// Adds a body whose inertia about its centre of mass, along the world's axes, is `tensor`.
    #[inline(always)]
    fn add_body(&mut self, body: &Body<T>, com: Vec3<T>, tensor: &Sym3<T>) {
        self.mass += body.mass;
        self.moment = scale_add(com, body.mass, self.moment);
        for (sum, &entry) in self.inertia.iter_mut().zip(tensor) {
            *sum += entry;
        }
        add_point_mass(&mut self.inertia, body.mass, com);
    }

    #[inline(always)]
    fn add(&mut self, other: &Self) {
        self.mass += other.mass;
        self.moment = add(self.moment, other.moment);
        for (sum, &entry) in self.inertia.iter_mut().zip(&other.inertia) {
            *sum += entry;
        }
    }

    /// Force and torque about the origin that accelerate it, at rest, by a turn of 1 rad/s² about `axis`
    /// which moves the origin with `sweep`.
    #[inline(always)]
    fn wrench(&self, axis: Vec3<T>, sweep: Vec3<T>) -> (Vec3<T>, Vec3<T>) {
        let force = scale_add(sweep, self.mass, cross(axis, self.moment));
        let torque = add(sym_mul(&self.inertia, axis), cross(self.moment, sweep));
        (force, torque)
    }
}

/// Inertia tensors about the centres of mass, along the world's axes.
pub struct Tensors<T, const L: usize, const J: usize> {
    pub root: Sym3<T>,
    pub links: [[Sym3<T>; J]; L],
}

impl<T: Lane, const L: usize, const J: usize> Tensors<T, L, J> {
    pub fn zero() -> Self {
        Self { root: [T::zero(); 6], links: [[[T::zero(); 6]; J]; L] }
    }

    #[inline(always)]
    pub fn update(&mut self, constants: &Constants<T, L, J>, kinematics: &Kinematics<T, L, J>) {
        self.root = sym_rotate(&kinematics.root, &constants.root.tensor);
        for limb in 0..L {
            for joint in 0..J {
                let tensor = &constants.links[limb][joint].body.tensor;
                self.links[limb][joint] = sym_rotate(&kinematics.links[limb][joint].axes, tensor);
            }
        }
    }
}

/// Fills the mass matrix, armature included, and returns the robot as one body.
#[inline(always)]
pub fn mass_matrix<T: Lane, const L: usize, const J: usize, const W: usize>(
    skeleton: &Skeleton<T, L, J>,
    constants: &Constants<T, L, J>,
    kinematics: &Kinematics<T, L, J>,
    tensors: &Tensors<T, L, J>,
    matrix: &mut Arrow<T, L, J, W>,
) -> Composite<T> {
    let mut robot = Composite::nothing();
    robot.add_body(&constants.root, kinematics.root_com, &tensors.root);
    // What hangs on each link of the trunk, whose own turn is the last.
    let mut hanging = [Composite::nothing(); W];
    for limb in (0..L).rev() {
        let links = &kinematics.links[limb];
        let parent = skeleton.parents[limb];
        let mut outer = Composite::nothing();
        for joint in (0..J).rev() {
            let (link, pose) = (&constants.links[limb][joint], &links[joint]);
            outer.add_body(&link.body, pose.com, &tensors.links[limb][joint]);
            if limb == 0 && joint < W {
                outer.add(&hanging[joint]);
            }
            let (force, torque) = outer.wrench(pose.hinge(), pose.sweep);
            matrix.coupling[limb][joint] = [force[0], force[1], force[2], torque[0], torque[1], torque[2]];
            for inner in 0..joint + 1 {
                matrix.limbs[limb][joint][inner] =
                    dot(links[inner].hinge(), torque) + dot(links[inner].sweep, force);
            }
            matrix.limbs[limb][joint][joint] += link.armature;
            for trunk in 0..W {
                let moved = parent.is_some_and(|last| trunk <= last);
                let pose = &kinematics.links[0][trunk];
                matrix.trunk[limb][joint][trunk] =
                    if moved { dot(pose.hinge(), torque) + dot(pose.sweep, force) } else { T::zero() };
            }
        }
        match parent {
            Some(link) if W > 0 => hanging[link].add(&outer),
            _ => robot.add(&outer),
        }
    }
    root_block(&mut matrix.root, &robot);
    for i in 0..6 {
        matrix.root[i][i] += constants.root_armature;
    }
    robot
}

/// The lower triangle of [m·1, ·; [c]ₓ, I] with the robot's mass, first moment c and inertia.
#[inline(always)]
fn root_block<T: Lane>(root: &mut [[T; 6]; 6], robot: &Composite<T>) {
    let (zero, mass) = (T::zero(), robot.mass);
    let [x, y, z] = robot.moment;
    let [xx, yy, zz, xy, xz, yz] = robot.inertia;
    *root = [
        [mass, zero, zero, zero, zero, zero],
        [zero, mass, zero, zero, zero, zero],
        [zero, zero, mass, zero, zero, zero],
        [zero, -z, y, xx, zero, zero],
        [z, zero, -x, xy, yy, zero],
        [-y, x, zero, xz, yz, zz],
    ];
}

/// Centre of mass of a composite, from the root's origin.
#[inline(always)]
pub fn center<T: Lane>(robot: &Composite<T>) -> Vec3<T> {
    scale(robot.moment, T::of(1.0) / robot.mass)
}
