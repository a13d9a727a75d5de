//! Gains of one learner over another, with bootstrap intervals over damage classes and training seeds.
//!
//! Source: Efron and Tibshirani (1993), "An introduction to the bootstrap", the percentile interval.

use dappo_sim::rng::{Purpose, Stream};
use serde::Serialize;

use crate::statistics::{mean, quantile};

/// Resamples of a bootstrap.
pub const RESAMPLES: usize = 10_000;
/// Share of the resamples that lies inside an interval.
pub const CONFIDENCE: f64 = 0.95;

/// A number with its interval.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Estimate {
    /// The estimate itself.
    pub value: f64,
    /// Lower end of the interval.
    pub low: f64,
    /// Upper end of the interval.
    pub high: f64,
}

/// How much more one learner reaches than another, on average over some damage classes.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Gain {
    /// Number of classes.
    pub classes: usize,
    /// Difference of the means, m/s.
    pub absolute: Estimate,
    /// Ratio of the means, minus 1. `None` if the other mean is not above 0, in the estimate or in any
    /// resample: a ratio to it would be meaningless.
    pub relative: Option<Estimate>,
}

/// The gain of `runs` over `others` in the classes `chosen`.
///
/// A resample draws with replacement as many classes, the same for both sides, and as many seeds, for each
/// side by itself.
///
/// # Shapes
/// - `runs`, `others`: `[seeds][classes]`, each with a number of seeds of its own, at least 1
/// - `chosen`: indices of classes, at least one
pub(super) fn gain(runs: &[Vec<f64>], others: &[Vec<f64>], chosen: &[usize], seed: u64) -> Gain {
    let all = |side: &[Vec<f64>]| (0..side.len()).collect::<Vec<_>>();
    let means = [mean_over(runs, &all(runs), chosen), mean_over(others, &all(others), chosen)];
    let resamples: Vec<[f64; 2]> =
        (0..RESAMPLES as u64).map(|number| resample(runs, others, chosen, seed, number)).collect();
    let estimate = |of: fn([f64; 2]) -> f64| {
        let mut values: Vec<f64> = resamples.iter().copied().map(of).collect();
        values.sort_by(f64::total_cmp);
        let outside = (1.0 - CONFIDENCE) / 2.0;
        Estimate { value: of(means), low: quantile(&values, outside), high: quantile(&values, 1.0 - outside) }
    };
    let has_ratio = means[1] > 0.0 && resamples.iter().all(|[_, other]| *other > 0.0);
    Gain {
        classes: chosen.len(),
        absolute: estimate(|[run, other]| run - other),
        relative: has_ratio.then(|| estimate(|[run, other]| run / other - 1.0)),
    }
}

/// The means of both sides in one resample.
fn resample(runs: &[Vec<f64>], others: &[Vec<f64>], chosen: &[usize], seed: u64, number: u64) -> [f64; 2] {
    let mut stream = Stream::new(seed, number, Purpose::Bootstrap);
    let mut draw =
        |count: usize| -> Vec<usize> { (0..count).map(|_| stream.below(count as u64) as usize).collect() };
    let (run_seeds, other_seeds) = (draw(runs.len()), draw(others.len()));
    let classes: Vec<usize> = draw(chosen.len()).into_iter().map(|index| chosen[index]).collect();
    [mean_over(runs, &run_seeds, &classes), mean_over(others, &other_seeds, &classes)]
}

fn mean_over(rewards: &[Vec<f64>], seeds: &[usize], classes: &[usize]) -> f64 {
    mean(seeds.iter().map(|&seed| mean(classes.iter().map(|&class| rewards[seed][class]))))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_sides_have_the_same_classes_in_a_resample() {
        // Means of two drawn classes: (1, 1) with probability 1/4, (1, 2) with 1/2, (2, 2) with 1/4. The
        // differences are 5, 4 and 3; classes drawn for each side by itself would also give 103 and −95.
        let gain = gain(&[vec![105.0, 3.0]], &[vec![100.0, 0.0]], &[0, 1], 1);
        assert_eq!(gain.absolute, Estimate { value: 4.0, low: 3.0, high: 5.0 });
    }

    #[test]
    fn each_side_draws_its_seeds_by_itself() {
        // One class. A mean of two drawn seeds is the lower one, the middle or the upper one with probability 1/4, 1/2
        // and 1/4. Drawn independently, 10 − 6 and 14 − 2 each have 1/16, more than the 1/40 outside the interval.
        let gain = gain(&[vec![10.0], vec![14.0]], &[vec![2.0], vec![6.0]], &[0], 1);
        assert_eq!(gain.absolute, Estimate { value: 8.0, low: 4.0, high: 12.0 });
        // 10 / 6 − 1 and 14 / 2 − 1; the estimate is the ratio of the means, 12 / 4 − 1, not the mean of ratios.
        let relative = gain.relative.unwrap();
        assert!((relative.low - 2.0 / 3.0).abs() < 1e-12);
        assert_eq!((relative.value, relative.high), (2.0, 6.0));
    }

    #[test]
    fn one_seed_on_each_side_and_one_class_leave_no_interval() {
        let gain = gain(&[vec![7.0, 3.0]], &[vec![1.0, 2.0]], &[1], 1);
        assert_eq!(gain.classes, 1);
        assert_eq!(gain.absolute, Estimate { value: 1.0, low: 1.0, high: 1.0 });
        assert_eq!(gain.relative, Some(Estimate { value: 0.5, low: 0.5, high: 0.5 }));
    }

    #[test]
    fn no_ratio_is_formed_to_a_mean_that_may_not_be_positive() {
        let relative = |other: Vec<f64>| gain(&[vec![5.0, 6.0]], &[other], &[0, 1], 1).relative;
        assert!(relative(vec![1.0, 2.0]).is_some());
        assert_eq!(relative(vec![-3.0, 1.0]), None);
        // Its mean is 2, but a quarter of the resamples holds the first class alone.
        assert_eq!(relative(vec![-1.0, 5.0]), None);
    }

    #[test]
    fn intervals_equal_those_of_numpy() {
        let runs = [
            vec![812.0, 640.5, 233.0, 1210.0, 95.0, 480.0, 700.0, 655.0],
            vec![750.0, 590.0, 310.0, 1105.0, 60.0, 520.0, 640.0, 610.0],
            vec![905.0, 702.0, 190.0, 1320.0, 130.0, 455.0, 790.0, 720.0],
        ];
        let others = [
            vec![600.0, 480.0, 250.0, 700.0, 90.0, 410.0, 500.0, 350.0],
            vec![510.0, 530.0, 205.0, 815.0, 40.0, 390.0, 455.0, 420.0],
        ];
        let found = gain(&runs, &others, &[0, 1, 2, 3, 4, 5, 6, 7], 1_000_000);
        // a[rng.integers(3, size=(n, 3))][…, classes].mean((1, 2)) and so on, n = 1 000 000 resamples. The
        // tolerance is five standard errors of a 2.5 % quantile of 10 000 resamples: 5 · 0.0267 standard deviations.
        for (estimate, [value, low, high, deviation]) in [
            (found.absolute, [187.708_333, 92.021, 303.604, 53.963]),
            (found.relative.unwrap(), [0.445_268, 0.277_127, 0.622_886, 0.087_649]),
        ] {
            let tolerance = 5.0 * 0.0267 * deviation;
            assert!((estimate.value - value).abs() < 1e-4 * deviation, "{estimate:?}");
            assert!((estimate.low - low).abs() < tolerance, "{estimate:?}");
            assert!((estimate.high - high).abs() < tolerance, "{estimate:?}");
        }
    }
}
