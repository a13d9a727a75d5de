//! The arguments of `export`.

use std::path::PathBuf;

use clap::Args;

use super::ControllerArgs;

/// Arguments of `export`.
#[derive(Debug, Args)]
pub struct ExportArgs {
    /// Run folder of a damage-aware policy that has been evaluated
    #[arg(value_name = "RUN")]
    pub run: PathBuf,
    /// The controller.
    #[command(flatten)]
    pub controller: ControllerArgs,
    /// Folder to write; an earlier export there is replaced
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
}
