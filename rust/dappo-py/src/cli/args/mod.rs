//! The arguments of every command.

mod adapt;
mod controller;
mod diagnose;
mod export;
mod render;

use std::ffi::OsString;
use std::path::PathBuf;

use clap::{Args, Parser, Subcommand};
use dappo_learn::LearnerDevice;
use dappo_learn::config::MOST_THREADS;
use dappo_learn::evaluate::Encoding;

pub use adapt::AdaptArgs;
pub use controller::ControllerArgs;
pub use diagnose::{
    CollectArgs, DiagnoseArgs, DiagnoseCommand, SweepArgs, TestDiagnoserArgs, TrainDiagnoserArgs,
};
pub use export::ExportArgs;
pub use render::{RenderArgs, ViewArgs, WalkArgs};

use crate::run_robot::RobotChanged;

/// Thousands of damage-randomised robots in MuJoCo: train, evaluate, measure.
#[derive(Debug, Parser)]
#[command(name = "dappo-batch", version, arg_required_else_help = true, max_term_width = 100)]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
}

/// The commands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Train a damage-aware policy into a run folder
    Train(Box<TrainArgs>),
    /// Run trained policies on every damage class, and compare learners
    Evaluate(EvaluateArgs),
    /// Learn to tell the damage of a robot from a short walk
    Diagnose(DiagnoseArgs),
    /// Let damage strike in mid-walk, and see how a controller finds out and walks on
    Adapt(Box<AdaptArgs>),
    /// Write all that a controller needs into one folder, with its networks as ONNX
    Export(ExportArgs),
    /// Draw a walk into a video, an animation or a picture
    Render(RenderArgs),
    /// Show a walk in a window or a browser, again and again
    View(ViewArgs),
    /// Draw runs, sweeps, diagnosers and traces into one HTML page
    #[command(disable_help_flag = true)]
    Report(ForwardedArgs),
    /// Train every combination of a grid, and go on where it was stopped
    #[command(disable_help_flag = true)]
    Sweep(ForwardedArgs),
    /// List the damage classes of a robot
    Classes(ClassesArgs),
    /// Print the resolved configuration of a training run
    Config(ConfigArgs),
    /// Compare env steps per second with other simulators in one interleaved run
    #[command(disable_help_flag = true)]
    Bench(ForwardedArgs),
    /// Say what is installed, what works and what to install
    #[command(disable_help_flag = true)]
    Doctor(ForwardedArgs),
}

/// Reads a number with a lower bound; TOML, which the configuration is written in, ends at 2⁶³ − 1.
fn at_least(minimum: i64) -> impl Fn(&str) -> Result<i64, String> + Clone {
    within(minimum, i64::MAX)
}

/// Reads a number between two bounds.
fn within(minimum: i64, maximum: i64) -> impl Fn(&str) -> Result<i64, String> + Clone {
    move |text| {
        let number = text.parse().ok().filter(|number| (minimum..=maximum).contains(number));
        number.ok_or_else(|| format!("expected a whole number of at least {minimum} and at most {maximum}"))
    }
}

/// Reads a number of threads or processes.
fn threads() -> impl Fn(&str) -> Result<i64, String> + Clone {
    within(1, MOST_THREADS as i64)
}

/// Reads a number of things that are counted with 31 bits.
fn count(minimum: i64) -> impl Fn(&str) -> Result<i64, String> + Clone {
    within(minimum, i64::from(i32::MAX))
}

const DEVICES: [&str; 4] = ["auto", "cpu", "cuda", "warp-cpu"];
const BACKENDS: [&str; 3] = ["auto", "lanes", "mujoco"];
const PRECISIONS: [&str; 2] = ["f32", "f64"];

/// Where a configuration comes from; later sources win.
#[derive(Debug, Args)]
pub struct ConfigArgs {
    /// Built-in robot or path of a robot file [default: the one of `dappo-batch config`]
    #[arg(long, value_name = "NAME|FILE")]
    pub robot: Option<String>,
    /// Configuration file instead of the robot's own in configs/
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Number of envs simulated at once
    #[arg(long, value_name = "N", allow_negative_numbers = true, value_parser = count(1))]
    pub envs: Option<i64>,
    /// Env steps of the whole run
    #[arg(long, value_name = "N", allow_negative_numbers = true, value_parser = at_least(1))]
    pub steps: Option<i64>,
    /// Seed of all random streams
    #[arg(long, value_name = "S", allow_negative_numbers = true, value_parser = at_least(0))]
    pub seed: Option<i64>,
    /// Where to simulate: auto is a CUDA GPU where one can be used, warp-cpu its kernels on the CPU, for tests
    #[arg(long, value_parser = DEVICES)]
    pub device: Option<String>,
    /// Physics backend on the CPU
    #[arg(long, value_parser = BACKENDS)]
    pub backend: Option<String>,
    /// Precision of the backend lanes
    #[arg(long, value_parser = PRECISIONS)]
    pub precision: Option<String>,
    /// Where to compute the networks; wgpu needs a build with that feature
    #[arg(long, value_parser = LearnerDevice::ALL.map(LearnerDevice::name))]
    pub learner: Option<String>,
    /// Worker threads [default: all cores]
    #[arg(long, value_name = "N", allow_negative_numbers = true, value_parser = threads())]
    pub threads: Option<i64>,
    /// Hide the damage code from the policy (PPO-Unaware)
    #[arg(long)]
    pub unaware: bool,
    /// Train on the healthy robot alone (the expert)
    #[arg(long)]
    pub healthy: bool,
    /// Reward function of the robot, for example paper or gym
    #[arg(long, value_name = "NAME")]
    pub reward: Option<String>,
    /// Integrator, if not the robot's own; euler is faster and another physics
    #[arg(long, value_parser = ["rk4", "euler"])]
    pub physics: Option<String>,
    /// Any other setting, for example ppo.gamma=0.99 (see `dappo-batch config`)
    #[arg(long = "set", value_name = "KEY=VALUE", num_args = 1..)]
    pub set: Vec<String>,
}

