//! Even and odd parts of vectors under a reflection.
//!
//! A vector is the sum of an even part, which its reflection leaves as it is, and an odd part, whose sign it changes. A
//! linear layer that is its own mirror image makes even parts of even parts and odd parts of odd ones: in coordinates of the
//! parts, its matrix is two of half the rows and half the columns, with half the operations. The coordinates are orthonormal,
//! so that transposes are inverses, and gradients change coordinates as vectors do.

#![expect(
    clippy::inline_always,
    reason = "a body is compiled for an instruction set only inside the function that enables it"
)]

use std::cmp::Ordering;
use std::f32::consts::FRAC_1_SQRT_2;
use std::ops::Range;

use dappo_sim::task::Reflection;

use super::Level;
use super::layer::{Layer, Product};
use super::level::for_every_level;
use super::matmul::Matrix;

/// The parts of the vectors at one level of a net, `[even, odd]`: entries that stay as they are, sums of pairs, differences
/// of pairs, entries that change their sign.
#[derive(Debug, Clone)]
pub(super) struct Parity {
    /// The entries in the order of the parts: those that stay, the first ones of pairs, the second ones with the sign that
    /// makes them the images of the first, those that change their sign.
    order: Vec<(usize, f32)>,
    /// Where the pairs are in this order.
    pairs: Range<usize>,
}

impl Parity {
    /// The parts under this reflection.
    pub fn new(reflection: &Reflection) -> Self {
        let (mut even, mut first, mut second, mut odd) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        for (entry, image) in reflection.entries().iter().enumerate() {
            match entry.cmp(&image.of) {
                Ordering::Less => {
                    first.push((entry, 1.0));
                    second.push((image.of, image.sign));
                }
                Ordering::Equal if image.sign < 0.0 => odd.push((entry, 1.0)),
                Ordering::Equal => even.push((entry, 1.0)),
                Ordering::Greater => {}
            }
        }
        let pairs = even.len()..even.len() + 2 * first.len();
        Self { order: [even, first, second, odd].concat(), pairs }
    }

    /// Number of entries, and of coordinates.
    pub fn len(&self) -> usize {
        self.order.len()
    }

    /// The sums and differences of pairs.
    pub fn pairs(&self) -> Range<usize> {
        self.pairs.clone()
    }

    /// The coordinates of the even and of the odd part.
    pub fn parts(&self) -> [Range<usize>; 2] {
        let middle = self.pairs.start + self.pairs.len() / 2;
        [0..middle, middle..self.len()]
    }

    /// Writes the coordinates of vectors.
    ///
    /// # Shapes
    /// vectors, parts `[M, len]`
    pub fn split(&self, level: Level, vectors: &[f32], parts: &mut [f32]) {
        let width = self.len();
        for (vector, parts) in vectors.chunks_exact(width).zip(parts.chunks_exact_mut(width)) {
            self.arrange(vector, parts);
        }
        turn(level, parts, width, self.pairs());
    }

    /// Writes the entries of a vector in the order of the parts.
    ///
    /// # Shapes
    /// vector, arranged `[len]`
    pub fn arrange(&self, vector: &[f32], arranged: &mut [f32]) {
        for ((entry, sign), x) in self.order.iter().zip(arranged) {
            *x = sign * vector[*entry];
        }
    }

    /// Writes the vectors with these coordinates, which become their entries in the order of the parts.
    ///
    /// # Shapes
    /// parts, vectors `[M, len]`
    pub fn join(&self, level: Level, parts: &mut [f32], vectors: &mut [f32]) {
        let width = self.len();
        turn(level, parts, width, self.pairs());
        for (parts, vector) in parts.chunks_exact(width).zip(vectors.chunks_exact_mut(width)) {
            for ((entry, sign), x) in self.order.iter().zip(parts) {
                vector[*entry] = sign * x;
            }
        }
    }

