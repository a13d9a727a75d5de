//! The `gpu` backend: the physics of all envs in one kernel, a thread a limb (crate `dappo-gpu`, feature `gpu`).
//!
//! It simulates the robots of the [lane engine](super::lanes), from the same compiled models. As a backend, actions go to
//! the device and states come back once an env step; observations, rewards and terminations are computed on the CPU.
//! `GpuEnvs` leave all of it on the device for whole rollouts, for tasks whose terms and events the kernels know.

#[cfg(feature = "gpu")]
mod engine;
#[cfg(feature = "gpu")]
mod envs;

#[cfg(feature = "gpu")]
pub use dappo_gpu::{Collected, Net, Networks};
#[cfg(feature = "gpu")]
pub use envs::GpuEnvs;

use super::lanes::LaneTable;
use super::{Backend, Precision, Worlds};
use crate::error::SimError;
use crate::task::Task;

/// The name of the device that the backend would use.
///
/// # Errors
/// The reason why there is none.
#[cfg(feature = "gpu")]
pub fn device() -> Result<String, SimError> {
    Ok(engine::find()?.name())
}

/// The name of the device that the backend would use.
///
/// # Errors
/// The reason why there is none.
#[cfg(not(feature = "gpu"))]
pub fn device() -> Result<String, SimError> {
    Err(absent())
}

/// A backend for `num_envs` robots of a table.
///
/// # Errors
/// If there is no device, or the kernels do not support the robot.
#[cfg(feature = "gpu")]
pub fn open(
    task: Task,
    table: LaneTable,
    precision: Precision,
    num_envs: usize,
) -> Result<Box<dyn Backend>, SimError> {
    Ok(Box::new(engine::GpuBackend::new(task, table, precision, num_envs)?))
}

/// A backend for `num_envs` robots of a table.
///
/// # Errors
/// In this build always: it has no such backend.
#[cfg(not(feature = "gpu"))]
pub fn open(_: Task, _: LaneTable, _: Precision, _: usize) -> Result<Box<dyn Backend>, SimError> {
    Err(absent())
}

/// Worlds of a table without episodes.
///
/// # Errors
/// If there is no device, or the kernels do not support the robot.
#[cfg(feature = "gpu")]
pub fn worlds(table: &LaneTable, precision: Precision, count: usize) -> Result<Box<dyn Worlds>, SimError> {
    Ok(Box::new(engine::GpuWorlds::new(table, precision, count)?))
}

/// Worlds of a table without episodes.
///
/// # Errors
/// In this build always: it has no such backend.
#[cfg(not(feature = "gpu"))]
pub fn worlds(_: &LaneTable, _: Precision, _: usize) -> Result<Box<dyn Worlds>, SimError> {
    Err(absent())
}

#[cfg(not(feature = "gpu"))]
fn absent() -> SimError {
    unusable("this build of dappo-batch does not have it (feature `gpu`)")
}

fn unusable(why: &str) -> SimError {
    SimError::Config(format!("the device gpu cannot be used: {why}"))
}
