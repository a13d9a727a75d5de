//! What a person sees of a trial.

use dappo_diagnose::adapt::{AdaptationSummary, ClassOutcome, Contest};
use dappo_learn::walk::{Event, EventKind, Trial};

use crate::cli::console::{Table, print_line};

/// Prints the events and numbers of a single damage class, or the tables of all classes. `names` are those of the
/// classes that the controller knows, `control_period` is the length of a step, s.
pub fn show(
    summary: &AdaptationSummary,
    contest: &Contest,
    trial: &Trial,
    names: &[String],
    control_period: f64,
) {
    if let [only] = summary.classes.as_slice() {
        let first = contest.adapted.episodes.first();
        events(first.map_or(&[], |episode| episode.events.as_slice()), trial, names);
        class(only, trial, control_period);
    } else {
        diagnoses(summary);
        walks(summary);
        means(summary);
    }
    let time = summary.decision_ms;
    print_line!(
        "time of a decision for {} robots: {:.2} ms (median), {:.2} ms (99th percentile), {:.2} ms (longest)",
        time.robots,
        time.median,
        time.p99,
        time.longest
    );
}

/// The events of the first episode.
fn events(events: &[Event], trial: &Trial, names: &[String]) {
    print_line!("episode 1 of {}, damage at step {}", trial.episodes, trial.onset.first);
    if events.is_empty() {
        print_line!("  no damage suspected");
    }
    for event in events {
        let name = |class: usize| names.get(class).map_or("", String::as_str);
        let text = match &event.kind {
            EventKind::Suspected { forward_velocity, expected, residual } => {
                let residual =
                    residual.map_or_else(String::new, |residual| format!(", residual {residual:.3}"));
                format!("damage suspected: {forward_velocity:.2} m/s, expected {expected:.2} m/s{residual}")
            }
            EventKind::Diagnosed { class, confidence, accepted } => {
                let rejected = if *accepted { "" } else { ", rejected" };
                format!("diagnosis: {} ({:.0} %{rejected})", name(*class), 100.0 * confidence)
            }
            EventKind::Adapted { class } => format!("damage code of the policy: {}", name(*class)),
            EventKind::Withdrawn { class, residual, healthy } => format!(
                "diagnosis withdrawn: {} (residual of its twin {residual:.3}, of the healthy twin {healthy:.3})",
                name(*class)
            ),
            EventKind::ReadingsLost { faults } => format!("{faults} readings lost"),
            EventKind::ReadingsBack => "all readings are back".to_owned(),
        };
        print_line!("  step {:>4}  {text}", event.step);
    }
}

/// The numbers of a single class.
fn class(c: &ClassOutcome, trial: &Trial, control_period: f64) {
    let of = |count: usize| format!("{count} of {}", c.episodes);
    print_line!("{}, {} episodes", c.name, c.episodes);
    if c.ended_before > 0 {
        print_line!("  left out, ended before the damage: {}", c.ended_before);
    }
    if c.class == 0 {
        print_line!("  false alarms: {}", of(c.false_alarms));
    } else {
        print_line!(
            "  damage detected: {}, after {} steps (median); false alarms before: {}",
            of(c.detected),
            steps(c.median_delay),
            of(c.false_alarms)
        );
        print_line!(
            "  first diagnosis correct: {}; damage code correct at the end: {}",
            of(c.right_at_first),
            of(c.right_at_last)
        );
        let given: Vec<String> =
            c.given.iter().map(|given| format!("{} ({})", given.name, given.episodes)).collect();
        print_line!("  damage codes at the end, with episodes: {}", given.join(", "));
    }
    print_line!(
        "  forward velocity before step {}: {:.2} m/s; over the last 200 steps: {:.2} m/s, {} of that before{}",
        trial.onset.first,
        c.velocity_before,
        c.velocity_kept,
        percent(share(c.velocity_kept, Some(c.velocity_before))),
        c.oracle_velocity_kept.map_or_else(String::new, |oracle| {
            format!(", {} of the oracle's", percent(share(c.velocity_kept, Some(oracle))))
        })
    );
    if c.class != 0 && c.oracle.is_some() {
        print_line!(
            "  recovered (diagnosed, and at least 80 % of the oracle's speed at the end): {}, after {} steps (median)",
            of(c.recovered),
            steps(c.median_recovery)
        );
    }
    print_line!("  stood still at the end: {}; fell: {}", of(c.stood_still), of(c.falls));
    print_line!("  forward reward and distance from step {} on:", trial.onset.first);
    for (name, reward) in [
        ("adapted", Some(c.adapted)),
        ("oracle (given the damage code at once)", c.oracle),
        ("no adaptation (code of a healthy robot)", Some(c.unadapted)),
        ("PPO-Unaware", c.unaware),
    ] {
        if let Some(reward) = reward {
            print_line!("  {reward:>10.1} {:>8.1} m  {name}", reward * control_period);
        }
    }
}

