//! MuJoCo's equations for limbed robots on a floor, with several worlds in the lanes of one SIMD register.
//!
//! A robot is a free root with L limbs of J hinges each over a level floor; what it is made of stands in
//! [`Model`]. An [`Engine`] holds its damage classes and makes [`Group`]s of worlds, one world a lane. An
//! evaluation of the dynamics goes through the modules in the order in which they are listed here.

#![allow(clippy::inline_always, reason = "what is not inlined is not compiled for the instruction set")]
#![allow(clippy::needless_range_loop, reason = "an index runs over several arrays at once, as in formulas")]
#![allow(clippy::range_plus_one, reason = "loops over inclusive ranges do not unroll")]

mod kinematics;

mod inertia;

mod bias;

mod actuation;

mod contact;
mod dry_friction;
mod limit;

mod cone;
mod pyramid;

mod hessian;
mod solver;

mod dynamics;

mod integrate;

mod forces;

mod arrow;
mod constants;
mod coords;
mod engine;
mod error;
mod group;
mod lane;
mod math;
pub mod model;
mod skeleton;
mod state;
mod worlds;

pub use engine::{Engine, Precision, Simd};
pub use error::Unsupported;
pub use group::{Group, Readout, WorldAccess};
pub use model::Model;
pub use skeleton::difference;
