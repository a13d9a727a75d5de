//! Tests over the public interface of the crate, in one program: each that is linked takes its time.

#![allow(clippy::unwrap_used, clippy::float_cmp, reason = "helpers of a test may fail loudly, as tests do")]

mod lstm_op;
mod memory;
mod mlp_kernels;

use burn::tensor::Tensor;
use dappo_sim::rng::{Purpose, Stream};

/// Largest difference between two ways to compute the same, relative to the largest reference value.
const TOLERANCE: f32 = 2e-6;

/// Standard normals, `[count]`.
fn normals(count: usize, seed: u64) -> Vec<f32> {
    let mut stream = Stream::new(seed, 0, Purpose::Weights);
    (0..count).map(|_| stream.normal() as f32).collect()
}

/// The numbers of a tensor.
fn values<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    tensor.into_data().try_into_vec().unwrap()
}
