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
use super::lstm_block::{BLOCK, BlockActivations, GradientSums, PARTITIONS, Recurrence, Windows};
use super::matmul::Destination::Overwrite;
use super::matmul::{Matrix, matmul};
use super::reduce::sum_in_order;

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
    let input = Matrix::new(weight, sizes.inputs, sizes.gates());
    let recurrence = Recurrence { level, input, bias: folded_bias, recurrent };
    let run = |(x, last): (&[f32], &mut [f32])| {
        let keep_last = |row: usize, step: usize, hidden: &[f32]| {
            if step + 1 == steps {
                last[row * sizes.hidden..][..sizes.hidden].copy_from_slice(hidden);
            }
        };
        recurrence.forward(Windows { steps, x, state: &[], begins: &[] }, keep_last)
    };
    let inputs = x.par_chunks(BLOCK * steps * sizes.inputs);
    let blocks = inputs.zip(out.par_chunks_mut(BLOCK * sizes.hidden));
    if keep {
        return Some(Activations { blocks: blocks.map(run).collect() });
    }
    blocks.for_each(|block| drop(run(block)));
    None
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
            let mut sums = GradientSums::new(sizes.inputs, sizes.hidden, steps);
            for &((x, out_gradient), kept) in blocks {
                let windows = Windows { steps, x, state: &[], begins: &[] };
                sums.add(level, windows, kept, back, |step, hidden| {
                    if step + 1 == steps {
                        hidden.copy_from_slice(out_gradient);
                    }
                });
            }
            sums.sums
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
