//! Forward dynamics: from positions, velocities and controls to accelerations and contact forces.
//! (Documentation: Computation, "Forward dynamics"; `mj_forward`.)

use crate::actuation::{Actuation, actuation};
use crate::arrow::Arrow;
use crate::bias::bias;
use crate::constants::{Constants, Skeleton};
use crate::contact::{Contact, find_contacts};
use crate::coords::Coords;
use crate::dry_friction::DryFriction;
use crate::inertia::{Tensors, center, mass_matrix};
use crate::kinematics::Kinematics;
use crate::lane::{Lane, Mask};
use crate::limit::Limits;
use crate::math::{Vec3, rotate, unrotate, zero3};
use crate::model::Cone;
use crate::solver::Problem;
use crate::state::State;

/// An evaluation of the dynamics. Large, so it is made once and then updated.
pub struct Dynamics<T: Lane, const L: usize, const J: usize> {
    pub kinematics: Kinematics<T, L, J>,
    tensors: Tensors<T, L, J>,
    /// Mass matrix; angular entries along the world's axes.
    mass: Arrow<T, L, J>,
    /// Centre of mass of the robot, from the root's origin.
    pub center: Vec3<T>,
    pub actuation: Actuation<T, L, J>,
    /// Contacts with their forces.
    pub contacts: Vec<Contact<T, J>>,
    limits: Limits<T, L, J>,
    dry_friction: DryFriction<T>,
    /// A sum of the mass matrix and others.
    work: Arrow<T, L, J>,
    /// A factorised matrix.
    factor: Arrow<T, L, J>,
    /// Acceleration; angular entries along the world's axes.
    acceleration: Coords<T, L, J>,
}

impl<T: Lane, const L: usize, const J: usize> Dynamics<T, L, J> {
    /// Room for the evaluation of a robot.
    pub fn new(skeleton: &Skeleton<T, L, J>) -> Self {
        Self {
            kinematics: Kinematics::zero(),
            tensors: Tensors::zero(),
            mass: Arrow::zero(),
            center: zero3(),
            actuation: Actuation::zero(),
            contacts: Vec::with_capacity(skeleton.points.len()),
            limits: Limits::none(),
            dry_friction: DryFriction::new(L * J),
            work: Arrow::zero(),
            factor: Arrow::zero(),
            acceleration: Coords::zero(),
        }
    }

    /// Evaluates the dynamics of a state.
    #[inline(always)]
    pub fn update(
        &mut self,
        skeleton: &Skeleton<T, L, J>,
        constants: &Constants<T, L, J>,
        state: &State<T, L, J>,
        ctrl: &[[T; J]; L],
    ) {
        let position = &state.position;
        self.kinematics.update(skeleton, constants, position);
        let velocity = self.to_world(&state.velocity);
        self.tensors.update(constants, &self.kinematics);
        let robot = mass_matrix(constants, &self.kinematics, &self.tensors, &mut self.mass);
        self.center = center(&robot);

        let mut smooth = bias(skeleton, constants, &self.kinematics, &self.tensors, &velocity);
        smooth.negate(!T::Mask::none());
        self.actuation = actuation(skeleton, constants, &position.joints, &velocity.limbs, ctrl);
        for limb in 0..L {
            for joint in 0..J {
                smooth.limbs[limb][joint] += self.actuation.force[limb][joint];
            }
        }
        if skeleton.damps_root {
            for i in 0..6 {
                smooth.root[i] = constants.root_damping.neg_mul_add(velocity.root[i], smooth.root[i]);
            }
        }
        self.mass.solve(&mut self.factor, &mut smooth);

        let height = position.root[2] - T::splat(skeleton.floor);
        let touching =
            find_contacts(skeleton, constants, &self.kinematics, height, &velocity, &mut self.contacts);
        self.limits.update(skeleton, constants, &position.joints, &velocity.limbs);
        let mut present = touching | self.limits.present;
        if skeleton.has_dry_friction {
            self.dry_friction.update(skeleton, constants, &velocity.limbs);
            present = !T::Mask::none();
        }
        self.acceleration = smooth;
        if present.any() {
            let guess = self.to_world(&state.warm_start);
            let mut problem = Problem {
                mass: &self.mass,
                kinematics: &self.kinematics,
                contacts: &mut self.contacts,
                limits: &mut self.limits,
                dry_friction: &mut self.dry_friction,
                hessian: &mut self.work,
                factor: &mut self.factor,
                present,
                slips: skeleton.cone == Cone::Elliptic,
            };
            self.acceleration = problem.solve(&smooth, &guess, constants.solver_scale);
        }
    }

    /// The acceleration as qacc has it: angular entries along the root's axes.
    #[inline(always)]
    pub fn qacc(&self) -> Coords<T, L, J> {
        self.to_root(&self.acceleration)
    }

    /// Acceleration, as qacc, of a step that treats a part of the forces implicitly in velocity, with the
    /// drag of the root's coordinates and of the joints: (M + h·drag)⁻¹ M a (documentation: Computation, "Numerical integration").
    #[inline(always)]
    pub fn implicit_qacc(&mut self, root: T, drag: &[[T; J]; L], timestep: T) -> Coords<T, L, J> {
        let mut acceleration = self.mass.mul(&self.acceleration);
        self.work = self.mass;
        for i in 0..6 {
            self.work.root[i][i] = timestep.mul_add(root, self.work.root[i][i]);
        }
        for limb in 0..L {
            for joint in 0..J {
                let entry = &mut self.work.limbs[limb][joint][joint];
                *entry = timestep.mul_add(drag[limb][joint], *entry);
            }
        }
        self.work.solve(&mut self.factor, &mut acceleration);
        self.to_root(&acceleration)
    }

    #[inline(always)]
    fn to_world(&self, coords: &Coords<T, L, J>) -> Coords<T, L, J> {
        coords.with_angular(rotate(&self.kinematics.root, coords.angular()))
    }

    #[inline(always)]
    fn to_root(&self, coords: &Coords<T, L, J>) -> Coords<T, L, J> {
        coords.with_angular(unrotate(&self.kinematics.root, coords.angular()))
    }
}
