//! Batched simulation of damage-randomised robots.
//!
//! The data flows from top to bottom:
//!
//! ```text
//! robot (TOML) ─ damage space ─ class distribution
//!        └──────────┬───────────────┘
//!   backend: reset / set_classes / step      one compiled model per damage class
//!        └── task: actions, commands, observation, reward, termination, events
//!   vector env: time limit, autoreset, damage draw, onset, final_obs
//! ```
//!
//! This crate handles numbers and damage classes; it depends on no Python, no learner and no screen.

pub mod backend;
pub mod curriculum;
pub mod damage;
mod error;
pub mod memory;
pub mod rng;
pub mod robot;
pub mod simd;
pub mod task;

pub mod threads;
pub mod vector_env;

pub use backend::{Backend, BackendKind, Device, Layout, Physics, Precision, Reset, StepOutputs, WarpDevice};
pub use damage::{Damage, DamageClass, DamageSpace, Severity};
pub use error::SimError;
pub use robot::Robot;
pub use threads::ThreadPool;
pub use vector_env::{Autoreset, VectorEnv, VectorEnvConfig};
