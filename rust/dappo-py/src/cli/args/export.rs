//! The arguments of `export`.

use std::path::PathBuf;

use clap::Args;
use dappo_learn::controller::Trigger;

/// Arguments of `export`.
#[derive(Debug, Args)]
pub struct ExportArgs {
    /// Run folder of a damage-aware policy that has been evaluated
    #[arg(value_name = "RUN")]
    pub run: PathBuf,
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
    #[arg(long, value_name = "KEY=VALUE", num_args = 1..)]
    pub controller: Vec<String>,
    /// Folder to write; an earlier export there is replaced
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
}
