//! Forward and backward pass of a tanh MLP with a linear output layer, a block of rows at a time.
//!
//! `sizes` is `[inputs, hidden…, outputs]`. Parameters lie in one array, layer by layer: the weight,
//! row-major `[inputs, outputs]`, then the bias. Hidden activations of a block lie layer by layer.
//!
//! [`forward`] is for acting; [`MlpPass`] is for learning.

use std::sync::{Mutex, PoisonError};

use dappo_sim::task::Reflection;
use rayon::prelude::*;

use super::Level;
use super::elementwise::{bias_add, column_sums, tanh_backward};
use super::layer::{Layer, Product, split_layer};
use super::matmul::Matrix;
use super::parity::{MlpParity, turn};
use super::reduce::add_in_order;
use super::tanh::bias_tanh;

/// Inputs that go through the net at a time: their activations and gradients in a 100-200-100 net and its weights then
/// fit into a core's second-level cache.
const BLOCK: usize = 128;
/// Gradients are summed in partitions of about a quarter of the minibatch, but no more and no fewer rows than these,
/// and then in the order of the partitions. That depends on the minibatch alone, so the result does not depend on the
/// number of threads.
const PARTITION: [usize; 2] = [64, 512];

/// Inputs of a partition of a minibatch.
fn partition_rows(rows: usize) -> usize {
    let [fewest, most] = PARTITION;
    rows.div_ceil(4).next_multiple_of(fewest).min(most)
}

/// Number of partitions of a minibatch, each of which sums a gradient of its own.
#[must_use]
pub fn partitions(rows: usize) -> usize {
    rows.div_ceil(partition_rows(rows.max(1)))
}

/// Number of weights and biases of an MLP whose sizes are those of its input, its hidden layers and its output; `None` if
/// they cannot be counted.
#[must_use]
pub fn parameter_count(sizes: &[usize]) -> Option<usize> {
    let layer = |pair: &[usize]| pair[0].checked_add(1)?.checked_mul(pair[1]);
    sizes.windows(2).map(layer).try_fold(0_usize, |sum, count| sum.checked_add(count?))
}

/// Number of hidden activations of one row.
fn hidden_width(sizes: &[usize]) -> usize {
    sizes[1..sizes.len() - 1].iter().sum()
}

fn layers<'a>(sizes: &[usize], mut parameters: &'a [f32]) -> Vec<Layer<'a>> {
    assert!(sizes.len() >= 2, "an MLP has an input and an output size");
    assert_eq!(Some(parameters.len()), parameter_count(sizes), "parameters of an MLP of sizes {sizes:?}");
    let mut layers = Vec::with_capacity(sizes.len() - 1);
    for pair in sizes.windows(2) {
        let [inputs, outputs] = [pair[0], pair[1]];
        let (weight, rest) = parameters.split_at(inputs * outputs);
        let (bias, rest) = rest.split_at(outputs);
        let weight = Matrix::new(weight, inputs, outputs);
        let products = vec![Product { inputs: 0..inputs, outputs: 0..outputs, weight }];
        layers.push(Layer { inputs, outputs, products, bias, pairs: 0..0 });
        parameters = rest;
    }
    layers
}

/// Sends one block through all layers; `hidden` receives the activations, `out` the result.
fn forward_block(level: Level, layers: &[Layer<'_>], x: &[f32], mut hidden: &mut [f32], out: &mut [f32]) {
    let rows = x.len() / layers[0].inputs;
    let (last, inner) = layers.split_last().unwrap_or((&layers[0], &[]));
    let mut input = x;
    for layer in inner {
        let (y, rest) = std::mem::take(&mut hidden).split_at_mut(rows * layer.outputs);
        layer.apply(level, input, y);
        turn(level, y, layer.outputs, layer.pairs.clone());
        bias_tanh(level, y, layer.bias);
        turn(level, y, layer.outputs, layer.pairs.clone());
        (input, hidden) = (y, rest);
    }
    last.apply(level, input, out);
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
    x.par_chunks(BLOCK * inputs).zip(out.par_chunks_mut(BLOCK * outputs)).for_each_init(
        || vec![0.0; BLOCK * width],
        |hidden, (x, out)| {
            let rows = x.len() / inputs;
            forward_block(level, &layers, x, &mut hidden[..rows * width], out);
        },
    );
}

/// The rows of one array followed by those of another.
#[derive(Debug, Clone, Copy)]
pub struct Inputs<'a> {
    first: &'a [f32],
    second: &'a [f32],
}

