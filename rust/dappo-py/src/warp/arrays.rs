//! Copies between numpy arrays and vectors.

use numpy::{Element, PyArray1, PyArray2, PyArrayDyn, PyArrayMethods, PyUntypedArrayMethods};
use pyo3::prelude::*;

use crate::errors::{Kind, raise};

/// A numpy array of one dimension.
pub fn numbers<'py, T: Element>(py: Python<'py>, values: &[T]) -> Bound<'py, PyArray1<T>> {
    PyArray1::from_slice(py, values)
}

/// A numpy array of rows.
pub fn rows<'py, T: Element>(
    py: Python<'py>,
    values: &[T],
    count: usize,
) -> PyResult<Bound<'py, PyArray2<T>>> {
    PyArray1::from_slice(py, values).reshape([count, values.len() / count.max(1)])
}

/// Copies an array into a slice of as many elements.
pub fn copy<T: Element + Copy>(array: &Bound<'_, PyAny>, what: &str, out: &mut [T]) -> PyResult<()> {
    let array = array.cast::<PyArrayDyn<T>>()?;
    if array.len() != out.len() {
        let (got, expected) = (array.len(), out.len());
        return Err(raise(Kind::Shape, format!("{what} has {got} elements, expected {expected}")));
    }
    out.copy_from_slice(array.try_readonly()?.as_slice()?);
    Ok(())
}

/// The elements of an array.
pub fn vector<T: Element + Copy>(array: &Bound<'_, PyAny>) -> PyResult<Vec<T>> {
    Ok(array.cast::<PyArrayDyn<T>>()?.try_readonly()?.as_slice()?.to_vec())
}
