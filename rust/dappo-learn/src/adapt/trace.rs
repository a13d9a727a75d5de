//! One walk, step by step, for plots.

use std::fmt::Write as _;

use super::Walk;
use crate::controller::EventKind;

/// A walk as CSV: forward velocity, the damage in force, what the policy is told, and what happened.
#[must_use]
pub fn trace(walk: &Walk, onset: usize, names: &[String]) -> String {
    let name = |class: usize| names.get(class).map_or("", String::as_str);
    let mut text = "step,forward_velocity,damage,told,event\n".to_owned();
    let (mut told, mut events) = (0, walk.events.iter().peekable());
    for (step, velocity) in walk.velocities.iter().enumerate() {
        let mut happened = Vec::new();
        while let Some(event) = events.next_if(|event| event.step as usize <= step) {
            happened.push(match &event.kind {
                EventKind::Suspected { .. } => "suspected".to_owned(),
                EventKind::Diagnosed { class, confidence, .. } => {
                    format!("diagnosed {} ({confidence:.2})", name(*class))
                }
                EventKind::Adapted { class } => {
                    told = *class;
                    "adapted".to_owned()
                }
                EventKind::ReadingsLost { .. } => "readings lost".to_owned(),
                EventKind::ReadingsBack => "readings back".to_owned(),
            });
        }
        let damage = if step >= onset { walk.class } else { 0 };
        // Writing to a String cannot fail.
        let _ =
            writeln!(text, "{step},{velocity:.5},{},{},{}", name(damage), name(told), happened.join("; "));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::controller::Event;

    #[test]
    fn a_trace_says_what_is_true_what_is_believed_and_what_happened() {
        let event = |step, kind| Event { robot: 0, step, kind };
        let walk = Walk {
            class: 1,
            velocities: vec![1.0, 0.5, 0.25],
            events: vec![
                event(1, EventKind::Diagnosed { class: 1, confidence: 0.875, accepted: true }),
                event(1, EventKind::Adapted { class: 1 }),
            ],
            ..Walk::default()
        };
        let names = ["healthy".to_owned(), "broken".to_owned()];
        assert_eq!(
            trace(&walk, 1, &names).lines().collect::<Vec<_>>(),
            [
                "step,forward_velocity,damage,told,event",
                "0,1.00000,healthy,healthy,",
                "1,0.50000,broken,broken,diagnosed broken (0.88); adapted",
                "2,0.25000,broken,broken,",
            ]
        );
    }
}
