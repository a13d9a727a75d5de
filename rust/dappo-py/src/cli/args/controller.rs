//! What a controller is made of, and how it is set.

use std::path::PathBuf;

use clap::Args;
use dappo_learn::controller::{ControllerConfig, Trigger};

use crate::controller::{self, Parts};

/// The parts of a controller beside its policy, and its settings.
#[derive(Debug, Args)]
pub struct ControllerArgs {
    /// Folder of a diagnoser that `diagnose train` made, best from records of this RUN with the preset residual
    #[arg(long, value_name = "DIR")]
    pub diagnoser: PathBuf,
    /// Run folder of the policy that walks during a diagnosis, the one whose records the diagnoser learned from
    /// [default: RUN, as if nothing were damaged]
    #[arg(long, value_name = "RUN")]
    pub expert: Option<PathBuf>,
    /// What raises suspicion: steps that differ from those of a simulated twin (residual), or too low a speed
    #[arg(long, value_parser = Trigger::NAMES, default_value = Trigger::NAMES[0])]
    pub trigger: String,
    /// Other settings of the controller, for example cooldown=100
    #[arg(long = "controller", value_name = "KEY=VALUE", num_args = 1..)]
    pub settings: Vec<String>,
}

impl ControllerArgs {
    /// Where its parts lie.
    pub fn parts(&self) -> Parts<'_> {
        Parts { expert: self.expert.as_deref(), diagnoser: &self.diagnoser }
    }

    /// Its settings.
    pub fn config(&self) -> dappo_learn::Result<ControllerConfig> {
        controller::settings(&self.trigger, &self.settings)
    }
}
