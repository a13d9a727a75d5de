//! The check of robot files in Python.

use dappo_sim::Robot;
use pyo3::prelude::*;

/// What is wrong with the text of a robot TOML, a sentence a fault; empty for one that can be used.
#[pyfunction]
pub fn robot_faults(toml: &str) -> Vec<String> {
    Robot::faults(toml)
}
