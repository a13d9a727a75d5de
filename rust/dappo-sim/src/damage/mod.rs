//! Damages, damage classes and the space of all classes of a robot.
//!
//! Rust has only the names of damage types: what a type does to the robot is an edit of its MJCF
//! (`python/dappo_batch/damage`), compiled once per class.

mod class;
mod severity;
mod space;

pub use class::{Damage, DamageClass};
pub use severity::Severity;
pub use space::DamageSpace;
