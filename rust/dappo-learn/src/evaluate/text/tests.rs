use super::super::tables::tests::{class, simulator};
use super::*;

fn evaluation(encoding: Encoding, rewards: [f64; 3], standard_error: f64) -> Evaluation {
    let classes = ["none", "D1", "D1"].into_iter().zip(rewards).enumerate();
    let classes = classes.map(|(id, (group, reward))| class(id, group, reward, standard_error));
    Evaluation::new(encoding, simulator(), classes.collect())
}

fn run(seed: u64, rewards: [f64; 3]) -> RunEvaluation {
    let evaluation = evaluation(Encoding::True, rewards, 1.0);
    RunEvaluation { run: format!("runs/{seed}"), seed: Some(seed), env_steps: Some(1000), evaluation }
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
        seed: Some(seed),
        env_steps: Some(env_steps),
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
        (class.tracking, class.tracking_standard_error) = (Some(share), Some(0.03));
    }
    let tracked = Evaluation::new(Encoding::True, simulator(), tracked.classes);
    // D1: √(0.03² + 0.03²) / 2 = 0.0212. All: √(3 · 0.03²) / 3 = 0.0173.
    let expected = "\
        class  name     group  tracking  ± s.e.  length  falls\n    \
            0  class 0  none      0.750   0.030      20    0/4\n    \
            1  class 1  D1        0.500   0.030      20    1/4\n    \
            2  class 2  D1        0.250   0.030      20    2/4\n\
        group  classes  tracking  ± s.e.  falls\n\
        none         1     0.750   0.030    0/4\n\
        D1           2     0.375   0.021    3/8\n\
        all          3     0.500   0.017   3/12\n\
        episodes among the falls that ended because the physics diverged: 1\n\
        mean over 3 damage classes: tracking 0.500 (backend lanes, f64)\n";
    assert_eq!(tracked.text(), expected);
    assert_eq!(tracked.mean_score(), 0.5);
    let line = tracked.class_table();
    assert!(line.contains(",0.7500,0.0300,lanes,"), "{line}");
    assert!(
        line.starts_with("class,name,group,")
            && line.contains(",diverged,tracking,tracking_standard_error,backend"),
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
    comparison.others.seeds[0].env_steps = Some(1000);
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
