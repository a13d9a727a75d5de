//! The last hidden state of an LSTM behind a linear embedding, and its gradients.
//!
//! Without an activation in between, embedding and input gates are one linear map: their product, formed
//! once a batch, takes F inputs to 4 H gates without the far wider embedding ever being computed for a time
//! step. The backward pass first finds the gradient of the product and then those of its factors.
//!
//! Parameters lie in one array: embedding weight `[F, E]` and bias `[E]`, input weight `[E, 4 H]`, bias
//! `[4 H]`, recurrent weight `[H, 4 H]`. The gates lie side by side in the order input, forget, cell, output,
//! which is PyTorch's.
//!
//! Windows are independent of each other, so a block of them goes through all time steps on one thread.

use rayon::prelude::*;

use super::Level;
use super::elementwise::column_sums;
use super::lstm_cell::{Block, Gradients, Saved, step_backward, step_forward};
use super::matmul::Destination::{Accumulate, Overwrite};
use super::matmul::{Matrix, matmul, matmul_strided};
use super::reduce::sum_in_order;

/// The backward pass sums gradients in this many partitions and then adds those in order. The number is
/// fixed, so that the result does not depend on the number of threads.
const PARTITIONS: usize = 8;
/// Windows of a block: what a block of this size computes on its way fits into a core's cache.
const BLOCK: usize = 8;
/// Products of parameters are cut into this many pieces.
const PIECES: usize = 4;

/// Widths of an LSTM behind a linear embedding.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LstmSizes {
    /// Numbers of one time step, F.
    pub inputs: usize,
    /// Width of the embedding, E.
    pub embedding: usize,
    /// Width of the hidden state, H.
    pub hidden: usize,
}

/// What [`forward`] keeps for [`backward`].
#[derive(Debug, Clone, Default)]
pub struct Activations {
    /// Of every block of windows, in order.
    blocks: Vec<BlockActivations>,
}

/// The stored results of a block of M windows of T steps.
#[derive(Debug, Clone)]
struct BlockActivations {
    /// `[M, T, 4 H]`
    gates: Vec<f32>,
    /// `[M, T + 1, H]`
    cells: Vec<f32>,
    /// `[M, T, H]`, before every step.
    hidden: Vec<f32>,
}

/// Views of the parts of an array of parameters.
struct Parameters<'a> {
    /// Embedding weight and below it the bias, `[F + 1, E]`.
    embedding: Matrix<'a>,
    /// `[E, 4 H]`
    input: Matrix<'a>,
    bias: &'a [f32],
    /// `[H, 4 H]`
    recurrent: Matrix<'a>,
}

impl LstmSizes {
    /// Width of the four gates.
    fn gates(self) -> usize {
        4 * self.hidden
    }

    /// Number of weights and biases; `None` if they cannot be counted.
    #[must_use]
    pub fn parameter_count(self) -> Option<usize> {
        let Self { inputs, embedding, hidden } = self;
        let gates = hidden.checked_mul(4)?;
        super::parameter_count(&[inputs, embedding, gates])?.checked_add(hidden.checked_mul(gates)?)
    }

    fn split(self, parameters: &[f32]) -> Parameters<'_> {
        assert_eq!(Some(parameters.len()), self.parameter_count(), "parameters of an LSTM of sizes {self:?}");
        let Self { inputs, embedding, hidden } = self;
        let (embedding_part, rest) = parameters.split_at((inputs + 1) * embedding);
        let (input, rest) = rest.split_at(embedding * self.gates());
        let (bias, recurrent) = rest.split_at(self.gates());
        Parameters {
            embedding: Matrix::new(embedding_part, inputs + 1, embedding),
            input: Matrix::new(input, embedding, self.gates()),
            bias,
            recurrent: Matrix::new(recurrent, hidden, self.gates()),
        }
    }
}

/// `a · b`, its rows cut into a fixed number of pieces that are computed in parallel.
fn parallel_product(level: Level, a: Matrix<'_>, b: Matrix<'_>) -> Vec<f32> {
    let (rows, columns) = (a.rows(), b.columns());
    let piece = rows.div_ceil(PIECES).max(1);
    let mut out = vec![0.0; rows * columns];
    out.par_chunks_mut(piece * columns).enumerate().for_each(|(index, out)| {
        matmul(level, out, Overwrite, a.rows_from(index * piece, out.len() / columns), b);
    });
    out
}