    /// The entries that a coordinate is made of, each with a factor.
    fn entries(&self, coordinate: usize) -> [(usize, f32); 2] {
        if !self.pairs.contains(&coordinate) {
            let (entry, sign) = self.order[coordinate];
            return [(entry, sign), (entry, 0.0)];
        }
        let count = self.pairs.len() / 2;
        let first = self.pairs.start + (coordinate - self.pairs.start) % count;
        let sign = if coordinate < self.pairs.start + count { FRAC_1_SQRT_2 } else { -FRAC_1_SQRT_2 };
        let ((first, of_first), (second, of_second)) = (self.order[first], self.order[first + count]);
        [(first, FRAC_1_SQRT_2 * of_first), (second, sign * of_second)]
    }
}

/// Appends the matrices of both parts, `[even, even]` and `[odd, odd]`, of a weight that is its own mirror image.
///
/// # Shapes
/// weight `[inputs, outputs]`
fn fold_weight(level: Level, weight: &[f32], inputs: &Parity, outputs: &Parity, folded: &mut Vec<f32>) {
    let width = outputs.len();
    let (mut row, mut parts) = (vec![0.0; width], vec![0.0; width]);
    for (inputs_of_part, outputs_of_part) in inputs.parts().into_iter().zip(outputs.parts()) {
        for [(first, a), (second, b)] in inputs_of_part.map(|input| inputs.entries(input)) {
            let rows = weight[first * width..].iter().zip(&weight[second * width..]);
            row.iter_mut().zip(rows).for_each(|(x, (first, second))| *x = a * first + b * second);
            outputs.split(level, &row, &mut parts);
            folded.extend_from_slice(&parts[outputs_of_part.clone()]);
        }
    }
}

/// Writes the weight whose parts have these matrices: it is its own mirror image.
///
/// # Shapes
/// folded `[even · even + odd · odd]`, weight `[inputs, outputs]`
fn unfold_weight(level: Level, mut folded: &[f32], inputs: &Parity, outputs: &Parity, weight: &mut [f32]) {
    let width = outputs.len();
    let (mut row, mut parts) = (vec![0.0; width], vec![0.0; width]);
    weight.fill(0.0);
    for (inputs_of_part, outputs_of_part) in inputs.parts().into_iter().zip(outputs.parts()) {
        for entries in inputs_of_part.map(|input| inputs.entries(input)) {
            let (values, rest) = folded.split_at(outputs_of_part.len());
            folded = rest;
            parts.fill(0.0);
            parts[outputs_of_part.clone()].copy_from_slice(values);
            outputs.join(level, &mut parts, &mut row);
            for (entry, factor) in entries {
                let into = &mut weight[entry * width..][..width];
                into.iter_mut().zip(&row).for_each(|(x, y)| *x += factor * y);
            }
        }
    }
}

/// The parts at every level of an MLP that is its own mirror image.
#[derive(Debug)]
pub(super) struct MlpParity {
    levels: Vec<Parity>,
}

impl MlpParity {
    /// The parts under the reflections of the input, of the units of each hidden layer, and of the output.
    pub fn new(reflections: &[Reflection]) -> Self {
        Self { levels: reflections.iter().map(Parity::new).collect() }
    }

    /// The parts of the input.
    pub fn input(&self) -> &Parity {
        &self.levels[0]
    }

    /// The parts of the output.
    pub fn output(&self) -> &Parity {
        &self.levels[self.levels.len() - 1]
    }

    /// Inputs and outputs of each layer, and whether the outputs are those of the net.
    fn ends(&self) -> impl Iterator<Item = (&Parity, &Parity, bool)> {
        let last = self.levels.len() - 2;
        self.levels.windows(2).enumerate().map(move |(index, pair)| (&pair[0], &pair[1], index == last))
    }

