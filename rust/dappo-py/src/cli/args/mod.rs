//! The arguments of every command.

mod adapt;
mod controller;
mod diagnose;
mod export;
mod render;
mod tools;

use std::path::PathBuf;

use clap::{Args, Parser, Subcommand};
use dappo_learn::config::{Assignment, EnvSection};
use dappo_learn::walk::Encoding;
use dappo_nn::LearnerDevice;
use dappo_sim::{BackendKind, Device, Precision};

pub use adapt::AdaptArgs;
pub use controller::ControllerArgs;
pub use diagnose::{
    CollectArgs, DiagnoseArgs, DiagnoseCommand, SweepArgs, TestDiagnoserArgs, TrainDiagnoserArgs,
};
pub use export::ExportArgs;
pub use render::{RenderArgs, ViewArgs, WalkArgs};
pub use tools::{BenchArgs, CheckArgs, DoctorArgs, GridArgs, ReportArgs};

use crate::keywords::arguments;
pub use crate::kinds::{AtLeast, Count, OneOf, Threads, Whole};
use crate::kinds::{Integrator, RobotChanged};
use crate::outside_policy::Function;

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
    /// Learn to classify the damage of a robot from a short walk
    Diagnose(DiagnoseArgs),
    /// Evaluate a controller that detects mid-episode damage, diagnoses it and adapts
    Adapt(Box<AdaptArgs>),
    /// Write all that a controller needs into one folder, with its networks as ONNX
    Export(ExportArgs),
    /// Draw a walk into a video, an animation or a picture
    Render(RenderArgs),
    /// Show a walk in a window or a browser, again and again
    View(ViewArgs),
    /// Draw runs, sweeps, diagnosers and traces into one HTML page
    Report(ReportArgs),
    /// Train every combination of a grid; a stopped sweep resumes
    Sweep(GridArgs),
    /// Compile a robot with all damage, and print what it is and what supports it
    Check(CheckArgs),
    /// List the damage classes of a robot
    Classes(ClassesArgs),
    /// Print the resolved configuration of a training run
    Config(ConfigArgs),
    /// Compare env steps per second with other simulators in one interleaved run
    Bench(BenchArgs),
    /// Print what is installed, what works and what to install
    Doctor(DoctorArgs),
}

arguments! {
    /// Where a configuration comes from; later sources win.
    pub struct ConfigArgs {
        /// Built-in robot or path of a robot file [default: the one of `dappo-batch config`]
        #[arg(long, value_name = "NAME|FILE")]
        pub robot: Option<String> => "robot",
        /// Configuration file instead of the robot's own in configs/
        #[arg(long, value_name = "FILE")]
        pub config: Option<PathBuf>,
        /// Number of envs simulated at once
        #[arg(long = "envs", visible_alias = "num-envs", value_name = "N", allow_negative_numbers = true)]
        pub num_envs: Option<Count<1>> => "env.num_envs",
        /// Env steps of the whole run
        #[arg(long = "steps", visible_alias = "total-steps", value_name = "N", allow_negative_numbers = true)]
        pub total_steps: Option<AtLeast<1>> => "total_steps",
        /// Seed of all random streams
        #[arg(long, value_name = "S", allow_negative_numbers = true)]
        pub seed: Option<AtLeast<0>> => "seed",
        /// Where to simulate: auto is a CUDA GPU where one can be used, gpu a GPU of any maker in builds with that
        /// feature, warp-cpu the kernels of cuda on the CPU, for tests
        #[arg(long)]
        pub device: Option<OneOf<Device>> => "env.device",
        /// Physics backend on the CPU
        #[arg(long)]
        pub backend: Option<OneOf<BackendKind>> => "env.backend",
        /// Precision of the backend lanes
        #[arg(long)]
        pub precision: Option<OneOf<Precision>> => "env.precision",
        /// Room for contacts and constraints on a GPU.
        #[command(flatten)]
        pub room: RoomArgs,
        /// Where to compute the networks; gpu needs a build with that feature
        #[arg(long)]
        pub learner: Option<OneOf<LearnerDevice>> => "ppo.device",
        /// Worker threads [default: all cores]
        #[arg(long, value_name = "N", allow_negative_numbers = true)]
        pub threads: Option<Threads> => "env.threads",
        /// Hide the damage code from the policy (PPO-Unaware), each episode of which draws its damage class
        #[arg(long)]
        pub unaware: bool,
        /// Let the policy observe the last N env steps instead of the last one
        #[arg(long, value_name = "N", allow_negative_numbers = true)]
        pub history: Option<Count<1>> => "env.history",
        /// Give the policy a memory of its observations: an LSTM of so many units
        #[arg(long, value_name = "UNITS", allow_negative_numbers = true)]
        pub lstm: Option<Count<1>> => "ppo.lstm",
        /// Train on the healthy robot alone (the expert)
        #[arg(long)]
        pub healthy: bool,
        /// Train on this damage alone (a specialist), for example `missing_toe@1`
        #[arg(long, value_name = "SPEC", conflicts_with = "healthy")]
        pub damage: Option<String>,
        /// Reward function of the robot, for example paper or gym
        #[arg(long, value_name = "NAME")]
        pub reward: Option<String> => "env.reward",
        /// Integrator, if not the robot's own; euler is faster and another physics
        #[arg(long)]
        pub physics: Option<OneOf<Integrator>> => "env.physics",
        /// Any other setting, for example ppo.gamma=0.99 (see `dappo-batch config`)
        #[arg(long = "set", value_name = "KEY=VALUE", num_args = 1..)]
        pub set: Vec<Assignment>,
    }
}

