//! Two learners on the same damage classes: where one is ahead, by how much, and how sure that is.

use serde::Serialize;

use super::bootstrap::{CONFIDENCE, Gain, RESAMPLES, gain};
use super::score::Score;
use super::tables::{ClassResult, Evaluation};
use crate::csv_table::table;
use crate::error::{LearnError, Result};
use crate::run_folder::EvaluationFolder;
use crate::simulator::Simulator;
use crate::statistics::mean;
use crate::walk::Encoding;

/// The evaluation of one run.
#[derive(Debug, Clone, Serialize)]
pub struct RunEvaluation {
    /// Its run folder, or the name of the policy that chose the actions in the place of the run's.
    pub run: String,
    /// Seed of its training; `None` for a policy of another learner.
    pub seed: Option<u64>,
    /// Env steps that its policy was trained for; `None` for a policy of another learner.
    pub env_steps: Option<u64>,
    /// What was found.
    #[serde(flatten)]
    pub evaluation: Evaluation,
}

/// One run of a side.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RunSummary {
    /// Its run folder, or the name of the policy that chose the actions in the place of the run's.
    pub run: String,
    /// Seed of its training; `None` for a policy of another learner.
    pub seed: Option<u64>,
    /// Env steps that its policy was trained for; `None` for a policy of another learner.
    pub env_steps: Option<u64>,
    /// Mean forward reward over all classes.
    pub forward_reward: f64,
    /// Mean forward velocity over all classes, m/s.
    pub forward_velocity: f64,
    /// Mean distance of an episode over all classes, m.
    pub distance: f64,
    /// Mean tracking over all classes; `None` for a task without commands.
    pub tracking: Option<f64>,
}

/// One side of a comparison: runs of one learner that differ in their seeds.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Side {
    /// How their damage code came from the damage.
    pub encoding: Encoding,
    /// Mean forward reward over all classes and seeds.
    pub forward_reward: f64,
    /// Mean forward velocity over all classes and seeds, m/s.
    pub forward_velocity: f64,
    /// Mean distance of an episode over all classes and seeds, m.
    pub distance: f64,
    /// Mean tracking over all classes and seeds; `None` for a task without commands.
    pub tracking: Option<f64>,
    /// One run a seed.
    pub seeds: Vec<RunSummary>,
}

/// A comparison in a few numbers.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ComparisonSummary {
    /// The side whose gain is computed.
    pub runs: Side,
    /// The side that it is compared with.
    pub others: Side,
    /// Episodes of each class and run.
    pub episodes: usize,
    /// Seed of the start states and of the resamples.
    pub evaluation_seed: u64,
    /// The simulator.
    #[serde(flatten)]
    pub simulator: Simulator,
    /// Classes in which the first side is ahead on average over its seeds.
    pub classes_won: usize,
    /// Their share, 0 to 1.
    pub share_won: f64,
    /// Gain over all classes.
    pub gain: Gain,
    /// Gain over the classes with two damages on adjacent limbs, if the robot has any.
    pub adjacent_pairs: Option<Gain>,
    /// Gain over the classes with two damages on opposite limbs, if the robot has any.
    pub opposite_pairs: Option<Gain>,
    /// Resamples of each interval.
    pub resamples: usize,
    /// What the two sides are compared by: gains are in its unit.
    pub compared_by: Score,
    /// Share of the resamples inside an interval.
    pub confidence: f64,
    /// What was drawn in each resample, in words.
    pub intervals_cover: &'static str,
}

impl ComparisonSummary {
    /// Whether all policies of both sides were trained for the same number of env steps.
    #[must_use]
    pub fn equal_budgets(&self) -> bool {
        let mut budgets = self.runs.seeds.iter().chain(&self.others.seeds).map(|run| run.env_steps);
        let first = budgets.next();
        budgets.all(|budget| Some(budget) == first)
    }
}

/// One damage class of a comparison.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ClassComparison {
    /// Damage class.
    pub class: usize,
    /// Its name.
    pub name: String,
    /// Its group.
    pub group: String,
    /// What the first side is compared by, mean over its seeds.
    pub score: f64,
    /// The same of the other side.
    pub other_score: f64,
    /// The first minus the other.
    pub difference: f64,
    /// Whether the first side is ahead.
    pub better: bool,
}

/// A comparison of two learners.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Comparison {
    /// The summary.
    pub summary: ComparisonSummary,
    /// One entry a class, in canonical order.
    pub classes: Vec<ClassComparison>,
}

