//! Tasks on the device: what an env step is besides physics, one thread an env.
//!
//! The definitions are those of the host's tasks; terms, events and draws have the names that they have there.
//!
//! ```text
//! begin_step ─ advance ─ end_step ─ evaluate ─ observe_placed
//! ```

pub mod action;
pub mod episode;
pub mod events;
pub mod feet;
pub mod kernels;
pub mod observation;
pub mod places;
pub mod plan;
pub mod random;
pub mod reset;
pub mod reward;
pub mod scene;
pub mod variation;
