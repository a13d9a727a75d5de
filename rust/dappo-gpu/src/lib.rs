//! MuJoCo's equations for limbed robots on a floor as one GPU kernel, one thread a limb, and whole rollouts around it.
//!
//! A robot is what [`dappo_lanes`] simulates: a free root with limbs of hinges over a level floor, given by the same
//! [`Model`](dappo_lanes::Model)s. An [`Engine`] holds its damage classes on the device and computes many worlds in one
//! launch; [`Group`]s of worlds keep their states on the host. An evaluation of the dynamics goes through the modules
//! in the order in which they are listed here; they have the names that they have in [`dappo_lanes`].
//!
//! [`Envs`] stay on the device for whole rollouts: what a step is besides physics is in `task`, what acts in it in
//! `networks`.
//!
//! Threads of a world exchange numbers by subgroup shuffles. Nothing depends on the order in which threads run, so
//! that the same device computes the same bits every time.
#![cfg(feature = "wgpu")]
#![allow(clippy::too_many_arguments, reason = "buffers are no members of structures in a kernel")]
#![allow(
    clippy::large_types_passed_by_value,
    reason = "the shape of a robot is known when a kernel is compiled"
)]
#![allow(clippy::needless_pass_by_value, reason = "kernels own what is known when they are compiled")]
#![allow(clippy::expl_impl_clone_on_copy, reason = "the macros of CubeCL derive neither for what they write")]
#![allow(clippy::extra_unused_type_parameters, reason = "the macros of CubeCL use them")]
#![allow(clippy::used_underscore_binding, reason = "the macros of CubeCL use them")]
#![allow(clippy::needless_range_loop, reason = "an index runs over several arrays at once, as in formulas")]
#![allow(clippy::manual_memcpy, reason = "kernels copy number by number")]
#![allow(clippy::manual_range_contains, reason = "ranges are none of a kernel's types")]
#![allow(clippy::collapsible_if, reason = "a kernel may evaluate both sides of a condition")]

mod kinematics;

mod inertia;

mod bias;

mod actuation;

mod contact;
mod surface;

mod dry_friction;
mod impedance;
mod limit;

mod pyramid;

mod hessian;
mod line_search;
mod solver;

mod dynamics;

mod integrate;

mod forces;

mod arrow;
mod constants;
mod coords;
#[cfg(feature = "cuda-source")]
pub mod cuda_source;
mod device;
mod engine;
mod envs;
mod error;
mod group;
mod kernel;
mod math;
mod networks;
mod shape;
mod skeleton;
mod state;

mod task;

pub use device::{ALLOW_SOFTWARE, Device};
pub use engine::Engine;
pub use envs::{Clock, Collected, EnvStates, Envs, Net, Networks, TaskTable};
pub use error::Error;
pub use group::Group;
pub use task::plan;
