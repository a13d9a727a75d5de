//! What a person sees of a trial.

use dappo_learn::adapt::{ClassOutcome, Contest, Summary, Trial};
use dappo_learn::controller::{Event, EventKind};

use crate::cli::console;

/// Prints the story of a single damage, or the table of all classes.
pub fn show(summary: &Summary, contest: &Contest, trial: &Trial, names: &[String]) {
    if let [only] = summary.classes.as_slice() {
        story(contest.adapted.episodes.first().map_or(&[], |walk| walk.events.as_slice()), trial, names);
        one(only, trial);
    } else {
        table(summary);
        essence(summary);
    }
    let time = summary.decision_ms;
    console::print_line(&format!(
        "time of a decision about {} robots: {:.2} ms (median), 99 % below {:.2} ms, longest {:.2} ms",
        time.robots, time.median, time.p99, time.longest
    ));
}

/// The events of the first episode.
fn story(events: &[Event], trial: &Trial, names: &[String]) {
    console::print_line(&format!("episode 1 of {}, damage at step {}", trial.episodes, trial.onset));
    if events.is_empty() {
        console::print_line("  nothing was suspected");
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
        console::print_line(&format!("  step {:>4}  {text}", event.step));
    }
}

/// The numbers of a single class.
fn one(c: &ClassOutcome, trial: &Trial) {
    let of = |count: usize| format!("{count} of {}", c.episodes);
    console::print_line(&format!("{}, {} episodes", c.name, c.episodes));
    if c.class == 0 {
        console::print_line(&format!("  false alarms: {}", of(c.false_alarms)));
    } else {
        console::print_line(&format!(
            "  detected: {}, after {} steps (median); false alarms before: {}",
            of(c.detected),
            steps(c.median_delay),
            of(c.false_alarms)
        ));
        console::print_line(&format!(
            "  first diagnosis right: {}; told the right class in the end: {}",
            of(c.right_at_first),
            of(c.right_at_last)
        ));
        let told: Vec<String> =
            c.told.iter().map(|told| format!("{} ({})", told.name, told.episodes)).collect();
        console::print_line(&format!("  told in the end, with episodes: {}", told.join(", ")));
    }
    if c.class != 0 && c.oracle.is_some() {
        console::print_line(&format!(
            "  recovered (80 % of the oracle's speed): {}, after {} steps (median)",
            of(c.recovered),
            steps(c.median_recovery)
        ));
    }
    if c.ended_before > 0 {
        console::print_line(&format!("  ended before the damage struck, and left out: {}", c.ended_before));
    }
    console::print_line(&format!("  falls: {}", of(c.falls)));
    console::print_line(&format!(
        "  forward velocity before step {}: {:.2} m/s",
        trial.onset, c.velocity_before
    ));
    console::print_line("  forward reward from then on:");
    for (name, reward) in [
        ("adapted", Some(c.adapted)),
        ("oracle (told the truth at once)", c.oracle),
        ("no adaptation", Some(c.unadapted)),
        ("PPO-Unaware", c.unaware),
    ] {
        if let Some(reward) = reward {
            console::print_line(&format!("  {reward:>10.1}  {name}"));
        }
    }
}

fn table(summary: &Summary) {
    let width = summary.classes.iter().map(|class| class.name.len()).max().unwrap_or(0).max("damage".len());
    console::print_line(&format!(
        "{:<width$} {:>6} {:>8} {:>6} {:>6} {:>6} {:>8} {:>6} {:>8} {:>8} {:>9} {:>8}",
        "damage",
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
        "unaware"
    ));
    for c in &summary.classes {
        let share = |count: usize| format!("{:.0} %", 100.0 * count as f64 / c.episodes as f64);
        let of_damage = |count: usize| if c.class == 0 { "–".to_owned() } else { share(count) };
        let reward = |reward: Option<f64>| reward.map_or_else(String::new, |reward| format!("{reward:.1}"));
        console::print_line(&format!(
            "{:<width$} {:>6} {:>8} {:>6} {:>6} {:>6} {:>8} {:>6} {:>8.1} {:>8} {:>9.1} {:>8}",
            c.name,
            share(c.false_alarms),
            of_damage(c.detected),
            steps(c.median_delay),
            of_damage(c.right_at_first),
            share(c.right_at_last),
            steps(c.median_recovery),
            share(c.falls),
            c.adapted,
            reward(c.oracle),
            c.unadapted,
            reward(c.unaware)
        ));
    }
}

fn essence(summary: &Summary) {
    let percent =
        |share: Option<f64>| share.map_or("–".to_owned(), |share| format!("{:.1} %", 100.0 * share));
    console::print_line(&format!(
        "healthy episodes without alarm: {}",
        percent(summary.healthy_without_alarm)
    ));
    let left_out: usize = summary.classes.iter().map(|class| class.ended_before).sum();
    if left_out > 0 {
        console::print_line(&format!(
            "episodes that ended before the damage struck, and are left out: {left_out}"
        ));
    }
    console::print_line(&format!(
        "damages that cost more than half of the speed: {} of {} episodes detected, after {} steps (median)",
        percent(summary.severe_detected),
        summary.severe_episodes,
        steps(summary.severe_median_delay)
    ));
    console::print_line(&format!(
        "first diagnosis right: {}; told the right class in the end: {}",
        percent(summary.right_at_first),
        percent(summary.right_at_last)
    ));
    console::print_line(&format!(
        "forward reward after the damage, of the oracle's: {} adapted, {} without adaptation{}",
        percent(summary.recovered_share),
        percent(summary.unadapted_share),
        summary
            .unaware_share
            .map_or_else(String::new, |share| format!(", {:.1} % PPO-Unaware", 100.0 * share))
    ));
}

fn steps(median: Option<f64>) -> String {
    median.map_or_else(|| "–".to_owned(), |steps| format!("{steps:.0}"))
}
