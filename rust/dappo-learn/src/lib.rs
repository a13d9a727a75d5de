//! Learners for damaged robots: rollout buffers, advantages and damage-aware PPO.
//!
//! To this crate robots are only rows of numbers, and envs do not depend on a learner: they take a policy
//! that no longer changes. One iteration of training reads
//!
//! ```text
//! let rollout = engine.collect(&ppo.frozen()?, &mut episodes, first_step)?;
//! let targets = gae(&rollout, gamma, gae_lambda);
//! let losses  = ppo.update(&rollout, &targets, done)?;
//! ```
//!
//! Everything here is bit-reproducible on a CPU: random numbers come from counter-based streams, and
//! parallel sums are formed in an order that does not depend on the number of threads.

pub mod checkpoint;
pub mod config;
pub mod csv_table;
pub mod engine;
pub mod envs;
pub mod episodes;
pub mod error;
pub mod evaluate;
pub mod faults;
pub mod files;
pub mod fleet;
pub mod gae;
pub mod memory;
pub mod metrics;
pub mod ppo;
pub mod records;
pub mod robot_files;
pub mod rollout;
pub mod run_folder;
mod run_policy;
mod simulator;
mod sizes;
pub mod statistics;
pub mod text_table;
pub mod train;
pub mod walk;

pub use error::{FileKind, LearnError, Result};
pub use gae::{Targets, gae};
pub use ppo::{Ppo, PpoConfig, PpoLosses, Schedule, Symmetry};
pub use rollout::Rollout;
pub use run_policy::RunPolicy;
pub use simulator::Simulator;
pub use sizes::Sizes;
