//! The self-diagnose network: from a window of what a robot and its healthy twin did to a damage class.
//!
//! Sources: Verma et al. (2019), section III. What training reads in a page is [`train::train`]; a trained
//! network is a [`Diagnoser`].

pub mod config;
mod folder;
mod head;
pub mod method;
pub mod model;
pub mod report;
pub mod samples;
pub mod source;
pub mod standardizer;
pub mod subject;
pub mod train;

pub use config::{DiagnoserConfig, Schedule};
pub use folder::TrainingFolder;
pub use head::Head;
pub use method::Method;
pub use model::Diagnoser;
pub use report::{Report, Summary};
pub use samples::{Sample, Split};
pub use source::{PairSource, Window};
pub use standardizer::Standardizer;
pub use subject::Subject;
