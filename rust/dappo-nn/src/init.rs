//! Initial weights, as functions of the caller's random numbers alone.
//!
//! Unlike burn's process-wide generator, a stream of our own makes the weights a function of the seed.

use burn::module::Param;
use burn::nn::Linear;
use burn::tensor::{Device, TensorData};

/// A linear layer of this row-major `[inputs, outputs]` weight; its bias starts at 0.
pub(super) fn linear(weight: Vec<f32>, inputs: usize, outputs: usize, device: &Device) -> Linear {
    Linear {
        weight: Param::from_data(TensorData::new(weight, [inputs, outputs]), device),
        bias: Some(Param::from_data(TensorData::zeros::<f32, _>([outputs]), device)),
    }
}

/// A linear layer with normal weights of standard deviation √(`gain` / inputs), which pass a variance on
/// unchanged when `gain` is 1, or 2 before a `ReLU` (He et al., 2015); its bias starts at 0.
pub(super) fn normal_linear(
    inputs: usize,
    outputs: usize,
    gain: f64,
    normal: &mut dyn FnMut() -> f64,
    device: &Device,
) -> Linear {
    let deviation = (gain / inputs as f64).sqrt();
    let weight = (0..inputs * outputs).map(|_| (deviation * normal()) as f32).collect();
    linear(weight, inputs, outputs, device)
}

/// A row-major `[rows, columns]` matrix whose shorter side is orthogonal, times `gain`.
///
/// Gram-Schmidt on Gaussian vectors: the result is uniform over the orthogonal group. Vectors are
/// orthogonalised twice, which keeps them orthogonal to rounding error.
pub(super) fn orthogonal(
    rows: usize,
    columns: usize,
    gain: f64,
    normal: &mut dyn FnMut() -> f64,
) -> Vec<f32> {
    let (count, length) = (rows.min(columns), rows.max(columns));
    let mut basis: Vec<Vec<f64>> = Vec::with_capacity(count);
    while basis.len() < count {
        let mut vector: Vec<f64> = (0..length).map(|_| normal()).collect();
        for unit in basis.iter().chain(&basis) {
            let overlap: f64 = vector.iter().zip(unit).map(|(a, b)| a * b).sum();
            vector.iter_mut().zip(unit).for_each(|(a, b)| *a -= overlap * b);
        }
        let norm = vector.iter().map(|a| a * a).sum::<f64>().sqrt();
        // A vector that lies in the span of its predecessors has probability 0; rounding could make one.
        if norm > 1e-6 {
            vector.iter_mut().for_each(|a| *a /= norm);
            basis.push(vector);
        }
    }
    let entry = |row: usize, column: usize| {
        let value = if rows < columns { basis[row][column] } else { basis[column][row] };
        (gain * value) as f32
    };
    (0..rows * columns).map(|index| entry(index / columns, index % columns)).collect()
}

#[cfg(test)]
mod tests {
    use dappo_sim::rng::{Purpose, Stream};

    use super::*;

    #[test]
    fn orthogonal_matrices_have_orthonormal_short_sides_times_the_gain() {
        let mut stream = Stream::new(3, 0, Purpose::Weights);
        for (rows, columns) in [(7, 4), (4, 7), (5, 5), (1, 3)] {
            let matrix = orthogonal(rows, columns, 0.5, &mut || stream.normal());
            let at = |i: usize, j: usize| f64::from(matrix[i * columns + j]);
            let short = rows.min(columns);
            for (a, b) in (0..short).flat_map(|a| (0..short).map(move |b| (a, b))) {
                let product: f64 = if rows <= columns {
                    (0..columns).map(|j| at(a, j) * at(b, j)).sum()
                } else {
                    (0..rows).map(|i| at(i, a) * at(i, b)).sum()
                };
                let expected = if a == b { 0.25 } else { 0.0 };
                assert!((product - expected).abs() < 1e-6, "{rows}×{columns} [{a},{b}]: {product}");
            }
        }
    }
}
