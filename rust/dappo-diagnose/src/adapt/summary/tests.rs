//! Small trials, counted by hand.

use super::*;
use dappo_sim::vector_env::{DamageCourse, StepRange};

use dappo_learn::walk::{Episode, Kept, Walks};
use dappo_learn::walk::{Event, EventKind};

/// A policy with codes for all of these classes.
fn all_known(names: &[&str]) -> KnownClasses {
    let names: Vec<String> = names.iter().map(ToString::to_string).collect();
    KnownClasses {
        known: (0..names.len()).map(Some).collect(),
        codes: vec![Vec::new(); names.len()],
        known_names: names.clone(),
        names,
    }
}

/// Damage at step 10.
fn trial(classes: Vec<usize>, episodes: usize) -> Trial {
    let onset = StepRange { first: 10, last: 10 };
    let course = DamageCourse { onset, ..DamageCourse::default() };
    Trial { classes, episodes, course, seed: 0, kept: Kept::Velocities }
}

fn walk(class: usize, before: f64, after: f64, suspected: Option<u64>) -> Episode {
    let kind = EventKind::Suspected { forward_velocity: 0.0, expected: 1.0, residual: None };
    Episode {
        class,
        onset: 10,
        steps: 100,
        velocities: [vec![before; 10], vec![after; 90]].concat(),
        events: suspected.map(|step| Event { robot: 0, step, kind }).into_iter().collect(),
        ..Episode::default()
    }
}

#[test]
fn shares_are_of_the_oracles_reward_and_of_the_episodes_that_they_are_about() {
    let trial = trial(vec![0, 1, 2], 2);
    let all = |healthy: f64, mild: f64, severe: f64| {
        let episodes = vec![
            walk(0, 1.0, healthy, None),
            walk(0, 1.0, healthy, Some(50)),
            walk(1, 1.0, mild, None),
            walk(1, 1.0, mild, None),
            walk(2, 1.0, severe, Some(14)),
            walk(2, 1.0, severe, Some(20)),
        ];
        // From 200 down to 1 ms.
        let decision_seconds = (1..=200).rev().map(|ms| f64::from(ms) / 1000.0).collect();
        Walks { episodes, decision_seconds }
    };
    let contest = Contest {
        adapted: all(1.0, 0.8, 0.6),
        oracle: all(1.0, 0.8, 0.8),
        no_adaptation: all(1.0, 0.6, 0.2),
        unaware: None,
    };
    let known = all_known(&["healthy", "mild", "severe"]);
    let summary = AdaptationSummary::new(&trial, &known, &contest).unwrap();
    assert_eq!(summary.healthy_without_alarm, Some(0.5));
    assert_eq!((summary.severe_episodes, summary.severe_detected), (2, Some(1.0)));
    assert_eq!(summary.severe_median_delay, Some(7.0));
    // (0.8 + 0.6) / (0.8 + 0.8) and (0.6 + 0.2) / 1.6, of 90 steps each.
    assert!((summary.adapted_share.unwrap() - 0.875).abs() < 1e-12);
    assert!((summary.no_adaptation_share.unwrap() - 0.5).abs() < 1e-12);
    // The speeds after the damage are constant: 1.4 of the oracle's 1.6 m/s, and of 2 · 1 m/s before.
    assert!((summary.kept_of_oracle.unwrap() - 0.875).abs() < 1e-12);
    assert!((summary.kept_of_healthy.unwrap() - 0.7).abs() < 1e-12);
    // Nothing was diagnosed, so that nothing counts as recovered.
    assert_eq!((summary.recovered, summary.stood_still, summary.fell), (Some(0.0), Some(0.0), Some(0.0)));
    assert_eq!(summary.unaware_share, None);
    let DecisionTime { robots, median, p99, longest } = summary.decision_ms;
    assert_eq!((robots, median, p99, longest), (6, 100.0, 198.0, 200.0));
    assert!((summary.classes[2].adapted - 54.0).abs() < 1e-9);
    assert_eq!((summary.classes[1].detected, summary.classes[2].detected), (0, 2));
    assert_eq!(summary.classes[1].ended_before_onset, 0);
    assert!(AdaptationSummary::new(&Trial { episodes: 3, ..trial }, &known, &contest).is_err());
}

#[test]
fn robots_that_stand_still_and_that_fall_are_counted_apart_and_recover_in_neither_case() {
    let diagnosed = |kept: f64, fell| {
        let adapted = Event { robot: 0, step: 20, kind: EventKind::Adapted { class: 1 } };
        let suspected = walk(1, 1.0, kept, Some(14));
        Episode { events: [suspected.events.clone(), vec![adapted]].concat(), fell, ..suspected }
    };
    let walks = |episodes| Walks { episodes, decision_seconds: Vec::new() };
    let contest = Contest {
        adapted: walks(vec![diagnosed(0.6, false), diagnosed(0.05, false), diagnosed(0.6, true)]),
        oracle: walks(vec![walk(1, 1.0, 0.6, None), walk(1, 1.0, 0.6, None), walk(1, 1.0, 0.0, None)]),
        no_adaptation: walks(vec![walk(1, 1.0, 0.1, None); 3]),
        unaware: None,
    };
    let known = all_known(&["healthy", "broken"]);
    let summary = AdaptationSummary::new(&trial(vec![1], 3), &known, &contest).unwrap();
    let class = &summary.classes[0];
    assert_eq!((class.recovered, class.stood_still, class.falls), (1, 1, 1));
    // The oracle keeps (0.6 + 0.6 + 0) / 3 = 0.4 m/s, the robot (0.6 + 0.05 + 0) / 3 = 0.2166….
    assert!((class.oracle_velocity_kept.unwrap() - 0.4).abs() < 1e-12);
    assert!((summary.kept_of_oracle.unwrap() - 0.65 / 1.2).abs() < 1e-12);
    for share in [summary.recovered, summary.stood_still, summary.fell] {
        assert!((share.unwrap() - 1.0 / 3.0).abs() < 1e-12);
    }
}

