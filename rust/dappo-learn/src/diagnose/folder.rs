//! The folder of a diagnoser's training: `config.toml metrics.jsonl checkpoints/ model/ eval/`.

use std::fs;
use std::path::{Path, PathBuf};

use super::DiagnoserConfig;
use crate::error::{LearnError, Result};
use crate::files::{io, write_atomically};
use crate::metrics::MetricsLog;

/// The folder of one training.
#[derive(Debug, Clone)]
pub struct TrainingFolder {
    root: PathBuf,
}

impl TrainingFolder {
    /// Makes a new folder; refuses one that already holds a training.
    pub fn create(root: &Path, config: &DiagnoserConfig) -> Result<Self> {
        let folder = Self { root: root.to_owned() };
        let path = folder.config_path();
        if path.exists() {
            return Err(LearnError::Invalid(format!(
                "{} already holds the training of a diagnoser; choose another folder or go on with it",
                root.display()
            )));
        }
        fs::create_dir_all(folder.checkpoints()).map_err(io(&folder.checkpoints()))?;
        let text = toml::to_string(config).map_err(|error| LearnError::Invalid(error.to_string()))?;
        write_atomically(&path, text.as_bytes())?;
        Ok(folder)
    }

    /// Opens the folder of an earlier training and reads its configuration.
    pub fn open(root: &Path) -> Result<(Self, DiagnoserConfig)> {
        let folder = Self { root: root.to_owned() };
        let path = folder.config_path();
        let text = fs::read_to_string(&path).map_err(io(&path))?;
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
