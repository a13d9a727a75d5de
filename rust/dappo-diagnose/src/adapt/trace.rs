//! One episode, step by step, for plots.

use dappo_learn::csv_table::table;
use dappo_learn::walk::{Episode, EventKind, KnownClasses};

/// An episode with its velocities as CSV: forward velocity, the active damage, the damage whose code the
/// policy has, what happened, and how the command was tracked, if there was one.
#[must_use]
pub fn trace(episode: &Episode, classes: &KnownClasses) -> String {
    let name = |class: usize| &classes.known_names[class];
    let (mut assumed, mut events) = (0, episode.events.iter().peekable());
    let rows = episode.velocities.iter().enumerate().map(|(step, velocity)| {
        let mut happened = Vec::new();
        while let Some(event) = events.next_if(|event| event.step as usize <= step) {
            happened.push(match &event.kind {
                EventKind::Suspected { .. } => "suspected".to_owned(),
                EventKind::Diagnosed { class, confidence, .. } => {
                    format!("diagnosed {} ({confidence:.2})", name(*class))
                }
                EventKind::Adapted { class } => {
                    assumed = *class;
                    "adapted".to_owned()
                }
                EventKind::Withdrawn { class, .. } => format!("withdrawn {}", name(*class)),
                EventKind::ObservationInvalid { .. } => "observation invalid".to_owned(),
                EventKind::ObservationValid => "observation valid".to_owned(),
            });
        }
        let damage = &classes.names[if step >= episode.onset { episode.class } else { 0 }];
        let mut row = vec![
            step.to_string(),
            format!("{velocity:.5}"),
            damage.clone(),
            name(assumed).clone(),
            happened.join("; "),
        ];
        row.extend(episode.trackings.get(step).map(|tracking| format!("{tracking:.5}")));
        row
    });
    let mut columns = vec!["step", "forward_velocity", "damage", "assumed", "event"];
    columns.extend((!episode.trackings.is_empty()).then_some("tracking"));
    table(&columns, rows)
}

#[cfg(test)]
mod tests {
    use super::*;
    use dappo_learn::walk::Event;

    #[test]
    fn a_trace_says_what_is_true_what_is_believed_and_what_happened() {
        let event = |step, kind| Event { robot: 0, step, kind };
        let episode = Episode {
            class: 1,
            onset: 1,
            steps: 3,
            velocities: vec![1.0, 0.5, 0.25],
            events: vec![
                event(1, EventKind::Diagnosed { class: 1, confidence: 0.875, accepted: true }),
                event(1, EventKind::Adapted { class: 1 }),
            ],
            ..Episode::default()
        };
        let classes = KnownClasses {
            names: ["healthy", "leg off"].map(ToOwned::to_owned).to_vec(),
            known: vec![Some(0), None],
            codes: vec![Vec::new(); 2],
            known_names: ["healthy", "broken"].map(ToOwned::to_owned).to_vec(),
        };
        assert_eq!(
            trace(&episode, &classes).lines().collect::<Vec<_>>(),
            [
                "step,forward_velocity,damage,assumed,event",
                "0,1.00000,healthy,healthy,",
                "1,0.50000,leg off,broken,diagnosed broken (0.88); adapted",
                "2,0.25000,leg off,broken,",
            ]
        );
    }
}
