//! A run on its way into an export.

use std::path::Path;

use dappo_learn::RunPolicy;
use dappo_learn::config::Config;
use dappo_learn::envs::EnvFactory;
use dappo_learn::error::Result;
use dappo_learn::evaluate::MeanVelocities;
use dappo_learn::robot_files::RobotFiles;
use dappo_learn::run_folder::RunFolder;
use dappo_sim::task::Task;

use super::{Body, ClassHeader, Contents, RunSource, Sources, Staged};
use crate::Subject;
use crate::controller::{ControllerConfig, Parts};

/// A run whose policy is exported.
pub struct ExportedRun<'a> {
    /// Its folder.
    pub folder: &'a RunFolder,
    /// Its configuration.
    pub config: &'a Config,
    /// Simulates its robot.
    pub factory: &'a dyn EnvFactory,
    /// The files of its robot, see [`Body::files`].
    pub files: &'a RobotFiles,
    /// Version of MuJoCo.
    pub mujoco: &'a str,
}

impl ExportedRun<'_> {
    /// Writes a controller next to `out`: the policy of the run and these parts.
    pub fn stage_controller(&self, parts: &Parts, settings: &ControllerConfig, out: &Path) -> Result<Staged> {
        let (skills, sources) = parts.load(self.folder, self.config, self.factory)?;
        let robot = self.factory.backend(1, None, self.factory.evaluation_physics())?;
        let settings = settings.clone().resolved(skills.diagnoser.description())?;
        skills.check()?;
        skills.check_robot(robot.as_ref())?;
        let classes = classes(&skills.diagnoser.description().subject, skills.baselines.as_deref());
        let controller = Some((&skills, &settings));
        let (policy, body, config) = (&skills.policy, self.body(robot.task()), self.config);
        Contents { policy, classes, controller, body, config, sources }.stage(out)
    }

    /// Writes the policy alone next to `out`.
    pub fn stage_policy(&self, out: &Path) -> Result<Staged> {
        let policy = RunPolicy::trained(self.folder, self.config, self.factory)?;
        let subject = Subject::new(&self.factory.robot().name, self.factory.space());
        // A policy alone may not have been evaluated, or with other damage classes than its robot has now.
        let velocities = MeanVelocities::read(self.folder)?;
        let baselines = velocities.and_then(|velocities| velocities.of(&subject.class_names).ok());
        let classes = classes(&subject, baselines.as_deref());
        let robot = self.factory.backend(1, None, self.factory.evaluation_physics())?;
        let sources = Sources { policy: RunSource::of(self.folder, &policy)?, expert: None, diagnoser: None };
        let (policy, body, config) = (&policy.policy, self.body(robot.task()), self.config);
        Contents { policy, classes, controller: None, body, config, sources }.stage(out)
    }

    fn body<'a>(&'a self, task: &'a Task) -> Body<'a> {
        let Self { files, mujoco, .. } = self;
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
