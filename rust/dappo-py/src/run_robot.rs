//! The robot of a run: the one that it was trained on, of which the run keeps a copy.
//!
//! Every command that reads a run opens it here, so that none uses another robot by mistake.

use std::path::{Path, PathBuf};

use dappo_diagnose::export::Export;
use dappo_learn::config::Config;
use dappo_learn::robot_files::RobotFiles;
use dappo_learn::run_folder::RunFolder;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};

use crate::cli::console::note;
use crate::errors::OrRaise;
use crate::factory::to_python;
use crate::kinds::RobotChanged;

/// A Python `RobotCopy`: the files of a robot.
pub struct RobotCopy(Py<PyAny>);

impl RobotCopy {
    /// Copies the robot of a configuration.
    pub fn of(py: Python<'_>, config: &Config) -> PyResult<Self> {
        let damage = to_python(py, &config.damage)?;
        let copy = module(py)?.call_method1("copy_robot", (&config.robot, damage))?;
        Ok(Self(copy.unbind()))
    }

    /// The copy in the folder of a dataset or a diagnoser; those of older versions have none.
    pub fn read(py: Python<'_>, root: &Path) -> PyResult<Option<Self>> {
        let copy = module(py)?.call_method1("read_copy", (root,))?;
        Ok((!copy.is_none()).then(|| Self(copy.unbind())))
    }

    /// The files that a folder keeps.
    pub fn to_keep(&self, py: Python<'_>) -> PyResult<RobotFiles> {
        self.0.bind(py).call_method0("to_write")?.cast_into::<PyDict>()?.iter().map(extract).collect()
    }

    /// The files of the robot alone.
    pub fn files(&self, py: Python<'_>) -> PyResult<RobotFiles> {
        self.0.bind(py).getattr("files")?.cast_into::<PyDict>()?.iter().map(extract).collect()
    }

    /// Fails unless another folder was made with the same robot, and with the same damage if that matters.
    pub fn check_same(
        &self,
        py: Python<'_>,
        root: &Path,
        (other_root, other): (&Path, &Self),
        with_damage: bool,
    ) -> PyResult<()> {
        let named = PyDict::new(py);
        named.set_item("with_damage", with_damage)?;
        let (one, two) = (root.display().to_string(), other_root.display().to_string());
        module(py)?.call_method("check_same", (one, &self.0, two, &other.0), Some(&named)).map(drop)
    }
}

/// Fails if the robot of an export, which may come from others, needs other files than those of the export.
pub fn check_export(py: Python<'_>, export: &Export) -> PyResult<()> {
    let files = PyDict::new(py);
    for (name, content) in export.robot_files().or_raise()? {
        files.set_item(name, PyBytes::new(py, &content))?;
    }
    py.import("dappo_batch.robots.copies")?.call_method1("check_confined", (export.folder(), files)).map(drop)
}

fn extract((name, content): (Bound<'_, PyAny>, Bound<'_, PyAny>)) -> PyResult<(String, Vec<u8>)> {
    Ok((name.extract()?, content.extract()?))
}

fn module(py: Python<'_>) -> PyResult<Bound<'_, PyModule>> {
    py.import("dappo_batch.runs.robot_of_run")
}

/// A run, and the robot that it is simulated with.
pub struct OpenRun {
    /// Its folder.
    pub folder: RunFolder,
    /// Its configuration, with the robot file to compile.
    pub config: Config,
    /// The files of that robot.
    pub robot: RobotCopy,
    /// Whether the run keeps a copy of that robot.
    pub is_kept: bool,
    /// What to do where the robot has changed.
    changed: Option<RobotChanged>,
}

impl OpenRun {
    /// Opens a run; fails if its robot file has changed since the training and `changed` is not given.
    pub fn open(py: Python<'_>, root: &Path, changed: Option<RobotChanged>) -> PyResult<Self> {
        let (folder, mut config) = RunFolder::open(root).or_raise()?;
        let damage = to_python(py, &config.damage)?;
        let choice = changed.map(RobotChanged::name);
        let found = module(py)?.call_method1("robot_of_run", (root, &config.robot, damage, choice))?;
        let (robot_file, copy, has_copy): (Option<PathBuf>, Py<PyAny>, bool) = found.extract()?;
        if !has_copy {
            note!(
                "{} keeps no copy of its robot, as runs of earlier versions do not: {} is used as it is now",
                root.display(),
                config.robot
            );
        }
        config.robot_file = robot_file;
        let is_kept = has_copy && changed != Some(RobotChanged::UseFile);
        Ok(Self { folder, config, robot: RobotCopy(copy), is_kept, changed })
    }

    /// Opens another run for the same command; fails unless both have one robot, and one damage if that matters.
    pub fn open_other(&self, py: Python<'_>, root: &Path, with_damage: bool) -> PyResult<Self> {
        let other = Self::open(py, root, self.changed)?;
        self.robot.check_same(py, self.folder.root(), (root, &other.robot), with_damage)?;
        Ok(other)
    }

    /// Fails if a dataset or a diagnoser was made with another robot, or with another meaning of its damage codes.
    pub fn check_folder(&self, py: Python<'_>, root: &Path) -> PyResult<()> {
        // A user who continues with the current robot file has seen what differs.
        if self.changed == Some(RobotChanged::UseFile) {
            return Ok(());
        }
        match RobotCopy::read(py, root)? {
            Some(copy) => self.robot.check_same(py, self.folder.root(), (root, &copy), true),
            None => Ok(()),
        }
    }
}
