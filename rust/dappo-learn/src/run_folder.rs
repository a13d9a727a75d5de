//! The run folder: `config.toml meta.json robot/ metrics.jsonl checkpoints/ eval/`.

use std::fs::{self, File};
use std::io::ErrorKind;
use std::ops::Deref;
use std::path::{Path, PathBuf};

use serde::Serialize;

use crate::checkpoint::Progress;
use crate::config::{Change, Config, Layers, changes};
use crate::error::{LearnError, Result};
use crate::files::{self, check_folder, io, own_folder, read_text, write_atomically};
use crate::metrics::{Metrics, MetricsLog};
use crate::robot_files::{RobotFiles, keep};
use crate::simulator::Simulator;

/// Letters at most of a setting's value in the name of a folder.
const LONGEST_VALUE: usize = 60;

/// The folder of one training run.
#[derive(Debug, Clone)]
pub struct RunFolder {
    root: PathBuf,
}

/// What made the run, for later readers.
#[derive(Debug, Clone, Serialize)]
pub struct Meta {
    /// Version of this program.
    pub version: String,
    /// Version of MuJoCo.
    pub mujoco: String,
    /// What simulates the training.
    #[serde(flatten)]
    pub simulator: Simulator,
    /// Name of the reward function.
    pub reward: String,
    /// Worker threads.
    pub threads: usize,
    /// Operating system and processor architecture.
    pub platform: String,
    /// Name of the processor.
    pub cpu: String,
    /// Vector instruction set of the lane engine and of the networks.
    pub simd: String,
    /// The command that started the run.
    pub command: Vec<String>,
}

/// A setting that changed when the run went on, in `meta.json`.
#[derive(Serialize)]
struct ChangeRecord {
    /// Iterations and env steps done before.
    iteration: u64,
    env_steps: u64,
    #[serde(flatten)]
    change: Change,
}

impl RunFolder {
    /// Makes a new run folder; refuses one that already holds a run.
    pub fn create(root: &Path, config: &Config, meta: &Meta, robot: &RobotFiles) -> Result<LockedRun> {
        fs::create_dir_all(root).map_err(io(root))?;
        // Its contents are read only under the lock: of two processes that begin together, one makes the run.
        let run = Self { root: root.to_owned() }.lock()?;
        if run.config_path().exists() {
            return Err(LearnError::Invalid(format!(
                "{} already holds a run; choose another folder with --run, or resume it with --resume",
                root.display()
            )));
        }
        own_folder(&run.checkpoints())?;
        run.write_meta(meta)?;
        run.keep_robot(robot)?;
        // The configuration makes it a run, so it comes last: a kill before leaves a folder that can be used again.
        write_atomically(&run.config_path(), config.to_toml()?.as_bytes())?;
        Ok(run)
    }

    /// Opens the folder of an earlier run and reads its configuration.
    pub fn open(root: &Path) -> Result<(Self, Config)> {
        let run = Self { root: root.to_owned() };
        let path = run.config_path();
        if !path.exists() {
            return Err(LearnError::Invalid(format!(
                "{} is not a run folder: it has no config.toml; `dappo-batch train` makes one",
                root.display()
            )));
        }
        let text = read_text(&path).map_err(io(&path))?;
        let mut layers = Layers::default();
        layers.add_toml(&text, &path.display().to_string())?;
        Ok((run, layers.resolve()?))
    }

    /// The folder itself.
    #[must_use]
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// Locks the run for training; refuses one that another process trains.
    pub fn lock(self) -> Result<LockedRun> {
        let path = self.root.join("lock");
        let Some(lock) = files::lock(&path)? else {
            return Err(LearnError::Invalid(format!(
                "{} is being trained by another process; wait for its end, or choose another folder",
                self.root.display()
            )));
        };
        Ok(LockedRun { folder: self, _lock: lock })
    }

    fn config_path(&self) -> PathBuf {
        self.root.join("config.toml")
    }

    /// Folder of the checkpoints.
    #[must_use]
    pub fn checkpoints(&self) -> PathBuf {
        self.root.join("checkpoints")
    }

    /// Folder of the evaluation with the settings of the run itself.
    #[must_use]
    pub fn evaluation(&self) -> EvaluationFolder {
        EvaluationFolder { path: self.root.join("eval") }
    }

    /// Folder of an evaluation with `config`: that of the run itself, or a folder in it, which the settings that differ
    /// from those of the run give its name, after that of the policy if it is not the run's.
    pub fn evaluation_with(&self, config: &Config, policy: Option<&str>) -> Result<EvaluationFolder> {
        let (_, own) = Self::open(&self.root)?;
        let mut names: Vec<String> = policy.map(|name| format!("act-{name}")).into_iter().collect();
        for Change { key, from, to } in changes(&own, config)? {
            // What was left to this program to choose is no other choice of the user's.
            let was_open = from.as_ref().is_some_and(|from| from.as_str() == Some("auto"));
            if let (Some(name), Some(value), false) = (evaluation_setting(&key), to, was_open) {
                let value = value.as_str().map_or_else(|| value.to_string(), ToOwned::to_owned);
                names.push(format!("{name}-{}", file_name(&value)));
            }
        }
        let EvaluationFolder { path } = self.evaluation();
        Ok(EvaluationFolder { path: if names.is_empty() { path } else { path.join(names.join("_")) } })
    }

    fn metrics(&self) -> MetricsLog {
        MetricsLog::new(&self.root, "env_steps")
    }

