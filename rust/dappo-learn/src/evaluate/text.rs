//! Evaluations and comparisons as text.

use super::bootstrap::{Estimate, Gain};
use super::comparison::{ComparisonSummary, RunEvaluation, RunSummary, Score, Side};
use super::tables::{Evaluation, GroupResult};
use crate::statistics::mean;
use crate::text_table::table;
use crate::walk::Encoding;

impl Evaluation {
    /// The table of the classes, that of the groups and the mean over all classes.
    #[must_use]
    pub fn text(&self) -> String {
        if self.is_commanded() {
            let headers = ["class", "<name", "<group", "tracking", "length", "falls"];
            let rows = self.classes.iter().map(|c| {
                [
                    c.class.to_string(),
                    c.name.clone(),
                    c.group.clone(),
                    share(c.tracking),
                    format!("{:.0}", c.episode_length),
                    format!("{}/{}", c.falls, c.episodes),
                ]
            });
            return table(headers, rows) + &self.group_text();
        }
        let headers = ["class", "<name", "<group", "forward reward", "± s.e.", "m/s", "m", "length", "falls"];
        let rows = self.classes.iter().map(|c| {
            [
                c.class.to_string(),
                c.name.clone(),
                c.group.clone(),
                format!("{:.1}", c.forward_reward),
                error(c.standard_error),
                format!("{:.2}", c.forward_velocity),
                format!("{:.1}", c.distance),
                format!("{:.0}", c.episode_length),
                format!("{}/{}", c.falls, c.episodes),
            ]
        });
        table(headers, rows) + &self.group_text()
    }

    /// The table of the groups and the mean over all classes.
    #[must_use]
    pub fn group_text(&self) -> String {
        let groups = if self.is_commanded() {
            let headers = ["<group", "classes", "tracking", "falls"];
            let row = |g: &GroupResult| {
                let falls = format!("{}/{}", g.falls, g.episodes);
                [g.group.clone(), g.classes.to_string(), share(g.tracking), falls]
            };
            table(headers, self.groups.iter().map(row))
        } else {
            let headers = ["<group", "classes", "forward reward", "± s.e.", "m/s", "m", "falls"];
            let row = |g: &GroupResult| {
                [
                    g.group.clone(),
                    g.classes.to_string(),
                    format!("{:.1}", g.forward_reward),
                    error(g.standard_error),
                    format!("{:.2}", g.forward_velocity),
                    format!("{:.1}", g.distance),
                    format!("{}/{}", g.falls, g.episodes),
                ]
            };
            table(headers, self.groups.iter().map(row))
        };
        let all = self.all();
        let diverged = match all.diverged {
            0 => String::new(),
            some => format!("episodes among the falls that ended because the physics diverged: {some}\n"),
        };
        format!(
            "{groups}{diverged}mean over {} damage classes: {} (backend {}, {}){}\n",
            all.classes,
            walked(all.tracking, all.forward_reward, all.forward_velocity, all.distance),
            self.simulator.physics.backend(),
            self.simulator.physics.precision(),
            encoding(self.encoding)
        )
    }
}

/// The mean over several runs of one learner, as a line.
#[must_use]
pub fn seeds_text(runs: &[RunEvaluation]) -> String {
    let is_commanded = runs.iter().all(|run| run.evaluation.is_commanded());
    let means: Vec<f64> = runs.iter().map(|run| run.evaluation.mean_score()).collect();
    let low = means.iter().copied().fold(f64::INFINITY, f64::min);
    let high = means.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let over_runs = |of: fn(&GroupResult) -> f64| mean(runs.iter().map(|run| of(run.evaluation.all())));
    let decimals = if is_commanded { 3 } else { 1 };
    let score = mean(means.iter().copied());
    format!(
        "mean of {} runs: {}, from {low:.decimals$} to {high:.decimals$} ({})\n",
        runs.len(),
        walked(
            is_commanded.then_some(score),
            score,
            over_runs(|all| all.forward_velocity),
            over_runs(|all| all.distance)
        ),
        seed_list(runs.iter().map(|run| run.seed))
    )
}

