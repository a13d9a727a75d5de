//! Forward dynamics: from positions, velocities and controls to accelerations and contact forces.
//! (Documentation: Computation, "Forward dynamics"; `mj_forward`.)

use crate::actuation::{Actuation, actuation};
use crate::arrow::Arrow;
use crate::bias::bias;
use crate::constants::Constants;
use crate::contact::Contacts;
use crate::coords::Coords;
use crate::dry_friction::DryFriction;
use crate::inertia::{Tensors, center, mass_matrix};
use crate::kinematics::Kinematics;
use crate::lane::{Lane, Mask};
use crate::limit::Limits;
use crate::math::{Vec3, unrotate, zero3};
use crate::model::Cone;
use crate::skeleton::Skeleton;
use crate::solver::Problem;
use crate::state::State;

/// An evaluation of the dynamics. Large, so it is made once and then updated.
pub struct Dynamics<T: Lane, const L: usize, const J: usize, const W: usize> {
    pub kinematics: Kinematics<T, L, J>,
    tensors: Tensors<T, L, J>,
    /// Mass matrix; angular entries along the world's axes.
    mass: Arrow<T, L, J, W>,
    /// Centre of mass of the robot, from the root's origin.
    pub center: Vec3<T>,
    pub actuation: Actuation<T, L, J>,
    /// Contacts with their forces.
    pub contacts: Contacts<T, J, W>,
    limits: Limits<T, L, J>,
    dry_friction: DryFriction<T>,
    /// A sum of the mass matrix and others, factorised.
    work: Arrow<T, L, J, W>,
    /// Acceleration; angular entries along the world's axes.
    acceleration: Coords<T, L, J>,
}

impl<T: Lane, const L: usize, const J: usize, const W: usize> Dynamics<T, L, J, W> {
    /// Room for the evaluation of a robot.
    pub fn new(skeleton: &Skeleton<T, L, J>) -> Self {
        Self {
            kinematics: Kinematics::zero(),
            tensors: Tensors::zero(),
            mass: Arrow::zero(),
            center: zero3(),
            actuation: Actuation::zero(),
            contacts: Contacts::new(skeleton.points.len()),
            limits: Limits::none(),
            dry_friction: DryFriction::new(L * J),
            work: Arrow::zero(),
            acceleration: Coords::zero(),
        }
    }

    /// Forgets the evaluation before, so that the next one depends on its arguments alone.
    #[inline(always)]
    pub fn forget(&mut self) {
        self.contacts.forget();
        self.limits.forget();
        self.dry_friction.forget();
    }

    /// Evaluates the dynamics of a state; the solver begins with the constraints that pushed in the evaluation
    /// before.
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
        let velocity = self.kinematics.to_world(&state.velocity);
        self.tensors.update(constants, &self.kinematics);
        let robot = mass_matrix(skeleton, constants, &self.kinematics, &self.tensors, &mut self.mass);
        self.center = center(&robot);

        let mut force = bias::<T, L, J, W>(skeleton, constants, &self.kinematics, &self.tensors, &velocity);
        force.negate(!T::Mask::none());
        self.actuation = actuation(skeleton, constants, &position.joints, &velocity.limbs, ctrl);
        for limb in 0..L {
            for joint in 0..J {
                force.limbs[limb][joint] += self.actuation.force[limb][joint];
            }
        }
        if skeleton.damps_root {
            for i in 0..6 {
                force.root[i] = constants.root_damping.neg_mul_add(velocity.root[i], force.root[i]);
            }
        }
        let height = position.root[2] - T::splat(skeleton.floor);
        self.contacts.update(skeleton, constants, &self.kinematics, height, &velocity);
        self.limits.update(skeleton, constants, &position.joints, &velocity.limbs);
        if skeleton.has_dry_friction {
            self.dry_friction.update(skeleton, constants, &velocity.limbs);
        }
        let mut problem = Problem {
            mass: &self.mass,
            force: &force,
            kinematics: &self.kinematics,
            contacts: &mut self.contacts,
            limits: &mut self.limits,
            dry_friction: &mut self.dry_friction,
            hessian: &mut self.work,
            scale: constants.solver_scale,
        };
        self.acceleration = if skeleton.has_cones {
            let guess = self.kinematics.to_world(&state.warm_start);
            T::run(
                #[inline(always)]
                || problem.solve_from(&guess, skeleton.cone == Cone::Elliptic),
            )
        } else {
            problem.solve()
        };
    }

    /// The acceleration as qacc has it: angular entries along the root's axes.
    #[inline(always)]
    pub fn qacc(&self) -> Coords<T, L, J> {
        self.to_root(&self.acceleration)
    }

    /// Acceleration, as qacc, of a step that treats a part of the forces implicitly in velocity, with the
    /// drag of the root's coordinates and of the joints: (M + h·drag)⁻¹ M a = a − (M + h·drag)⁻¹ h·drag a
    /// (documentation: Computation, "Numerical integration").
    #[inline(always)]
    pub fn implicit_qacc(&mut self, root: T, drag: &[[T; J]; L], timestep: T) -> Coords<T, L, J> {
        // The mass matrix is not needed any more.
        let mut change = Coords::zero();
        for i in 0..6 {
            let implicit = timestep * root;
            self.mass.root[i][i] += implicit;
            change.root[i] = implicit * self.acceleration.root[i];
        }
        for limb in 0..L {
            for joint in 0..J {
                let implicit = timestep * drag[limb][joint];
                self.mass.limbs[limb][joint][joint] += implicit;
                change.limbs[limb][joint] = implicit * self.acceleration.limbs[limb][joint];
            }
        }
        self.mass.solve(&mut change);
        let mut acceleration = self.acceleration;
        acceleration.subtract(&change);
        self.to_root(&acceleration)
    }

    #[inline(always)]
    fn to_root(&self, coords: &Coords<T, L, J>) -> Coords<T, L, J> {
        coords.with_angular(unrotate(&self.kinematics.root, coords.angular()))
    }
}
