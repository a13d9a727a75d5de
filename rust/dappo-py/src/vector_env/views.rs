//! Views of the buffers of a vector env.

use dappo_sim::vector_env::Buffers;
use numpy::ndarray::{ArrayView1, ArrayView2};
use numpy::{Element, PyArray1, PyArray2};
use pyo3::prelude::*;

use super::PyVectorEnv;
use crate::errors::{Kind, raise};

/// A numpy view on one of the env's buffers; writable, because `DLPack` refuses to share read-only arrays.
pub(super) fn view1<'py, T: Element>(
    this: &Bound<'py, PyVectorEnv>,
    buffer: impl Fn(&Buffers) -> &[T],
) -> PyResult<Bound<'py, PyArray1<T>>> {
    let borrowed = this.borrow();
    let array = ArrayView1::from(buffer(borrowed.env()?.buffers()));
    // SAFETY: the buffer lives as long as `this` and is never reallocated (see `close`, which keeps it).
    let view = unsafe { PyArray1::borrow_from_array(&array, this.clone().into_any()) };
    Ok(view)
}

pub(super) fn view2<'py, T: Element>(
    this: &Bound<'py, PyVectorEnv>,
    buffer: impl Fn(&Buffers) -> &[T],
) -> PyResult<Bound<'py, PyArray2<T>>> {
    let borrowed = this.borrow();
    let env = borrowed.env()?;
    let numbers = buffer(env.buffers());
    let array = ArrayView2::from_shape((env.num_envs(), numbers.len() / env.num_envs()), numbers)
        .map_err(|error| raise(Kind::Shape, error.to_string()))?;
    // SAFETY: as in `view1`.
    let view = unsafe { PyArray2::borrow_from_array(&array, this.clone().into_any()) };
    Ok(view)
}
