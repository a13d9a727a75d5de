//! The text of small trials, as a person would write it.

use dappo_learn::walk::{Episode, Kept, Walks};
use dappo_sim::vector_env::{DamageCourse, StepRange};

use super::*;
use crate::adapt::{AssumedClass, Tracking};

fn trial(episodes: usize) -> Trial {
    let onset = StepRange { first: 300, last: 300 };
    let course = DamageCourse { onset, ..DamageCourse::default() };
    Trial { classes: Vec::new(), episodes, course, seed: 0, kept: Kept::Velocities }
}

fn known() -> KnownClasses {
    let names = ["healthy", "jammed@0"].map(ToOwned::to_owned).to_vec();
    KnownClasses {
        known: vec![Some(0), Some(1)],
        codes: vec![vec![0.0], vec![1.0]],
        known_names: names.clone(),
        names,
    }
}

/// A trial whose first episode has these events.
fn contest(events: Vec<EventKind>) -> Contest {
    let events = events.into_iter().zip(310..).map(|(kind, step)| Event { robot: 0, step, kind });
    let episode = Episode { events: events.collect(), ..Episode::default() };
    let adapted = Walks { episodes: vec![episode], decision_seconds: Vec::new() };
    Contest { adapted, oracle: Walks::default(), no_adaptation: Walks::default(), unaware: None }
}

fn healthy() -> ClassOutcome {
    ClassOutcome {
        class: 0,
        name: "healthy".into(),
        episodes: 4,
        ended_before_onset: 0,
        false_alarms: 1,
        detected: 0,
        median_delay: None,
        correct_first: 0,
        correct_last: 3,
        assumed: Vec::new(),
        diagnosis_windows: 0.25,
        recovered: 0,
        median_recovery: None,
        falls: 0,
        stood_still: 0,
        velocity_before: 2.0,
        velocity_kept: 1.5,
        oracle_velocity_kept: Some(2.0),
        tracking: Tracking::default(),
        adapted: 1500.0,
        oracle: Some(2000.0),
        no_adaptation: 2000.0,
        unaware: None,
    }
}

fn jammed() -> ClassOutcome {
    let assumed = [("jammed@0", 3), ("healthy", 1)];
    let assumed = assumed.map(|(name, episodes)| AssumedClass { name: name.into(), episodes });
    ClassOutcome {
        class: 1,
        name: "jammed@0".into(),
        ended_before_onset: 2,
        detected: 3,
        median_delay: Some(12.0),
        correct_first: 2,
        assumed: assumed.to_vec(),
        recovered: 1,
        median_recovery: Some(250.0),
        falls: 1,
        stood_still: 2,
        unaware: Some(-100.0),
        ..healthy()
    }
}

/// Damage without a code, of a robot that stood still at the onset.
fn unknown() -> ClassOutcome {
    ClassOutcome {
        name: "weak@0".into(),
        ended_before_onset: 0,
        velocity_before: 0.0,
        oracle_velocity_kept: None,
        oracle: None,
        ..jammed()
    }
}

fn summary(classes: Vec<ClassOutcome>) -> AdaptationSummary {
    AdaptationSummary {
        classes,
        healthy_without_alarm: Some(0.75),
        severe_episodes: 3,
        severe_detected: Some(1.0),
        severe_median_delay: Some(12.0),
        correct_first: Some(0.5),
        correct_last: Some(0.25),
        recovered: Some(0.125),
        stood_still: Some(0.0),
        fell: Some(0.2),
        kept_of_oracle: Some(0.9),
        kept_of_healthy: Some(0.45),
        adapted_share: Some(0.8),
        no_adaptation_share: Some(0.3),
        unaware_share: Some(-0.1),
        decision_ms: DecisionTime { robots: 8, median: 0.5, p99: 1.25, longest: 30.0 },
    }
}

const TIME: &str =
    "time of a decision for 8 robots: 0.50 ms (median), 1.25 ms (99th percentile), 30.00 ms (longest)\n";