/// Arguments of `train`.
#[derive(Debug, Args)]
pub struct TrainArgs {
    /// The configuration.
    #[command(flatten)]
    pub config: ConfigArgs,
    /// Run folder [default: runs/ROBOT-SEED-TIME]
    #[arg(long, value_name = "DIR")]
    pub run: Option<PathBuf>,
    /// Go on with an earlier run; --steps may extend it, --set change settings that its checkpoints do not depend on
    #[arg(long, value_name = "DIR", conflicts_with_all = ["run", "robot", "config", "envs", "seed", "device", "backend", "precision", "unaware", "healthy", "reward", "physics"])]
    pub resume: Option<PathBuf>,
    /// Where the robot file has changed since the run began [default: stop, and say what differs]
    #[arg(long, value_name = "WHICH", requires = "resume")]
    pub robot_changed: Option<RobotChanged>,
    /// Print one JSON object an iteration instead of a progress bar
    #[arg(long)]
    pub json: bool,
}

/// Which robot an earlier run means.
#[derive(Debug, Args)]
pub struct RobotArgs {
    /// Where the robot file has changed since the training [default: stop, and say what differs]
    #[arg(long, value_name = "WHICH")]
    pub robot_changed: Option<RobotChanged>,
}

/// How to simulate the robot of an earlier run.
#[derive(Debug, Args)]
pub struct SimulationArgs {
    /// Where to simulate [default: the run's for evaluations, cpu]
    #[arg(long, value_parser = DEVICES)]
    pub device: Option<String>,
    /// Physics backend on the CPU [default: the run's]
    #[arg(long, value_parser = BACKENDS)]
    pub backend: Option<String>,
    /// Precision of the backend lanes [default: the run's for evaluations, f64]
    #[arg(long, value_parser = PRECISIONS)]
    pub precision: Option<String>,
    /// Worker threads [default: all cores]
    #[arg(long, value_name = "N", allow_negative_numbers = true, value_parser = threads())]
    pub threads: Option<i64>,
}

impl SimulationArgs {
    /// Worker threads; all cores for `None`.
    pub fn threads(&self) -> Option<usize> {
        self.threads.map(|threads| threads as usize)
    }
}

/// Arguments of `evaluate`.
#[derive(Debug, Args)]
pub struct EvaluateArgs {
    /// Run folder; several are seeds of one learner
    #[arg(value_name = "RUN", required = true)]
    pub runs: Vec<PathBuf>,
    /// Other runs, of another learner or setting, to compare with; their policies are told the truth
    #[arg(long, value_name = "OTHER", num_args = 1..)]
    pub compare: Vec<PathBuf>,
    /// What the policies of RUN are told: the truth, that nothing is damaged, another damage, or noise
    #[arg(long, value_parser = Encoding::ALL.map(Encoding::name), default_value = Encoding::True.name())]
    pub encoding: String,
    /// Episodes a damage class [default: the run's]
    #[arg(long, value_name = "N", allow_negative_numbers = true, value_parser = count(1))]
    pub episodes: Option<i64>,
    /// Seed of the initial states [default: the run's]
    #[arg(long, value_name = "S", allow_negative_numbers = true)]
    pub seed: Option<u64>,
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

/// Arguments of `classes`.
#[derive(Debug, Args)]
pub struct ClassesArgs {
    /// Built-in robot or path of a robot file [default: the one of `dappo-batch config`]
    #[arg(long, value_name = "NAME|FILE")]
    pub robot: Option<String>,
    /// Damage types, comma separated [default: the robot's]
    #[arg(long, value_delimiter = ',', value_name = "TYPES")]
    pub types: Option<Vec<String>>,
    /// Largest number of damaged limbs [default: the robot's]
    #[arg(long, value_name = "M", allow_negative_numbers = true)]
    pub max_damaged_limbs: Option<usize>,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}

/// Arguments that a Python module reads.
#[derive(Debug, Args)]
pub struct ForwardedArgs {
    /// Everything after the command's name
    #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
    pub arguments: Vec<OsString>,
}
