//! The policy and the value net of a rollout.
//!
//! Parameters lie in one array a net, layer by layer: the weight, row-major `[inputs, outputs]`, then the bias.

use cubecl::prelude::*;

use crate::math::{exponential, lit};
use crate::task::random::{Stream, purpose};

/// Rows that a thread takes through a layer at once, so that each weight is read once for all of them.
pub const TILE: usize = 4;

/// The inputs of a net from rows of observations: the first `seen` entries standardised and clipped, and the damage code
/// scaled.
///
/// # Shapes
/// - `obs`: `[…, rows, width]`, from `first` on; `statistics`: `[2, observed]`, means and scales
/// - `out`: `[rows, seen + code]`
#[cube(launch_unchecked)]
pub fn prepare(
    obs: &[f32],
    statistics: &[f32],
    out: &mut [f32],
    first: usize,
    rows: usize,
    clip: f32,
    code_scale: f32,
    #[comptime] observed: usize,
    #[comptime] seen: usize,
    #[comptime] code: usize,
) {
    let inputs = comptime!(seen + code);
    if ABSOLUTE_POS < rows * inputs {
        let (row, entry) = (ABSOLUTE_POS / inputs, ABSOLUTE_POS % inputs);
        let from = first + row * comptime!(observed + code);
        if entry < seen {
            let centred = (obs[from + entry] - statistics[entry]) * statistics[observed + entry];
            out[ABSOLUTE_POS] = min(max(centred, -clip), clip);
        } else {
            out[ABSOLUTE_POS] = obs[from + observed + entry - seen] * code_scale;
        }
    }
}

/// One layer of a net for all rows; hidden layers end in tanh.
///
/// # Shapes
/// - `input`: `[rows, inputs]`; `parameters`: those of the layer from `first` on; `out`: `[…, rows, outputs]`, from
///   `at` on
#[cube(launch_unchecked)]
pub fn layer(
    input: &[f32],
    parameters: &[f32],
    out: &mut [f32],
    first: usize,
    at: usize,
    rows: usize,
    #[comptime] inputs: usize,
    #[comptime] outputs: usize,
    #[comptime] is_hidden: bool,
) {
    let unit = ABSOLUTE_POS % outputs;
    let row = ABSOLUTE_POS / outputs * comptime!(TILE);
    if row < rows {
        let mut sums = Array::<f32>::new(comptime!(TILE));
        let mut starts = Array::<usize>::new(comptime!(TILE));
        let bias = parameters[first + comptime!(inputs * outputs) + unit];
        #[unroll]
        for i in 0..comptime!(TILE) {
            sums[i] = bias;
            // Rows beyond the last one are computed from it, and not kept.
            starts[i] = min(row + i, rows - 1) * inputs;
        }
        for k in 0..inputs {
            let weight = parameters[first + k * outputs + unit];
            #[unroll]
            for i in 0..comptime!(TILE) {
                sums[i] = fma(input[starts[i] + k], weight, sums[i]);
            }
        }
        #[unroll]
        for i in 0..comptime!(TILE) {
            if row + i < rows {
                let sum = sums[i];
                out[at + (row + i) * outputs + unit] = if comptime!(is_hidden) { tanh(sum) } else { sum };
            }
        }
    }
}

/// Hyperbolic tangent: a GPU's own may be good to a few digits only.
#[cube]
fn tanh(x: f32) -> f32 {
    let part = exponential::<f32>(lit::<f32>(-2.0) * x.abs());
    let size = (lit::<f32>(1.0) - part) / (lit::<f32>(1.0) + part);
    select(x < lit::<f32>(0.0), -size, size)
}

/// Samples actions: mean + std · noise. `F` is the precision in which noise is drawn.
///
/// # Shapes
/// - `keys`: `[rows, 2]`, halves of the keys of the noise; `std`: `[actions]`
/// - `means`, `actions`: `[…, rows, actions]`, from `first` on; `log_probs`: `[…, rows]`, from `at` on
#[cube(launch_unchecked)]
pub fn sample<F: Float>(
    keys: &[u32],
    std: &[f32],
    means: &[f32],
    actions: &mut [f32],
    log_probs: &mut [f32],
    first: usize,
    at: usize,
    rows: usize,
    step_low: u32,
    step_high: u32,
    constant: f32,
    #[comptime] count: usize,
) {
    if ABSOLUTE_POS < rows {
        let stream = Stream {
            key_low: keys[2 * ABSOLUTE_POS],
            key_high: keys[2 * ABSOLUTE_POS + 1],
            episode_low: step_low,
            episode_high: step_high,
        };
        let mut squares = lit::<f32>(0.0);
        #[unroll]
        for k in 0..comptime!(count) {
            let index = comptime!(k as u32).runtime();
            let z = f32::cast_from(stream.normal::<F>(comptime!(purpose::ACTION_NOISE), 0u32, index));
            let place = first + ABSOLUTE_POS * count + k;
            actions[place] = fma(std[k], z, means[place]);
            squares = fma(z, z, squares);
        }
        log_probs[at + ABSOLUTE_POS] = lit::<f32>(-0.5) * squares - constant;
    }
}

/// Copies rows into an array of their own.
///
/// # Shapes
/// - `from`: `[…, width]`; `rows`: `[count]`, which of them; `to`: `[count, width]`
#[cube(launch_unchecked)]
pub fn gather(from: &[f32], rows: &[u32], to: &mut [f32], count: usize, width: usize) {
    if ABSOLUTE_POS < count * width {
        let row = rows[ABSOLUTE_POS / width] as usize;
        to[ABSOLUTE_POS] = from[row * width + ABSOLUTE_POS % width];
    }
}
