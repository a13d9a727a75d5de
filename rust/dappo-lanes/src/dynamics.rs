//! Forward dynamics: from positions, velocities and controls to accelerations and contact forces.
//! (Documentation: Computation, "Forward dynamics"; `mj_forward`.)

use crate::actuation::actuation;
use crate::arrow::Arrow;
use crate::bias::bias;
use crate::constants::{Constants, Skeleton};
use crate::contact::{Contact, contacts};
use crate::coords::Coords;
use crate::inertia::{center, mass_matrix, tensors};
use crate::kinematics::kinematics;
use crate::lane::{Lane, Mask};
use crate::limit::limits;
use crate::math::{Axes, Vec3, quat_axes, quat_normalize, rotate, unrotate};
use crate::solver::Problem;
use crate::state::State;

/// What an evaluation leaves besides the contacts.
pub struct Dynamics<T, const L: usize, const J: usize> {
    /// Axes of the root.
    pub root: Axes<T>,
    /// Mass matrix; angular entries along the world's axes.
    pub mass: Arrow<T, L, J>,
    /// Centre of mass of the robot, from the root's origin.
    pub center: Vec3<T>,
    /// Acceleration; angular entries along the world's axes.
    pub acceleration: Coords<T, L, J>,
    /// −∂force/∂velocity of each joint, through damping alone and with actuators.
    pub damping: [[T; J]; L],
    /// See `damping`.
    pub drag: [[T; J]; L],
}

impl<T: Lane, const L: usize, const J: usize> Dynamics<T, L, J> {
    /// The acceleration as qacc has it: angular entries along the root's axes.
    #[inline(always)]
    pub fn qacc(&self) -> Coords<T, L, J> {
        self.acceleration.with_angular(unrotate(&self.root, self.acceleration.angular()))
    }

    /// Acceleration, as qacc, of a step that treats a part of the forces implicitly in velocity:
    /// (M + h·drag)⁻¹ M a (documentation: Computation, "Numerical integration").
    #[inline(always)]
    pub fn implicit_qacc(&self, drag: &[[T; J]; L], timestep: T) -> Coords<T, L, J> {
        let mut matrix = self.mass;
        for limb in 0..L {
            for joint in 0..J {
                let entry = &mut matrix.limbs[limb][joint][joint];
                *entry = timestep.mul_add(drag[limb][joint], *entry);
            }
        }
        let acceleration = matrix.solve(&self.mass.mul(&self.acceleration));
        acceleration.with_angular(unrotate(&self.root, acceleration.angular()))
    }
}

/// Evaluates the dynamics of a state; `found` receives the contacts with their forces.
#[inline(always)]
pub fn forward<T: Lane, const L: usize, const J: usize>(
    skeleton: &Skeleton<T, L, J>,
    constants: &Constants<T, L, J>,
    state: &State<T, L, J>,
    ctrl: &[[T; J]; L],
    found: &mut Vec<Contact<T, J>>,
) -> Dynamics<T, L, J> {
    let position = &state.position;
    let root = quat_axes(quat_normalize(position.rotation));
    let velocity = state.velocity.with_angular(rotate(&root, state.velocity.angular()));

    let kinematics = kinematics(skeleton, constants, root, position);
    let tensors = tensors(constants, &kinematics);
    let (mass, robot) = mass_matrix(constants, &kinematics, &tensors);
    let bias = bias(skeleton, constants, &kinematics, &tensors, &velocity);
    let actuation = actuation(skeleton, constants, &position.joints, &velocity.limbs, ctrl);
    let mut force = bias.map(|entry| -entry);
    for (entry, &push) in force.limbs.as_flattened_mut().iter_mut().zip(actuation.force.as_flattened()) {
        *entry += push;
    }
    let smooth = mass.solve(&force);

    let touching = contacts(skeleton, constants, &kinematics, position.root[2], &velocity, found);
    let mut limits = limits(skeleton, constants, &position.joints, &velocity.limbs);
    let present = touching | limits.present;
    let acceleration = if present.any() {
        let guess = state.warm_start.with_angular(rotate(&root, state.warm_start.angular()));
        let mut problem = Problem { mass: &mass, contacts: found, limits: &mut limits, present };
        problem.solve(&smooth, &guess, constants.solver_scale)
    } else {
        smooth
    };
    Dynamics {
        root,
        mass,
        center: center(&robot),
        acceleration,
        damping: actuation.damping,
        drag: actuation.drag,
    }
}
