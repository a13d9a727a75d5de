//! How many inputs properties are tried with.

use proptest::test_runner::{Config, RngSeed};

/// The same inputs in every run, or so many times as many others as the environment variable `PROPERTY_TIMES`
/// sets.
pub fn cases(cases: u32) -> Config {
    let times = std::env::var("PROPERTY_TIMES").map_or(1, |times| times.parse().unwrap());
    Config {
        cases: cases * times,
        failure_persistence: None,
        rng_seed: RngSeed::Fixed(u64::from(times)),
        ..Config::default()
    }
}