impl Comparison {
    /// Writes its tables into the evaluation of the first run; `encoding` is that of its policies.
    pub fn write(&self, folder: &EvaluationFolder, encoding: Encoding) -> Result<()> {
        folder.write(&encoding.file_name("comparison", "csv"), &self.class_table())?;
        folder.write_json(&encoding.file_name("comparison", "json"), &self.summary)
    }

    /// Compares two sides that were evaluated with the same start states, drawn from `evaluation_seed`.
    pub fn new(runs: &[RunEvaluation], others: &[RunEvaluation], evaluation_seed: u64) -> Result<Self> {
        let [first, ..] = runs else { return Err(nothing_to_compare()) };
        let [_, ..] = others else { return Err(nothing_to_compare()) };
        let names = |run: &RunEvaluation| -> Vec<String> {
            run.evaluation.classes.iter().map(|class| class.name.clone()).collect()
        };
        if let Some(other) = runs.iter().chain(others).find(|other| names(other) != names(first)) {
            return Err(LearnError::Invalid(format!(
                "{} has other damage classes than {}; only equal classes can be compared",
                other.run, first.run
            )));
        }
        let classes = compare_classes(runs, others);
        let (scores, other_scores) = (scores(runs), scores(others));
        let gain_in = |chosen: &[usize]| gain(&scores, &other_scores, chosen, evaluation_seed);
        let pairs = |place: &str| {
            let is_there = |class: &&ClassComparison| class.group.ends_with(place);
            let chosen: Vec<usize> = classes.iter().filter(is_there).map(|class| class.class).collect();
            (!chosen.is_empty()).then(|| gain_in(&chosen))
        };
        let classes_won = classes.iter().filter(|class| class.better).count();
        let summary = ComparisonSummary {
            runs: side(runs, first.evaluation.encoding),
            others: side(others, others[0].evaluation.encoding),
            episodes: first.evaluation.classes.first().map_or(0, |class| class.episodes),
            evaluation_seed,
            simulator: first.evaluation.simulator.clone(),
            classes_won,
            share_won: classes_won as f64 / classes.len() as f64,
            gain: gain_in(&(0..classes.len()).collect::<Vec<_>>()),
            // As the damage space names its groups.
            adjacent_pairs: pairs(" A"),
            opposite_pairs: pairs(" O"),
            compared_by: first.evaluation.score(),
            resamples: RESAMPLES,
            confidence: CONFIDENCE,
            intervals_cover: coverage(runs.len(), others.len()),
        };
        Ok(Self { summary, classes })
    }

    /// The table of the classes as CSV with a header line.
    #[must_use]
    pub fn class_table(&self) -> String {
        let [score, other_score] = self.summary.compared_by.columns();
        let columns =
            ["class", "name", "group", score, other_score, "difference", "better", "seeds", "other_seeds"];
        let (seeds, other_seeds) = (self.summary.runs.seeds.len(), self.summary.others.seeds.len());
        let row = |c: &ClassComparison| {
            vec![
                c.class.to_string(),
                c.name.clone(),
                c.group.clone(),
                format!("{:.4}", c.score),
                format!("{:.4}", c.other_score),
                format!("{:.4}", c.difference),
                c.better.to_string(),
                seeds.to_string(),
                other_seeds.to_string(),
            ]
        };
        table(&columns, self.classes.iter().map(row))
    }
}

fn nothing_to_compare() -> LearnError {
    LearnError::Invalid("a comparison needs at least one run on each side, got none".into())
}

/// What the policies are compared by, `[seeds][classes]`.
fn scores(runs: &[RunEvaluation]) -> Vec<Vec<f64>> {
    let of_run = |run: &RunEvaluation| run.evaluation.classes.iter().map(ClassResult::score).collect();
    runs.iter().map(of_run).collect()
}

fn side(runs: &[RunEvaluation], encoding: Encoding) -> Side {
    let seeds: Vec<RunSummary> = runs
        .iter()
        .map(|run| RunSummary {
            run: run.run.clone(),
            seed: run.seed,
            env_steps: run.env_steps,
            forward_reward: run.evaluation.mean_forward_reward(),
            forward_velocity: run.evaluation.all().forward_velocity,
            distance: run.evaluation.all().distance,
            tracking: run.evaluation.all().tracking,
        })
        .collect();
    let over_seeds = |of: fn(&RunSummary) -> f64| mean(seeds.iter().map(of));
    Side {
        encoding,
        forward_reward: over_seeds(|run| run.forward_reward),
        forward_velocity: over_seeds(|run| run.forward_velocity),
        distance: over_seeds(|run| run.distance),
        tracking: seeds
            .iter()
            .map(|run| run.tracking)
            .collect::<Option<Vec<f64>>>()
            .map(|shares| mean(shares.into_iter())),
        seeds,
    }
}

