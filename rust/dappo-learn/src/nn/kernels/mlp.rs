//! Forward and backward pass of a tanh MLP with a linear output layer, a block of rows at a time.
//!
//! `sizes` is `[inputs, hidden…, outputs]`. Parameters lie in one array, layer by layer: the weight,
//! row-major `[inputs, outputs]`, then the bias. Hidden activations lie block by block, and within a
//! block layer by layer, so that both passes touch one contiguous piece of memory per block.

use rayon::prelude::*;

use super::Level;
use super::elementwise::{bias_add, bias_tanh, column_sums, tanh_backward};
use super::matmul::Destination::{Accumulate, Overwrite};
use super::matmul::{Matrix, matmul};
use super::reduce::sum_in_order;

/// The backward pass sums gradients in this many partitions and then adds those in order. The number is
/// fixed, so that the result does not depend on the number of threads.
const PARTITIONS: usize = 8;
/// Blocks have between this many rows …
const MIN_BLOCK: usize = 64;
/// … and this many: activations of a 100-200-100 net then fit into a core's cache.
const MAX_BLOCK: usize = 256;

/// Rows of a block: a function of the batch alone, so that results do not depend on the machine.
fn block_rows(rows: usize) -> usize {
    rows.div_ceil(PARTITIONS).next_multiple_of(MIN_BLOCK).clamp(MIN_BLOCK, MAX_BLOCK)
}

/// Number of weights and biases of an MLP of these sizes.
#[must_use]
pub fn parameter_count(sizes: &[usize]) -> usize {
    sizes.windows(2).map(|layer| (layer[0] + 1) * layer[1]).sum()
}

/// Number of hidden activations of one row.
#[must_use]
pub fn hidden_width(sizes: &[usize]) -> usize {
    sizes[1..sizes.len() - 1].iter().sum()
}

#[derive(Clone, Copy)]
struct Layer<'a> {
    inputs: usize,
    outputs: usize,
    weight: &'a [f32],
    bias: &'a [f32],
}

impl Layer<'_> {
    fn weight(&self) -> Matrix<'_> {
        Matrix::new(self.weight, self.inputs, self.outputs)
    }
}

fn layers<'a>(sizes: &[usize], mut parameters: &'a [f32]) -> Vec<Layer<'a>> {
    assert!(sizes.len() >= 2, "an MLP has an input and an output size");
    assert_eq!(parameters.len(), parameter_count(sizes), "parameters of an MLP of sizes {sizes:?}");
    let mut layers = Vec::with_capacity(sizes.len() - 1);
    for pair in sizes.windows(2) {
        let (weight, rest) = parameters.split_at(pair[0] * pair[1]);
        let (bias, rest) = rest.split_at(pair[1]);
        layers.push(Layer { inputs: pair[0], outputs: pair[1], weight, bias });
        parameters = rest;
    }
    layers
}

/// The gradients of one layer, cut off the front of `gradients`.
#[expect(clippy::mut_mut, reason = "a cursor into a slice is a mutable reference to it")]
fn split_layer<'a>(gradients: &mut &'a mut [f32], layer: &Layer<'_>) -> (&'a mut [f32], &'a mut [f32]) {
    let (weight, rest) = std::mem::take(gradients).split_at_mut(layer.weight.len());
    let (bias, rest) = rest.split_at_mut(layer.outputs);
    *gradients = rest;
    (weight, bias)
}

/// Sends one block through all layers; `hidden` receives the activations, `out` the result.
fn forward_block(level: Level, layers: &[Layer<'_>], x: &[f32], mut hidden: &mut [f32], out: &mut [f32]) {
    let rows = x.len() / layers[0].inputs;
    let (last, inner) = layers.split_last().unwrap_or((&layers[0], &[]));
    let mut input = x;
    for layer in inner {
        let (y, rest) = std::mem::take(&mut hidden).split_at_mut(rows * layer.outputs);
        matmul(y, Overwrite, Matrix::new(input, rows, layer.inputs), layer.weight());
        bias_tanh(level, y, layer.bias);
        (input, hidden) = (y, rest);
    }
    matmul(out, Overwrite, Matrix::new(input, rows, last.inputs), last.weight());
    bias_add(level, out, last.bias);
}

/// The MLP's output for every row of `x`; `keep` receives the hidden activations that [`backward`] needs.
///
/// # Shapes
/// x `[N, inputs]`, parameters `[parameter_count(sizes)]`, out `[N, outputs]`,
/// keep `[N * hidden_width(sizes)]`
///
/// # Panics
/// If a slice has another length.
pub fn forward(
    level: Level,
    sizes: &[usize],
    parameters: &[f32],
    x: &[f32],
    out: &mut [f32],
    keep: Option<&mut [f32]>,
) {
    let layers = layers(sizes, parameters);
    let (inputs, outputs, width) = (sizes[0], sizes[sizes.len() - 1], hidden_width(sizes));
    let rows = x.len() / inputs;
    assert_eq!((x.len(), out.len()), (rows * inputs, rows * outputs), "input and output of an MLP");
    let block = block_rows(rows);
    let blocks = x.par_chunks(block * inputs).zip(out.par_chunks_mut(block * outputs));
    match keep {
        Some(keep) if width > 0 => {
            assert_eq!(keep.len(), rows * width, "hidden activations of an MLP");
            blocks
                .zip(keep.par_chunks_mut(block * width))
                .for_each(|((x, out), hidden)| forward_block(level, &layers, x, hidden, out));
        }
        _ => blocks.for_each_init(
            || vec![0.0; block * width],
            |hidden, (x, out)| {
                let rows = x.len() / inputs;
                forward_block(level, &layers, x, &mut hidden[..rows * width], out);
            },
        ),
    }
}

/// One block of the backward pass, as slices.
struct BlockGradient<'a> {
    x: &'a [f32],
    hidden: &'a [f32],
    out_gradient: &'a [f32],
    x_gradient: Option<&'a mut [f32]>,
}

