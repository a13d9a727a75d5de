//! The kernel: whole env steps of all worlds in one launch.

use cubecl::prelude::*;
use dappo_lanes::model::Integrator;

use crate::constants::root;
use crate::coords::Coords;
use crate::integrate::State;
use crate::shape::Shape;
use crate::state::{Place, Position};

/// Advances every world by a number of substeps with the same controls.
///
/// With one substep of one stage the readings and the accelerations are those of the given state, which the new
/// positions and velocities do not matter for.
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
    stages: u32,
    #[comptime] shape: Shape,
) {
    let lanes = comptime!(shape.lanes);
    let counts = ABSOLUTE_POS < worlds * lanes;
    // Threads beyond the last world compute it once more, so that all stay together.
    let world = min(ABSOLUTE_POS / lanes, worlds - 1);
    let lane = ABSOLUTE_POS % lanes;
    let model = models[world] as usize * comptime!(shape.row());
    let place = Place {
        lane,
        world,
        counts,
        model,
        limb: model + comptime!(root::LEN) + lane * comptime!(shape.limb_len()),
    };
    let row = world * comptime!(shape.state());
    let mut own = State::<F> {
        position: Position::<F>::room(shape),
        velocity: Coords::<F>::room(shape),
        acceleration: Coords::<F>::room(shape),
    };
    own.position.read(&*state, row, lane, shape);
    own.velocity.read(&*state, row + comptime!(shape.velocity()), lane, shape);
    own.acceleration.read(&*state, row + comptime!(shape.guess()), lane, shape);
    let mut control = Array::<F>::new(comptime!(shape.joints));
    #[unroll]
    for k in 0..comptime!(shape.joints) {
        control[k] = ctrl[world * comptime!(shape.dofs()) + lane * comptime!(shape.joints) + k];
    }
    if comptime!(matches!(shape.integrator, Integrator::Rk4 { .. })) {
        own.runge_kutta(numbers, place, &control, readings, substeps, stages, shape);
    } else {
        own.euler(numbers, place, &control, readings, substeps, shape);
    }
    if counts {
        own.position.write(state, row, lane, shape);
        own.velocity.write(state, row + comptime!(shape.velocity()), lane, shape);
        own.acceleration.write(state, row + comptime!(shape.guess()), lane, shape);
    }
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
