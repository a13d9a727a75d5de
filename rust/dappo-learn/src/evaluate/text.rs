//! Evaluations and comparisons as text.

use super::bootstrap::{Estimate, Gain};
use super::comparison::{ComparisonSummary, RunEvaluation, RunSummary, Side};
use super::score::Score;
use super::tables::{Evaluation, GroupResult};
use crate::statistics::mean;
use crate::text_table::table;
use crate::walk::Encoding;

impl Evaluation {
    /// The table of the classes, that of the groups and the mean over all classes.
    #[must_use]
    pub fn text(&self) -> String {
        if self.is_commanded() {
            let headers = ["class", "<name", "<group", "tracking", "± s.e.", "length", "falls"];
            let rows = self.classes.iter().map(|c| {
                [
                    c.class.to_string(),
                    c.name.clone(),
                    c.group.clone(),
                    share(c.tracking),
                    error(c.tracking_standard_error, Score::Tracking),
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
                error(Some(c.standard_error), Score::ForwardReward),
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
            let headers = ["<group", "classes", "tracking", "± s.e.", "falls"];
            let row = |g: &GroupResult| {
                let falls = format!("{}/{}", g.falls, g.episodes);
                let error = error(g.tracking_standard_error, Score::Tracking);
                [g.group.clone(), g.classes.to_string(), share(g.tracking), error, falls]
            };
            table(headers, self.groups.iter().map(row))
        } else {
            let headers = ["<group", "classes", "forward reward", "± s.e.", "m/s", "m", "falls"];
            let row = |g: &GroupResult| {
                [
                    g.group.clone(),
                    g.classes.to_string(),
                    format!("{:.1}", g.forward_reward),
                    error(Some(g.standard_error), Score::ForwardReward),
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
    let of = if is_commanded { Score::Tracking } else { Score::ForwardReward };
    let means: Vec<f64> = runs.iter().map(|run| run.evaluation.mean_score()).collect();
    let low = means.iter().copied().fold(f64::INFINITY, f64::min);
    let high = means.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let over_runs = |of: fn(&GroupResult) -> f64| mean(runs.iter().map(|run| of(run.evaluation.all())));
    let decimals = of.decimals();
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
        let [runs, others] = [&self.runs, &self.others].map(|side| list(side, |run| known(run.env_steps)));
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
fn seed_list(seeds: impl Iterator<Item = Option<u64>>) -> String {
    let seeds: Vec<String> = seeds.map(known).collect();
    let noun = if seeds.len() == 1 { "seed" } else { "seeds" };
    format!("{} {noun}: {}", seeds.len(), seeds.join(", "))
}

/// A number of a run; that of a policy of another learner is not known.
fn known(number: Option<u64>) -> String {
    number.map_or_else(|| "unknown".to_owned(), |number| number.to_string())
}

/// Nothing for the true code.
fn encoding(encoding: Encoding) -> String {
    if encoding == Encoding::True { String::new() } else { format!(", encoding {}", encoding.name()) }
}

fn share(share: Option<f64>) -> String {
    share.map_or_else(String::new, |share| format!("{share:.3}"))
}

fn gain(gain: &Gain, compared_by: Score) -> String {
    let decimals = compared_by.decimals();
    let absolute = with_interval(gain.absolute, 1.0, decimals, "");
    let relative = gain.relative.map(|relative| format!(", {}", with_interval(relative, 100.0, 1, " %")));
    format!("{absolute}{}", relative.unwrap_or_default())
}

fn with_interval(estimate: Estimate, factor: f64, decimals: usize, unit: &str) -> String {
    let number = |value: f64| format!("{:+.decimals$}{unit}", factor * value);
    format!("{} [{}, {}]", number(estimate.value), number(estimate.low), number(estimate.high))
}

fn error(standard_error: Option<f64>, score: Score) -> String {
    let decimals = score.decimals();
    standard_error
        .filter(|error| !error.is_nan())
        .map_or_else(|| "–".to_owned(), |error| format!("{error:.decimals$}"))
}

#[cfg(test)]
mod tests;
