//! The bare networks of an export folder, for tests and research.

use std::path::PathBuf;

use dappo_diagnose::controller::Skills;
use dappo_diagnose::export::Export;
use dappo_nn::Policy;
use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray2, PyReadonlyArray3, PyUntypedArrayMethods};
use pyo3::prelude::*;

use crate::arguments::not_contiguous;
use crate::pool::Pool;

/// The networks of an export folder as this program computes them.
#[pyclass(name = "ExportedNetworks", module = "dappo_batch._core")]
pub struct PyExportedNetworks {
    skills: Skills,
    pool: Pool,
}

#[expect(clippy::needless_pass_by_value, reason = "PyO3 hands arguments over by value")]
#[pymethods]
impl PyExportedNetworks {
    #[new]
    fn new(py: Python<'_>, folder: PathBuf) -> PyResult<Self> {
        let pool = Pool::new(Some(1))?;
        let (skills, _) = pool.run(py, || Export::open(&folder).and_then(|export| export.controller()))?;
        Ok(Self { skills, pool })
    }

    /// Mean actions of the policy, given observations followed by damage codes.
    fn policy<'py>(
        &self,
        py: Python<'py>,
        rows: PyReadonlyArray2<'py, f32>,
    ) -> PyResult<Bound<'py, PyArray2<f32>>> {
        self.mean_actions(py, &self.skills.policy, &rows)
    }

    /// The same of the expert.
    fn expert<'py>(
        &self,
        py: Python<'py>,
        rows: PyReadonlyArray2<'py, f32>,
    ) -> PyResult<Bound<'py, PyArray2<f32>>> {
        self.mean_actions(py, &self.skills.expert, &rows)
    }

    /// Probabilities of the damage classes, given raw windows.
    fn diagnose<'py>(
        &self,
        py: Python<'py>,
        windows: PyReadonlyArray3<'py, f32>,
    ) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let inputs = windows.as_slice().map_err(not_contiguous)?;
        let probabilities = self.pool.run(py, || self.skills.diagnoser.probabilities(inputs))?;
        table(py, probabilities, windows.shape()[0])
    }
}

impl PyExportedNetworks {
    fn mean_actions<'py>(
        &self,
        py: Python<'py>,
        policy: &Policy,
        rows: &PyReadonlyArray2<'py, f32>,
    ) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let inputs = rows.as_slice().map_err(not_contiguous)?;
        let actions = self.pool.run(py, || dappo_learn::Result::Ok(policy.mean_actions(inputs)?))?;
        table(py, actions, rows.shape()[0])
    }
}

fn table(py: Python<'_>, values: Vec<f32>, rows: usize) -> PyResult<Bound<'_, PyArray2<f32>>> {
    let columns = values.len() / rows.max(1);
    PyArray1::from_vec(py, values).reshape([rows, columns])
}
