//! The check of robot files in Python.

use dappo_sim::{Robot, robot};
use pyo3::prelude::*;

use crate::errors::OrRaise;

/// What is wrong with the text of a robot TOML, a sentence a fault; empty for one that can be used.
#[pyfunction]
pub fn robot_faults(toml: &str) -> Vec<String> {
    Robot::faults(toml)
}

/// The task that the text of a robot TOML names; None if it names none, or cannot be read.
#[pyfunction]
pub fn robot_task(toml: &str) -> Option<String> {
    Robot::task_name(toml)
}

/// The text of a robot TOML with the task `name` in the place of its own.
#[pyfunction]
pub fn robot_with_task(robot: &str, task: &str, name: &str) -> PyResult<String> {
    robot::with_task(robot, task, name).or_raise()
}