impl ComparisonSummary {
    /// A line about each number.
    #[must_use]
    pub fn text(&self) -> String {
        let names = |side: &Side| list(side, |run| run.run.clone());
        let side = |name: &str, side: &Side| {
            format!(
                "  mean of {name}: {} ({}){}\n",
                walked(side.tracking, side.forward_reward, side.forward_velocity, side.distance),
                seed_list(side.seeds.iter().map(|run| run.seed)),
                encoding(side.encoding)
            )
        };
        [
            format!("comparison of RUN ({}) with OTHER ({})\n", names(&self.runs), names(&self.others)),
            side("RUN", &self.runs),
            side("OTHER", &self.others),
            self.budgets(),
            format!(
                "  classes in which RUN is ahead: {} of {} ({:.1} %)\n",
                self.classes_won,
                self.gain.classes,
                100.0 * self.share_won
            ),
            self.gains(),
            format!(
                "  intervals: {:.0} % of {} bootstrap resamples over {}\n",
                100.0 * self.confidence,
                self.resamples,
                self.intervals_cover
            ),
        ]
        .concat()
    }

    /// Nothing for equal budgets.
    fn budgets(&self) -> String {
        if self.equal_budgets() {
            return String::new();
        }
        let [runs, others] =
            [&self.runs, &self.others].map(|side| list(side, |run| run.env_steps.to_string()));
        format!("  their budgets differ, in env steps: {runs} of RUN, {others} of OTHER\n")
    }

    fn gains(&self) -> String {
        let pairs = |name: &str, pairs: &Option<Gain>| {
            pairs.as_ref().map_or_else(String::new, |pairs| {
                format!(
                    "  average gain on {name} pairs ({} classes): {}\n",
                    pairs.classes,
                    gain(pairs, self.compared_by)
                )
            })
        };
        let mut all = [Some(&self.gain), self.adjacent_pairs.as_ref(), self.opposite_pairs.as_ref()]
            .into_iter()
            .flatten();
        let missing = if all.any(|gain| gain.relative.is_none()) {
            "  no gain in per cent where the mean of OTHER may not be above 0\n"
        } else {
            ""
        };
        format!(
            "  average gain: {}\n{}{}{missing}",
            gain(&self.gain, self.compared_by),
            pairs("adjacent", &self.adjacent_pairs),
            pairs("opposite", &self.opposite_pairs)
        )
    }
}

/// How far a robot walks in an episode: the forward reward, and the same in other units; with commands, how well it
/// tracks them.
fn walked(tracking: Option<f64>, forward_reward: f64, forward_velocity: f64, distance: f64) -> String {
    if tracking.is_some() {
        return format!("tracking {}", share(tracking));
    }
    format!("forward reward {forward_reward:.1}, {forward_velocity:.2} m/s, {distance:.1} m an episode")
}