arguments! {
    /// Arguments of `train`.
    pub struct TrainArgs {
        /// The configuration.
        #[command(flatten)]
        pub config: ConfigArgs,
        /// Run folder [default: runs/ROBOT-SEED-TIME]
        #[arg(long, value_name = "DIR")]
        pub run: Option<PathBuf>,
        /// Resume an earlier run; --steps may extend it, --set change settings that its checkpoints do not
        /// depend on
        #[arg(long, value_name = "DIR", conflicts_with_all = ["run", "robot", "config", "num_envs", "seed", "device", "backend", "precision", "unaware", "history", "lstm", "healthy", "damage", "reward", "physics"])]
        pub resume: Option<PathBuf>,
        /// Where the robot file has changed since the run began [default: stop, and print what differs]
        #[arg(long, value_name = "WHICH", requires = "resume")]
        pub robot_changed: Option<RobotChanged>,
        /// Print one JSON object an iteration instead of a progress bar
        #[arg(long)]
        pub json: bool,
    }
}

arguments! {
    /// The robot of an earlier run.
    pub struct RobotArgs {
        /// Where the robot file has changed since the training [default: stop, and print what differs]
        #[arg(long, value_name = "WHICH")]
        pub robot_changed: Option<RobotChanged>,
    }
}

arguments! {
    /// How to simulate the robot of an earlier run.
    pub struct SimulationArgs {
        /// Where to simulate [default: the run's for evaluations, cpu]
        #[arg(long)]
        pub device: Option<OneOf<Device>>,
        /// Physics backend on the CPU [default: the run's]
        #[arg(long)]
        pub backend: Option<OneOf<BackendKind>>,
        /// Precision of the backend lanes [default: the run's for evaluations, f64]
        #[arg(long)]
        pub precision: Option<OneOf<Precision>>,
        /// Room for contacts and constraints on a GPU.
        #[command(flatten)]
        pub room: RoomArgs,
        /// Worker threads [default: all cores]
        #[arg(long, value_name = "N", allow_negative_numbers = true)]
        pub threads: Option<Threads>,
    }
}

impl SimulationArgs {
    /// Worker threads; all cores for `None`.
    pub fn threads(&self) -> Option<usize> {
        self.threads.map(Threads::count)
    }
}

arguments! {
    /// Room for contacts and constraints on a GPU, for robots that need more than is guessed.
    pub struct RoomArgs {
        /// Room for the constraints of an env on a GPU [default: what a limbed robot can need at most]
        #[arg(long, value_name = "N", allow_negative_numbers = true)]
        pub njmax: Option<Count<1>> => "env.njmax",
        /// Room for contacts there, an env on average [default: likewise]
        #[arg(long, value_name = "N", allow_negative_numbers = true)]
        pub nconmax: Option<Count<1>> => "env.nconmax",
    }
}

impl RoomArgs {
    /// Lays the flags over the settings of an earlier run.
    pub fn lay_over(&self, env: &mut EnvSection) {
        env.njmax = self.njmax.map(Count::count).or(env.njmax);
        env.nconmax = self.nconmax.map(Count::count).or(env.nconmax);
    }
}

arguments! {
    /// Arguments of `evaluate`.
    pub struct EvaluateArgs {
        /// Run folder; several are seeds of one learner
        #[arg(value_name = "RUN", required = true)]
        pub runs: Vec<PathBuf>,
        /// Other runs, of another learner or setting, to compare with; their policies are given the true
        /// damage code
        #[arg(long, value_name = "OTHER", num_args = 1..)]
        pub compare: Vec<PathBuf>,
        /// Python function that chooses the actions in the place of the policy of RUN: a policy of another learner
        #[arg(long, value_name = "MODULE:FUNCTION")]
        pub act: Option<Function>,
        /// Damage code of the policies of RUN: the true one, that of no damage, that of another damage, or
        /// noise
        #[arg(long, default_value = Encoding::True.name())]
        pub encoding: OneOf<Encoding>,
        /// Episodes a damage class [default: the run's]
        #[arg(long, value_name = "N", allow_negative_numbers = true)]
        pub episodes: Option<Count<1>>,
        /// Seed of the initial states [default: the run's]
        #[arg(long, value_name = "S", allow_negative_numbers = true)]
        pub seed: Option<AtLeast<0>>,
        /// Settings of the episodes that differ from those of the training, for example damage.severity=0.5
        #[arg(long = "set", value_name = "KEY=VALUE", num_args = 1..)]
        pub set: Vec<Assignment>,
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
    /// Largest number of damages of a limb [default: the robot's]
    #[arg(long, value_name = "P", allow_negative_numbers = true)]
    pub max_damages_per_limb: Option<usize>,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}
