//! `dappo-batch export`.

use std::path::Path;

use dappo_diagnose::Subject;
use dappo_diagnose::controller::ControllerConfig;
use dappo_diagnose::export::{Body, ClassHeader, Contents, Export, ExportHeader, Sources, Staged};
use dappo_learn::Result;
use dappo_learn::config::Config;
use dappo_learn::envs::EnvFactory;
use dappo_learn::evaluate::MeanVelocities;
use dappo_learn::robot_files::RobotFiles;
use dappo_learn::run_folder::RunFolder;
use dappo_sim::terms::Task;
use pyo3::prelude::*;

use super::Caller;
use super::args::ExportArgs;
use crate::cli::console::print_line;
use crate::controller::{self, Parts, load_policy};
use crate::errors::{Kind, OrRaise, raise};
use crate::factory::TableFactory;
use crate::pool::Pool;
use crate::run_robot::OpenRun;

/// What Python knows about the robot.
struct RobotInPython {
    files: RobotFiles,
    mujoco: String,
}

pub fn run(py: Python<'_>, arguments: &ExportArgs, caller: &Caller) -> PyResult<i32> {
    let wanted = arguments.controller.config().or_raise()?;
    Staged::check(&arguments.out).or_raise()?;
    let run = OpenRun::open(py, &arguments.run, arguments.robot.robot_changed)?;
    let diagnoser = arguments.diagnoser.as_deref();
    let parts = diagnoser.map(|diagnoser| arguments.controller.parts(py, &run, diagnoser)).transpose()?;
    let factory = TableFactory::compile(py, &run.config)?;
    let robot = RobotInPython {
        files: run.robot.files(py)?,
        mujoco: py.import("mujoco")?.getattr("__version__")?.extract()?,
    };
    let exported = Exported { folder: &run.folder, config: &run.config, factory: &factory, robot };
    // There is nothing here for a second one to do.
    let pool = Pool::new(Some(1))?;
    let staged = pool.run(py, || match &parts {
        Some(parts) => exported.stage_controller(&arguments.out, parts, &wanted),
        None => exported.stage_policy(&arguments.out),
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

/// A run whose policy is exported.
struct Exported<'a> {
    folder: &'a RunFolder,
    config: &'a Config,
    factory: &'a TableFactory,
    robot: RobotInPython,
}

impl Exported<'_> {
    fn stage_controller(&self, out: &Path, parts: &Parts, wanted: &ControllerConfig) -> Result<Staged> {
        let (skills, sources) = parts.load(self.folder, self.config, self.factory)?;
        let twins = self.factory.backend(1, None, self.factory.evaluation_physics())?;
        skills.check(twins.as_ref())?;
        let subject = &skills.diagnoser.description().subject;
        let classes = classes(subject, Some(&skills.baselines));
        let controller = Some((&skills, wanted));
        let (policy, body, config) = (&skills.policy, self.body(twins.task()), self.config);
        Contents { policy, classes, controller, body, config, sources }.stage(out)
    }

    fn stage_policy(&self, out: &Path) -> Result<Staged> {
        let (policy, source) = load_policy(self.folder, self.config, self.factory)?;
        let subject = Subject::new(&self.factory.robot().name, self.factory.space());
        // A policy alone need not have been evaluated, nor with the damage classes that its robot has now.
        let velocities = MeanVelocities::read(self.folder)?;
        let baselines = velocities.and_then(|velocities| velocities.of(&subject.class_names).ok());
        let classes = classes(&subject, baselines.as_deref());
        let robot = self.factory.backend(1, None, self.factory.evaluation_physics())?;
        let sources = Sources { policy: source, expert: None, diagnoser: None };
        let (policy, body, config) = (&policy, self.body(robot.task()), self.config);
        Contents { policy, classes, controller: None, body, config, sources }.stage(out)
    }

    fn body<'a>(&'a self, task: &'a Task) -> Body<'a> {
        let RobotInPython { files, mujoco } = &self.robot;
        let (robot, integrator) = (self.factory.robot(), self.factory.integrator());
        Body { robot, files, task, integrator, mujoco }
    }
}

fn classes(subject: &Subject, baselines: Option<&[f64]>) -> Vec<ClassHeader> {
    let class = |(index, (name, code)): (usize, (&String, &Vec<u8>))| ClassHeader {
        name: name.clone(),
        code: code.clone(),
        baseline: baselines.and_then(|baselines| baselines.get(index).copied()),
    };
    subject.class_names.iter().zip(&subject.codes).enumerate().map(class).collect()
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
