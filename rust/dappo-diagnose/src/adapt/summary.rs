//! The tables of a trial: one row a damage class, and a summary.

use dappo_learn::csv_table::table;
use dappo_learn::error::Result;
use dappo_learn::run_folder::RunFolder;
use dappo_learn::statistics::median;
use dappo_learn::walk::{KnownClasses, Trial};
use dappo_nn::error::check_length;
use serde::Serialize;

use super::class::{average, pace, struck};
use super::{ClassOutcome, Contest, Tracking};

/// The outcome of a trial.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AdaptationSummary {
    /// One entry a class, in the order of the trial.
    pub classes: Vec<ClassOutcome>,
    /// Share of the healthy episodes without any alarm, if there are some.
    pub healthy_without_alarm: Option<f64>,
    /// Episodes of damages that cost more than half of the speed, or of the tracking, when nothing is done about them.
    pub severe_episodes: usize,
    /// Share of them with an alarm after the damage.
    pub severe_detected: Option<f64>,
    /// Median number of steps that this took.
    pub severe_median_delay: Option<f64>,
    /// Share of the damaged episodes whose first diagnosis was correct; undetected ones count as wrong.
    pub correct_first: Option<f64>,
    /// Share of them whose assumed class was correct at the end.
    pub correct_last: Option<f64>,
    /// Share of them in which the robot recovered, of those with a damage code.
    pub recovered: Option<f64>,
    /// Share of the damaged episodes at whose end the robot stood still.
    pub stood_still: Option<f64>,
    /// Share of them that ended in failure.
    pub fell: Option<f64>,
    /// Speed, or tracking, over the last 200 steps with the damages that have a code, as a share of the oracle's.
    pub kept_of_oracle: Option<f64>,
    /// The same as a share of that before the damage.
    pub kept_of_healthy: Option<f64>,
    /// Mean score over the damages that have a code, as a share of the oracle's.
    pub adapted_share: Option<f64>,
    /// The same of the policy with the code of a healthy robot.
    pub no_adaptation_share: Option<f64>,
    /// The same of the policy without damage code.
    pub unaware_share: Option<f64>,
    /// How long the controller took for its decisions.
    pub decision_ms: DecisionTime,
}

/// How long a controller took for a step of all its robots, ms.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct DecisionTime {
    /// Robots decided about.
    pub robots: usize,
    /// Median.
    pub median: f64,
    /// 99th percentile.
    pub p99: f64,
    /// Longest; most often the step of a diagnosis.
    pub longest: f64,
}

/// A number of a class, which not all classes may have.
type Value<'a> = &'a dyn Fn(&ClassOutcome) -> Option<f64>;

impl DecisionTime {
    fn new(robots: usize, seconds: &[f64]) -> Self {
        let mut sorted: Vec<f64> = seconds.iter().map(|seconds| 1000.0 * seconds).collect();
        sorted.sort_by(f64::total_cmp);
        // The smallest time that this share of the times does not exceed.
        let quantile = |share: f64| {
            let rank = (share * sorted.len() as f64).ceil() as usize;
            sorted.get(rank.saturating_sub(1)).copied().unwrap_or(f64::NAN)
        };
        Self { robots, median: quantile(0.5), p99: quantile(0.99), longest: quantile(1.0) }
    }
}

impl AdaptationSummary {
    /// Combines the episodes of a trial.
    ///
    /// # Errors
    /// If the episodes of an agent are incomplete.
    pub fn new(trial: &Trial, known: &KnownClasses, contest: &Contest) -> Result<Self> {
        let all = trial.classes.len() * trial.episodes;
        for walks in
            [&contest.adapted, &contest.oracle, &contest.no_adaptation].into_iter().chain(&contest.unaware)
        {
            check_length("walks [classes, episodes]", &walks.episodes, all)?;
        }
        let mut classes = Vec::with_capacity(trial.classes.len());
        let (mut severe, mut delays) = (0, Vec::new());
        let steps = contest.no_adaptation.episodes.iter().map(|episode| episode.steps).max().unwrap_or(0);
        for (row, &class) in trial.classes.iter().enumerate() {
            let (outcome, episodes) = ClassOutcome::new(trial, row, known, contest);
            let struck = struck(trial, row, &contest.adapted);
            let slowed = average(&contest.no_adaptation, &struck, |episode| pace(episode, steps));
            if class != 0 && slowed < 0.5 * outcome.before() {
                severe += struck.len();
                delays.extend(episodes.iter().filter_map(|episode| episode.delay));
            }
            classes.push(outcome);
        }
        Ok(Self::of(classes, severe, &delays, DecisionTime::new(all, &contest.adapted.decision_seconds)))
    }

