//! Buffers of the device, and launches that are large enough.

use cubecl::client::Client;
use cubecl::prelude::*;
use cubecl::server::Handle;

use crate::device::THREADS;
use crate::engine::{Number, upload};

/// The most cubes of a launch in one dimension.
const MAX_CUBES: usize = 65_535;

/// A buffer and the number of its entries.
#[derive(Clone)]
pub(super) struct Buffer {
    pub handle: Handle,
    pub len: usize,
}

impl Buffer {
    pub fn of<T: CubeElement>(client: &Client, values: &[T]) -> Self {
        // No buffer is empty.
        let handle = match values {
            [] => client.empty(size_of::<T>()),
            values => client.create_from_slice(T::as_bytes(values)),
        };
        Self { handle, len: values.len().max(1) }
    }

    pub fn numbers<F: Number>(client: &Client, values: &[f64]) -> Self {
        Self { handle: upload::<F>(client, values), len: values.len() }
    }

    pub fn zeros<T: CubeElement + Default>(client: &Client, len: usize) -> Self {
        Self::of(client, &vec![T::default(); len.max(1)])
    }

    pub fn empty<T>(client: &Client, len: usize) -> Self {
        Self { handle: client.empty(len.max(1) * size_of::<T>()), len: len.max(1) }
    }

    pub fn arg(&self) -> BufferArg {
        // SAFETY: the length is that of the buffer.
        unsafe { BufferArg::from_raw_parts(self.handle.clone(), self.len) }
    }
}

/// Enough cubes for so many threads.
pub(super) fn cubes(threads: usize) -> CubeCount {
    let cubes = threads.div_ceil(THREADS).max(1);
    let columns = cubes.min(MAX_CUBES);
    CubeCount::Static(columns as u32, cubes.div_ceil(columns) as u32, 1)
}

pub(super) fn cube() -> CubeDim {
    CubeDim::new_1d(THREADS as u32)
}
