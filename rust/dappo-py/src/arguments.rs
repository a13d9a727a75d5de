//! Arguments of the classes that Python programs make themselves: what has the wrong type is a `ConfigError`, an array with
//! another layout a `ShapeError`.

use pyo3::prelude::*;
use pyo3::types::PyBool;

use crate::errors::{Kind, raise};

/// An argument as a value of Rust; `expected` describes what it must be.
pub fn argument<'py, T>(value: &Bound<'py, PyAny>, what: &str, expected: &str) -> PyResult<T>
where
    T: for<'a> FromPyObject<'a, 'py>,
{
    // A bool is an int in Python, but no argument is a number that may be written as True.
    let found = if value.is_instance_of::<PyBool>() { None } else { value.extract::<T>().ok() };
    found.ok_or_else(|| {
        let shown = value.repr().and_then(|text| text.extract::<String>());
        let shown: String = shown.unwrap_or_else(|_| "an object".to_owned()).chars().take(80).collect();
        raise(Kind::Config, format!("{what} must be {expected}, got {shown}"))
    })
}

/// The error of an array whose numbers are not side by side.
pub fn not_contiguous<E: std::fmt::Display>(error: E) -> PyErr {
    raise(Kind::Shape, format!("arrays must be C-contiguous ({error}); use numpy.ascontiguousarray"))
}
