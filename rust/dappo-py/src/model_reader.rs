//! Reads the arrays of a compiled `mujoco.MjModel` for the lane engine.

use dappo_sim::backend::lanes::ModelReader;
use numpy::{PyArrayDyn, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyBytes;

/// An `mujoco.MjModel`.
pub struct PyModel<'py> {
    model: Bound<'py, PyAny>,
    opt: Bound<'py, PyAny>,
}

impl<'py> PyModel<'py> {
    /// Wraps a model.
    pub fn new(model: Bound<'py, PyAny>) -> PyResult<Self> {
        let opt = model.getattr("opt")?;
        Ok(Self { model, opt })
    }

    fn field(&self, name: &str) -> PyResult<Bound<'py, PyAny>> {
        match name.split_once('.') {
            None => self.model.getattr(name),
            Some(("opt", name)) => self.opt.getattr(name),
            Some((part, name)) => self.model.getattr(part)?.getattr(name),
        }
    }
}

/// The entries of an array with elements of type `T`, converted; `None` if it has others.
fn entries<T: numpy::Element + Copy, N: From<T>>(field: &Bound<'_, PyAny>) -> Option<Vec<N>> {
    let array = field.cast::<PyArrayDyn<T>>().ok()?.try_readonly().ok()?;
    Some(array.as_slice().ok()?.iter().map(|&entry| N::from(entry)).collect())
}

/// Arrays of any type of number, and numbers that are no arrays.
fn numbers(field: &Bound<'_, PyAny>) -> PyResult<Vec<f64>> {
    let found = entries::<f64, f64>(field)
        .or_else(|| entries::<i32, f64>(field))
        .or_else(|| entries::<bool, f64>(field));
    found.map_or_else(|| field.extract().map(|number: f64| vec![number]), Ok)
}

impl ModelReader for PyModel<'_> {
    type Error = PyErr;

    fn size(&self, name: &str) -> PyResult<usize> {
        self.field(name)?.extract()
    }

    fn reals(&self, name: &str) -> PyResult<Vec<f64>> {
        numbers(&self.field(name)?)
    }

    fn integers(&self, name: &str) -> PyResult<Vec<i32>> {
        let field = self.field(name)?;
        let found = entries::<i32, i32>(&field).or_else(|| entries::<bool, i32>(&field));
        found.map_or_else(|| field.extract().map(|number: i32| vec![number]), Ok)
    }

    fn optional(&self, name: &str) -> PyResult<Option<Vec<f64>>> {
        match self.field(name) {
            Ok(field) => numbers(&field).map(Some),
            Err(error) if error.is_instance_of::<pyo3::exceptions::PyAttributeError>(self.model.py()) => {
                Ok(None)
            }
            Err(error) => Err(error),
        }
    }

    fn names(&self) -> PyResult<Vec<u8>> {
        Ok(self.field("names")?.cast::<PyBytes>()?.as_bytes().to_vec())
    }
}
