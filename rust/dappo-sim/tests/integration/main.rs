//! Tests over the public interface of the crate, in one program: each that is linked takes its time.

#![allow(clippy::unwrap_used, clippy::float_cmp, reason = "helpers of a test may fail loudly, as tests do")]

mod cases;
mod counter;
mod properties;
mod task;
mod vector_env;
