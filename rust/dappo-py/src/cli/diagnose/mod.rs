//! `dappo-batch diagnose`.

mod collect;
mod sweep;
mod test;
mod train;

use pyo3::prelude::*;

use super::Caller;
use super::args::{DiagnoseArgs, DiagnoseCommand};

pub fn run(py: Python<'_>, arguments: &DiagnoseArgs, caller: &Caller) -> PyResult<i32> {
    match &arguments.command {
        DiagnoseCommand::Collect(arguments) => collect::run(py, arguments, caller),
        DiagnoseCommand::Train(arguments) => train::run(py, arguments, caller),
        DiagnoseCommand::Test(arguments) => test::run(py, arguments, caller),
        DiagnoseCommand::Sweep(arguments) => sweep::run(py, arguments, caller),
    }
}
