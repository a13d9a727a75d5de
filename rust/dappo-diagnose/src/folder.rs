//! The folder of a diagnoser's training: `config.toml robot/ metrics.jsonl checkpoints/ model/ eval/`.

use std::fs::{self, File};
use std::ops::Deref;
use std::path::{Path, PathBuf};

use dappo_learn::error::{LearnError, Result};
use dappo_learn::files::{self, io, own_folder, read_text, write_atomically};
use dappo_learn::metrics::MetricsLog;

use super::DiagnoserConfig;

/// The folder of one training.
#[derive(Debug, Clone)]
pub struct TrainingFolder {
    root: PathBuf,
}

impl TrainingFolder {
    /// Makes a new folder; refuses one that already holds a training.
    pub fn create(root: &Path, config: &DiagnoserConfig) -> Result<LockedTraining> {
        fs::create_dir_all(root).map_err(io(root))?;
        // Its contents are read only under the lock: of two processes that begin together, one makes the
        // training.
        let folder = Self { root: root.to_owned() }.lock()?;
        let path = folder.config_path();
        if path.exists() {
            return Err(LearnError::Invalid(format!(
                "{} already holds the training of a diagnoser; choose another folder or resume it",
                root.display()
            )));
        }
        own_folder(&folder.checkpoints())?;
        let text = toml::to_string(config).map_err(|error| LearnError::Invalid(error.to_string()))?;
        write_atomically(&path, text.as_bytes())?;
        Ok(folder)
    }

    /// Opens the folder of an earlier training and reads its configuration.
    pub fn open(root: &Path) -> Result<(Self, DiagnoserConfig)> {
        let folder = Self { root: root.to_owned() };
        let path = folder.config_path();
        let text = read_text(&path).map_err(io(&path))?;
        let config: DiagnoserConfig = toml::from_str(&text)
            .map_err(|error| LearnError::Invalid(format!("{}: {error}", path.display())))?;
        config.check()?;
        Ok((folder, config))
    }

    /// The folder itself.
    #[must_use]
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// Locks the folder for training; refuses one that another process trains in.
    pub fn lock(self) -> Result<LockedTraining> {
        let Some(lock) = files::lock(&self.root.join("lock"))? else {
            return Err(LearnError::Invalid(format!(
                "a diagnoser is being trained in {} by another process; wait for its end, or choose another folder",
                self.root.display()
            )));
        };
        Ok(LockedTraining { folder: self, _lock: lock })
    }

    fn config_path(&self) -> PathBuf {
        self.root.join("config.toml")
    }

    /// Folder of the checkpoints.
    #[must_use]
    pub fn checkpoints(&self) -> PathBuf {
        self.root.join("checkpoints")
    }

    /// Folder of the trained diagnoser, for [`super::Diagnoser::load`].
    #[must_use]
    pub fn model(&self) -> PathBuf {
        self.root.join("model")
    }

    /// Folder of the results on datasets.
    #[must_use]
    pub fn eval(&self) -> PathBuf {
        self.root.join("eval")
    }

    /// The metrics, one line an epoch.
    #[must_use]
    pub fn metrics(&self) -> MetricsLog {
        MetricsLog::new(&self.root, "epoch")
    }
}

/// A folder that this process alone may train in until it is dropped; the lock of a killed process is gone.
#[derive(Debug)]
pub struct LockedTraining {
    folder: TrainingFolder,
    _lock: File,
}

impl Deref for LockedTraining {
    type Target = TrainingFolder;

    fn deref(&self) -> &TrainingFolder {
        &self.folder
    }
}
