//! What a controller is made of, and how it is set.

use std::path::{Path, PathBuf};

use dappo_diagnose::controller::{ControllerConfig, Parts, Trigger};
use dappo_learn::config::Assignment;
use pyo3::prelude::*;

use super::OneOf;
use crate::controller;
use crate::keywords::arguments;
use crate::run_robot::OpenRun;

arguments! {
    /// The parts of a controller other than its policy, and its settings.
    pub struct ControllerArgs {
        /// Folder of a diagnoser that `diagnose train` made, best from records of this RUN with the preset
        /// residual, or observation
        #[arg(long, value_name = "DIR")]
        pub diagnoser: PathBuf,
        /// How it is used.
        #[command(flatten)]
        pub settings: DiagnosisArgs,
    }
}

arguments! {
    /// How a diagnoser is used.
    pub struct DiagnosisArgs {
        /// Run folder of the policy that walks during a diagnosis, the one whose records the diagnoser
        /// learned from [default: RUN with the code of no damage]
        #[arg(long, value_name = "RUN", requires = "diagnoser")]
        pub expert: Option<PathBuf>,
        /// What reveals damage: steps that differ from those of a simulated twin (residual), too low a speed, or
        /// diagnoses of the last observations without a twin (observation) [default: residual, or observation with a
        /// diagnoser of the preset observation]
        #[arg(long, requires = "diagnoser")]
        pub trigger: Option<OneOf<Trigger>>,
        /// Other settings of the controller, for example cooldown=100
        #[arg(long, value_name = "KEY=VALUE", num_args = 1.., requires = "diagnoser")]
        pub controller: Vec<Assignment>,
    }
}

impl ControllerArgs {
    /// Its parts other than the policy of a run.
    pub fn parts(&self, py: Python<'_>, run: &OpenRun) -> PyResult<Parts> {
        self.settings.parts(py, run, &self.diagnoser)
    }

    /// Its settings.
    pub fn config(&self) -> dappo_learn::Result<ControllerConfig> {
        self.settings.config()
    }
}

impl DiagnosisArgs {
    /// The parts of a controller with a diagnoser, other than the policy of a run.
    pub fn parts(&self, py: Python<'_>, run: &OpenRun, diagnoser: &Path) -> PyResult<Parts> {
        controller::open_parts(py, run, self.expert.as_deref(), diagnoser)
    }

    /// The settings of the controller.
    pub fn config(&self) -> dappo_learn::Result<ControllerConfig> {
        controller::settings(self.trigger.as_deref(), &self.controller)
    }
}
