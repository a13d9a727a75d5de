//! Statistics of samples.

/// Mean; NaN of nothing.
pub fn mean(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let count = values.len() as f64;
    values.sum::<f64>() / count
}

/// Variance of a sample, of one degree of freedom fewer than values; NaN of a single value.
fn sample_variance(values: &[f64]) -> f64 {
    let mean = mean(values.iter().copied());
    let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
    squares / (values.len() as f64 - 1.0)
}

/// Standard deviation of a sample; NaN of a single value.
#[must_use]
pub fn sample_deviation(values: &[f64]) -> f64 {
    sample_variance(values).sqrt()
}

/// Standard error of the mean of a sample; NaN of a single value.
#[must_use]
pub fn standard_error(values: &[f64]) -> f64 {
    (sample_variance(values) / values.len() as f64).sqrt()
}

/// Median, between the two in the middle of an even number of values; `None` of nothing.
pub fn median(values: impl Iterator<Item = f64>) -> Option<f64> {
    let sorted = sorted(values);
    let upper = sorted.get(sorted.len() / 2)?;
    let lower = &sorted[(sorted.len() - 1) / 2];
    Some(f64::midpoint(*lower, *upper))
}

/// The upper one of the two in the middle of an even number of values; `None` of nothing.
pub fn upper_median(values: impl Iterator<Item = f64>) -> Option<f64> {
    let sorted = sorted(values);
    sorted.get(sorted.len() / 2).copied()
}

fn sorted(values: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut sorted: Vec<f64> = values.collect();
    sorted.sort_by(f64::total_cmp);
    sorted
}

/// A quantile of sorted numbers, interpolated linearly between neighbours as `numpy.quantile` does.
#[must_use]
pub fn quantile(sorted: &[f64], share: f64) -> f64 {
    let place = share * (sorted.len() - 1) as f64;
    let below = place.floor() as usize;
    let above = (below + 1).min(sorted.len() - 1);
    sorted[below] + (sorted[above] - sorted[below]) * place.fract()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn close(found: f64, expected: f64) {
        assert!((found - expected).abs() < 1e-12, "{found}, expected {expected}");
    }

    #[test]
    fn moments_equal_those_of_numpy() {
        let values = [1.0, 2.0, 4.0, 9.0];
        close(mean(values.into_iter()), 4.0);
        // np.std([1, 2, 4, 9], ddof=1), and the same divided by 2.
        close(sample_deviation(&values), 3.559_026_084_010_437);
        close(standard_error(&values), 1.779_513_042_005_218_6);
        assert!(sample_deviation(&[1.0]).is_nan() && standard_error(&[1.0]).is_nan());
        assert!(mean([].into_iter()).is_nan());
    }

    #[test]
    fn medians_equal_those_of_python() {
        // statistics.median and statistics.median_high
        for (values, middle, upper) in
            [(vec![3.0, 1.0, 10.0], 3.0, 3.0), (vec![4.0, 1.0, 10.0, 3.0], 3.5, 4.0), (vec![7.0], 7.0, 7.0)]
        {
            assert_eq!(median(values.iter().copied()), Some(middle));
            assert_eq!(upper_median(values.into_iter()), Some(upper));
        }
        assert_eq!(median([].into_iter()).or(upper_median([].into_iter())), None);
    }

    #[test]
    fn quantiles_equal_those_of_numpy() {
        // np.quantile([1, 2, 3, 4, 10], [.025, .5, .975, 1])
        let sorted = [1.0, 2.0, 3.0, 4.0, 10.0];
        for (share, expected) in [(0.025, 1.1), (0.5, 3.0), (0.975, 9.4), (1.0, 10.0)] {
            close(quantile(&sorted, share), expected);
        }
    }
}
