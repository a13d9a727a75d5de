//! Forward dynamics: from positions, velocities and controls to accelerations and contact forces.
//! (Documentation: Computation, "Forward dynamics"; `mj_forward`.)

use cubecl::prelude::*;
use dappo_lanes::model::Integrator;

use crate::actuation::actuation;
use crate::arrow::Arrow;
use crate::bias::bias;
use crate::constants::root;
use crate::contact::contacts;
use crate::coords::Coords;
use crate::dry_friction::dry_friction;
use crate::forces::{write_bodies, write_motors, write_touch};
use crate::inertia::mass_matrix;
use crate::kinematics::kinematics;
use crate::limit::limits;
use crate::math::{copied_in_kernels, lit};
use crate::shape::{Shape, lower};
use crate::solver::{Constraints, Rows, solve};
use crate::state::{Place, Position};

/// What an evaluation writes to the readings.
#[derive(CubeType, Clone, Copy)]
pub struct Shown {
    /// The touch sensors.
    pub touch: bool,
    /// Forces on bodies, forces of motors and x of the root.
    pub forces: bool,
}
copied_in_kernels!(plain: ShownExpand);

/// Evaluates the dynamics of a state.
///
/// `acceleration` comes as the solver's guess and leaves as qacc. `implicit` becomes that of a step of the integrator,
/// where this differs from qacc: one which treats a part of the forces implicitly in velocity.
#[cube]
pub fn forward<F: Float>(
    numbers: &[F],
    place: Place,
    position: &Position<F>,
    velocity: &Coords<F>,
    ctrl: &Array<F>,
    shown: Shown,
    readings: &mut [F],
    acceleration: &mut Coords<F>,
    implicit: &mut Coords<F>,
    #[comptime] shape: Shape,
) {
    let axes = position.rotation().normalized().axes();
    // Inside the dynamics angular entries are along the world's axes.
    let mut v = Coords::<F>::room(shape);
    v.copy_from(velocity, shape);
    v.set_angular(axes.rotate(velocity.angular()));
    let mut a = Coords::<F>::room(shape);
    a.copy_from(&*acceleration, shape);
    a.set_angular(axes.rotate(acceleration.angular()));

    let links = kinematics::<F>(numbers, place.limb, axes, &position.limb, shape);
    let mut mass = Arrow::<F>::room(shape);
    let center = mass_matrix::<F>(numbers, place.model, place.limb, axes, &links, &mut mass, shape);
    let mut force = Coords::<F>::room(shape);
    bias::<F>(numbers, place.model, place.limb, axes, &links, &v, &mut force, shape);
    force.scale(lit::<F>(-1.0), shape);
    let actuation = actuation::<F>(numbers, place.limb, &position.limb, &v, ctrl, shape);
    #[unroll]
    for joint in 0..comptime!(shape.joints) {
        force.limb[joint] += actuation.force[joint];
    }
    if comptime!(shape.damps_root) {
        let damping = numbers[place.model + root::DAMPING];
        #[unroll]
        for i in 0..6usize {
            force.root[i] = fma(-damping, v.root[i], force.root[i]);
        }
    }
    let height = position.root[2] - numbers[place.model + root::FLOOR];
    let constraints = Constraints::<F> {
        contacts: contacts::<F>(numbers, place.limb, height, axes, &links, &v, shape),
        limits: limits::<F>(numbers, place.limb, &position.limb, &v, shape),
        friction: dry_friction::<F>(numbers, place.limb, &v, shape),
    };
    let mut residuals = Rows::<F>::room(shape);
    let scale = numbers[place.model + root::SOLVER_SCALE];
    solve::<F>(&mass, &force, &constraints, scale, &mut a, &mut residuals, shape);

    if shown.touch && place.counts {
        write_touch::<F>(readings, place, &constraints, &residuals, shape);
    }
    if shown.forces && place.counts {
        write_bodies::<F>(readings, place, &constraints, &residuals, center, shape);
        write_motors::<F>(readings, place, position.root[0], &actuation.motor, shape);
    }
    acceleration.copy_from(&a, shape);
    acceleration.set_angular(axes.unrotate(a.angular()));
    if comptime!(is_implicit(shape.integrator)) {
        let timestep = numbers[place.model + root::TIMESTEP];
        implicit_change::<F>(numbers, place, timestep, &actuation.drag, &a, &mut mass, implicit, shape);
        implicit.scale(lit::<F>(-1.0), shape);
        implicit.add_scaled(lit::<F>(1.0), &a, shape);
        let angular = axes.unrotate(implicit.angular());
        implicit.set_angular(angular);
    }
}

/// Whether a step has other accelerations than qacc.
pub fn is_implicit(integrator: Integrator) -> bool {
    matches!(integrator, Integrator::ImplicitFast { .. } | Integrator::Euler { implicit_damping: true })
}

/// out ← (M + h·drag)⁻¹ h·drag a, which implicit integration subtracts from a:
/// (M + h·drag)⁻¹ M a = a − (M + h·drag)⁻¹ h·drag a (documentation: Computation, "Numerical integration").
#[cube]
fn implicit_change<F: Float>(
    numbers: &[F],
    place: Place,
    timestep: F,
    drag: &Array<F>,
    a: &Coords<F>,
    mass: &mut Arrow<F>,
    out: &mut Coords<F>,
    #[comptime] shape: Shape,
) {
    out.clear(shape);
    if comptime!(shape.damps_root) {
        let part = timestep * numbers[place.model + root::DAMPING];
        #[unroll]
        for i in 0..6usize {
            mass.root[comptime!(lower(i, i))] += part;
            out.root[i] = part * a.root[i];
        }
    }
    let mut work = Arrow::<F>::room(shape);
    work.set_limb(&*mass, shape);
    #[unroll]
    for joint in 0..comptime!(shape.joints) {
        let part = timestep * drag[joint];
        work.block[comptime!(lower(joint, joint))] += part;
        out.limb[joint] = part * a.limb[joint];
    }
    work.solve(&mass.root, out, shape);
}