/// What the controller found out about every class.
fn diagnoses(summary: &AdaptationSummary) {
    let mut table = Table::new(&[
        "<damage",
        "false alarms",
        "detected",
        "after steps",
        "first diagnosis correct",
        "code correct at the end",
    ]);
    for c in &summary.classes {
        let of_damage = |count: usize| if c.class == 0 { "–".to_owned() } else { of_episodes(c, count) };
        table.row([
            c.name.clone(),
            of_episodes(c, c.false_alarms),
            of_damage(c.detected),
            steps(c.median_delay),
            of_damage(c.right_at_first),
            of_episodes(c, c.right_at_last),
        ]);
    }
    table.print();
}

/// How the robots of every class walked on. The speed kept is that over the last 200 steps.
fn walks(summary: &AdaptationSummary) {
    let mut table = Table::new(&[
        "<damage",
        "recovered",
        "stood still",
        "fell",
        "kept m/s",
        "of before",
        "of oracle",
        "adapted",
        "oracle",
        "no adaptation",
        "PPO-Unaware",
    ]);
    for c in &summary.classes {
        let reward = |reward: Option<f64>| reward.map_or_else(String::new, |reward| format!("{reward:.1}"));
        let is_comparable = c.class != 0 && c.oracle.is_some();
        table.row([
            c.name.clone(),
            if is_comparable { of_episodes(c, c.recovered) } else { "–".to_owned() },
            of_episodes(c, c.stood_still),
            of_episodes(c, c.falls),
            format!("{:.2}", c.velocity_kept),
            percent(share(c.velocity_kept, Some(c.velocity_before))),
            percent(share(c.velocity_kept, c.oracle_velocity_kept)),
            reward(Some(c.adapted)),
            reward(c.oracle),
            reward(Some(c.unadapted)),
            reward(c.unaware),
        ]);
    }
    table.print();
}

/// The means over all classes.
fn means(summary: &AdaptationSummary) {
    print_line!("healthy episodes without a false alarm: {}", percent(summary.healthy_without_alarm));
    let left_out: usize = summary.classes.iter().map(|class| class.ended_before).sum();
    if left_out > 0 {
        print_line!("episodes left out, which ended before the damage: {left_out}");
    }
    print_line!(
        "damage that costs more than half of the speed: {} of {} episodes detected, after {} steps (median)",
        percent(summary.severe_detected),
        summary.severe_episodes,
        steps(summary.severe_median_delay)
    );
    print_line!(
        "first diagnosis correct: {}; damage code correct at the end: {}",
        percent(summary.right_at_first),
        percent(summary.right_at_last)
    );
    print_line!(
        "speed over the last 200 steps: {} of the oracle's, {} of that before the damage",
        percent(summary.kept_of_oracle),
        percent(summary.kept_of_healthy)
    );
    print_line!(
        "episodes with damage: recovered {}, stood still at the end {}, fell {}",
        percent(summary.recovered),
        percent(summary.stood_still),
        percent(summary.fell)
    );
    print_line!(
        "forward reward after the damage, as a share of the oracle's: adapted {}, no adaptation {}{}",
        percent(summary.adapted_share),
        percent(summary.unadapted_share),
        summary
            .unaware_share
            .map_or_else(String::new, |share| format!(", PPO-Unaware {}", percent(Some(share))))
    );
}

fn of_episodes(class: &ClassOutcome, count: usize) -> String {
    format!("{:.0} %", 100.0 * count as f64 / class.episodes as f64)
}

/// A part of a whole that must be above 0.
fn share(part: f64, whole: Option<f64>) -> Option<f64> {
    whole.filter(|whole| *whole > 0.0).map(|whole| part / whole)
}

fn percent(share: Option<f64>) -> String {
    share.map_or_else(|| "–".to_owned(), |share| format!("{:.1} %", 100.0 * share))
}

fn steps(median: Option<f64>) -> String {
    median.map_or_else(|| "–".to_owned(), |steps| format!("{steps:.0}"))
}