    fn of(
        classes: Vec<ClassOutcome>,
        severe_episodes: usize,
        delays: &[usize],
        decision_ms: DecisionTime,
    ) -> Self {
        let healthy: Vec<&ClassOutcome> = classes.iter().filter(|outcome| outcome.class == 0).collect();
        let damaged: Vec<&ClassOutcome> =
            classes.iter().filter(|outcome| outcome.class != 0 && outcome.episodes > 0).collect();
        let share = |of: &[&ClassOutcome], count: &dyn Fn(&ClassOutcome) -> usize| {
            let episodes: usize = of.iter().map(|outcome| outcome.episodes).sum();
            let counted: usize = of.iter().map(|outcome| count(outcome)).sum();
            (episodes > 0).then(|| counted as f64 / episodes as f64)
        };
        let known: Vec<&ClassOutcome> =
            damaged.iter().copied().filter(|outcome| outcome.oracle.is_some()).collect();
        let total = |of: Value<'_>| -> Option<f64> { known.iter().map(|outcome| of(outcome)).sum() };
        let ratio = |of: Value<'_>, to: Value<'_>| Some(total(of)? / total(to).filter(|to| *to > 0.0)?);
        let of_oracle = |reward: Value<'_>| ratio(reward, &|outcome| outcome.oracle);
        let kept = |outcome: &ClassOutcome| Some(outcome.kept());
        Self {
            healthy_without_alarm: share(&healthy, &|outcome| outcome.episodes - outcome.false_alarms),
            severe_episodes,
            severe_detected: (severe_episodes > 0).then(|| delays.len() as f64 / severe_episodes as f64),
            severe_median_delay: median(delays.iter().map(|&delay| delay as f64)),
            correct_first: share(&damaged, &|outcome| outcome.correct_first),
            correct_last: share(&damaged, &|outcome| outcome.correct_last),
            recovered: share(&known, &|outcome| outcome.recovered),
            stood_still: share(&damaged, &|outcome| outcome.stood_still),
            fell: share(&damaged, &|outcome| outcome.falls),
            kept_of_oracle: ratio(&kept, &ClassOutcome::oracle_kept),
            kept_of_healthy: ratio(&kept, &|outcome| Some(outcome.before())),
            adapted_share: of_oracle(&|outcome| Some(outcome.adapted)),
            no_adaptation_share: of_oracle(&|outcome| Some(outcome.no_adaptation)),
            unaware_share: of_oracle(&|outcome| outcome.unaware),
            decision_ms,
            classes,
        }
    }

    /// Writes the table of the classes and all numbers into `eval/` of a run.
    pub fn write(&self, run: &RunFolder) -> Result<()> {
        run.evaluation().write("adapt.csv", &self.csv())?;
        run.evaluation().write_json("adapt.json", self)
    }

    /// The classes as CSV with a header line.
    #[must_use]
    pub fn csv(&self) -> String {
        let mut columns = vec![
            "class",
            "name",
            "episodes",
            "ended_before_onset",
            "false_alarms",
            "detected",
            "median_delay",
            "correct_first",
            "correct_last",
            "assumed",
            "diagnosis_windows",
            "recovered",
            "median_recovery",
            "falls",
            "stood_still",
            "velocity_before",
            "velocity_kept",
            "oracle_velocity_kept",
            "adapted",
            "oracle",
            "no_adaptation",
            "unaware",
        ];
        let has_commands = self.classes.iter().any(ClassOutcome::has_commands);
        if has_commands {
            columns.extend(["tracking_before", "tracking_kept", "oracle_tracking_kept"]);
        }
        let optional = |value: Option<f64>, decimals| {
            value.map_or_else(String::new, |value| format!("{value:.decimals$}"))
        };
        let row = |c: &ClassOutcome| {
            let assumed = c.assumed.iter().map(|assumed| format!("{} {}", assumed.name, assumed.episodes));
            let mut row = vec![
                c.class.to_string(),
                c.name.clone(),
                c.episodes.to_string(),
                c.ended_before_onset.to_string(),
                c.false_alarms.to_string(),
                c.detected.to_string(),
                optional(c.median_delay, 1),
                c.correct_first.to_string(),
                c.correct_last.to_string(),
                assumed.collect::<Vec<_>>().join("; "),
                format!("{:.2}", c.diagnosis_windows),
                c.recovered.to_string(),
                optional(c.median_recovery, 1),
                c.falls.to_string(),
                c.stood_still.to_string(),
                format!("{:.4}", c.velocity_before),
                format!("{:.4}", c.velocity_kept),
                optional(c.oracle_velocity_kept, 4),
                format!("{:.2}", c.adapted),
                optional(c.oracle, 2),
                format!("{:.2}", c.no_adaptation),
                optional(c.unaware, 2),
            ];
            if has_commands {
                let Tracking { before, kept, oracle_kept } = c.tracking;
                row.extend([before, kept, oracle_kept].map(|tracking| optional(tracking, 4)));
            }
            row
        };
        table(&columns, self.classes.iter().map(row))
    }
}

#[cfg(test)]
mod tests;
