//! The bare networks of an export folder, for tests and research.

use std::path::PathBuf;

use dappo_learn::controller::Skills;
use dappo_learn::evaluate::Policy;
use dappo_learn::export::Export;
use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray2, PyReadonlyArray3, PyUntypedArrayMethods};
use pyo3::prelude::*;

use crate::errors::from_learn;
use crate::vector_env::not_contiguous;

/// What this program makes of the networks of an export folder.
#[pyclass(name = "ExportedNetworks", module = "dappo_batch._core")]
pub struct PyExportedNetworks {
    skills: Skills,
}

#[expect(clippy::needless_pass_by_value, reason = "PyO3 hands arguments over by value")]
#[pymethods]
impl PyExportedNetworks {
    #[new]
    fn new(folder: PathBuf) -> PyResult<Self> {
        let skills = Export::open(&folder).and_then(|export| export.skills());
        Ok(Self { skills: skills.map_err(|error| from_learn(&error))? })
    }

    /// Mean actions of the policy, given observations followed by damage codes.
    fn policy<'py>(
        &self,
        py: Python<'py>,
        rows: PyReadonlyArray2<'py, f32>,
    ) -> PyResult<Bound<'py, PyArray2<f32>>> {
        mean_actions(py, &self.skills.policy, &rows)
    }

    /// The same of the expert.
    fn expert<'py>(
        &self,
        py: Python<'py>,
        rows: PyReadonlyArray2<'py, f32>,
    ) -> PyResult<Bound<'py, PyArray2<f32>>> {
        mean_actions(py, self.skills.expert.actor(), &rows)
    }

    /// Probabilities of the damage classes, given raw windows.
    fn diagnose<'py>(
        &self,
        py: Python<'py>,
        windows: PyReadonlyArray3<'py, f32>,
    ) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let inputs = windows.as_slice().map_err(not_contiguous)?;
        let probabilities =
            self.skills.diagnoser.probabilities(inputs).map_err(|error| from_learn(&error))?;
        table(py, probabilities, windows.shape()[0])
    }
}

fn mean_actions<'py>(
    py: Python<'py>,
    policy: &dyn Policy,
    rows: &PyReadonlyArray2<'py, f32>,
) -> PyResult<Bound<'py, PyArray2<f32>>> {
    let actions = policy.mean_actions(rows.as_slice().map_err(not_contiguous)?);
    table(py, actions.map_err(|error| from_learn(&error))?, rows.shape()[0])
}

fn table(py: Python<'_>, values: Vec<f32>, rows: usize) -> PyResult<Bound<'_, PyArray2<f32>>> {
    let columns = values.len() / rows.max(1);
    PyArray1::from_vec(py, values).reshape([rows, columns])
}
