//! Files of folders that may come from somebody else, for Python code.

use std::path::PathBuf;

use dappo_learn::{LearnError, files};
use pyo3::exceptions::PyOSError;
use pyo3::prelude::*;
use pyo3::types::PyBytes;

/// Reads a regular file of at most `most` bytes; links, pipes and devices are refused at once.
#[pyfunction]
#[pyo3(signature = (path, most=files::TEXT_BYTES))]
#[expect(clippy::needless_pass_by_value, reason = "PyO3 hands arguments over by value")]
pub fn read_file(py: Python<'_>, path: PathBuf, most: u64) -> PyResult<Bound<'_, PyBytes>> {
    let bytes = py.detach(|| files::read_regular(&path, most))?;
    Ok(PyBytes::new(py, &bytes))
}

/// Writes a file so that a kill leaves the old or the new one; a link under its name is replaced.
#[pyfunction]
#[expect(clippy::needless_pass_by_value, reason = "PyO3 hands arguments over by value")]
pub fn write_file(py: Python<'_>, path: PathBuf, content: Vec<u8>) -> PyResult<()> {
    py.detach(|| files::write_atomically(&path, &content)).map_err(|error| match error {
        LearnError::Io { source, .. } => source.into(),
        other => PyOSError::new_err(other.to_string()),
    })
}