impl<'a> Inputs<'a> {
    /// Inputs of two arrays, which stay where they are.
    #[must_use]
    pub fn of_two(first: &'a [f32], second: &'a [f32]) -> Self {
        Self { first, second }
    }

    /// A row of `width` numbers.
    fn row(self, index: usize, width: usize) -> &'a [f32] {
        let start = index * width;
        let (array, start) = match start.checked_sub(self.first.len()) {
            None => (self.first, start),
            Some(start) => (self.second, start),
        };
        &array[start..start + width]
    }
}

impl<'a> From<&'a [f32]> for Inputs<'a> {
    fn from(rows: &'a [f32]) -> Self {
        Self::of_two(rows, &[])
    }
}

/// Buffers of one block.
#[derive(Debug, Default)]
struct Block {
    x: Vec<f32>,
    hidden: Vec<f32>,
    out: Vec<f32>,
    out_gradient: Vec<f32>,
    /// The input or the output or its gradient, as they are or in coordinates of the [parts](super::parity).
    parts: Vec<f32>,
    /// These take turns as the gradient of a layer's output and input.
    gradients: [Vec<f32>; 2],
}

/// The passes of minibatches through an MLP and back: a block of rows goes forwards, through the loss and
/// back while it is in cache. Buffers are allocated once and reused for every block and minibatch.
#[derive(Debug)]
pub struct MlpPass {
    level: Level,
    sizes: Vec<usize>,
    /// Of a net that is its own mirror image.
    parity: Option<MlpParity>,
    /// Sums of the gradients of every partition; the first one becomes that of the minibatch.
    sums: Vec<Vec<f32>>,
    /// The gradient of the parameters of a net that is its own mirror image.
    unfolded: Vec<f32>,
    /// Those that no thread works with.
    idle: Mutex<Vec<Block>>,
}

impl MlpPass {
    /// Passes through MLPs of these sizes.
    #[must_use]
    pub fn new(level: Level, sizes: Vec<usize>) -> Self {
        Self { level, sizes, parity: None, sums: Vec::new(), unfolded: Vec::new(), idle: Mutex::default() }
    }

    /// Passes through MLPs that are their own mirror images under the reflections of the input, of the units of each hidden
    /// layer, which only take each other's place, and of the output. They take half the operations, and gradients are
    /// averaged with their mirror images.
    #[must_use]
    pub fn mirrored(level: Level, reflections: &[Reflection]) -> Self {
        let sizes = reflections.iter().map(Reflection::len).collect();
        Self { parity: Some(MlpParity::new(reflections)), ..Self::new(level, sizes) }
    }