fn compare_classes(runs: &[RunEvaluation], others: &[RunEvaluation]) -> Vec<ClassComparison> {
    let over_seeds = |runs: &[RunEvaluation], class: usize| {
        mean(runs.iter().map(|run| run.evaluation.classes[class].score()))
    };
    let compare = |(index, class): (usize, &ClassResult)| {
        let (score, other_score) = (over_seeds(runs, index), over_seeds(others, index));
        let difference = score - other_score;
        ClassComparison {
            class: class.class,
            name: class.name.clone(),
            group: class.group.clone(),
            score,
            other_score,
            difference,
            better: difference > 0.0,
        }
    };
    runs[0].evaluation.classes.iter().enumerate().map(compare).collect()
}

/// What the intervals cover: a single seed cannot be drawn in two ways.
fn coverage(seeds: usize, other_seeds: usize) -> &'static str {
    match (seeds > 1, other_seeds > 1) {
        (true, true) => "classes and seeds",
        (true, false) => "classes and the seeds of RUN, but classes only of OTHER, which has one seed",
        (false, true) => "classes and the seeds of OTHER, but classes only of RUN, which has one seed",
        (false, false) => "classes only, as each side has one seed",
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::super::tables::tests::{class, simulator};
    use super::*;
    use crate::files::testing::Scratch;
    use crate::run_folder::RunFolder;

    fn run(seed: u64, encoding: Encoding, rewards: [f64; 4]) -> RunEvaluation {
        let groups = ["none", "D1", "D1_1 A", "D1_1 O"];
        let classes = groups.into_iter().zip(rewards).enumerate();
        let classes = classes.map(|(id, (group, reward))| class(id, group, reward, 1.0)).collect();
        let evaluation = Evaluation::new(encoding, simulator(), classes);
        RunEvaluation {
            run: format!("runs/{seed}"),
            seed: Some(seed),
            env_steps: Some(1000 * seed),
            evaluation,
        }
    }

    fn comparison() -> Comparison {
        let runs =
            [run(1, Encoding::Wrong, [10.0, 6.0, 5.0, 9.0]), run(2, Encoding::Wrong, [12.0, 2.0, 7.0, 9.0])];
        Comparison::new(&runs, &[run(1, Encoding::True, [8.0, 4.0, 5.0, 3.0])], 3).unwrap()
    }

    #[test]
    fn classes_are_compared_by_their_means_over_seeds() {
        // Class 1: (6 + 2) / 2 = 4 against 4, which is no win.
        let expected = "\
            class,name,group,forward_reward,other_forward_reward,difference,better,seeds,other_seeds\n\
            0,class 0,none,11.0000,8.0000,3.0000,true,2,1\n\
            1,class 1,D1,4.0000,4.0000,0.0000,false,2,1\n\
            2,class 2,D1_1 A,6.0000,5.0000,1.0000,true,2,1\n\
            3,class 3,D1_1 O,9.0000,3.0000,6.0000,true,2,1\n";
        assert_eq!(comparison().class_table(), expected);
    }

    #[test]
    fn the_summary_holds_what_can_be_computed_by_hand() {
        let summary = comparison().summary;
        // (10 + 6 + 5 + 9) / 4, (12 + 2 + 7 + 9) / 4 and their mean; (8 + 4 + 5 + 3) / 4.
        assert_eq!(summary.runs.seeds.iter().map(|run| run.forward_reward).collect::<Vec<_>>(), [7.5, 7.5]);
        assert_eq!((summary.runs.forward_reward, summary.others.forward_reward), (7.5, 5.0));
        assert_eq!(
            summary.runs.seeds.iter().map(|run| run.env_steps).collect::<Vec<_>>(),
            [1000, 2000].map(Some)
        );
        assert!(!summary.equal_budgets());
        assert_eq!((summary.runs.encoding, summary.others.encoding), (Encoding::Wrong, Encoding::True));
        assert_eq!((summary.classes_won, summary.share_won), (3, 0.75));
        assert_eq!((summary.gain.classes, summary.gain.absolute.value), (4, 2.5));
        assert_eq!(summary.gain.relative.unwrap().value, 0.5);
        let (adjacent, opposite) = (summary.adjacent_pairs.unwrap(), summary.opposite_pairs.unwrap());
        // One class each. Adjacent: 5, 6 or 7 against 5. Opposite: 9 for both seeds against 3.
        assert_eq!((adjacent.absolute.low, adjacent.absolute.value, adjacent.absolute.high), (0.0, 1.0, 2.0));
        assert_eq!((opposite.absolute.low, opposite.absolute.value, opposite.absolute.high), (6.0, 6.0, 6.0));
        assert_eq!(
            summary.intervals_cover,
            "classes and the seeds of RUN, but classes only of OTHER, which has one seed"
        );
    }

    #[test]
    fn a_comparison_is_written_into_the_first_run_under_the_name_of_its_encoding() {
        let (scratch, comparison) = (Scratch::new(), comparison());
        std::fs::write(scratch.0.join("config.toml"), "robot = 'ant'").unwrap();
        let (run, _) = RunFolder::open(&scratch.0).unwrap();
        comparison.write(&run.evaluation(), Encoding::Wrong).unwrap();
        let eval = scratch.0.join("eval");
        let mut files: Vec<_> =
            std::fs::read_dir(&eval).unwrap().map(|file| file.unwrap().file_name()).collect();
        files.sort();
        assert_eq!(files, ["comparison.wrong.csv", "comparison.wrong.json"]);
        let text = |name| std::fs::read_to_string(eval.join(name)).unwrap();
        assert_eq!(text("comparison.wrong.csv"), comparison.class_table());
        let json: serde_json::Value = serde_json::from_str(&text("comparison.wrong.json")).unwrap();
        let expected = json!({
            "runs": {
                "encoding": "wrong",
                "forward_reward": 7.5,
                "forward_velocity": 7.5 / 16.0,
                "distance": 7.5 / 8.0,
                "tracking": null,
                "seeds": [
                    {"run": "runs/1", "seed": 1, "env_steps": 1000, "forward_reward": 7.5,
                     "forward_velocity": 7.5 / 16.0, "distance": 7.5 / 8.0, "tracking": null},
                    {"run": "runs/2", "seed": 2, "env_steps": 2000, "forward_reward": 7.5,
                     "forward_velocity": 7.5 / 16.0, "distance": 7.5 / 8.0, "tracking": null},
                ],
            },
            "others": {
                "encoding": "true",
                "forward_reward": 5.0,
                "forward_velocity": 5.0 / 16.0,
                "distance": 5.0 / 8.0,
                "tracking": null,
                "seeds": [{"run": "runs/1", "seed": 1, "env_steps": 1000, "forward_reward": 5.0,
                           "forward_velocity": 5.0 / 16.0, "distance": 5.0 / 8.0, "tracking": null}],
            },
            "evaluation_seed": 3,
            "compared_by": "forward_reward",
            "backend": "lanes",
            "precision": "f64",
            "device": "cpu",
            "physics": "rk4",
            "classes_won": 3,
            "share_won": 0.75,
        });
        for (key, value) in expected.as_object().unwrap() {
            assert_eq!(json[key], *value, "{key}");
        }
        // The gains: 7.5 against 5 over all classes, 6 against 5 in the adjacent pair, 9 against 3 in the opposite one.
        for (key, classes, gain) in [("gain", 4, 2.5), ("adjacent_pairs", 1, 1.0), ("opposite_pairs", 1, 6.0)]
        {
            assert_eq!(json[key]["classes"], classes, "{key}");
            assert_eq!(json[key]["absolute"]["value"], gain, "{key}");
        }
    }

    #[test]
    fn without_pairs_there_is_no_gain_of_pairs() {
        let single = |seed| {
            let mut run = run(seed, Encoding::True, [1.0; 4]);
            run.evaluation.classes.truncate(2);
            run
        };
        let summary = Comparison::new(&[single(1)], &[single(2)], 3).unwrap().summary;
        assert_eq!((summary.adjacent_pairs, summary.opposite_pairs), (None, None));
        assert_eq!(summary.intervals_cover, "classes only, as each side has one seed");
    }

    #[test]
    fn other_classes_and_empty_sides_are_rejected() {
        let mut foreign = run(2, Encoding::True, [1.0; 4]);
        foreign.evaluation.classes[3].name = "class 4".into();
        let known = run(1, Encoding::True, [1.0; 4]);
        let message = Comparison::new(std::slice::from_ref(&known), &[foreign], 3).unwrap_err().to_string();
        assert_eq!(
            message,
            "runs/2 has other damage classes than runs/1; only equal classes can be compared"
        );
        assert!(Comparison::new(&[known], &[], 3).is_err());
    }
}
