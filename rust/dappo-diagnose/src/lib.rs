//! The self-diagnosis of Verma et al. (2019), section III: pairs of a damaged robot and its healthy twin, and the
//! network that learns from them which limbs are damaged.
//!
//! ```text
//! expert (a policy trained on the healthy robot)
//!   └── collect: both robots of every (rollout, damage class) walk for T steps   → dataset on disk
//!         └── train: the network, from what a method shows it of a window        → diagnoser
//!               └── evaluate: confusion, accuracy, calibration; cost: what mistakes do to the walk
//! sweep: many trainings over one dataset, and the paper's Table 1
//!
//! controller: one trial, no reset: suspicion, diagnosis window, diagnosis, the policy with another damage code
//!   └── adapt: mid-episode damage, compared with policies of fixed codes
//! export: a policy or all that a controller needs in one folder, with ONNX
//! ```

pub mod adapt;
pub mod collect;
mod config;
pub mod controller;
pub mod cost;
pub mod dataset;
pub mod evaluate;
pub mod export;
mod folder;
mod head;
pub mod memory;
mod method;
mod model;
mod preset;
mod report;
mod samples;
mod source;
mod subject;
pub mod sweep;
mod timing;
pub mod train;
pub mod trajectory;
mod twin;

pub use config::{DiagnoserConfig, Schedule};
pub use folder::{LockedTraining, TrainingFolder};
pub use head::Head;
pub use method::Method;
pub use model::{Description, Diagnoser};
pub use preset::{Preset, Protocol};
pub use report::{CalibrationBin, DiagnosisSummary, Report};
pub use samples::{Sample, Split};
pub use source::{PairSource, Window};
pub use subject::Subject;
pub use timing::{Span, Timing};
pub use twin::{Twin, TwinAction};
