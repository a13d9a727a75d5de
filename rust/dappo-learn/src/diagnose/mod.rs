//! The self-diagnosis of Verma et al. (2019), section III: pairs of a damaged robot and its healthy twin, and the
//! network that learns from them which limbs are damaged.
//!
//! ```text
//! expert (a policy trained on the healthy robot)
//!   └── collect: both robots of every (rollout, damage class) walk for T steps   → dataset on disk
//!         └── train: the network, from what a method shows it of a window        → diagnoser
//!               └── report: confusion, accuracy, calibration; cost: what mistakes do to the walk
//! sweep: many trainings over one dataset, beside the paper's Table 1
//! ```

pub mod collect;
mod config;
pub mod cost;
pub mod dataset;
mod expert;
mod folder;
mod head;
mod method;
mod model;
mod preset;
mod report;
mod samples;
mod source;
mod standardizer;
mod subject;
pub mod sweep;
mod timing;
pub mod train;
pub mod trajectory;
mod twin;

pub use config::{DiagnoserConfig, Schedule};
pub use expert::Expert;
pub use folder::{LockedTraining, TrainingFolder};
pub use head::Head;
pub use method::Method;
pub use model::{Description, Diagnoser};
pub use preset::Preset;
pub use report::{CalibrationBin, Report, Summary};
pub use samples::{Sample, Split};
pub use source::{PairSource, Window};
pub use standardizer::Standardizer;
pub use subject::Subject;
pub use timing::{Span, Timing};
pub use twin::{Twin, TwinAction};
