//! Files of folders that may come from others, for Python code.

use std::io::{Error, ErrorKind};
use std::path::{Path, PathBuf};

use dappo_learn::{LearnError, files};
use pyo3::exceptions::PyOSError;
use pyo3::prelude::*;
use pyo3::types::PyBytes;

/// Reads a regular file of at most `most` bytes; links, pipes and devices are refused at once.
#[pyfunction]
#[pyo3(signature = (path, most=files::TEXT_BYTES))]
#[expect(clippy::needless_pass_by_value, reason = "PyO3 hands arguments over by value")]
pub fn read_file(py: Python<'_>, path: PathBuf, most: u64) -> PyResult<Bound<'_, PyBytes>> {
    let bytes = py.detach(|| files::read_regular(&path, most));
    Ok(PyBytes::new(py, &bytes.map_err(|error| os_error(py, &path, &error))?))
}

/// Writes a file so that a kill leaves the old or the new one; a link under its name is replaced.
#[pyfunction]
#[expect(clippy::needless_pass_by_value, reason = "PyO3 hands arguments over by value")]
pub fn write_file(py: Python<'_>, path: PathBuf, content: Vec<u8>) -> PyResult<()> {
    py.detach(|| files::write_atomically(&path, &content)).map_err(|error| match error {
        LearnError::Io { path, source } => os_error(py, &path, &source),
        other => PyOSError::new_err(other.to_string()),
    })
}

/// An `OSError` as Python raises it, with the number, the reason and the path.
fn os_error(py: Python<'_>, path: &Path, error: &Error) -> PyErr {
    let parts = || -> PyResult<(i32, String)> {
        if let Some(number) = error.raw_os_error() {
            return Ok((number, py.import("os")?.call_method1("strerror", (number,))?.extract()?));
        }
        let name = match error.kind() {
            ErrorKind::InvalidInput | ErrorKind::InvalidData => "EINVAL",
            ErrorKind::OutOfMemory => "ENOMEM",
            _ => "EIO",
        };
        Ok((py.import("errno")?.getattr(name)?.extract()?, error.to_string()))
    };
    match parts() {
        Ok((number, reason)) => PyOSError::new_err((number, reason, path.as_os_str().to_owned())),
        Err(error) => error,
    }
}
