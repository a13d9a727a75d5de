//! Tests over the public interface of the crate, in one program: each that is linked takes its time.

#![allow(clippy::unwrap_used, clippy::float_cmp, reason = "helpers of a test may fail loudly, as tests do")]

#[path = "../../../dappo-sim/tests/integration/cases.rs"]
mod cases;

mod diagnoser;
mod properties;
