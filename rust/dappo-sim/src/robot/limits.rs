//! Limits that several sections of a robot file have in common.

use super::entries::{Entries, number, shown};

/// Weights, clips and scales up to here keep every reward and observation finite in single precision: at worst a
/// weight times the fourth power of a clip times the number of bodies.
pub(super) const LARGEST: f64 = 1e6;
/// Longest time between two commands, pushes or faults, s.
pub(super) const LONGEST: f64 = 1e6;

/// Checks the entry `height`, which ends episodes.
pub(super) fn check_height(entries: &mut Entries) {
    let Some(range) = entries.list("height") else { return };
    let numbers: Vec<f64> = range.iter().filter_map(number).collect();
    let is_range = matches!(numbers[..], [low, high] if range.len() == 2 && low < high);
    if !is_range {
        let shown: Vec<String> = range.iter().take(4).map(shown).collect();
        entries.fault(&format!(
            "`height` is [{}], expected [low, high], two numbers in m with low < high",
            shown.join(", ")
        ));
    }
}
