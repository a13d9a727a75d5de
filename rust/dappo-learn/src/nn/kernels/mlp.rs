//! Forward and backward pass of a tanh MLP with a linear output layer, a block of rows at a time.
//!
//! `sizes` is `[inputs, hidden…, outputs]`. Parameters lie in one array, layer by layer: the weight,
//! row-major `[inputs, outputs]`, then the bias. Hidden activations lie block by block, and within a
//! block layer by layer, so that both passes touch one contiguous piece of memory per block.
//!
//! [`forward`] is for acting; [`MlpPass`] is for learning.

use rayon::prelude::*;

use super::Level;
use super::elementwise::{bias_add, bias_tanh, column_sums, tanh_backward};
use super::matmul::Destination::{Accumulate, Overwrite};
use super::matmul::{Matrix, matmul};
use super::reduce::add_in_order;

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

/// The MLP's output for every row of `x`.
///
/// # Shapes
/// x `[N, inputs]`, parameters `[parameter_count(sizes)]`, out `[N, outputs]`
///
/// # Panics
/// If a slice has another length.
pub fn forward(level: Level, sizes: &[usize], parameters: &[f32], x: &[f32], out: &mut [f32]) {
    let layers = layers(sizes, parameters);
    let (inputs, outputs, width) = (sizes[0], sizes[sizes.len() - 1], hidden_width(sizes));
    let rows = x.len() / inputs;
    assert_eq!((x.len(), out.len()), (rows * inputs, rows * outputs), "input and output of an MLP");
    let block = block_rows(rows);
    x.par_chunks(block * inputs).zip(out.par_chunks_mut(block * outputs)).for_each_init(
        || vec![0.0; block * width],
        |hidden, (x, out)| {
            let rows = x.len() / inputs;
            forward_block(level, &layers, x, &mut hidden[..rows * width], out);
        },
    );
}

/// What one partition of the backward pass works with: the sum of its gradients, and two buffers that take
/// turns as the gradient of a layer's output and input.
#[derive(Debug, Default)]
struct Partition {
    sum: Vec<f32>,
    scratch: [Vec<f32>; 2],
}

/// One minibatch's way through an MLP and back. The buffers are made once and used again for every minibatch:
/// fresh memory for each would take longer than a product of matrices.
#[derive(Debug)]
pub struct MlpPass {
    level: Level,
    sizes: Vec<usize>,
    /// Rows of the minibatch that went forwards last.
    rows: usize,
    x: Vec<f32>,
    hidden: Vec<f32>,
    out: Vec<f32>,
    partitions: Vec<Partition>,
}

impl MlpPass {
    /// A pass through an MLP of these sizes.
    #[must_use]
    pub fn new(level: Level, sizes: Vec<usize>) -> Self {
        let partitions = (0..PARTITIONS).map(|_| Partition::default()).collect();
        Self { level, sizes, rows: 0, x: Vec::new(), hidden: Vec::new(), out: Vec::new(), partitions }
    }

    /// The MLP's output for the rows `order` of `data`, in that order.
    ///
    /// # Shapes
    /// parameters `[parameter_count(sizes)]`, data `[…, inputs]`, order `[M]`; returns `[M, outputs]`
    ///
    /// # Panics
    /// If there are not as many parameters, or a row lies outside of the data.
    pub fn forward(&mut self, parameters: &[f32], data: &[f32], order: &[i32]) -> &[f32] {
        let (level, layers) = (self.level, layers(&self.sizes, parameters));
        let (inputs, outputs, width) = self.widths();
        self.rows = order.len();
        self.x.resize(self.rows * inputs, 0.0);
        self.hidden.resize(self.rows * width, 0.0);
        self.out.resize(self.rows * outputs, 0.0);
        let block = block_rows(self.rows);
        // Without hidden layers there is nothing to cut into pieces.
        let mut hidden: Vec<&mut [f32]> = self.hidden.chunks_mut((block * width).max(1)).collect();
        hidden.resize_with(self.rows.div_ceil(block), Default::default);
        order
            .par_chunks(block)
            .zip(self.x.par_chunks_mut(block * inputs))
            .zip(hidden.into_par_iter().zip(self.out.par_chunks_mut(block * outputs)))
            .for_each(|((order, x), (hidden, out))| {
                for (row, index) in x.chunks_exact_mut(inputs).zip(order) {
                    row.copy_from_slice(&data[*index as usize * inputs..][..inputs]);
                }
                forward_block(level, &layers, x, hidden, out);
            });
        &self.out
    }