    /// The values of `of` for the MLP's output, block by block, for the rows `order` of `data`. `of` receives
    /// the block's part of `order` and the output there.
    ///
    /// # Shapes
    /// parameters `[parameter_count(sizes)]`, data `[…, inputs]`, order `[M]`; `of`: `[B]`, `[B, outputs]`
    ///
    /// # Panics
    /// If there are not as many parameters, or a row lies outside of the data.
    pub fn evaluate<'a, T: Send>(
        &self,
        parameters: &[f32],
        data: impl Into<Inputs<'a>>,
        order: &[i32],
        of: impl Fn(&[i32], &[f32]) -> T + Sync,
    ) -> Vec<T> {
        let (folded, data) = (self.fold(parameters), data.into());
        let layers = self.layers(parameters, &folded);
        order
            .par_chunks(BLOCK)
            .map(|order| {
                let mut block = self.take_block();
                block.forward(self.level, self.parity.as_ref(), &layers, data, order);
                let answer = of(order, &block.out);
                self.give_back(block);
                answer
            })
            .collect()
    }

    /// The gradient of the parameters, laid out as they are, and the `loss` of each block of the rows `order`
    /// of `data`. `loss` receives the block's part of `order` and the output there, and writes the gradient
    /// of the output.
    ///
    /// # Shapes
    /// parameters `[parameter_count(sizes)]`, data `[…, inputs]`, order `[M]`; `loss`: `[B]`, `[B, outputs]`,
    /// `[B, outputs]`; returns `[blocks]`, `[parameter_count(sizes)]`
    ///
    /// # Panics
    /// If there are not as many parameters, or a row lies outside of the data.
    pub fn gradient<'a, T: Send>(
        &mut self,
        parameters: &[f32],
        data: impl Into<Inputs<'a>>,
        order: &[i32],
        loss: impl Fn(&[i32], &[f32], &mut [f32]) -> T + Sync,
    ) -> (Vec<T>, &[f32]) {
        self.gradient_and_inputs(parameters, data, order, &mut [], loss)
    }

    /// The same with the gradients of the inputs, unless there is no room for them.
    ///
    /// # Shapes
    /// `input_gradient` `[M, inputs]`, in the order of `order`, or empty
    ///
    /// # Panics
    /// As [`MlpPass::gradient`], and if `input_gradient` has another length.
    pub fn gradient_and_inputs<'a, T: Send>(
        &mut self,
        parameters: &[f32],
        data: impl Into<Inputs<'a>>,
        order: &[i32],
        input_gradient: &mut [f32],
        loss: impl Fn(&[i32], &[f32], &mut [f32]) -> T + Sync,
    ) -> (Vec<T>, &[f32]) {
        let data = data.into();
        let mut sums = std::mem::take(&mut self.sums);
        let partition = partition_rows(order.len());
        let used = order.len().div_ceil(partition).max(1);
        sums.resize_with(sums.len().max(used), Vec::new);
        let folded = self.fold(parameters);
        let layers = self.layers(parameters, &folded);
        let count = if self.parity.is_some() { folded.len() } else { parameters.len() };
        let transposes: Vec<Vec<Vec<f32>>> = layers.par_iter().map(Layer::transposes).collect();
        let inputs = self.sizes[0];
        let mut input_gradients: Vec<&mut [f32]> = if input_gradient.is_empty() {
            (0..used).map(|_| &mut [][..]).collect()
        } else {
            assert_eq!(input_gradient.len(), order.len() * inputs, "gradients of the inputs of an MLP");
            input_gradient.chunks_mut(partition * inputs).collect()
        };
        let answers: Vec<Vec<T>> = order
            .par_chunks(partition)
            .zip(&mut sums)
            .zip(&mut input_gradients)
            .map(|((order, sum), input_gradient)| {
                sum.resize(count, 0.0);
                sum.fill(0.0);
                let mut block = self.take_block();
                let answers = order.chunks(BLOCK).enumerate().map(|(index, order)| {
                    block.forward(self.level, self.parity.as_ref(), &layers, data, order);
                    block.out_gradient.resize(block.out.len(), 0.0);
                    let answer = loss(order, &block.out, &mut block.out_gradient);
                    let (start, length) = (index * BLOCK * inputs, order.len() * inputs);
                    let input_gradient = input_gradient.get_mut(start..start + length);
                    block.backward(
                        self.level,
                        self.parity.as_ref(),
                        &layers,
                        &transposes,
                        sum,
                        input_gradient,
                    );
                    answer
                });
                let answers = answers.collect();
                self.give_back(block);
                answers
            })
            .collect();
        let (first, rest) = sums[..used].split_at_mut(1);
        add_in_order(&mut first[0], &rest.iter().map(Vec::as_slice).collect::<Vec<_>>());
        self.sums = sums;
        let answers = answers.into_iter().flatten().collect();
        let Some(parity) = &self.parity else { return (answers, &self.sums[0]) };
        self.unfolded.resize(parameters.len(), 0.0);
        parity.unfold(self.level, &mut self.sums[0], &mut self.unfolded);
        (answers, &self.unfolded)
    }

    /// The parameters for the parts of a net that is its own mirror image.
    fn fold(&self, parameters: &[f32]) -> Vec<f32> {
        self.parity.as_ref().map(|parity| parity.fold(self.level, parameters)).unwrap_or_default()
    }

    fn layers<'a>(&self, parameters: &'a [f32], folded: &'a [f32]) -> Vec<Layer<'a>> {
        match &self.parity {
            None => layers(&self.sizes, parameters),
            Some(parity) => parity.layers(folded),
        }
    }

    fn take_block(&self) -> Block {
        self.idle.lock().unwrap_or_else(PoisonError::into_inner).pop().unwrap_or_default()
    }

    fn give_back(&self, block: Block) {
        self.idle.lock().unwrap_or_else(PoisonError::into_inner).push(block);
    }
}

