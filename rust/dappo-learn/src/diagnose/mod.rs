//! The self-diagnosis: pairs of a damaged robot and its healthy twin, and the network that learns from them
//! which limbs are damaged.
//!
//! ```text
//! expert (a policy trained on the healthy robot)
//!   └── collect: both robots of every (rollout, damage class) walk for T steps   → dataset on disk
//! ```

pub mod collect;
pub mod dataset;
mod expert;
mod preset;
mod source;
mod timing;
mod twin;

pub use expert::Expert;
pub use preset::Preset;
pub use source::{PairSource, Window};
pub use timing::{Span, Timing};
pub use twin::{Twin, TwinAction};
