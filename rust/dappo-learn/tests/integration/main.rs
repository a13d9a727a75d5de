//! Tests over the public interface of the crate, in one program: each that is linked takes its time.

#![allow(clippy::unwrap_used, clippy::float_cmp, reason = "helpers of a test may fail loudly, as tests do")]

#[path = "../../../dappo-sim/tests/integration/cases.rs"]
mod cases;
#[path = "../../../dappo-sim/tests/integration/counter/mod.rs"]
mod counter;

mod evaluation;
mod ppo;
mod properties;
mod recurrent;
mod run_folder;
mod walk;