impl Block {
    /// Sends some rows of `data` forwards.
    fn forward(
        &mut self,
        level: Level,
        parity: Option<&MlpParity>,
        layers: &[Layer<'_>],
        data: Inputs<'_>,
        order: &[i32],
    ) {
        let (inputs, outputs) = (layers[0].inputs, layers[layers.len() - 1].outputs);
        let width: usize = layers[1..].iter().map(|layer| layer.inputs).sum();
        self.x.resize(order.len() * inputs, 0.0);
        self.hidden.resize(order.len() * width, 0.0);
        self.out.resize(order.len() * outputs, 0.0);
        for (row, index) in self.x.chunks_exact_mut(inputs).zip(order) {
            row.copy_from_slice(data.row(*index as usize, inputs));
        }
        let Some(parity) = parity else {
            forward_block(level, layers, &self.x, &mut self.hidden, &mut self.out);
            return;
        };
        self.parts.resize(self.x.len(), 0.0);
        parity.input().split(level, &self.x, &mut self.parts);
        std::mem::swap(&mut self.x, &mut self.parts);
        self.parts.resize(self.out.len(), 0.0);
        forward_block(level, layers, &self.x, &mut self.hidden, &mut self.parts);
        parity.output().join(level, &mut self.parts, &mut self.out);
    }

    /// Adds the gradients of the parameters to `sum` and writes those of the inputs, if there is room for them;
    /// `transposes` are those of the layers' weights.
    fn backward(
        &mut self,
        level: Level,
        parity: Option<&MlpParity>,
        layers: &[Layer<'_>],
        transposes: &[Vec<Vec<f32>>],
        mut sum: &mut [f32],
        input_gradient: Option<&mut [f32]>,
    ) {
        let rows = self.x.len() / layers[0].inputs;
        let mut sums: Vec<_> = layers.iter().map(|layer| split_layer(&mut sum, layer)).collect();
        let [mut current, mut next] = self.gradients.each_mut();
        let mut hidden = self.hidden.as_mut_slice();
        let mut gradient = &self.out_gradient;
        if let Some(parity) = parity {
            parity.output().split(level, gradient, &mut self.parts);
            gradient = &self.parts;
        }
        let last = layers.len() - 1;
        column_sums(level, gradient, sums[last].1);
        for (index, layer) in layers.iter().enumerate().rev() {
            let gradient = if index == last { gradient } else { &*current };
            if index == 0 {
                layer.add_weight_gradient(level, &self.x, gradient, sums[0].0);
                let Some(out) = input_gradient else { return };
                let Some(parity) = parity else {
                    layer.input_gradient(level, &transposes[0], gradient, out);
                    return;
                };
                next.resize(rows * layer.inputs, 0.0);
                layer.input_gradient(level, &transposes[0], gradient, next);
                parity.input().join(level, next, out);
                return;
            }
            let start = hidden.len() - rows * layer.inputs;
            let (rest, input) = std::mem::take(&mut hidden).split_at_mut(start);
            hidden = rest;
            layer.add_weight_gradient(level, input, gradient, sums[index].0);
            next.resize(rows * layer.inputs, 0.0);
            layer.input_gradient(level, &transposes[index], gradient, next);
            let pairs = &layers[index - 1].pairs;
            turn(level, input, layer.inputs, pairs.clone());
            turn(level, next, layer.inputs, pairs.clone());
            tanh_backward(level, next, input, sums[index - 1].1);
            turn(level, next, layer.inputs, pairs.clone());
            std::mem::swap(&mut current, &mut next);
        }
    }
}
