//! The arguments of `adapt`.

use std::path::PathBuf;

use dappo_learn::config::Assignment;

use super::{AtLeast, ControllerArgs, Count, RobotArgs, SimulationArgs};
use crate::keywords::arguments;
use crate::outside_policy::Function;

arguments! {
    /// Arguments of `adapt`.
    pub struct AdaptArgs {
        /// Run folder of a damage-aware policy that has been evaluated
        #[arg(value_name = "RUN")]
        pub run: PathBuf,
        /// The controller.
        #[command(flatten)]
        pub controller: ControllerArgs,
        /// Run folder of a policy that was trained with --unaware, to compare with
        #[arg(long, value_name = "RUN")]
        pub unaware: Option<PathBuf>,
        /// Python function in the place of such a policy, which chooses the actions of all robots from their observations
        #[arg(long, value_name = "MODULE:FUNCTION", conflicts_with = "unaware")]
        pub act: Option<Function>,
        /// The damage that strikes: a name or an id that `dappo-batch classes` lists
        #[arg(long, value_name = "SPEC", required_unless_present = "all_classes")]
        pub damage: Option<String>,
        /// Every damage class in turn, the healthy one included; tables go into RUN/eval/
        #[arg(long, conflicts_with = "damage")]
        pub all_classes: bool,
        /// Step at which the damage strikes
        #[arg(long, value_name = "STEP", allow_negative_numbers = true, default_value = "300")]
        pub at: Count<1>,
        /// Episodes a damage class
        #[arg(long, value_name = "N", allow_negative_numbers = true, default_value = "20")]
        pub episodes: Count<1>,
        /// Seed of the initial states
        #[arg(long, value_name = "S", allow_negative_numbers = true, default_value = "0")]
        pub seed: AtLeast<0>,
        /// Settings of the robot that are unknown to the controller, for example damage.severity=0.5
        #[arg(long = "set", value_name = "KEY=VALUE", num_args = 1..)]
        pub set: Vec<Assignment>,
        /// Write the first episode step by step, as CSV
        #[arg(long, value_name = "FILE", conflicts_with = "all_classes")]
        pub log: Option<PathBuf>,
        /// Draw the first episode into a file: .mp4, .gif, or .png for a strip of frames
        #[arg(long, value_name = "FILE", conflicts_with = "all_classes")]
        pub video: Option<PathBuf>,
        /// Camera of the video: auto (on the side of the damaged limbs), left, right, front, back, or a camera of the
        /// MJCF
        #[arg(long, value_name = "CAMERA", default_value = "auto", requires = "video")]
        pub camera: String,
        /// The robot.
        #[command(flatten)]
        pub robot: RobotArgs,
        /// The simulation.
        #[command(flatten)]
        pub simulation: SimulationArgs,
        /// Print JSON
        #[arg(long)]
        pub json: bool,
    }
}
