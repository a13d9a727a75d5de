//! The arguments of `render` and `view`.

use std::path::PathBuf;

use clap::Args;

use super::{AtLeast, Count, RobotArgs, SimulationArgs};

/// Arguments of `render`.
#[derive(Debug, Args)]
pub struct RenderArgs {
    /// The walk.
    #[command(flatten)]
    pub walk: WalkArgs,
    /// File to write: .mp4, .gif, or .png for a strip of frames
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
    /// Frames of a .png, evenly spaced from the first step to the last; 1 is the last
    #[arg(long, value_name = "N", allow_negative_numbers = true, default_value = "4")]
    pub strip: Count<1>,
}

/// The policy, the damage, the length of the walk, and the camera.
#[derive(Debug, Args)]
pub struct WalkArgs {
    /// Run folder of the policy; a damage-aware one gets the true damage code from the onset on
    #[arg(value_name = "RUN")]
    pub run: PathBuf,
    /// Damage: a name or an id that `dappo-batch classes` lists
    #[arg(long, value_name = "SPEC", default_value = "healthy")]
    pub damage: String,
    /// Step at which the damage strikes; 0 is the start
    #[arg(long, value_name = "STEP", allow_negative_numbers = true, default_value = "0")]
    pub at: Count<0>,
    /// Steps to show, unless the robot falls earlier
    #[arg(long, value_name = "N", allow_negative_numbers = true, default_value = "400")]
    pub steps: Count<1>,
    /// Seed of the initial state
    #[arg(long, value_name = "S", allow_negative_numbers = true, default_value = "0")]
    pub seed: AtLeast<0>,
    /// Folder of a diagnoser that `diagnose train` made: a controller diagnoses the damage and adapts the policy
    #[arg(long, value_name = "DIR")]
    pub diagnoser: Option<PathBuf>,
    /// Run folder of the policy that acts during a diagnosis window [default: RUN, with the healthy damage code]
    #[arg(long, value_name = "RUN", requires = "diagnoser")]
    pub expert: Option<PathBuf>,
    /// Camera: auto (on the side of the damaged limbs), left, right, front, back, or a camera of the MJCF
    #[arg(long, value_name = "CAMERA", default_value = "auto")]
    pub camera: String,
    /// The robot.
    #[command(flatten)]
    pub robot: RobotArgs,
    /// The simulation.
    #[command(flatten)]
    pub simulation: SimulationArgs,
}

/// The arguments of `dappo-batch view`.
#[derive(Debug, Args)]
pub struct ViewArgs {
    /// The walk.
    #[command(flatten)]
    pub walk: WalkArgs,
    /// Serve a page for browsers instead of opening a window
    #[arg(long)]
    pub browser: bool,
    /// Address of the page: localhost is for this machine alone, 0.0.0.0 for all that can reach it
    #[arg(long, requires = "browser", default_value = "localhost")]
    pub host: String,
    /// Port of the page, or the first free one after it
    #[arg(long, requires = "browser", value_name = "N", default_value = "8080")]
    pub port: u16,
}
