//! CPU kernels of the fused networks: plain slices in, plain slices out, no tensors.
//!
//! Stock elementwise operations make one pass over memory each and compute tanh one number at a time.
//! Here a block of rows goes through all layers while it is in cache, and every loop is compiled for the
//! widest vectors of the machine it runs on.

pub(crate) mod adam;
mod elementwise;
mod layer;
mod level;
pub mod lstm;
mod lstm_block;
mod lstm_cell;
pub mod lstm_sequence;
mod matmul;
mod mlp;
mod parity;
#[cfg(target_arch = "x86_64")]
mod product;
mod reduce;
mod tanh;

pub use level::Level;
pub use mlp::{Inputs, MlpPass, forward, parameter_count, partitions};
