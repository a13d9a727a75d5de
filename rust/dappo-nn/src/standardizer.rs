//! Mean and scale of every component of a network's inputs.

use serde::{Deserialize, Serialize};

use crate::error::{NnError, Result, check_length};
use crate::{CLIP, Normalizer};

/// A component whose standard deviation is below this, relative to its mean if that exceeds 1, never varies:
/// what is left is the rounding of `f32`.
const ROUNDING: f64 = 1e-6;

/// Scales every component to mean 0 and variance 1 over the training samples, clipped to ± [`CLIP`];
/// components that never vary become 0.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Standardizer {
    mean: Vec<f32>,
    /// 1 / standard deviation, or 0.
    scale: Vec<f32>,
}

impl Standardizer {
    /// The standardiser of the rows that `statistics` has seen.
    #[must_use]
    pub fn new(statistics: &Normalizer) -> Self {
        let scale = |(mean, variance): (&f64, &f64)| {
            let deviation = variance.sqrt();
            if deviation > ROUNDING * mean.abs().max(1.0) { (1.0 / deviation) as f32 } else { 0.0 }
        };
        Self {
            mean: statistics.mean().iter().map(|mean| *mean as f32).collect(),
            scale: statistics.mean().iter().zip(&statistics.variance()).map(scale).collect(),
        }
    }

    /// A standardiser of known means and scales; a scale is 1 / standard deviation, or 0 for a component that never
    /// varies.
    ///
    /// # Shapes
    /// mean, scale `[F]`
    pub fn of(mean: Vec<f32>, scale: Vec<f32>) -> Result<Self> {
        let standardizer = Self { mean, scale };
        standardizer.check(standardizer.mean.len())?;
        Ok(standardizer)
    }

    /// Mean of every component, `[F]`.
    #[must_use]
    pub fn mean(&self) -> &[f32] {
        &self.mean
    }

    /// 1 / standard deviation of every component, or 0, `[F]`.
    #[must_use]
    pub fn scale(&self) -> &[f32] {
        &self.scale
    }

    /// Components of an input, F.
    #[must_use]
    pub fn input_dim(&self) -> usize {
        self.mean.len()
    }

    /// Fails unless there is a finite mean and scale for each of `expected` components.
    pub fn check(&self, expected: usize) -> Result<()> {
        check_length("means of the standardiser", &self.mean, expected)?;
        check_length("scales of the standardiser", &self.scale, expected)?;
        let bad = self.mean.iter().chain(&self.scale).find(|x| !x.is_finite());
        bad.map_or(Ok(()), |x| {
            Err(NnError::NonFinite { what: "a number of the standardiser".into(), got: f64::from(*x) })
        })
    }

    /// Standardises rows in place.
    ///
    /// # Shapes
    /// rows `[N, F]`
    pub fn apply(&self, rows: &mut [f32]) {
        for row in rows.chunks_exact_mut(self.mean.len().max(1)) {
            for ((x, mean), scale) in row.iter_mut().zip(&self.mean).zip(&self.scale) {
                *x = ((*x - mean) * scale).clamp(-CLIP, CLIP);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::f32::consts::{FRAC_1_SQRT_2, SQRT_2};

    use super::*;

    fn standardizer() -> Standardizer {
        let mut statistics = Normalizer::new(4, 0).unwrap();
        // Columns: 1 2 3, a constant, a constant with the rounding of f32, 0 0 900.
        statistics.update(&[1.0, 7.0, 0.1, 0.0, 2.0, 7.0, 0.1 + 7.5e-9, 0.0, 3.0, 7.0, 0.1, 900.0]).unwrap();
        Standardizer::new(&statistics)
    }

    #[test]
    fn components_get_mean_0_and_variance_1_and_constant_ones_vanish() {
        let mut rows = [1.0, 7.0, 0.1, 0.0, 3.0, 8.0, 0.3, 900.0];
        standardizer().apply(&mut rows);
        // (x - x.mean(0)) / x.std(0) in NumPy, with 0 for the constant columns.
        let expected = [-1.224_744_9, 0.0, 0.0, -FRAC_1_SQRT_2, 1.224_744_9, 0.0, 0.0, SQRT_2];
        for (got, expected) in rows.iter().zip(expected) {
            assert!((got - expected).abs() < 1e-6, "{got}, expected {expected}");
        }
    }

    #[test]
    fn values_far_outside_are_clipped_and_nan_passes() {
        let mut rows = [1e6, -1e9, 0.1, f32::NAN];
        standardizer().apply(&mut rows);
        assert_eq!(rows[..3], [CLIP, 0.0, 0.0]);
        assert!(rows[3].is_nan());
    }

    #[test]
    fn a_standardiser_reads_back_from_toml_to_the_bit_and_is_checked() {
        let standardizer = standardizer();
        let text = toml::to_string(&standardizer).unwrap();
        assert_eq!(toml::from_str::<Standardizer>(&text).unwrap(), standardizer);
        standardizer.check(4).unwrap();
        assert!(standardizer.check(5).unwrap_err().to_string().contains("4 elements, expected 5"));
    }
}
