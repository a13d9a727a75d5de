//! The arguments of `diagnose`.

use std::path::PathBuf;

use clap::{Args, Subcommand};
use dappo_diagnose::{Head, Method, Preset, Span, TwinAction};
use dappo_learn::config::Assignment;

use super::{AtLeast, Count, OneOf, RobotArgs, SimulationArgs, Threads, Whole};
use crate::keywords::arguments;
use crate::outside_policy::Function;

/// Arguments of `diagnose`.
#[derive(Debug, Args)]
#[command(arg_required_else_help = true)]
pub struct DiagnoseArgs {
    /// What to do.
    #[command(subcommand)]
    pub command: DiagnoseCommand,
}

/// The commands of `diagnose`.
#[derive(Debug, Subcommand)]
pub enum DiagnoseCommand {
    /// Record damaged robots and their healthy twins, or the robots alone
    Collect(Box<CollectArgs>),
    /// Train a network that classifies the damage from such records
    Train(TrainDiagnoserArgs),
    /// Test trained networks on records that they have not seen
    Test(TestDiagnoserArgs),
    /// Reproduce the paper's Table 1 of accuracies, from the expert to the last cell
    Sweep(SweepArgs),
}

arguments! {
    /// Arguments of `diagnose collect`.
    pub struct CollectArgs {
        /// Run folder of the policy that acts during the recording. For `adapt`: the damage-aware policy that will be
        /// adapted. For the paper's Table 1: an expert, trained with `train --healthy`
        #[arg(value_name = "RUN")]
        pub expert: PathBuf,
        /// Python function that chooses the actions in the place of the policy of RUN: a policy of another learner,
        /// whose actions depend on the current observations alone
        #[arg(long, value_name = "MODULE:FUNCTION")]
        pub act: Option<Function>,
        /// Folder of the dataset; one that holds rollouts of the same kind is continued
        #[arg(long, value_name = "DATA")]
        pub out: PathBuf,
        /// Rollouts, each with all damage classes from one start
        #[arg(long, value_name = "N", allow_negative_numbers = true, default_value = "1000")]
        pub rollouts: Count<1>,
        /// Steps that are recorded
        #[arg(long, value_name = "T", allow_negative_numbers = true, default_value = "50")]
        pub timesteps: Count<1>,
        /// Mid-episode damage and a twin that is re-synchronised before every step, as `adapt` needs it
        /// (residual), the same with a free-running twin (runtime), damage at the start of an episode
        /// (paper), or mid-episode damage without a twin (observation) [default: residual, or observation for
        /// robots that do not observe their whole state]
        #[arg(long)]
        pub preset: Option<OneOf<Preset>>,
        /// Steps of healthy walk before the damage, instead of the preset's
        #[arg(long, value_name = "FIRST-LAST")]
        pub onset: Option<Span>,
        /// Steps between the damage and the recording, without a twin to its end, instead of the preset's
        #[arg(long, value_name = "FIRST-LAST")]
        pub delay: Option<Span>,
        /// Run folder of the policy that walks before the recording [default: the expert]
        #[arg(long, value_name = "RUN")]
        pub policy: Option<PathBuf>,
        /// Whose actions the twin takes, its own or the damaged robot's, instead of the preset's
        #[arg(long)]
        pub twin_action: Option<OneOf<TwinAction>>,
        /// Steps after which the twin is re-synchronised, 0 for never, instead of the preset's
        #[arg(long, value_name = "STEPS", allow_negative_numbers = true)]
        pub resync: Option<Whole<0, { u32::MAX as i64 }>>,
        /// Seed of the rollouts
        #[arg(long, value_name = "S", allow_negative_numbers = true, default_value = "0")]
        pub seed: AtLeast<0>,
        /// Collect only piece i of n, for example 0/4; all pieces may go into one folder
        #[arg(long, value_name = "I/N", default_value = "0/1")]
        pub shard: String,
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

arguments! {
    /// Arguments of `diagnose train`.
    pub struct TrainDiagnoserArgs {
        /// Folder of a dataset that `diagnose collect` wrote
        #[arg(value_name = "DATA")]
        pub data: PathBuf,
        /// Folder of the training; the trained diagnoser will be in its folder model/
        #[arg(long, value_name = "DIR", required_unless_present = "resume")]
        pub out: Option<PathBuf>,
        /// Resume an earlier training on the same data
        #[arg(long, value_name = "DIR", conflicts_with_all = ["out", "method", "timesteps", "rollouts", "seed", "head", "held_out", "set"])]
        pub resume: Option<PathBuf>,
        /// What the network sees: A the damaged robot, B its difference to the twin, C both, D both and the action
        /// [default: B, or A for records without a twin]
        #[arg(long)]
        pub method: Option<OneOf<Method>> => "method",
        /// Steps that it sees [default: all of the data]
        #[arg(long, value_name = "T", allow_negative_numbers = true)]
        pub timesteps: Option<Count<1>> => "timesteps",
        /// Rollouts that are used, a fifth of them to validate on [default: all]
        #[arg(long, value_name = "N", allow_negative_numbers = true)]
        pub rollouts: Option<Count<2>> => "rollouts",
        /// Seed of split, weights and order
        #[arg(long, value_name = "S", allow_negative_numbers = true)]
        pub seed: Option<AtLeast<0>> => "seed",
        /// One output a damage class (classes), or one a limb and damage type (limbs)
        #[arg(long)]
        pub head: Option<OneOf<Head>> => "head",
        /// Damage classes that are never trained on, comma separated names or ids
        #[arg(long, value_name = "CLASSES", value_delimiter = ',')]
        pub held_out: Vec<String>,
        /// Any other setting, for example epochs=20 (see `config.toml` in the folder)
        #[arg(long = "set", value_name = "KEY=VALUE", num_args = 1..)]
        pub set: Vec<Assignment>,
        /// Worker threads [default: all cores]
        #[arg(long, value_name = "N", allow_negative_numbers = true)]
        pub threads: Option<Threads>,
        /// Print one JSON object an epoch instead of a progress bar
        #[arg(long)]
        pub json: bool,
    }
}

arguments! {
    /// Arguments of `diagnose test`.
    pub struct TestDiagnoserArgs {
        /// Folders of trainings; several make a table
        #[arg(value_name = "DIR", required = true)]
        pub models: Vec<PathBuf>,
        /// Datasets to test on, of another seed than the training data; several make a table
        #[arg(long, value_name = "DATA", required = true, num_args = 1..)]
        pub data: Vec<PathBuf>,
        /// Run folder of a damage-aware policy: also measure what the mistakes cost it
        #[arg(long, value_name = "RUN")]
        pub policy: Option<PathBuf>,
        /// Episodes a pair of true and diagnosed class, for --policy [default: the run's]
        #[arg(long, value_name = "N", allow_negative_numbers = true, requires = "policy")]
        pub episodes: Option<Count<1>>,
        /// The robot, for --policy.
        #[command(flatten)]
        pub robot: RobotArgs,
        /// Worker threads [default: all cores]
        #[arg(long, value_name = "N", allow_negative_numbers = true)]
        pub threads: Option<Threads>,
        /// Print JSON
        #[arg(long)]
        pub json: bool,
    }
}

/// Arguments of `diagnose sweep`.
#[derive(Debug, Args)]
pub struct SweepArgs {
    /// Built-in robot or path of a robot file, for the expert [default: the one of `dappo-batch config`]
    #[arg(long, value_name = "NAME|FILE")]
    pub robot: Option<String>,
    /// Folder of the sweep: expert, datasets, cells and table; one that exists is continued
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Run folder of the expert [default: trained into the folder of the sweep]
    #[arg(long, value_name = "RUN", conflicts_with = "robot")]
    pub expert: Option<PathBuf>,
    /// Env steps of the expert's training
    #[arg(long, value_name = "N", allow_negative_numbers = true, default_value = "6291456")]
    pub expert_steps: AtLeast<1>,
    /// Window lengths
    #[arg(long, value_delimiter = ',', default_value = "10,30,50")]
    pub timesteps: Vec<Count<1>>,
    /// What the networks see
    #[arg(long, value_delimiter = ',', default_value = "A,B")]
    pub methods: Vec<OneOf<Method>>,
    /// Numbers of rollouts
    #[arg(long, value_delimiter = ',', default_value = "1000,2000,7000")]
    pub rollouts: Vec<Count<2>>,
    /// Rollouts, of another seed, that all cells are tested on
    #[arg(long, value_name = "N", allow_negative_numbers = true, default_value = "500")]
    pub test_rollouts: Count<2>,
    /// Seeds of every cell
    #[arg(long, value_name = "N", allow_negative_numbers = true, default_value = "5")]
    pub seeds: Whole<1, 10_000>,
    /// Samples that a cell is trained on, about, counting each time it is seen
    #[arg(long, value_name = "N", allow_negative_numbers = true, default_value = "600000")]
    pub samples: AtLeast<1>,
    /// Any other setting of the trainings, for example dropout=0.2
    #[arg(long = "set", value_name = "KEY=VALUE", num_args = 1..)]
    pub set: Vec<Assignment>,
    /// The robot of an expert that exists.
    #[command(flatten)]
    pub changed: RobotArgs,
    /// Cells trained side by side, each on one thread, and worker threads of what comes before them
    /// [default: the number of cores]
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    pub jobs: Option<Threads>,
}