/// Adds the parameter gradients of one block to `sums`, and writes the gradient of its input.
///
/// `scratch` holds two buffers that take turns as the gradient of a layer's output and input.
fn backward_block(
    level: Level,
    layers: &[Layer<'_>],
    block: BlockGradient<'_>,
    sums: &mut [(&mut [f32], &mut [f32])],
    scratch: &mut [Vec<f32>; 2],
) {
    let rows = block.x.len() / layers[0].inputs;
    let [mut current, mut next] = scratch.each_mut();
    let mut hidden = block.hidden;
    for (index, layer) in layers.iter().enumerate().rev() {
        let gradient = if index + 1 == layers.len() {
            column_sums(level, block.out_gradient, sums[index].1);
            block.out_gradient
        } else {
            &current[..rows * layer.outputs]
        };
        let gradient = Matrix::new(gradient, rows, layer.outputs);
        if index == 0 {
            let x = Matrix::new(block.x, rows, layer.inputs);
            matmul(sums[0].0, Accumulate, x.transposed(), gradient);
            if let Some(x_gradient) = block.x_gradient {
                matmul(x_gradient, Overwrite, gradient, layer.weight().transposed());
            }
            return;
        }
        let (rest, input) = hidden.split_at(hidden.len() - rows * layer.inputs);
        hidden = rest;
        let input_matrix = Matrix::new(input, rows, layer.inputs);
        matmul(sums[index].0, Accumulate, input_matrix.transposed(), gradient);
        let input_gradient = &mut next[..rows * layer.inputs];
        matmul(input_gradient, Overwrite, gradient, layer.weight().transposed());
        tanh_backward(level, input_gradient, input, sums[index - 1].1);
        std::mem::swap(&mut current, &mut next);
    }
}

/// The gradient of the parameters, laid out as they are, given the gradient of the output;
/// `x_gradient`, if given, receives the gradient of the input.
///
/// # Shapes
/// x `[N, inputs]`, hidden `[N * hidden_width(sizes)]` as kept by [`forward`], `out_gradient`
/// `[N, outputs]`, `x_gradient` `[N, inputs]`; returns `[parameter_count(sizes)]`
///
/// # Panics
/// If a slice has another length.
#[must_use]
pub fn backward(
    level: Level,
    sizes: &[usize],
    parameters: &[f32],
    x: &[f32],
    hidden: &[f32],
    out_gradient: &[f32],
    x_gradient: Option<&mut [f32]>,
) -> Vec<f32> {
    let layers = layers(sizes, parameters);
    let (inputs, outputs, width) = (sizes[0], sizes[sizes.len() - 1], hidden_width(sizes));
    let rows = x.len() / inputs;
    assert_eq!(
        (x.len(), hidden.len(), out_gradient.len()),
        (rows * inputs, rows * width, rows * outputs),
        "input, activations and output gradient of an MLP"
    );
    let block = block_rows(rows);
    let partition = rows.div_ceil(block).div_ceil(PARTITIONS).max(1) * block;
    let mut x_gradients: Vec<Option<&mut [f32]>> = match x_gradient {
        Some(x_gradient) => {
            assert_eq!(x_gradient.len(), rows * inputs, "input gradient of an MLP");
            x_gradient.chunks_mut(partition * inputs).map(Some).collect()
        }
        None => (0..rows.div_ceil(partition)).map(|_| None).collect(),
    };
    let widest = sizes.iter().copied().max().unwrap_or(0);
    let partial: Vec<Vec<f32>> = x_gradients
        .par_iter_mut()
        .enumerate()
        .map(|(index, x_gradient)| {
            let mut flat = vec![0.0; parameters.len()];
            let mut remaining = flat.as_mut_slice();
            let mut sums: Vec<_> = layers.iter().map(|layer| split_layer(&mut remaining, layer)).collect();
            let mut scratch = [vec![0.0; block * widest], vec![0.0; block * widest]];
            let end = ((index + 1) * partition).min(rows);
            for start in (index * partition..end).step_by(block) {
                let stop = (start + block).min(end);
                let offset = start - index * partition;
                let block = BlockGradient {
                    x: &x[start * inputs..stop * inputs],
                    hidden: &hidden[start * width..stop * width],
                    out_gradient: &out_gradient[start * outputs..stop * outputs],
                    x_gradient: x_gradient
                        .as_deref_mut()
                        .map(|dx| &mut dx[offset * inputs..(offset + stop - start) * inputs]),
                };
                backward_block(level, &layers, block, &mut sums, &mut scratch);
            }
            flat
        })
        .collect();
    sum_in_order(partial, parameters.len())
}
