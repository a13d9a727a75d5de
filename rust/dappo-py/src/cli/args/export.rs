//! The arguments of `export`.

use std::path::PathBuf;

use super::RobotArgs;
use super::controller::DiagnosisArgs;
use crate::keywords::arguments;

arguments! {
    /// Arguments of `export`.
    pub struct ExportArgs {
        /// Run folder of the policy; one for a controller observes the damage and has been evaluated
        #[arg(value_name = "RUN")]
        pub run: PathBuf,
        /// Folder of a diagnoser that `diagnose train` made, best from records of this RUN with the preset
        /// residual, or observation [default: none, the policy alone is exported]
        #[arg(long, value_name = "DIR")]
        pub diagnoser: Option<PathBuf>,
        /// The controller.
        #[command(flatten)]
        pub controller: DiagnosisArgs,
        /// The robot.
        #[command(flatten)]
        pub robot: RobotArgs,
        /// Folder to write; an earlier export there is replaced
        #[arg(long, value_name = "DIR")]
        pub out: PathBuf,
        /// Print the header of the export as JSON
        #[arg(long)]
        pub json: bool,
    }
}
