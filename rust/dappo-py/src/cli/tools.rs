//! The commands that are written in Python.

use pyo3::prelude::*;
use pyo3::types::PyDict;

use super::args::{BenchArgs, DoctorArgs, GridArgs, ReportArgs, Threads};
use crate::factory::to_python;

/// `dappo-batch report`.
pub fn report(py: Python<'_>, arguments: &ReportArgs) -> PyResult<i32> {
    let keywords = PyDict::new(py);
    let paths: Vec<_> = arguments.paths.iter().map(|path| path.as_os_str()).collect();
    keywords.set_item("paths", paths)?;
    keywords.set_item("out", arguments.out.as_os_str())?;
    keywords.set_item("figures", arguments.figures.as_ref().map(|path| path.as_os_str()))?;
    keywords.set_item("title", &arguments.title)?;
    call(py, "dappo_batch.report", &keywords)
}

/// `dappo-batch sweep`.
pub fn sweep(py: Python<'_>, arguments: &GridArgs) -> PyResult<i32> {
    let keywords = PyDict::new(py);
    keywords.set_item("out", arguments.out.as_os_str())?;
    for (name, values) in [("grid", &arguments.grid), ("base", &arguments.base)] {
        let mapping = PyDict::new(py);
        for (key, value) in values {
            mapping.set_item(key, to_python(py, value)?)?;
        }
        keywords.set_item(name, mapping)?;
    }
    keywords.set_item("jobs", arguments.jobs.get())?;
    call(py, "dappo_batch.sweeps.command", &keywords)
}

/// `dappo-batch bench`.
pub fn bench(py: Python<'_>, arguments: &BenchArgs) -> PyResult<i32> {
    let keywords = PyDict::new(py);
    keywords.set_item("robot", &arguments.robot)?;
    keywords.set_item("num_envs", arguments.envs.get())?;
    keywords.set_item("threads", arguments.threads.map(Threads::get))?;
    keywords.set_item("seconds", arguments.seconds)?;
    keywords.set_item("rounds", arguments.rounds.get())?;
    keywords.set_item("json", arguments.json)?;
    call(py, "dappo_batch.bench", &keywords)
}

/// `dappo-batch doctor`.
pub fn doctor(py: Python<'_>, arguments: &DoctorArgs) -> PyResult<i32> {
    let keywords = PyDict::new(py);
    keywords.set_item("json", arguments.json)?;
    call(py, "dappo_batch.doctor", &keywords)
}

/// Calls the function `command` of a module; it returns the exit code.
fn call(py: Python<'_>, module: &str, keywords: &Bound<'_, PyDict>) -> PyResult<i32> {
    let command = py.import(module)?.getattr("command")?;
    py.import("dappo_batch.commands.output")?.getattr("written")?.call((command,), Some(keywords))?.extract()
}