fn text(classes: Vec<ClassOutcome>, events: Vec<EventKind>) -> String {
    summary(classes).text(&trial(6), &known(), &contest(events), 0.05)
}

#[test]
fn a_single_damage_class_shows_the_events_of_its_first_episode_and_its_numbers() {
    let events = vec![
        EventKind::Suspected { forward_velocity: 0.25, expected: 2.0, residual: Some(0.125) },
        EventKind::Suspected { forward_velocity: 0.25, expected: 2.0, residual: None },
        EventKind::Diagnosed { class: 1, confidence: 0.75, accepted: false },
        EventKind::Diagnosed { class: 1, confidence: 1.0, accepted: true },
        EventKind::Adapted { class: 1 },
        EventKind::Withdrawn { class: 1, residual: 0.5, healthy: 0.25 },
        EventKind::ObservationInvalid { entries: 3 },
        EventKind::ObservationValid,
    ];
    // 0.05 s a step: 1500 m/s · 0.05 s = 75 m.
    let expected = "\
        episode 1 of 6, damage at step 300\n  \
          step  310  damage suspected: 0.25 m/s, expected 2.00 m/s, residual 0.125\n  \
          step  311  damage suspected: 0.25 m/s, expected 2.00 m/s\n  \
          step  312  diagnosis: jammed@0 (75 %, rejected)\n  \
          step  313  diagnosis: jammed@0 (100 %)\n  \
          step  314  damage code of the policy: jammed@0\n  \
          step  315  diagnosis withdrawn: jammed@0 (residual of its twin 0.500, of the healthy twin 0.250)\n  \
          step  316  observation: 3 entries are not finite\n  \
          step  317  observation: all entries are finite again\n\
        jammed@0, 4 episodes\n  \
          left out, ended before the damage: 2\n  \
          damage detected: 3 of 4, after 12 steps (median); false alarms before: 1 of 4\n  \
          first diagnosis correct: 2 of 4; damage code correct at the end: 3 of 4\n  \
          damage codes at the end, with episodes: jammed@0 (3), healthy (1)\n  \
          forward velocity before step 300: 2.00 m/s; over the last 200 steps: 1.50 m/s, 75.0 % of that before, \
          75.0 % of the oracle's\n  \
          recovered (diagnosed, and at least 80 % of the oracle's speed at the end): 1 of 4, after 250 steps \
          (median)\n  \
          stood still at the end: 2 of 4; fell: 1 of 4\n  \
          forward reward and distance from step 300 on:\n      \
              1500.0     75.0 m  adapted\n      \
              2000.0    100.0 m  oracle (given the damage code at once)\n      \
              2000.0    100.0 m  no adaptation (code of a healthy robot)\n      \
              -100.0     -5.0 m  policy without damage code\n";
    assert_eq!(text(vec![jammed()], events), [expected, TIME].concat());
}

#[test]
fn a_healthy_robot_has_false_alarms_and_nothing_to_detect_or_to_recover_from() {
    let expected = "\
        episode 1 of 6, damage at step 300\n  \
          no damage suspected\n\
        healthy, 4 episodes\n  \
          false alarms: 1 of 4\n  \
          forward velocity before step 300: 2.00 m/s; over the last 200 steps: 1.50 m/s, 75.0 % of that before, \
          75.0 % of the oracle's\n  \
          stood still at the end: 0 of 4; fell: 0 of 4\n  \
          forward reward and distance from step 300 on:\n      \
              1500.0     75.0 m  adapted\n      \
              2000.0    100.0 m  oracle (given the damage code at once)\n      \
              2000.0    100.0 m  no adaptation (code of a healthy robot)\n";
    assert_eq!(text(vec![healthy()], Vec::new()), [expected, TIME].concat());
}