/// The last hidden state of every window of `x`, and what [`backward`] needs if `keep` is set.
///
/// # Shapes
/// parameters `[sizes.parameter_count()]`, x `[B, T, F]`, out `[B, H]`
///
/// # Panics
/// If a slice has another length.
pub fn forward(
    level: Level,
    sizes: LstmSizes,
    steps: usize,
    parameters: &[f32],
    x: &[f32],
    out: &mut [f32],
    keep: bool,
) -> Option<Activations> {
    let windows = out.len() / sizes.hidden;
    assert_eq!(x.len(), windows * steps * sizes.inputs, "windows [B, T, F] of an LSTM");
    assert_eq!(out.len(), windows * sizes.hidden, "hidden states [B, H] of an LSTM");
    let Parameters { embedding, input, bias, recurrent } = sizes.split(parameters);
    let mut folded = parallel_product(level, embedding, input);
    let (weight, folded_bias) = folded.split_at_mut(sizes.inputs * sizes.gates());
    folded_bias.iter_mut().zip(bias).for_each(|(sum, b)| *sum += b);
    let weight = Matrix::new(weight, sizes.inputs, sizes.gates());

    let run = |(x, last): (&[f32], &mut [f32])| {
        let windows = last.len() / sizes.hidden;
        let mut kept = BlockActivations {
            gates: vec![0.0; windows * steps * sizes.gates()],
            cells: vec![0.0; windows * (steps + 1) * sizes.hidden],
            hidden: vec![0.0; windows * steps * sizes.hidden],
        };
        let BlockActivations { gates, cells, hidden } = &mut kept;
        let mut block = Block { gates, cells, hidden, last };
        matmul(level, block.gates, Overwrite, Matrix::new(x, windows * steps, sizes.inputs), weight);
        for step in 0..steps {
            if step > 0 {
                add_recurrent(level, &mut block, recurrent, step);
            }
            step_forward(level, &mut block, folded_bias, step);
        }
        kept
    };
    let inputs = x.par_chunks(BLOCK * steps * sizes.inputs);
    let blocks = inputs.zip(out.par_chunks_mut(BLOCK * sizes.hidden));
    if keep {
        return Some(Activations { blocks: blocks.map(run).collect() });
    }
    blocks.for_each(|block| drop(run(block)));
    None
}

/// Adds what the hidden states before a step contribute to its gates.
fn add_recurrent(level: Level, block: &mut Block<'_>, recurrent: Matrix<'_>, step: usize) {
    let (width, gates) = (recurrent.rows(), recurrent.columns());
    let rows = block.last.len() / width;
    let steps = block.hidden.len() / block.last.len();
    let used = |columns| (rows - 1) * steps * columns + columns;
    let before = &block.hidden[step * width..][..used(width)];
    let before = Matrix::strided(before, rows, width, steps * width);
    let out = &mut block.gates[step * gates..][..used(gates)];
    matmul_strided(level, out, steps * gates, Accumulate, before, recurrent);
}

