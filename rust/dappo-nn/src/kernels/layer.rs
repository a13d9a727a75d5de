//! A layer of an MLP as it is computed, and its products.

use std::ops::Range;

use super::Level;
use super::matmul::Destination::{Accumulate, Overwrite};
use super::matmul::{Matrix, matmul, matmul_strided};

/// A matrix that makes some outputs of a layer of some of its inputs. A layer has one, and two if they are those of its even
/// and odd [parts](super::parity).
pub(super) struct Product<'a> {
    pub inputs: Range<usize>,
    pub outputs: Range<usize>,
    /// `[inputs, outputs]`.
    pub weight: Matrix<'a>,
}

/// A layer as it is computed.
pub(super) struct Layer<'a> {
    pub inputs: usize,
    pub outputs: usize,
    pub products: Vec<Product<'a>>,
    pub bias: &'a [f32],
    /// Outputs that are sums and differences of pairs of units before and after the activation.
    pub pairs: Range<usize>,
}

impl Layer<'_> {
    /// Writes the product with the weight.
    ///
    /// # Shapes
    /// x `[M, inputs]`, y `[M, outputs]`
    pub fn apply(&self, level: Level, x: &[f32], y: &mut [f32]) {
        let rows = x.len() / self.inputs;
        for Product { inputs, outputs, weight } in &self.products {
            let y = &mut y[span(rows, self.outputs, outputs)];
            matmul_strided(level, y, self.outputs, Overwrite, columns(x, rows, self.inputs, inputs), *weight);
        }
    }

    /// The transposes of the matrices on their own, which products read faster.
    pub fn transposes(&self) -> Vec<Vec<f32>> {
        self.products.iter().map(|product| product.weight.to_transposed()).collect()
    }

    /// Adds the gradient of the weight to `sum`, which is laid out like it.
    ///
    /// # Shapes
    /// x `[M, inputs]`, gradient `[M, outputs]`
    pub fn add_weight_gradient(&self, level: Level, x: &[f32], gradient: &[f32], mut sum: &mut [f32]) {
        let rows = x.len() / self.inputs;
        for Product { inputs, outputs, .. } in &self.products {
            let (of_weight, rest) = std::mem::take(&mut sum).split_at_mut(inputs.len() * outputs.len());
            sum = rest;
            let x = columns(x, rows, self.inputs, inputs).transposed();
            matmul(level, of_weight, Accumulate, x, columns(gradient, rows, self.outputs, outputs));
        }
    }

    /// Writes the gradient of the inputs.
    ///
    /// # Shapes
    /// gradient `[M, outputs]`, `of_inputs` `[M, inputs]`
    pub fn input_gradient(
        &self,
        level: Level,
        transposes: &[Vec<f32>],
        gradient: &[f32],
        of_inputs: &mut [f32],
    ) {
        let rows = gradient.len() / self.outputs;
        for (Product { inputs, outputs, .. }, transpose) in self.products.iter().zip(transposes) {
            let of_inputs = &mut of_inputs[span(rows, self.inputs, inputs)];
            let gradient = columns(gradient, rows, self.outputs, outputs);
            let transpose = Matrix::new(transpose, outputs.len(), inputs.len());
            matmul_strided(level, of_inputs, self.inputs, Overwrite, gradient, transpose);
        }
    }
}

/// The gradients of the weight and the bias of a layer, cut off the front of `gradients`.
#[expect(clippy::mut_mut, reason = "a cursor into a slice is a mutable reference to it")]
pub(super) fn split_layer<'a>(
    gradients: &mut &'a mut [f32],
    layer: &Layer<'_>,
) -> (&'a mut [f32], &'a mut [f32]) {
    let weight = layer.products.iter().map(|product| product.inputs.len() * product.outputs.len()).sum();
    let (weight, rest) = std::mem::take(gradients).split_at_mut(weight);
    let (bias, rest) = rest.split_at_mut(layer.outputs);
    *gradients = rest;
    (weight, bias)
}

/// Some columns of a matrix of this width.
fn columns<'a>(matrix: &'a [f32], rows: usize, width: usize, columns: &Range<usize>) -> Matrix<'a> {
    Matrix::strided(&matrix[span(rows, width, columns)], rows, columns.len(), width)
}

/// Where some columns of a matrix lie, from the first of the first row to the last of the last row.
fn span(rows: usize, width: usize, columns: &Range<usize>) -> Range<usize> {
    columns.start..rows.saturating_sub(1) * width + columns.end
}