#[test]
fn damage_that_the_policy_does_not_know_is_never_right_and_has_no_oracle() {
    let adapted = |event_class| {
        let events = vec![
            Event {
                robot: 0,
                step: 14,
                kind: EventKind::Suspected { forward_velocity: 0.0, expected: 1.0, residual: None },
            },
            Event {
                robot: 0,
                step: 20,
                kind: EventKind::Diagnosed { class: event_class, confidence: 0.9, accepted: true },
            },
            Event { robot: 0, step: 20, kind: EventKind::Adapted { class: event_class } },
        ];
        Episode { events, ..walk(1, 1.0, 0.5, None) }
    };
    let walks = |episodes| Walks { episodes, decision_seconds: Vec::new() };
    let contest = Contest {
        adapted: walks(vec![adapted(1), adapted(2), adapted(2)]),
        oracle: walks(vec![walk(1, 1.0, 1.0, None); 3]),
        no_adaptation: walks(vec![walk(1, 1.0, 0.1, None); 3]),
        unaware: None,
    };
    // The robot's class 1 has no code.
    let known = KnownClasses {
        names: ["healthy", "weak"].map(ToOwned::to_owned).to_vec(),
        known: vec![Some(0), None],
        codes: vec![vec![0.0]; 2],
        known_names: ["healthy", "jammed", "missing"].map(ToOwned::to_owned).to_vec(),
    };
    let trial = trial(vec![1], 3);
    let summary = AdaptationSummary::new(&trial, &known, &contest).unwrap();
    let class = &summary.classes[0];
    assert_eq!((class.detected, class.correct_first, class.correct_last), (3, 0, 0));
    assert_eq!((class.oracle, class.median_recovery, summary.adapted_share), (None, None, None));
    let assumed = [("missing", 2), ("jammed", 1)];
    assert!(class.assumed.iter().map(|assumed| (assumed.name.as_str(), assumed.episodes)).eq(assumed));
    assert!(summary.csv().contains(",missing 2; jammed 1,"));
}

#[test]
fn an_episode_that_ended_before_its_damage_struck_counts_for_nothing() {
    let trial = trial(vec![1], 2);
    let fallen = Episode { steps: 10, velocities: vec![1.0; 10], fell: true, ..walk(1, 1.0, 0.0, None) };
    let walks = |after: f64, suspected| Walks {
        episodes: vec![walk(1, 1.0, after, suspected), fallen.clone()],
        decision_seconds: Vec::new(),
    };
    let contest = Contest {
        adapted: walks(0.5, Some(12)),
        oracle: walks(1.0, None),
        no_adaptation: walks(0.1, None),
        unaware: Some(walks(0.2, None)),
    };
    let summary = AdaptationSummary::new(&trial, &all_known(&["healthy", "broken"]), &contest).unwrap();
    let class = &summary.classes[0];
    assert_eq!((class.episodes, class.ended_before_onset, class.detected, class.falls), (1, 1, 1, 0));
    assert_eq!((summary.severe_episodes, summary.severe_detected), (1, Some(1.0)));
    assert!((class.adapted - 45.0).abs() < 1e-9);
    assert!((summary.unaware_share.unwrap() - 0.2).abs() < 1e-12);
    assert_eq!(summary.healthy_without_alarm, None);
}

#[test]
fn outcomes_of_a_task_with_commands_are_trackings_and_a_fall_ends_them() {
    let tracked = |after: f64, steps: usize, fell| Episode {
        trackings: [vec![0.8; 10], vec![after; steps - 10]].concat(),
        at_rest: vec![0.3; steps],
        velocities: vec![0.0; steps],
        fell,
        steps,
        ..walk(1, 0.0, 0.0, None)
    };
    let walks = |episodes| Walks { episodes, decision_seconds: Vec::new() };
    let contest = Contest {
        adapted: walks(vec![tracked(0.6, 100, false), tracked(0.7, 55, true)]),
        oracle: walks(vec![tracked(0.8, 100, false); 2]),
        // 0.7 of 45 of the 90 steps after the damage is 0.35 a step, less than half of the 0.8 before.
        no_adaptation: walks(vec![tracked(0.7, 55, true), tracked(0.35, 100, false)]),
        unaware: None,
    };
    let known = all_known(&["healthy", "broken"]);
    let summary = AdaptationSummary::new(&trial(vec![1], 2), &known, &contest).unwrap();
    let Tracking { before, kept, oracle_kept } = summary.classes[0].tracking;
    for (got, expected) in [(before, 0.8), (kept, 0.3), (oracle_kept, 0.8), (summary.kept_of_oracle, 0.375)] {
        assert!((got.unwrap() - expected).abs() < 1e-12, "{got:?}, expected {expected}");
    }
    // (90 · 0.6 + 45 · 0.7) / (2 · 90 · 0.8)
    assert!((summary.adapted_share.unwrap() - 85.5 / 144.0).abs() < 1e-12);
    assert_eq!((summary.severe_episodes, summary.classes[0].stood_still), (2, 0));
    let csv = summary.csv();
    assert!(
        csv.lines().next().unwrap().ends_with(",unaware,tracking_before,tracking_kept,oracle_tracking_kept")
    );
    assert!(csv.lines().nth(1).unwrap().ends_with(",0.8000,0.3000,0.8000"), "{csv}");
}
