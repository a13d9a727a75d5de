//! One walk, step by step, for plots.

use std::fmt::Write as _;

use super::{Vocabulary, Walk};
use crate::controller::EventKind;

/// A walk as CSV: forward velocity, the damage in force, what the policy is told, and what happened.
#[must_use]
pub fn trace(walk: &Walk, onset: usize, vocabulary: &Vocabulary) -> String {
    let name = |class: usize| &vocabulary.known_names[class];
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
                EventKind::Withdrawn { class, .. } => format!("withdrawn {}", name(*class)),
                EventKind::ReadingsLost { .. } => "readings lost".to_owned(),
                EventKind::ReadingsBack => "readings back".to_owned(),
            });
        }
        let damage = &vocabulary.names[if step >= onset { walk.class } else { 0 }];
        // Writing to a String cannot fail.
        let _ = writeln!(text, "{step},{velocity:.5},{damage},{},{}", name(told), happened.join("; "));
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
        let vocabulary = Vocabulary {
            names: ["healthy", "leg off"].map(ToOwned::to_owned).to_vec(),
            known: vec![Some(0), None],
            codes: vec![Vec::new(); 2],
            known_names: ["healthy", "broken"].map(ToOwned::to_owned).to_vec(),
        };
        assert_eq!(
            trace(&walk, 1, &vocabulary).lines().collect::<Vec<_>>(),
            [
                "step,forward_velocity,damage,told,event",
                "0,1.00000,healthy,healthy,",
                "1,0.50000,leg off,broken,diagnosed broken (0.88); adapted",
                "2,0.25000,leg off,broken,",
            ]
        );
    }
}
