//! Copies of tensors in the host's memory.

use burn::tensor::Tensor;

use crate::error::{NnError, Result};

/// Copies a float tensor to the host.
pub fn read<const D: usize>(tensor: Tensor<D>) -> Result<Vec<f32>> {
    tensor.into_data().try_into_vec().map_err(|error| NnError::Tensor { message: format!("{error:?}") })
}

/// The one number of a tensor.
pub fn scalar(tensor: Tensor<1>) -> Result<f64> {
    Ok(read(tensor)?.first().copied().map_or(f64::NAN, f64::from))
}
