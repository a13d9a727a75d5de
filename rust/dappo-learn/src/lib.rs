//! Learners for damaged robots: rollout buffers, advantages, networks and damage-aware PPO.
//!
//! The crate knows robots only as rows of numbers. One iteration of training reads
//!
//! ```text
//! let rollout = engine.collect(&ppo, &mut episodes, first_step)?;
//! let targets = gae(&rollout, gamma, gae_lambda);
//! let losses  = ppo.update(&rollout, &targets)?;
//! ```
//!
//! Everything here is bit-reproducible on a CPU: random numbers come from counter-based streams, and
//! parallel sums are formed in an order that does not depend on the number of threads.

pub mod actor;
pub mod adapt;
pub mod checkpoint;
pub mod config;
pub mod controller;
pub mod diagnose;
pub mod engine;
pub mod envs;
pub mod episodes;
pub mod error;
pub mod evaluate;
pub mod export;
pub mod files;
mod fleet;
pub mod gae;
pub mod memory;
pub mod metrics;
pub mod nn;
pub mod normalizer;
pub mod ppo;
mod records;
pub mod robot_files;
pub mod rollout;
pub mod run_folder;
mod simulator;
pub mod train;

pub use actor::Actor;
pub use error::{LearnError, Result};
pub use gae::{Targets, gae};
pub use nn::{ActorCritic, Decision, LearnerDevice, cpu};
pub use normalizer::Normalizer;
pub use ppo::{Ppo, PpoConfig, PpoLosses};
pub use rollout::Rollout;
pub use simulator::{Compute, Simulator};
