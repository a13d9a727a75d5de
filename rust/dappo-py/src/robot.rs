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

/// An entry of `[events]` that changes bodies: its kind, the pattern of the bodies, the names of its numbers, and these in
/// every variant.
type BodyEvent = (&'static str, String, Vec<String>, Vec<Vec<f64>>);

/// The entries of `[events]` in the text of a robot TOML that change bodies, in the order in which they are applied.
#[pyfunction]
pub fn robot_body_events(toml: &str) -> PyResult<Vec<BodyEvent>> {
    let drawn = Robot::from_toml(toml).or_raise()?.events.bodies.draw();
    Ok(drawn.into_iter().map(|event| (event.kind, event.bodies, event.names, event.numbers)).collect())
}
