//! `dappo-batch export`.

use std::path::Path;

use dappo_diagnose::export::{Export, ExportHeader, ExportedRun, Staged};
use pyo3::prelude::*;

use super::Caller;
use super::args::ExportArgs;
use crate::cli::console::print_line;
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
    // The copy must do without anything that lies beside the original.
    controller::open_export(py, &export, 1)
        .map_err(|error| raise(Kind::Config, format!("the robot cannot be exported: {}", error.value(py))))?;
    staged.commit().or_raise()?;
    if arguments.json {
        caller.object(export.header());
    } else {
        describe(export.header(), &arguments.out);
    }
    Ok(0)
}

fn describe(header: &ExportHeader, out: &Path) {
    let what = match &header.diagnoser {
        Some(diagnoser) => format!("a window of {} steps", diagnoser.timesteps),
        None => "a policy without a diagnoser".to_owned(),
    };
    print_line!(
        "{}: {} damage classes, {what}, control period {} s",
        header.robot,
        header.classes.len(),
        header.control_period
    );
    for (name, file) in &header.files {
        print_line!("  {name:<24} {:>10} bytes", file.bytes);
    }
    print_line!("{}", out.display());
}
