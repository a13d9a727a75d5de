//! `dappo-batch diagnose`.

mod collect;

use pyo3::prelude::*;

use super::args::{DiagnoseArgs, DiagnoseCommand};

pub fn run(py: Python<'_>, arguments: &DiagnoseArgs) -> PyResult<i32> {
    match &arguments.command {
        DiagnoseCommand::Collect(arguments) => collect::run(py, arguments),
    }
}