#[test]
fn damage_that_the_policy_does_not_know_is_compared_with_no_oracle() {
    let text = text(vec![unknown()], Vec::new());
    let expected = "\
        weak@0, 4 episodes\n  \
          damage detected: 3 of 4, after 12 steps (median); false alarms before: 1 of 4\n  \
          first diagnosis correct: 2 of 4; damage code correct at the end: 3 of 4\n  \
          damage codes at the end, with episodes: jammed@0 (3), healthy (1)\n  \
          forward velocity before step 300: 0.00 m/s; over the last 200 steps: 1.50 m/s, – of that before\n  \
          stood still at the end: 2 of 4; fell: 1 of 4\n";
    assert!(text.contains(expected), "{text}");
    assert!(!text.contains("oracle"), "{text}");
}

#[test]
fn several_classes_show_two_tables_and_their_means() {
    let expected = "\
        damage    false alarms  detected  after steps  first diagnosis correct  code correct at the end\n\
        healthy           25 %         –            –                        –                     75 %\n\
        jammed@0          25 %      75 %           12                     50 %                     75 %\n\
        weak@0            25 %      75 %           12                     50 %                     75 %\n\
        damage    recovered  stood still  fell  kept m/s  of before  of oracle  adapted  oracle  no adaptation  \
        without code\n\
        healthy           –          0 %   0 %      1.50     75.0 %     75.0 %   1500.0  2000.0         2000.0\n\
        jammed@0       25 %         50 %  25 %      1.50     75.0 %     75.0 %   1500.0  2000.0         2000.0        \
             -100.0\n\
        weak@0            –         50 %  25 %      1.50          –          –   1500.0                 2000.0        \
             -100.0\n\
        healthy episodes without a false alarm: 75.0 %\n\
        episodes left out, which ended before the damage: 2\n\
        damage that costs more than half of the speed: 100.0 % of 3 episodes detected, after 12 steps (median)\n\
        first diagnosis correct: 50.0 %; damage code correct at the end: 25.0 %\n\
        speed over the last 200 steps: 90.0 % of the oracle's, 45.0 % of that before the damage\n\
        episodes with damage: recovered 12.5 %, stood still at the end 0.0 %, fell 20.0 %\n\
        forward reward after the damage, as a share of the oracle's: adapted 80.0 %, no adaptation 30.0 %, \
        without damage code -10.0 %\n";
    assert_eq!(text(vec![healthy(), jammed(), unknown()], Vec::new()), [expected, TIME].concat());
}

#[test]
fn what_no_class_has_is_a_dash_or_left_out() {
    let mut summary = summary(vec![healthy(), healthy()]);
    (summary.severe_detected, summary.severe_median_delay, summary.unaware_share) = (None, None, None);
    let text = summary.text(&trial(6), &known(), &contest(Vec::new()), 0.05);
    let expected = "\
        healthy episodes without a false alarm: 75.0 %\n\
        damage that costs more than half of the speed: – of 3 episodes detected, after – steps (median)\n";
    assert!(text.contains(expected), "{text}");
    assert!(text.contains("adapted 80.0 %, no adaptation 30.0 %\n"), "{text}");
}

#[test]
fn a_task_with_commands_is_described_by_its_tracking() {
    let tracking = Tracking { before: Some(0.8), kept: Some(0.6), oracle_kept: Some(0.75) };
    let class = ClassOutcome { tracking, ..jammed() };
    let text = class.text(&trial(4), 0.02);
    let line = "  tracking of the commands before step 300: 0.80; over the last 200 steps: 0.60, 75.0 % of that before, \
                80.0 % of the oracle's\n";
    assert!(text.contains(line), "{text}");
    assert!(text.contains("at least 80 % of the oracle's tracking at the end"), "{text}");
    assert!(text.contains("  tracking, summed over the steps from step 300 on:\n"), "{text}");
    assert!(!text.contains(" m  "), "{text}");
    let text =
        summary(vec![healthy(), class.clone(), class]).text(&trial(4), &known(), &contest(Vec::new()), 0.02);
    assert!(text.contains("kept tracking"), "{text}");
    assert!(
        text.contains("tracking over the last 200 steps: 90.0 % of the oracle's, 45.0 % of that before"),
        "{text}"
    );
}
