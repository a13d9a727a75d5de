//! The commands that are written in Python.

use pyo3::prelude::*;
use pyo3::types::PyDict;

/// Calls the function `command` of a module with the arguments as keywords; it returns the exit code.
pub fn run<'py, T>(py: Python<'py>, module: &str, arguments: T) -> PyResult<i32>
where
    T: IntoPyObject<'py, Output = Bound<'py, PyDict>, Error = PyErr>,
{
    let command = py.import(module)?.getattr("command")?;
    let written = py.import("dappo_batch.commands.output")?.getattr("written")?;
    written.call((command,), Some(&arguments.into_pyobject(py)?))?.extract()
}
