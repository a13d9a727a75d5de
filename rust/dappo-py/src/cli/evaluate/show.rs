//! What a person sees of an evaluation.

use dappo_learn::evaluate::{
    ComparisonSummary, Estimate, Evaluation, Gain, GroupResult, RunEvaluation, Side,
};
use dappo_learn::statistics::mean;
use dappo_learn::walk::Encoding;

use crate::cli::console::{Table, print_line};

/// Prints the table of the classes, that of the groups and the mean over all classes.
pub fn show(evaluation: &Evaluation) {
    classes(evaluation);
    groups(evaluation);
}

fn classes(evaluation: &Evaluation) {
    let mut table =
        Table::new(&["class", "<name", "<group", "forward reward", "± s.e.", "m/s", "m", "length", "falls"]);
    for c in &evaluation.classes {
        table.row([
            c.class.to_string(),
            c.name.clone(),
            c.group.clone(),
            format!("{:.1}", c.forward_reward),
            error(c.standard_error),
            format!("{:.2}", c.forward_velocity),
            format!("{:.1}", c.distance),
            format!("{:.0}", c.episode_length),
            format!("{}/{}", c.falls, c.episodes),
        ]);
    }
    table.print();
}

/// Prints the table of the groups and the mean over all classes.
pub fn groups(evaluation: &Evaluation) {
    let mut table = Table::new(&["<group", "classes", "forward reward", "± s.e.", "m/s", "m", "falls"]);
    for g in &evaluation.groups {
        table.row([
            g.group.clone(),
            g.classes.to_string(),
            format!("{:.1}", g.forward_reward),
            error(g.standard_error),
            format!("{:.2}", g.forward_velocity),
            format!("{:.1}", g.distance),
            format!("{}/{}", g.falls, g.episodes),
        ]);
    }
    table.print();
    let all = evaluation.all();
    if all.diverged > 0 {
        print_line!("episodes among the falls that ended because the physics diverged: {}", all.diverged);
    }
    print_line!(
        "mean over {} damage classes: {} (backend {}, {}){}",
        all.classes,
        walked(all.forward_reward, all.forward_velocity, all.distance),
        evaluation.simulator.physics.backend(),
        evaluation.simulator.physics.precision(),
        encoding(evaluation.encoding)
    );
}

/// Prints the mean over several runs of one learner.
pub fn seeds(runs: &[RunEvaluation]) {
    let means: Vec<f64> = runs.iter().map(|run| run.evaluation.mean_forward_reward()).collect();
    let low = means.iter().copied().fold(f64::INFINITY, f64::min);
    let high = means.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let over_runs = |of: fn(&GroupResult) -> f64| mean(runs.iter().map(|run| of(run.evaluation.all())));
    print_line!(
        "mean of {} runs: {}, from {low:.1} to {high:.1} ({})",
        runs.len(),
        walked(
            mean(means.iter().copied()),
            over_runs(|all| all.forward_velocity),
            over_runs(|all| all.distance)
        ),
        seed_list(runs.iter().map(|run| run.seed))
    );
}

/// Prints the essence of a comparison.
pub fn comparison(summary: &ComparisonSummary) {
    print_line!("comparison of RUN ({}) with OTHER ({})", names(&summary.runs), names(&summary.others));
    for (name, side) in [("RUN", &summary.runs), ("OTHER", &summary.others)] {
        print_line!(
            "  mean of {name}: {} ({}){}",
            walked(side.forward_reward, side.forward_velocity, side.distance),
            seed_list(side.seeds.iter().map(|run| run.seed)),
            encoding(side.encoding)
        );
    }
    if !summary.equal_budgets() {
        let budgets = |side: &Side| {
            side.seeds.iter().map(|run| run.env_steps.to_string()).collect::<Vec<_>>().join(", ")
        };
        print_line!(
            "  their budgets differ, in env steps: {} of RUN, {} of OTHER",
            budgets(&summary.runs),
            budgets(&summary.others)
        );
    }
    print_line!(
        "  classes in which RUN is ahead: {} of {} ({:.1} %)",
        summary.classes_won,
        summary.gain.classes,
        100.0 * summary.share_won
    );
    print_line!("  average gain: {}", gain(&summary.gain));
    for (name, pairs) in [("adjacent", &summary.adjacent_pairs), ("opposite", &summary.opposite_pairs)] {
        if let Some(pairs) = pairs {
            print_line!("  average gain on {name} pairs ({} classes): {}", pairs.classes, gain(pairs));
        }
    }
    if [Some(&summary.gain), summary.adjacent_pairs.as_ref(), summary.opposite_pairs.as_ref()]
        .into_iter()
        .flatten()
        .any(|gain| gain.relative.is_none())
    {
        print_line!("  no gain in per cent where the mean of OTHER may not be above 0");
    }
    print_line!(
        "  intervals: {:.0} % of {} bootstrap resamples over {}",
        100.0 * summary.confidence,
        summary.resamples,
        summary.intervals_cover
    );
}

/// How far a robot walks in an episode: the forward reward, and the same in units that tell more.
fn walked(forward_reward: f64, forward_velocity: f64, distance: f64) -> String {
    format!("forward reward {forward_reward:.1}, {forward_velocity:.2} m/s, {distance:.1} m an episode")
}

fn names(side: &Side) -> String {
    side.seeds.iter().map(|run| run.run.as_str()).collect::<Vec<_>>().join(", ")
}

/// `1 seed: 0` or `3 seeds: 0, 1, 2`.
fn seed_list(seeds: impl Iterator<Item = u64>) -> String {
    let seeds: Vec<String> = seeds.map(|seed| seed.to_string()).collect();
    let noun = if seeds.len() == 1 { "seed" } else { "seeds" };
    format!("{} {noun}: {}", seeds.len(), seeds.join(", "))
}

/// Nothing for the true code.
fn encoding(encoding: Encoding) -> String {
    if encoding == Encoding::True { String::new() } else { format!(", encoding {}", encoding.name()) }
}

fn gain(gain: &Gain) -> String {
    let absolute = with_interval(gain.absolute, 1.0, "");
    let relative = gain.relative.map(|relative| format!(", {}", with_interval(relative, 100.0, " %")));
    format!("{absolute}{}", relative.unwrap_or_default())
}

fn with_interval(estimate: Estimate, factor: f64, unit: &str) -> String {
    let number = |value: f64| format!("{:+.1}{unit}", factor * value);
    format!("{} [{}, {}]", number(estimate.value), number(estimate.low), number(estimate.high))
}

fn error(standard_error: f64) -> String {
    if standard_error.is_nan() { "–".to_owned() } else { format!("{standard_error:.1}") }
}
