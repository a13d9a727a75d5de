//! Networks and optimisers as burnpack files. Such records keep parameter ids, by which Adam's moments find
//! their parameters.

use std::path::Path;

use burn::module::Module;
use burn::optim::ModuleOptimizer;

use crate::error::{LearnError, Result};

pub(crate) fn save_module<M: Module>(module: &M, path: &Path) -> Result<()> {
    module.clone().into_record().save(path).map_err(|error| unreadable(path, error))
}

/// Replaces the parameters of `module` by those of a file.
pub(crate) fn load_module<M: Module>(module: M, path: &Path) -> Result<M> {
    module.try_load_file(path).map_err(|error| unreadable(path, error))
}

pub(crate) fn save_optimizer(optimizer: &ModuleOptimizer, path: &Path) -> Result<()> {
    optimizer.save(path).map_err(|error| unreadable(path, error))
}

/// Replaces the state of `fresh`, an optimiser of the same settings, by that of a file.
pub(crate) fn load_optimizer(fresh: ModuleOptimizer, path: &Path) -> Result<ModuleOptimizer> {
    fresh.load(path).map_err(|error| unreadable(path, error))
}

/// Turns what a reader or writer says of a file into an error that names it.
pub(crate) fn unreadable(path: &Path, error: impl std::fmt::Display) -> LearnError {
    LearnError::Checkpoint { path: path.into(), message: error.to_string() }
}
