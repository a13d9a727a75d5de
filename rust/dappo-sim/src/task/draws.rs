//! What commands, events and faults draw: numbers in ranges, and times in env steps.

use crate::rng::Stream;

/// Uniform in a range.
pub(super) fn within(stream: &mut Stream, [low, high]: [f64; 2]) -> f64 {
    low + (high - low) * stream.uniform()
}

/// A time in env steps, at least 1.
pub(super) fn steps(time: f64, dt: f64) -> u64 {
    (time / dt).round().max(1.0) as u64
}
