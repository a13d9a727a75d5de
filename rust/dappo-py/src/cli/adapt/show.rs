//! What a person sees of a trial.

use dappo_diagnose::adapt::{AdaptationSummary, ClassOutcome, Contest};
use dappo_learn::walk::Trial;
use dappo_learn::walk::{Event, EventKind};

use crate::cli::console::{Table, print_line};

/// Prints the story of a single damage, or the table of all classes.
pub fn show(summary: &AdaptationSummary, contest: &Contest, trial: &Trial, names: &[String]) {
    if let [only] = summary.classes.as_slice() {
        story(contest.adapted.episodes.first().map_or(&[], |walk| walk.events.as_slice()), trial, names);
        one(only, trial);
    } else {
        table(summary);
        essence(summary);
    }
    let time = summary.decision_ms;
    print_line!(
        "time of a decision about {} robots: {:.2} ms (median), 99 % below {:.2} ms, longest {:.2} ms",
        time.robots,
        time.median,
        time.p99,
        time.longest
    );
}

/// The events of the first episode.
fn story(events: &[Event], trial: &Trial, names: &[String]) {
    print_line!("episode 1 of {}, damage at step {}", trial.episodes, trial.onset.first);
    if events.is_empty() {
        print_line!("  nothing was suspected");
    }
    for event in events {
        let name = |class: usize| names.get(class).map_or("", String::as_str);
        let text = match &event.kind {
            EventKind::Suspected { forward_velocity, expected, residual } => {
                let residual =
                    residual.map_or_else(String::new, |residual| format!(", residual {residual:.3}"));
                format!("damage suspected: {forward_velocity:.2} m/s, expected {expected:.2}{residual}")
            }
            EventKind::Diagnosed { class, confidence, accepted } => {
                let doubt = if *accepted { "" } else { ", not believed" };
                format!("diagnosis: {} ({:.0} %{doubt})", name(*class), 100.0 * confidence)
            }
            EventKind::Adapted { class } => format!("the policy is told: {}", name(*class)),
            EventKind::Withdrawn { class, residual, healthy } => format!(
                "withdrawn: {}; its twin differs by {residual:.3}, the healthy one by {healthy:.3}",
                name(*class)
            ),
            EventKind::ReadingsLost { faults } => format!("{faults} readings lost"),
            EventKind::ReadingsBack => "all readings are back".to_owned(),
        };
        print_line!("  step {:>4}  {text}", event.step);
    }
}

/// The numbers of a single class.
fn one(c: &ClassOutcome, trial: &Trial) {
    let of = |count: usize| format!("{count} of {}", c.episodes);
    print_line!("{}, {} episodes", c.name, c.episodes);
    if c.class == 0 {
        print_line!("  false alarms: {}", of(c.false_alarms));
    } else {
        print_line!(
            "  detected: {}, after {} steps (median); false alarms before: {}",
            of(c.detected),
            steps(c.median_delay),
            of(c.false_alarms)
        );
        print_line!(
            "  first diagnosis right: {}; told the right class in the end: {}",
            of(c.right_at_first),
            of(c.right_at_last)
        );
        let given: Vec<String> =
            c.given.iter().map(|given| format!("{} ({})", given.name, given.episodes)).collect();
        print_line!("  told in the end, with episodes: {}", given.join(", "));
    }
    if c.class != 0 && c.oracle.is_some() {
        print_line!(
            "  recovered (80 % of the oracle's speed): {}, after {} steps (median)",
            of(c.recovered),
            steps(c.median_recovery)
        );
    }
    if c.ended_before > 0 {
        print_line!("  ended before the damage struck, and left out: {}", c.ended_before);
    }
    print_line!("  falls: {}", of(c.falls));
    print_line!("  forward velocity before step {}: {:.2} m/s", trial.onset.first, c.velocity_before);
    print_line!("  forward reward from then on:");
    for (name, reward) in [
        ("adapted", Some(c.adapted)),
        ("oracle (told the truth at once)", c.oracle),
        ("no adaptation", Some(c.unadapted)),
        ("PPO-Unaware", c.unaware),
    ] {
        if let Some(reward) = reward {
            print_line!("  {reward:>10.1}  {name}");
        }
    }
}

fn table(summary: &AdaptationSummary) {
    let mut table = Table::new(&[
        "<damage",
        "alarms",
        "detected",
        "delay",
        "first",
        "last",
        "recover",
        "falls",
        "adapted",
        "oracle",
        "unadapted",
        "unaware",
    ]);
    for c in &summary.classes {
        let share = |count: usize| format!("{:.0} %", 100.0 * count as f64 / c.episodes as f64);
        let of_damage = |count: usize| if c.class == 0 { "–".to_owned() } else { share(count) };
        let reward = |reward: Option<f64>| reward.map_or_else(String::new, |reward| format!("{reward:.1}"));
        table.row([
            c.name.clone(),
            share(c.false_alarms),
            of_damage(c.detected),
            steps(c.median_delay),
            of_damage(c.right_at_first),
            share(c.right_at_last),
            steps(c.median_recovery),
            share(c.falls),
            reward(Some(c.adapted)),
            reward(c.oracle),
            reward(Some(c.unadapted)),
            reward(c.unaware),
        ]);
    }
    table.print();
}

fn essence(summary: &AdaptationSummary) {
    let percent =
        |share: Option<f64>| share.map_or("–".to_owned(), |share| format!("{:.1} %", 100.0 * share));
    print_line!("healthy episodes without alarm: {}", percent(summary.healthy_without_alarm));
    let left_out: usize = summary.classes.iter().map(|class| class.ended_before).sum();
    if left_out > 0 {
        print_line!("episodes that ended before the damage struck, and are left out: {left_out}");
    }
    print_line!(
        "damages that cost more than half of the speed: {} of {} episodes detected, after {} steps (median)",
        percent(summary.severe_detected),
        summary.severe_episodes,
        steps(summary.severe_median_delay)
    );
    print_line!(
        "first diagnosis right: {}; told the right class in the end: {}",
        percent(summary.right_at_first),
        percent(summary.right_at_last)
    );
    print_line!(
        "forward reward after the damage, of the oracle's: {} adapted, {} without adaptation{}",
        percent(summary.recovered_share),
        percent(summary.unadapted_share),
        summary
            .unaware_share
            .map_or_else(String::new, |share| format!(", {:.1} % PPO-Unaware", 100.0 * share))
    );
}

fn steps(median: Option<f64>) -> String {
    median.map_or_else(|| "–".to_owned(), |steps| format!("{steps:.0}"))
}