    /// The parameters for the coordinates of the parts, layer by layer: the matrices of the even and of the odd part, and
    /// the bias: of hidden layers that of the units in their order among the parts.
    ///
    /// # Shapes
    /// parameters `[parameter_count(sizes)]`
    pub fn fold(&self, level: Level, mut parameters: &[f32]) -> Vec<f32> {
        let mut folded = Vec::with_capacity(parameters.len());
        for (inputs, outputs, is_last) in self.ends() {
            let (weight, rest) = parameters.split_at(inputs.len() * outputs.len());
            let (bias, rest) = rest.split_at(outputs.len());
            parameters = rest;
            fold_weight(level, weight, inputs, outputs, &mut folded);
            let start = folded.len();
            folded.resize(start + outputs.len(), 0.0);
            if is_last {
                outputs.split(level, bias, &mut folded[start..]);
            } else {
                outputs.arrange(bias, &mut folded[start..]);
            }
        }
        folded
    }

    /// The layers of a net whose parameters [`MlpParity::fold`] has laid out.
    pub fn layers<'a>(&self, mut folded: &'a [f32]) -> Vec<Layer<'a>> {
        let mut layers = Vec::new();
        for (from, to, is_last) in self.ends() {
            let parts = from.parts().into_iter().zip(to.parts());
            let products = parts.map(|(inputs, outputs)| {
                let (weight, rest) = folded.split_at(inputs.len() * outputs.len());
                folded = rest;
                Product { weight: Matrix::new(weight, inputs.len(), outputs.len()), inputs, outputs }
            });
            let products = products.collect();
            let (bias, rest) = folded.split_at(to.len());
            folded = rest;
            let pairs = if is_last { 0..0 } else { to.pairs() };
            layers.push(Layer { inputs: from.len(), outputs: to.len(), products, bias, pairs });
        }
        layers
    }

    /// The gradient of the parameters, averaged with its mirror image, from that of what [`MlpParity::fold`] makes of them,
    /// which it leaves in disorder.
    ///
    /// # Shapes
    /// gradient as `fold` lays it out, parameters `[parameter_count(sizes)]`
    pub fn unfold(&self, level: Level, mut gradient: &mut [f32], mut parameters: &mut [f32]) {
        for (inputs, outputs, is_last) in self.ends() {
            let (weight, rest) = std::mem::take(&mut parameters).split_at_mut(inputs.len() * outputs.len());
            let (bias, rest) = rest.split_at_mut(outputs.len());
            parameters = rest;
            let (of_weight, rest) =
                std::mem::take(&mut gradient).split_at_mut(folded_weights(inputs, outputs));
            let (of_bias, rest) = rest.split_at_mut(outputs.len());
            gradient = rest;
            unfold_weight(level, of_weight, inputs, outputs, weight);
            if !is_last {
                turn(level, of_bias, outputs.len(), outputs.pairs());
            }
            let [_, odd] = outputs.parts();
            of_bias[odd].fill(0.0);
            outputs.join(level, of_bias, bias);
        }
    }
}

/// Entries of the matrices of both parts.
fn folded_weights(inputs: &Parity, outputs: &Parity) -> usize {
    inputs
        .parts()
        .into_iter()
        .zip(outputs.parts())
        .map(|(inputs, outputs)| inputs.len() * outputs.len())
        .sum()
}

#[inline(always)]
fn turn_body<const FMA: bool>(rows: &mut [f32], width: usize, pairs: Range<usize>) {
    for row in rows.chunks_exact_mut(width) {
        let pairs = &mut row[pairs.clone()];
        let (first, second) = pairs.split_at_mut(pairs.len() / 2);
        for (a, b) in first.iter_mut().zip(second) {
            (*a, *b) = (FRAC_1_SQRT_2 * (*a + *b), FRAC_1_SQRT_2 * (*a - *b));
        }
    }
}

for_every_level! {
    /// Replaces the first and the second half of `pairs` in every row by their sums and differences, divided by √2: pairs of
    /// units become their parts, and parts the units.
    ///
    /// # Shapes
    /// rows `[M, width]`
    fn turn(rows: &mut [f32], width: usize, pairs: Range<usize>) = turn_body;
}
