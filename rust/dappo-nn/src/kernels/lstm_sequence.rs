//! All hidden states of an LSTM over sequences that may begin anew at any step, and the gradients of its parameters.
//!
//! Parameters lie in one array: input weight `[I, 4 H]`, bias `[4 H]`, recurrent weight `[H, 4 H]`. The gates lie side by
//! side in the order input, forget, cell, output, which is PyTorch's.

use rayon::prelude::*;

use super::Level;
use super::lstm_block::{BLOCK, BlockActivations, GradientSums, PARTITIONS, Recurrence, Windows};
use super::matmul::Matrix;
use super::reduce::sum_in_order;

/// Sequences of T steps.
#[derive(Debug, Clone, Copy)]
pub struct Sequences<'a> {
    /// T.
    pub steps: usize,
    /// Inputs `[B, T, I]`.
    pub x: &'a [f32],
    /// Hidden and cell states before the first step, `[B, 2, H]`.
    pub state: &'a [f32],
    /// 1 where a sequence begins anew, with zeros in the place of the states before, or else 0, `[B, T]`.
    pub begins: &'a [f32],
}

/// What [`forward`] keeps for [`backward`].
#[derive(Debug, Clone, Default)]
pub struct Activations {
    /// Of every block of sequences, in order.
    blocks: Vec<BlockActivations>,
}

/// Number of weights and biases of an LSTM; `None` if they cannot be counted.
#[must_use]
pub fn parameter_count(inputs: usize, width: usize) -> Option<usize> {
    inputs.checked_add(width)?.checked_add(1)?.checked_mul(width.checked_mul(4)?)
}

fn recurrence(level: Level, parameters: &[f32], width: usize) -> Recurrence<'_> {
    let gates = 4 * width;
    let inputs = parameters.len() / gates - width - 1;
    assert_eq!(Some(parameters.len()), parameter_count(inputs, width), "parameters of an LSTM of {width}");
    let (input, rest) = parameters.split_at(inputs * gates);
    let (bias, recurrent) = rest.split_at(gates);
    Recurrence {
        level,
        input: Matrix::new(input, inputs, gates),
        bias,
        recurrent: Matrix::new(recurrent, width, gates),
    }
}

/// The blocks of sequences.
fn blocks(sequences: Sequences<'_>, inputs: usize, width: usize) -> Vec<Windows<'_>> {
    let Sequences { steps, x, state, begins } = sequences;
    let of_block = |((x, state), begins)| Windows { steps, x, state, begins };
    let x = x.chunks(BLOCK * steps * inputs);
    x.zip(state.chunks(BLOCK * 2 * width)).zip(begins.chunks(BLOCK * steps)).map(of_block).collect()
}

/// The hidden states after every step, and what [`backward`] needs.
///
/// # Shapes
/// parameters `[parameter_count(I, H)]`, out `[B, T, H]`
///
/// # Panics
/// If a slice has another length.
pub fn forward(
    level: Level,
    width: usize,
    parameters: &[f32],
    sequences: Sequences<'_>,
    out: &mut [f32],
) -> Activations {
    let recurrence = recurrence(level, parameters, width);
    let (steps, inputs) = (sequences.steps, recurrence.input.rows());
    let rows = out.len() / (steps * width);
    assert_eq!(sequences.x.len(), rows * steps * inputs, "sequences [B, T, I] of an LSTM");
    assert_eq!(sequences.state.len(), rows * 2 * width, "states [B, 2, H] of an LSTM");
    assert_eq!(sequences.begins.len(), rows * steps, "beginnings [B, T] of sequences");
    let blocks = blocks(sequences, inputs, width).into_par_iter();
    let run = |(windows, out): (Windows<'_>, &mut [f32])| {
        recurrence.forward(windows, |row, step, hidden| {
            out[(row * steps + step) * width..][..width].copy_from_slice(hidden);
        })
    };
    Activations { blocks: blocks.zip(out.par_chunks_mut(BLOCK * steps * width)).map(run).collect() }
}

/// The gradient of the parameters, laid out as they are, given that of all hidden states.
///
/// # Shapes
/// parameters `[parameter_count(I, H)]`, `out_gradient` `[B, T, H]`
///
/// # Panics
/// If a slice has another length, or the activations are not those of [`forward`] on the same sequences.
#[must_use]
pub fn backward(
    level: Level,
    width: usize,
    parameters: &[f32],
    sequences: Sequences<'_>,
    kept: &Activations,
    out_gradient: &[f32],
) -> Vec<f32> {
    let recurrence = recurrence(level, parameters, width);
    let (steps, inputs) = (sequences.steps, recurrence.input.rows());
    let back = recurrence.recurrent.to_transposed();
    let back = Matrix::new(&back, 4 * width, width);
    let blocks = blocks(sequences, inputs, width);
    assert_eq!(kept.blocks.len(), blocks.len(), "kept blocks of an LSTM");
    let blocks: Vec<_> =
        blocks.into_iter().zip(&kept.blocks).zip(out_gradient.chunks(BLOCK * steps * width)).collect();
    let partition = blocks.len().div_ceil(PARTITIONS).max(1);
    let partial: Vec<Vec<f32>> = blocks
        .par_chunks(partition)
        .map(|blocks| {
            let mut sums = GradientSums::new(inputs, width, steps);
            for &((windows, kept), out_gradient) in blocks {
                sums.add(level, windows, kept, back, |step, hidden| {
                    for (row, hidden) in hidden.chunks_exact_mut(width).enumerate() {
                        let gradient = &out_gradient[(row * steps + step) * width..][..width];
                        hidden.iter_mut().zip(gradient).for_each(|(sum, x)| *sum += x);
                    }
                });
            }
            sums.sums
        })
        .collect();
    sum_in_order(partial, parameters.len())
}

/// One step of N robots, whose states become those after it.
///
/// # Shapes
/// parameters `[parameter_count(I, H)]`, x `[N, I]`, state `[N, 2, H]`
///
/// # Panics
/// If a slice has another length.
pub fn step(level: Level, width: usize, parameters: &[f32], x: &[f32], state: &mut [f32]) {
    /// Robots that a thread takes at a time.
    const ROWS: usize = 64;
    let recurrence = recurrence(level, parameters, width);
    let inputs = recurrence.input.rows();
    assert_eq!(x.len() / inputs, state.len() / (2 * width), "rows of an LSTM and its states");
    x.par_chunks(ROWS * inputs).zip(state.par_chunks_mut(ROWS * 2 * width)).for_each(|(x, state)| {
        recurrence.step(x, state);
    });
}