    /// The gradient of the parameters, laid out as they are, given that of the output of the last
    /// [`MlpPass::forward`].
    ///
    /// # Shapes
    /// parameters `[parameter_count(sizes)]`, `out_gradient` `[M, outputs]`; returns
    /// `[parameter_count(sizes)]`
    ///
    /// # Panics
    /// If a slice has another length.
    pub fn backward(&mut self, parameters: &[f32], out_gradient: &[f32]) -> &[f32] {
        let (level, layers) = (self.level, layers(&self.sizes, parameters));
        let (inputs, outputs, width) = self.widths();
        assert_eq!(out_gradient.len(), self.rows * outputs, "output gradient of an MLP");
        let block = block_rows(self.rows);
        let length = self.rows.div_ceil(block).div_ceil(PARTITIONS).max(1) * block;
        let used = self.rows.div_ceil(length).max(1);
        let (rows, x, hidden) = (self.rows, &self.x, &self.hidden);
        self.partitions[..used].par_iter_mut().enumerate().for_each(|(index, partition)| {
            partition.sum.resize(parameters.len(), 0.0);
            partition.sum.fill(0.0);
            let end = ((index + 1) * length).min(rows);
            for start in (index * length..end).step_by(block) {
                let stop = (start + block).min(end);
                let block = BlockGradient {
                    x: &x[start * inputs..stop * inputs],
                    hidden: &hidden[start * width..stop * width],
                    out_gradient: &out_gradient[start * outputs..stop * outputs],
                };
                backward_block(level, &layers, block, partition);
            }
        });
        let (first, rest) = self.partitions[..used].split_at_mut(1);
        let rest: Vec<&[f32]> = rest.iter().map(|partition| partition.sum.as_slice()).collect();
        add_in_order(&mut first[0].sum, &rest);
        &first[0].sum
    }

    /// Inputs, outputs and hidden activations of a row.
    fn widths(&self) -> (usize, usize, usize) {
        (self.sizes[0], self.sizes[self.sizes.len() - 1], hidden_width(&self.sizes))
    }
}

/// One block of the backward pass, as slices.
#[derive(Clone, Copy)]
struct BlockGradient<'a> {
    x: &'a [f32],
    hidden: &'a [f32],
    out_gradient: &'a [f32],
}

/// Adds the parameter gradients of one block to those of its partition.
fn backward_block(level: Level, layers: &[Layer<'_>], block: BlockGradient<'_>, partition: &mut Partition) {
    let rows = block.x.len() / layers[0].inputs;
    let mut remaining = partition.sum.as_mut_slice();
    let mut sums: Vec<_> = layers.iter().map(|layer| split_layer(&mut remaining, layer)).collect();
    let [mut current, mut next] = partition.scratch.each_mut();
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
            return;
        }
        let (rest, input) = hidden.split_at(hidden.len() - rows * layer.inputs);
        hidden = rest;
        let input_matrix = Matrix::new(input, rows, layer.inputs);
        matmul(sums[index].0, Accumulate, input_matrix.transposed(), gradient);
        next.resize(next.len().max(rows * layer.inputs), 0.0);
        let input_gradient = &mut next[..rows * layer.inputs];
        matmul(input_gradient, Overwrite, gradient, layer.weight().transposed());
        tanh_backward(level, input_gradient, input, sums[index - 1].1);
        std::mem::swap(&mut current, &mut next);
    }
}
