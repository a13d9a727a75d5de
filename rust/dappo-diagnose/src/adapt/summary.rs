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
    /// The same of PPO-Unaware.
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
mod tests {
    use super::*;
    use dappo_sim::vector_env::Onset;

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
        Trial { classes, episodes, onset: Onset { first: 10, last: 10 }, seed: 0, kept: Kept::Velocities }
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
        for (got, expected) in
            [(before, 0.8), (kept, 0.3), (oracle_kept, 0.8), (summary.kept_of_oracle, 0.375)]
        {
            assert!((got.unwrap() - expected).abs() < 1e-12, "{got:?}, expected {expected}");
        }
        // (90 · 0.6 + 45 · 0.7) / (2 · 90 · 0.8)
        assert!((summary.adapted_share.unwrap() - 85.5 / 144.0).abs() < 1e-12);
        assert_eq!((summary.severe_episodes, summary.classes[0].stood_still), (2, 0));
        let csv = summary.csv();
        assert!(
            csv.lines()
                .next()
                .unwrap()
                .ends_with(",unaware,tracking_before,tracking_kept,oracle_tracking_kept")
        );
        assert!(csv.lines().nth(1).unwrap().ends_with(",0.8000,0.3000,0.8000"), "{csv}");
    }
}