    /// Whether an iteration has been reported.
    #[must_use]
    pub(crate) fn has_metrics(&self) -> bool {
        self.metrics().exists()
    }

    /// Version of the program that made the run, as `meta.json` has it.
    pub fn version(&self) -> Result<String> {
        let path = self.meta_path();
        let text = read_text(&path).map_err(io(&path))?;
        let meta: serde_json::Value = serde_json::from_str(&text).map_err(|error| unusable(&path, &error))?;
        Ok(meta.get("version").and_then(serde_json::Value::as_str).unwrap_or("unknown").to_owned())
    }

    fn meta_path(&self) -> PathBuf {
        self.root.join("meta.json")
    }

    fn write_meta(&self, meta: &impl Serialize) -> Result<()> {
        let path = self.meta_path();
        let text = serde_json::to_string_pretty(meta).map_err(|error| unusable(&path, &error))?;
        write_atomically(&path, text.as_bytes())
    }
}

fn unusable(path: &Path, error: &dyn std::fmt::Display) -> LearnError {
    LearnError::Invalid(format!("{}: {error}", path.display()))
}

/// The name of a setting that changes the episodes of an evaluation or what simulates them.
fn evaluation_setting(key: &str) -> Option<&str> {
    let of_episodes = key.strip_prefix("evaluation.").filter(|name| *name != "every");
    let of_backend = || key.strip_prefix("env.").filter(|name| *name == "backend");
    of_episodes.or_else(of_backend).or_else(|| decides_episodes(key).then_some(key))
}

/// Whether a setting decides what an episode of a damage class is, apart from its number and seed.
#[must_use]
pub fn decides_episodes(key: &str) -> bool {
    key.starts_with("damage.") || ["env.max_episode_steps", "env.physics"].contains(&key)
}

/// A value as part of a file's name.
fn file_name(value: &str) -> String {
    let kept =
        |letter: char| if letter.is_ascii_alphanumeric() || ".-+@".contains(letter) { letter } else { '_' };
    value.chars().map(kept).take(LONGEST_VALUE).collect()
}

/// A folder with the tables and numbers of an evaluation.
#[derive(Debug, Clone)]
pub struct EvaluationFolder {
    path: PathBuf,
}

impl EvaluationFolder {
    /// Writes a file.
    pub fn write(&self, name: &str, text: &str) -> Result<()> {
        own_folder(&self.path)?;
        write_atomically(&self.path(name), text.as_bytes())
    }

    /// Writes a file of JSON.
    pub fn write_json(&self, name: &str, value: &impl Serialize) -> Result<()> {
        let text = serde_json::to_string_pretty(value).map_err(|error| unusable(&self.path(name), &error))?;
        self.write(name, &text)
    }

    /// Reads a file; `None` if there is none.
    pub fn read(&self, name: &str) -> Result<Option<String>> {
        check_folder(&self.path)?;
        let path = self.path(name);
        match read_text(&path) {
            Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
            read => read.map(Some).map_err(io(&path)),
        }
    }

    /// Path of a file.
    #[must_use]
    pub fn path(&self, name: &str) -> PathBuf {
        self.path.join(name)
    }
}

/// A run folder that this process alone may train until it is dropped; the lock of a killed process is gone.
#[derive(Debug)]
pub struct LockedRun {
    folder: RunFolder,
    _lock: File,
}

impl Deref for LockedRun {
    type Target = RunFolder;

    fn deref(&self) -> &RunFolder {
        &self.folder
    }
}

impl LockedRun {
    /// Keeps a copy of the robot that is trained from now on.
    pub fn keep_robot(&self, robot: &RobotFiles) -> Result<()> {
        keep(&self.root, robot)
    }

    /// Writes a changed configuration into `config.toml`, and under `changes` in `meta.json` which settings changed,
    /// and where the run stood.
    pub fn change(&self, config: &Config, progress: Progress) -> Result<()> {
        let (_, before) = RunFolder::open(&self.root)?;
        let changes = changes(&before, config)?;
        if changes.is_empty() {
            return Ok(());
        }
        let path = self.meta_path();
        let mut meta: serde_json::Map<String, serde_json::Value> = match read_text(&path) {
            Ok(text) => serde_json::from_str(&text).map_err(|error| unusable(&path, &error))?,
            Err(error) if error.kind() == ErrorKind::NotFound => serde_json::Map::new(),
            Err(error) => return Err(io(&path)(error)),
        };
        let list = meta.entry("changes").or_insert_with(|| serde_json::Value::Array(Vec::new()));
        let Some(list) = list.as_array_mut() else { return Err(unusable(&path, &"`changes` is no list")) };
        let Progress { iteration, env_steps, .. } = progress;
        for change in changes {
            let record = ChangeRecord { iteration, env_steps, change };
            list.push(serde_json::to_value(record).map_err(|error| unusable(&path, &error))?);
        }
        // The record first: a kill between the two leaves one too many, and no change without a record.
        self.write_meta(&meta)?;
        write_atomically(&self.config_path(), config.to_toml()?.as_bytes())
    }

    /// Appends one line to `metrics.jsonl`.
    pub(crate) fn append_metrics(&self, metrics: &Metrics) -> Result<()> {
        self.metrics().append(metrics)
    }

    /// Drops the metrics of iterations after `iteration`, and a line cut short by a kill: the run resumes
    /// from there.
    pub(crate) fn rewind_metrics(&self, iteration: u64) -> Result<()> {
        self.metrics().rewind("iteration", iteration)
    }
}