/// The gradient of the parameters, laid out as they are, given that of the last hidden states.
///
/// # Shapes
/// parameters `[sizes.parameter_count()]`, x `[B, T, F]`, `out_gradient` `[B, H]`
///
/// # Panics
/// If a slice has another length, or the activations are not those of [`forward`] on the same windows.
#[must_use]
pub fn backward(
    level: Level,
    sizes: LstmSizes,
    steps: usize,
    parameters: &[f32],
    x: &[f32],
    kept: &Activations,
    out_gradient: &[f32],
) -> Vec<f32> {
    let windows = out_gradient.len() / sizes.hidden;
    assert_eq!(x.len(), windows * steps * sizes.inputs, "windows [B, T, F] of an LSTM");
    assert_eq!(kept.blocks.len(), windows.div_ceil(BLOCK), "kept blocks of an LSTM");
    let Parameters { embedding, input, recurrent, .. } = sizes.split(parameters);
    let back = recurrent.to_transposed();
    let back = Matrix::new(&back, sizes.gates(), sizes.hidden);
    let folded = (sizes.inputs + 1) * sizes.gates();
    let count = folded + sizes.hidden * sizes.gates();
    let blocks: Vec<_> = x
        .chunks(BLOCK * steps * sizes.inputs)
        .zip(out_gradient.chunks(BLOCK * sizes.hidden))
        .zip(&kept.blocks)
        .collect();
    let partition = blocks.len().div_ceil(PARTITIONS).max(1);
    let partial: Vec<Vec<f32>> = blocks
        .par_chunks(partition)
        .map(|blocks| {
            let mut sums = vec![0.0; count];
            let mut scratch = Scratch::new(sizes, steps);
            for &((x, out_gradient), kept) in blocks {
                let saved = Saved { steps, width: sizes.hidden, gates: &kept.gates, cells: &kept.cells };
                let gates = backward_block(level, &saved, back, out_gradient, &mut scratch);
                let rows = x.len() / sizes.inputs;
                let gates_matrix = Matrix::new(gates, rows, sizes.gates());
                let (weight, rest) = sums.split_at_mut(sizes.inputs * sizes.gates());
                let (bias, recurrent) = rest.split_at_mut(sizes.gates());
                let x = Matrix::new(x, rows, sizes.inputs);
                matmul(level, weight, Accumulate, x.transposed(), gates_matrix);
                column_sums(level, gates, bias);
                let hidden = Matrix::new(&kept.hidden, rows, sizes.hidden);
                matmul(level, recurrent, Accumulate, hidden.transposed(), gates_matrix);
            }
            sums
        })
        .collect();
    let sums = sum_in_order(partial, count);
    let (folded_gradient, recurrent_gradient) = sums.split_at(folded);
    let bias_gradient = &folded_gradient[sizes.inputs * sizes.gates()..];
    let product = Matrix::new(folded_gradient, sizes.inputs + 1, sizes.gates());
    let (embedding_gradient, input_gradient) = rayon::join(
        || parallel_product(level, product, input.transposed()),
        || parallel_product(level, embedding.transposed(), product),
    );
    [&embedding_gradient, &input_gradient, bias_gradient, recurrent_gradient].concat()
}

/// Buffers of [`backward_block`].
struct Scratch {
    /// `[BLOCK, H]`
    hidden: Vec<f32>,
    /// `[BLOCK, H]`
    cells: Vec<f32>,
    /// `[BLOCK, T, 4 H]`
    gates: Vec<f32>,
}

impl Scratch {
    fn new(sizes: LstmSizes, steps: usize) -> Self {
        let zeros = |length| vec![0.0; BLOCK * length];
        Self { hidden: zeros(sizes.hidden), cells: zeros(sizes.hidden), gates: zeros(steps * sizes.gates()) }
    }
}

/// Goes back through time; returns the gradient of what enters the gates of a block of M windows.
///
/// # Shapes
/// recurrent, transposed, `[4 H, H]`, `out_gradient` `[M, H]`; returns `[M, T, 4 H]`
fn backward_block<'a>(
    level: Level,
    saved: &Saved<'_>,
    recurrent: Matrix<'_>,
    out_gradient: &[f32],
    scratch: &'a mut Scratch,
) -> &'a [f32] {
    let (columns, width) = (recurrent.rows(), recurrent.columns());
    let rows = out_gradient.len() / width;
    let hidden = &mut scratch.hidden[..rows * width];
    let cells = &mut scratch.cells[..rows * width];
    let gates = &mut scratch.gates[..rows * saved.steps * columns];
    hidden.copy_from_slice(out_gradient);
    cells.fill(0.0);
    for step in (0..saved.steps).rev() {
        step_backward(level, saved, &mut Gradients { hidden, cells, gates }, step);
        if step > 0 {
            let used = (rows - 1) * saved.steps * columns + columns;
            let entering = &gates[step * columns..][..used];
            let entering = Matrix::strided(entering, rows, columns, saved.steps * columns);
            matmul(level, hidden, Overwrite, entering, recurrent);
        }
    }
    gates
}
