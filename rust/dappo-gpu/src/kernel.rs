//! The kernels of the physics: all substeps of all worlds in one launch.

use cubecl::prelude::*;
use dappo_lanes::model::Integrator;

use crate::coords::Coords;
use crate::dynamics::{Shown, forward};
use crate::integrate::State;
use crate::shape::Shape;
use crate::state::Place;

/// Advances every world by a number of substeps with the same controls.
///
/// # Shapes
/// - `numbers`: `[models, row]`; `models`: `[worlds]`; `ctrl`: `[worlds, lanes · joints]`
/// - `state`: `[worlds, state]`; `readings`: `[worlds, readings]`
#[cube(launch_unchecked)]
pub fn advance<F: Float>(
    numbers: &[F],
    models: &[u32],
    ctrl: &[F],
    state: &mut [F],
    readings: &mut [F],
    worlds: usize,
    substeps: u32,
    #[comptime] shape: Shape,
) {
    // Threads beyond the last world compute it once more, so that all stay together.
    let counts = ABSOLUTE_POS < worlds * comptime!(shape.lanes);
    let world = min(ABSOLUTE_POS / comptime!(shape.lanes), worlds - 1);
    let place = Place::new(models, world, counts, shape);
    let mut own = State::<F>::read(&*state, place, shape);
    let control = control::<F>(ctrl, place, shape);
    if comptime!(matches!(shape.integrator, Integrator::Rk4 { .. })) {
        own.runge_kutta(numbers, place, &control, readings, substeps, shape);
    } else {
        own.euler(numbers, place, &control, readings, substeps, shape);
    }
    if counts {
        own.write(state, place, shape);
    }
}

/// Computes the accelerations and forces in the present states of the worlds with a 1 in `chosen`: accelerations, touch
/// sensors, and with `forces` all that a step shows.
///
/// # Shapes
/// - `chosen`: `[worlds]`; the others as in [`advance`]
#[cube(launch_unchecked)]
pub fn evaluate<F: Float>(
    numbers: &[F],
    models: &[u32],
    chosen: &[u32],
    ctrl: &[F],
    state: &mut [F],
    readings: &mut [F],
    worlds: usize,
    #[comptime] forces: bool,
    #[comptime] shape: Shape,
) {
    let world = min(ABSOLUTE_POS / comptime!(shape.lanes), worlds - 1);
    let counts = ABSOLUTE_POS < worlds * comptime!(shape.lanes) && chosen[world] == 1u32;
    // All threads of a subgroup take part, or none does.
    if plane_any(counts) {
        let place = Place::new(models, world, counts, shape);
        let mut own = State::<F>::read(&*state, place, shape);
        let control = control::<F>(ctrl, place, shape);
        let mut unused = Coords::<F>::room(shape);
        forward::<F>(
            numbers,
            place,
            &own.position,
            &own.velocity,
            &control,
            Shown { touch: true, forces: comptime!(forces).runtime() },
            readings,
            &mut own.acceleration,
            &mut unused,
            shape,
        );
        if counts {
            let row = world * comptime!(shape.state()) + comptime!(shape.guess());
            own.acceleration.write(state, row, place.lane, shape);
        }
    }
}

/// The controls of the joints of a limb.
#[cube]
fn control<F: Float>(ctrl: &[F], place: Place, #[comptime] shape: Shape) -> Array<F> {
    let first = place.world * comptime!(shape.dofs()) + place.lane * comptime!(shape.joints);
    let mut control = Array::<F>::new(comptime!(shape.joints));
    #[unroll]
    for k in 0..comptime!(shape.joints) {
        control[k] = ctrl[first + k];
    }
    control
}

/// Copies rows into a table: what is random about some worlds.
///
/// # Shapes
/// - `rows`: `[n, length]`; `places`: `[n]`, rows of the table; `table`: `[models, length]`
#[cube(launch_unchecked)]
pub fn copy_rows<F: Float>(rows: &[F], places: &[u32], table: &mut [F], count: usize, length: usize) {
    if ABSOLUTE_POS < count * length {
        let place = places[ABSOLUTE_POS / length] as usize;
        table[place * length + ABSOLUTE_POS % length] = rows[ABSOLUTE_POS];
    }
}

/// Exchanges indices of threads as the kernels exchange numbers.
///
/// # Shapes
/// - `out`: `[bits, threads]`
#[cube(launch_unchecked)]
pub fn exchange(out: &mut [u32], threads: usize, #[comptime] bits: u32) {
    #[unroll]
    for bit in 0..bits {
        let partner = plane_shuffle_xor(ABSOLUTE_POS as u32, comptime!(1u32 << bit));
        if ABSOLUTE_POS < threads {
            out[comptime!(bit as usize) * threads + ABSOLUTE_POS] = partner;
        }
    }
}
