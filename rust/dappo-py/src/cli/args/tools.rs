//! The arguments of the commands that are written in Python: `report`, `sweep`, `check`, `bench` and `doctor`. They are the
//! keywords of the function `command` there.

use std::borrow::Cow;
use std::path::PathBuf;

use clap::{ArgAction, Args};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use serde_json::Value;

use super::{Count, Threads};
use crate::factory::to_python;

/// Arguments of `report`.
#[derive(Debug, Args, IntoPyObjectRef)]
pub struct ReportArgs {
    /// A run folder, a folder of `sweep`, `evaluate --act`, `diagnose train` or `diagnose sweep`, or a trace of `adapt
    /// --log`; runs that differ in nothing but their seed are drawn as one learner
    #[arg(value_name = "PATH", required = true)]
    pub paths: Vec<PathBuf>,
    /// The page, which needs nothing else
    #[arg(long, value_name = "FILE", default_value = "report.html")]
    pub out: PathBuf,
    /// Write the figures into this folder, too, as PNG and SVG
    #[arg(long, value_name = "DIR")]
    pub figures: Option<PathBuf>,
    /// Write the table of all learners into this file, too
    #[arg(long, value_name = "FILE")]
    pub csv: Option<PathBuf>,
    /// Heading of the page
    #[arg(long, value_name = "TEXT", default_value = "dappo-batch report")]
    pub title: String,
    /// Leave out the film strips, which simulate every learner
    #[arg(long = "no-film-strips", action = ArgAction::SetFalse)]
    pub film_strips: bool,
}

/// Arguments of `sweep`.
#[derive(Debug, Args, IntoPyObjectRef)]
pub struct GridArgs {
    /// Folder of the sweep; the same command resumes it
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Values of a flag of `train` or of a setting, for example seed=0,1,2 unaware=false,true
    #[arg(long, value_name = "KEY=V1,V2", num_args = 1.., value_parser = values)]
    #[pyo3(into_py_with = mapping)]
    pub grid: Vec<(String, Value)>,
    /// What all trainings have in common
    #[arg(long, value_name = "KEY=VALUE", num_args = 1.., value_parser = value)]
    #[pyo3(into_py_with = mapping)]
    pub base: Vec<(String, Value)>,
    /// Trainings at once
    #[arg(long, value_name = "N", allow_negative_numbers = true, default_value = "1")]
    pub jobs: Threads,
}

/// Arguments of `check`.
#[derive(Debug, Args, IntoPyObjectRef)]
pub struct CheckArgs {
    /// Built-in robot or path of a robot file
    #[arg(value_name = "ROBOT")]
    pub robot: String,
    /// Damage types, comma separated [default: the robot's]
    #[arg(long, value_delimiter = ',', value_name = "TYPES")]
    pub types: Option<Vec<String>>,
    /// Largest number of damaged limbs [default: the robot's]
    #[arg(long, value_name = "M", allow_negative_numbers = true)]
    pub max_damaged_limbs: Option<usize>,
    /// Largest number of damages of a limb [default: the robot's]
    #[arg(long, value_name = "P", allow_negative_numbers = true)]
    pub max_damages_per_limb: Option<usize>,
    /// Write a PNG with a tile for each damage class, at most 36
    #[arg(long, value_name = "FILE")]
    pub picture: Option<PathBuf>,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}

/// Arguments of `bench`.
#[derive(Debug, Args, IntoPyObjectRef)]
pub struct BenchArgs {
    /// Built-in robot or path of a robot file
    #[arg(long, value_name = "NAME|FILE", default_value = "ant")]
    pub robot: String,
    /// Number of envs simulated at once
    #[arg(long, value_name = "N", allow_negative_numbers = true, default_value = "1024")]
    #[pyo3(item("num_envs"))]
    pub envs: Count<1>,
    /// Threads of each simulator [default: all cores]
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    pub threads: Option<Threads>,
    /// Least length of a sample, s
    #[arg(long, value_name = "S", allow_negative_numbers = true, value_parser = seconds, default_value = "2")]
    pub seconds: f64,
    /// Samples a simulator
    #[arg(long, value_name = "N", allow_negative_numbers = true, default_value = "5")]
    pub rounds: Count<1>,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}

/// Arguments of `doctor`.
#[derive(Debug, Args, IntoPyObjectRef)]
pub struct DoctorArgs {
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}

#[expect(clippy::owned_cow, reason = "PyO3 hands fields over as they are")]
#[expect(clippy::needless_pass_by_value, reason = "PyO3 hands fields over by value")]
fn mapping<'py>(values: Cow<'_, Vec<(String, Value)>>, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
    let mapping = PyDict::new(py);
    values.iter().try_for_each(|(key, value)| mapping.set_item(key, to_python(py, value)?))?;
    Ok(mapping.into_any())
}

/// Reads `key=value`: JSON, or else a text.
fn value(text: &str) -> Result<(String, Value), String> {
    let (key, value) = pair(text)?;
    Ok((key.to_owned(), json_or_text(value)))
}

/// Reads `key=value1,value2`.
fn values(text: &str) -> Result<(String, Value), String> {
    let (key, values) = pair(text)?;
    Ok((key.to_owned(), values.split(',').map(json_or_text).collect()))
}

fn pair(text: &str) -> Result<(&str, &str), String> {
    let pair = text.split_once('=').filter(|(key, value)| !key.is_empty() && !value.is_empty());
    pair.ok_or_else(|| format!("`{text}` is not an assignment; expected key=value, for example seed=0,1,2"))
}

fn json_or_text(text: &str) -> Value {
    serde_json::from_str(text).unwrap_or_else(|_| text.into())
}

/// Reads a time.
fn seconds(text: &str) -> Result<f64, String> {
    let seconds = text.parse().ok().filter(|&seconds: &f64| seconds > 0.0 && seconds.is_finite());
    seconds.ok_or_else(|| "expected a number of seconds above 0".to_owned())
}
