//! The arguments of `diagnose`.

use std::path::PathBuf;

use clap::{Args, Subcommand};
use dappo_learn::diagnose::Preset;

use super::{BACKENDS, PRECISIONS, at_least};

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
    /// Let damaged robots and their healthy twins walk, and record both
    Collect(Box<CollectArgs>),
}

/// Arguments of `diagnose collect`.
#[derive(Debug, Args)]
pub struct CollectArgs {
    /// Run folder of the expert, a policy trained with `train --healthy`; its robot and damage settings are used
    #[arg(value_name = "RUN")]
    pub expert: PathBuf,
    /// Folder of the dataset; one that holds rollouts of the same kind is continued
    #[arg(long, value_name = "DATA")]
    pub out: PathBuf,
    /// Rollouts, each with all damage classes from one start
    #[arg(long, value_name = "N", allow_negative_numbers = true, value_parser = at_least(1), default_value = "1000")]
    pub rollouts: i64,
    /// Steps that are recorded
    #[arg(long, value_name = "T", allow_negative_numbers = true, value_parser = at_least(1), default_value = "50")]
    pub timesteps: i64,
    /// Damage at the start of a rollout (paper), in mid-gait with a delayed diagnosis (runtime), or the same with a
    /// twin that is put beside the robot before every step (residual)
    #[arg(long, value_parser = Preset::NAMES, default_value = Preset::NAMES[0])]
    pub preset: String,
    /// Steps of healthy walk before the damage, instead of the preset's
    #[arg(long, value_name = "FIRST-LAST", value_parser = span)]
    pub onset: Option<(u32, u32)>,
    /// Steps between the damage and the recording, instead of the preset's
    #[arg(long, value_name = "FIRST-LAST", value_parser = span)]
    pub delay: Option<(u32, u32)>,
    /// Run folder of the policy that walks before the recording [default: the expert]
    #[arg(long, value_name = "RUN")]
    pub walker: Option<PathBuf>,
    /// Whose actions the twin takes, its own or the damaged robot's, instead of the preset's
    #[arg(long, value_parser = ["own", "shared"])]
    pub twin_action: Option<String>,
    /// Steps after which the twin is put beside the robot again, 0 for never, instead of the preset's
    #[arg(long, value_name = "STEPS", allow_negative_numbers = true)]
    pub resync: Option<u32>,
    /// Seed of the rollouts
    #[arg(long, value_name = "S", allow_negative_numbers = true, value_parser = at_least(0), default_value = "0")]
    pub seed: i64,
    /// Collect only piece i of n, for example 0/4; all pieces may go into one folder
    #[arg(long, value_name = "I/N", default_value = "0/1")]
    pub shard: String,
    /// Physics backend [default: the run's]
    #[arg(long, value_parser = BACKENDS)]
    pub backend: Option<String>,
    /// Precision of the backend lanes [default: the run's for evaluations, f64]
    #[arg(long, value_parser = PRECISIONS)]
    pub precision: Option<String>,
    /// Worker threads [default: all cores]
    #[arg(long, value_name = "N", allow_negative_numbers = true, value_parser = at_least(1))]
    pub threads: Option<i64>,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}

/// Reads `20-150`, or one number.
fn span(text: &str) -> Result<(u32, u32), String> {
    let (first, last) = text.split_once('-').unwrap_or((text, text));
    match (first.parse(), last.parse()) {
        (Ok(first), Ok(last)) => Ok((first, last)),
        _ => Err("expected a number of steps, or a range such as 20-150".to_owned()),
    }
}
