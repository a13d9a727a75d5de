//! Faults of the entries of `[events]` that describe faults of the robot's sensors and of the way to its actuators.

use toml::Table;

use super::entries::Entries;
use super::limits::LONGEST;

const KINDS: [&str; 3] = ["stuck", "biased", "lost"];
/// Terms of the observation that the IMU reads.
const IMU: [&str; 3] = ["base_ang_vel", "projected_gravity", "base_lin_vel"];

/// Checks `[events.action_dropout]`.
pub(super) fn check_dropout(dropout: Option<&Table>, found: &mut Vec<String>) {
    let Some(dropout) = dropout else { return };
    let mut entries = Entries::new(dropout, "[events.action_dropout]".into(), found);
    entries.number("share", 0.0..=1.0);
    entries.span("every", 1e-3..=LONGEST);
    entries.span("duration", 1e-3..=LONGEST);
    entries.finish();
}

/// Checks `[events.encoder_fault]`.
pub(super) fn check_encoder(fault: Option<&Table>, found: &mut Vec<String>) {
    let Some(fault) = fault else { return };
    let mut entries = Entries::new(fault, "[events.encoder_fault]".into(), found);
    let is_biased = check_course(&mut entries);
    if let Some(Err(why)) = entries.optional_text("joints").map(super::pattern) {
        entries.fault(&format!("`joints`: {why}"));
    }
    if is_biased {
        entries.span("offset", -10.0..=10.0);
    }
    entries.finish();
}

/// Checks `[events.imu_fault]`.
pub(super) fn check_imu(fault: Option<&Table>, found: &mut Vec<String>) {
    let Some(fault) = fault else { return };
    let mut entries = Entries::new(fault, "[events.imu_fault]".into(), found);
    let offset = if check_course(&mut entries) { entries.table("offset") } else { None };
    if offset.is_some_and(Table::is_empty) {
        entries.fault(&format!("`offset` is empty, expected some of {}", IMU.join(", ")));
    }
    entries.finish();
    let Some(offset) = offset else { return };
    let mut entries = Entries::new(offset, "[events.imu_fault.offset]".into(), found);
    for term in IMU {
        entries.optional_span(term, -1e3..=1e3);
    }
    entries.finish();
}

/// Checks how often a fault occurs, when, and which; returns whether some are biases.
fn check_course(entries: &mut Entries) -> bool {
    entries.number("share", 0.0..=1.0);
    let kinds = entries.texts("kinds", 1);
    for (index, kind) in kinds.iter().enumerate() {
        if !KINDS.contains(kind) {
            entries.fault(&format!("`kinds` has {kind:?} in it, expected some of {}", KINDS.join(", ")));
        } else if kinds[..index].contains(kind) {
            entries.fault(&format!("`kinds` has {kind:?} in it twice"));
        }
    }
    entries.span("onset", 0.0..=LONGEST);
    entries.optional_span("duration", 1e-3..=LONGEST);
    kinds.contains(&"biased")
}
