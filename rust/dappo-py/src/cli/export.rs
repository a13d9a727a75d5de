//! `dappo-batch export`.

use dappo_diagnose::export::{Export, ExportedRun, Staged};
use pyo3::prelude::*;

use super::args::ExportArgs;
use super::{Caller, console};
use crate::controller;
use crate::errors::{Kind, OrRaise, raise};
use crate::factory::{TableFactory, mujoco_version};
use crate::pool::Pool;
use crate::run_robot::OpenRun;

pub fn run(py: Python<'_>, arguments: &ExportArgs, caller: &Caller) -> PyResult<i32> {
    let wanted = arguments.controller.config().or_raise()?;
    Staged::check(&arguments.out).or_raise()?;
    let run = OpenRun::open(py, &arguments.run, arguments.robot.robot_changed)?;
    let diagnoser = arguments.diagnoser.as_deref();
    let parts = diagnoser.map(|diagnoser| arguments.controller.parts(py, &run, diagnoser)).transpose()?;
    let factory = TableFactory::compile(py, &run.config)?;
    let (files, mujoco) = (&run.robot.files(py)?, &mujoco_version(py)?);
    // There is nothing here for a second thread to do.
    let staged = Pool::new(Some(1))?.run(py, || {
        let (folder, config) = (&run.folder, &run.config);
        let exported = ExportedRun { folder, config, factory: &factory, files, mujoco };
        match &parts {
            Some(parts) => exported.stage_controller(parts, &wanted, &arguments.out),
            None => exported.stage_policy(&arguments.out),
        }
    })?;
    let export = Export::open(staged.folder()).or_raise()?;
    // The copy must not need anything next to the original.
    controller::open_export(py, &export, 1)
        .map_err(|error| raise(Kind::Config, format!("the robot cannot be exported: {}", error.value(py))))?;
    staged.commit().or_raise()?;
    if arguments.json {
        caller.object(export.header());
    } else {
        console::print(&export.header().text());
        console::write_line(&arguments.out.display().to_string());
    }
    Ok(0)
}