/// Something of every run of a side.
fn list(side: &Side, of: fn(&RunSummary) -> String) -> String {
    side.seeds.iter().map(of).collect::<Vec<_>>().join(", ")
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

fn share(share: Option<f64>) -> String {
    share.map_or_else(String::new, |share| format!("{share:.3}"))
}

fn gain(gain: &Gain, compared_by: Score) -> String {
    let decimals = if compared_by == Score::Tracking { 3 } else { 1 };
    let absolute = with_interval(gain.absolute, 1.0, decimals, "");
    let relative = gain.relative.map(|relative| format!(", {}", with_interval(relative, 100.0, 1, " %")));
    format!("{absolute}{}", relative.unwrap_or_default())
}

fn with_interval(estimate: Estimate, factor: f64, decimals: usize, unit: &str) -> String {
    let number = |value: f64| format!("{:+.decimals$}{unit}", factor * value);
    format!("{} [{}, {}]", number(estimate.value), number(estimate.low), number(estimate.high))
}

fn error(standard_error: f64) -> String {
    if standard_error.is_nan() { "–".to_owned() } else { format!("{standard_error:.1}") }
}

#[cfg(test)]
mod tests {
    use super::super::tables::tests::{class, simulator};
    use super::*;

    fn evaluation(encoding: Encoding, rewards: [f64; 3], standard_error: f64) -> Evaluation {
        let classes = ["none", "D1", "D1"].into_iter().zip(rewards).enumerate();
        let classes = classes.map(|(id, (group, reward))| class(id, group, reward, standard_error));
        Evaluation::new(encoding, simulator(), classes.collect())
    }

    fn run(seed: u64, rewards: [f64; 3]) -> RunEvaluation {
        let evaluation = evaluation(Encoding::True, rewards, 1.0);
        RunEvaluation { run: format!("runs/{seed}"), seed, env_steps: 1000, evaluation }
    }

    #[test]
    fn an_evaluation_shows_its_classes_its_groups_and_their_mean() {
        // D1: (40 + 8) / 2 = 24, √(3² + 3²) / 2 = 2.1. All: 144 / 3 = 48, √27 / 3 = 1.7.
        let evaluation = evaluation(Encoding::True, [96.0, 40.0, 8.0], 3.0);
        let groups = "\
            group  classes  forward reward  ± s.e.   m/s     m  falls\n\
            none         1            96.0     3.0  6.00  12.0    0/4\n\
            D1           2            24.0     2.1  1.50   3.0    3/8\n\
            all          3            48.0     1.7  3.00   6.0   3/12\n\
            episodes among the falls that ended because the physics diverged: 1\n\
            mean over 3 damage classes: forward reward 48.0, 3.00 m/s, 6.0 m an episode (backend lanes, f64)\n";
        let classes = "\
            class  name     group  forward reward  ± s.e.   m/s     m  length  falls\n    \
                0  class 0  none             96.0     3.0  6.00  12.0      20    0/4\n    \
                1  class 1  D1               40.0     3.0  2.50   5.0      20    1/4\n    \
                2  class 2  D1                8.0     3.0  0.50   1.0      20    2/4\n";
        assert_eq!(evaluation.group_text(), groups);
        assert_eq!(evaluation.text(), [classes, groups].concat());
    }

    #[test]
    fn no_standard_error_is_a_dash_and_other_encodings_than_the_true_one_are_named() {
        let mut evaluation = evaluation(Encoding::Wrong, [96.0, 40.0, 8.0], f64::NAN);
        evaluation.classes.truncate(1);
        let evaluation = Evaluation::new(Encoding::Wrong, simulator(), evaluation.classes);
        let expected = "\
            class  name     group  forward reward  ± s.e.   m/s     m  length  falls\n    \
                0  class 0  none             96.0       –  6.00  12.0      20    0/1\n\
            group  classes  forward reward  ± s.e.   m/s     m  falls\n\
            none         1            96.0       –  6.00  12.0    0/1\n\
            all          1            96.0       –  6.00  12.0    0/1\n\
            mean over 1 damage classes: forward reward 96.0, 6.00 m/s, 12.0 m an episode (backend lanes, f64), \
            encoding wrong\n";
        assert_eq!(evaluation.text(), expected);
    }

    #[test]
    fn several_runs_show_their_mean_and_range() {
        // Means of 4 and 12; velocities are a sixteenth, distances an eighth.
        let expected = "mean of 2 runs: forward reward 8.0, 0.50 m/s, 1.0 m an episode, from 4.0 to 12.0 \
            (2 seeds: 3, 5)\n";
        assert_eq!(seeds_text(&[run(3, [2.0, 4.0, 6.0]), run(5, [10.0, 12.0, 14.0])]), expected);
    }

    /// RUN has seeds 1 and 2, OTHER seed 3 and another budget.
    fn comparison() -> ComparisonSummary {
        let run = |seed, env_steps| RunSummary {
            run: format!("runs/{seed}"),
            seed,
            env_steps,
            forward_reward: 7.5,
            forward_velocity: 0.5,
            distance: 1.25,
            tracking: None,
        };
        let side = |encoding, seeds: Vec<RunSummary>| Side {
            encoding,
            forward_reward: 7.5,
            forward_velocity: 0.5,
            distance: 1.3,
            tracking: None,
            seeds,
        };
        let estimate = |value| Estimate { value, low: -value, high: 2.0 * value };
        let gain = |classes, absolute, relative: Option<f64>| Gain {
            classes,
            absolute: estimate(absolute),
            relative: relative.map(estimate),
        };
        ComparisonSummary {
            runs: side(Encoding::Wrong, vec![run(1, 1000), run(2, 1000)]),
            others: side(Encoding::True, vec![run(3, 2000)]),
            episodes: 4,
            evaluation_seed: 0,
            simulator: simulator(),
            classes_won: 3,
            share_won: 0.75,
            gain: gain(4, 2.5, Some(0.5)),
            adjacent_pairs: Some(gain(1, 1.0, Some(0.125))),
            opposite_pairs: Some(gain(2, 6.0, None)),
            resamples: 1000,
            confidence: 0.95,
            compared_by: Score::ForwardReward,
            intervals_cover: "classes only",
        }
    }

    #[test]
    fn a_comparison_shows_both_sides_and_every_gain() {
        let expected = "\
            comparison of RUN (runs/1, runs/2) with OTHER (runs/3)\n  \
              mean of RUN: forward reward 7.5, 0.50 m/s, 1.3 m an episode (2 seeds: 1, 2), encoding wrong\n  \
              mean of OTHER: forward reward 7.5, 0.50 m/s, 1.3 m an episode (1 seed: 3)\n  \
              their budgets differ, in env steps: 1000, 1000 of RUN, 2000 of OTHER\n  \
              classes in which RUN is ahead: 3 of 4 (75.0 %)\n  \
              average gain: +2.5 [-2.5, +5.0], +50.0 % [-50.0 %, +100.0 %]\n  \
              average gain on adjacent pairs (1 classes): +1.0 [-1.0, +2.0], +12.5 % [-12.5 %, +25.0 %]\n  \
              average gain on opposite pairs (2 classes): +6.0 [-6.0, +12.0]\n  \
              no gain in per cent where the mean of OTHER may not be above 0\n  \
              intervals: 95 % of 1000 bootstrap resamples over classes only\n";
        assert_eq!(comparison().text(), expected);
    }

    #[test]
    fn robots_with_commands_are_judged_by_how_well_they_track_them() {
        let mut tracked = evaluation(Encoding::True, [96.0, 40.0, 8.0], 3.0);
        for (class, share) in tracked.classes.iter_mut().zip([0.75, 0.5, 0.25]) {
            class.tracking = Some(share);
        }
        let tracked = Evaluation::new(Encoding::True, simulator(), tracked.classes);
        let expected = "\
            class  name     group  tracking  length  falls\n    \
                0  class 0  none      0.750      20    0/4\n    \
                1  class 1  D1        0.500      20    1/4\n    \
                2  class 2  D1        0.250      20    2/4\n\
            group  classes  tracking  falls\n\
            none         1     0.750    0/4\n\
            D1           2     0.375    3/8\n\
            all          3     0.500   3/12\n\
            episodes among the falls that ended because the physics diverged: 1\n\
            mean over 3 damage classes: tracking 0.500 (backend lanes, f64)\n";
        assert_eq!(tracked.text(), expected);
        assert_eq!(tracked.mean_score(), 0.5);
        let line = tracked.class_table();
        assert!(
            line.starts_with("class,name,group,") && line.contains(",diverged,tracking,backend"),
            "{line}"
        );
        let mut comparison = comparison();
        comparison.compared_by = Score::Tracking;
        (comparison.runs.tracking, comparison.others.tracking) = (Some(0.5), Some(0.25));
        let text = comparison.text();
        assert!(text.contains("mean of RUN: tracking 0.500 (2 seeds: 1, 2)"), "{text}");
        assert!(text.contains("average gain: +2.500 [-2.500, +5.000], +50.0 %"), "{text}");
    }

    #[test]
    fn a_comparison_of_equal_budgets_without_pairs_is_shorter() {
        let mut comparison = comparison();
        comparison.others.seeds[0].env_steps = 1000;
        (comparison.adjacent_pairs, comparison.opposite_pairs) = (None, None);
        let text = comparison.text();
        let starts: Vec<&str> = text.lines().map(|line| &line[..17]).collect();
        assert_eq!(
            starts,
            [
                "comparison of RUN",
                "  mean of RUN: fo",
                "  mean of OTHER: ",
                "  classes in whic",
                "  average gain: +",
                "  intervals: 95 %",
            ]
        );
    }
}
