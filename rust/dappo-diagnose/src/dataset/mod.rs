//! Pairs on disk: a folder with `dataset.json` and one NumPy file a shard.
//!
//! `rollouts-000000.npy` is an array of records that NumPy maps into memory with
//! `np.load(path, mmap_mode="r")`; the number in its name is that of its first rollout. A record is one rollout:
//!
//! | field | shape | holds |
//! |---|---|---|
//! | `damaged` | `[C, T, O]` f32 | observations after each step of the robot with each damage class |
//! | `actions` | `[C, T, A]` f32 | its actions |
//! | `twin` | `[C, T, O]` f32 | observations of its healthy twin; without the field, the run of class 0 is every twin |
//! | `onset`, `delay` | u32 | when the damage struck and how much later the window began, in steps |
//! | `fallen` | `[C]` u32 | 1 if the robot was out of its range of heights when the window began |
//!
//! The array's header is updated after each block of records, so that a file is valid at any moment.

mod header;
mod npy;
mod part;
mod pieces;
mod reader;

pub use header::{DatasetHeader, PolicyId};
pub(crate) use part::Part;
pub use part::{Record, Shard};
pub(crate) use pieces::check_piece;
pub use reader::Dataset;
