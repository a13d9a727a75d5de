//! Exact running mean and variance of observations.

use dappo_sim::task::Reflection;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::error::{NnError, Result, check_finite, check_length};
use crate::{InputTransform, Standardizer};

/// Normalised observations are clipped to ± this many standard deviations. The paper does not clip; a
/// component that was nearly constant so far would otherwise swamp the network when it first moves.
pub const CLIP: f32 = 10.0;
/// Added to the variance, so that a constant component does not divide by zero.
const EPSILON: f64 = 1e-8;
/// Counts beyond this are not exact in f64.
const MOST_ROWS: u64 = 1 << 53;
/// Rows summed before a merge. Fixed, so that the result does not depend on the number of threads.
const CHUNK_ROWS: usize = 1024;

/// Mean and variance of every row seen so far, in f64.
///
/// The last `code_length` entries of a row are the damage code, whose zeros and ones carry meaning; they are
/// multiplied by a constant and have no statistics. Observations go through [`Normalizer::transform`], which stays as it
/// is: a batch must be trained with the transform that it was collected with.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Normalizer {
    code_length: usize,
    /// 1 in checkpoints that do not name it.
    #[serde(default = "unscaled")]
    code_scale: f32,
    count: u64,
    mean: Vec<f64>,
    /// Sum of squared deviations from the mean.
    squares: Vec<f64>,
}

fn unscaled() -> f32 {
    1.0
}

/// Moments of a set of rows, mergeable with those of another set.
#[derive(Clone)]
struct Moments {
    count: u64,
    mean: Vec<f64>,
    squares: Vec<f64>,
}

impl Moments {
    /// Two passes: the mean first, then deviations from it.
    fn of_rows(rows: &[f32], row_length: usize, tracked: usize) -> Self {
        let count = rows.len() / row_length;
        let mut mean = vec![0.0; tracked];
        for row in rows.chunks_exact(row_length) {
            mean.iter_mut().zip(row).for_each(|(sum, x)| *sum += f64::from(*x));
        }
        mean.iter_mut().for_each(|sum| *sum /= count as f64);
        let mut squares = vec![0.0; tracked];
        for row in rows.chunks_exact(row_length) {
            for ((square, mean), x) in squares.iter_mut().zip(&mean).zip(row) {
                *square += (f64::from(*x) - mean).powi(2);
            }
        }
        Self { count: count as u64, mean, squares }
    }

    /// The moments of the mirror images of the rows.
    fn reflected(&self, reflection: &Reflection) -> Self {
        let images = || reflection.entries().iter().take(self.mean.len());
        Self {
            count: self.count,
            mean: images().map(|image| f64::from(image.sign) * self.mean[image.of]).collect(),
            squares: images().map(|image| self.squares[image.of]).collect(),
        }
    }

    /// Chan, Golub and LeVeque (1979), "Updating formulae and a pairwise algorithm for computing sample
    /// variances", equation 2.1.
    fn merge(&mut self, other: &Self) {
        let total = (self.count + other.count) as f64;
        let weight = other.count as f64 / total;
        for index in 0..self.mean.len() {
            let delta = other.mean[index] - self.mean[index];
            self.mean[index] += delta * weight;
            self.squares[index] += other.squares[index] + delta * delta * self.count as f64 * weight;
        }
        self.count += other.count;
    }
}

impl Normalizer {
    /// A normaliser of rows of `obs_dim` numbers, the last `code_length` of which pass unchanged; see
    /// [`Normalizer::with_code_scale`].
    pub fn new(obs_dim: usize, code_length: usize) -> Result<Self> {
        let Some(tracked) = obs_dim.checked_sub(code_length) else {
            return Err(NnError::Config {
                key: "code_length",
                got: format!("{code_length} in a row of {obs_dim}"),
                expected: "at most the length of a row",
            });
        };
        let zeros = vec![0.0; tracked];
        Ok(Self { code_length, code_scale: 1.0, count: 0, mean: zeros.clone(), squares: zeros })
    }

    /// The same with a factor for the entries of the code.
    #[must_use]
    pub fn with_code_scale(self, code_scale: f32) -> Self {
        Self { code_scale, ..self }
    }

    /// Fails unless these are statistics that a normaliser can have: what is read from a file may be anything.
    pub fn check(&self) -> Result<()> {
        check_length("squares of the normaliser", &self.squares, self.mean.len())?;
        for (index, (mean, square)) in self.mean.iter().zip(&self.squares).enumerate() {
            // Rows are f32, and so is what is subtracted from them.
            check_finite(format!("mean of observation entry {index}"), f64::from(*mean as f32))?;
            check_finite(format!("squares of observation entry {index}"), *square)?;
        }
        check_finite("the factor of the damage code", f64::from(self.code_scale))?;
        let unusual = |key, got, expected| Err(NnError::Config { key, got, expected });
        if let Some(square) = self.squares.iter().find(|square| **square < 0.0) {
            return unusual("squares", square.to_string(), "sums of squares, at least 0");
        }
        if self.count > MOST_ROWS {
            return unusual("count", self.count.to_string(), "at most 2^53 rows");
        }
        Ok(())
    }

    /// Length of a row, code included.
    #[must_use]
    pub fn obs_dim(&self) -> usize {
        self.mean.len().saturating_add(self.code_length)
    }

    /// Length of the damage code at the end of a row.
    #[must_use]
    pub fn code_length(&self) -> usize {
        self.code_length
    }

    /// What the entries of the damage code are multiplied by.
    #[must_use]
    pub fn code_scale(&self) -> f32 {
        self.code_scale
    }

    /// Rows seen so far.
    #[must_use]
    pub fn count(&self) -> u64 {
        self.count
    }

    /// Mean of every entry before the code, `[obs_dim − code_length]`.
    #[must_use]
    pub fn mean(&self) -> &[f64] {
        &self.mean
    }

    /// Population variance of every entry before the code, `[obs_dim − code_length]`; 1 while nothing was seen.
    #[must_use]
    pub fn variance(&self) -> Vec<f64> {
        if self.count == 0 {
            return vec![1.0; self.squares.len()];
        }
        self.squares.iter().map(|square| square / self.count as f64).collect()
    }

    /// Takes the rows of `obs` into the statistics.
    ///
    /// # Shapes
    /// obs `[N, obs_dim]`, raw
    pub fn update(&mut self, obs: &[f32]) -> Result<()> {
        self.take(obs, None)
    }

    /// Takes the rows of `obs` and their mirror images into the statistics, which are mirror images of themselves then.
    ///
    /// # Shapes
    /// obs `[N, obs_dim]`, raw; `reflection` is that of a row
    pub fn update_mirrored(&mut self, obs: &[f32], reflection: &Reflection) -> Result<()> {
        self.take(obs, Some(reflection))
    }

    fn take(&mut self, obs: &[f32], reflection: Option<&Reflection>) -> Result<()> {
        let (row_length, tracked) = (self.obs_dim(), self.mean.len());
        check_length("obs [N, obs_dim]", obs, obs.len() / row_length.max(1) * row_length)?;
        let chunks: Vec<Moments> = obs
            .par_chunks(CHUNK_ROWS * row_length.max(1))
            .map(|rows| Moments::of_rows(rows, row_length, tracked))
            .collect();
        let mut moments =
            Moments { count: self.count, mean: self.mean.clone(), squares: self.squares.clone() };
        for chunk in &chunks {
            moments.merge(chunk);
            if let Some(reflection) = reflection {
                moments.merge(&chunk.reflected(reflection));
            }
        }
        // One bad observation would spoil the statistics permanently, so it is refused instead.
        for (index, mean) in moments.mean.iter().enumerate() {
            check_finite(format!("mean of observation entry {index}"), *mean)?;
        }
        (self.count, self.mean, self.squares) = (moments.count, moments.mean, moments.squares);
        Ok(())
    }

    /// What a network is given of observations with the statistics of now.
    pub fn transform(&self) -> Result<InputTransform> {
        if self.count == 0 {
            return InputTransform::new(self.mean.len(), self.code_length, self.code_scale);
        }
        let mean = self.mean.iter().map(|mean| *mean as f32).collect();
        let scale = self.variance().iter().map(|var| (1.0 / (var + EPSILON).sqrt()) as f32).collect();
        InputTransform::standardized(Standardizer::of(mean, scale)?, self.code_length, self.code_scale)
    }
}

#[cfg(test)]
mod tests {
    use dappo_sim::task::Image;

    use super::*;

    /// `np.sin(i * .7) * 3 + i % 3 * 100` as `[2500, 3]` f32, the last column replaced by `i % 2`.
    fn rows() -> Vec<f32> {
        let value = |i: usize| {
            if i % 3 == 2 {
                (i % 2) as f32
            } else {
                ((i as f64 * 0.7).sin() * 3.0 + (i % 3 * 100) as f64) as f32
            }
        };
        (0..7500).map(value).collect()
    }

    fn assert_close(got: &[f64], expected: &[f64], tolerance: f64) {
        assert_eq!(got.len(), expected.len());
        for (got, expected) in got.iter().zip(expected) {
            assert!((got - expected).abs() <= tolerance, "{got}, expected {expected}");
        }
    }

    #[test]
    fn mean_and_variance_equal_numpy_however_the_rows_arrive() {
        for pieces in [1, 2, 25, 2500] {
            let mut normalizer = Normalizer::new(3, 0).unwrap();
            rows().chunks(7500 / pieces).for_each(|rows| normalizer.update(rows).unwrap());
            assert_eq!(normalizer.count(), 2500);
            // rows.astype(float).mean(0), rows.astype(float).var(0)
            assert_close(normalizer.mean(), &[0.000_894_272_887_5, 100.001_340_676_879_9, 0.5], 1e-9);
            let variance = [4.500_104_569_329, 4.499_225_366_279, 0.25];
            assert_close(&normalizer.variance(), &variance, 1e-9);
        }
    }

    #[test]
    fn statistics_with_mirror_images_are_those_of_rows_and_images_together() {
        // The first two entries take each other's place, one with another sign.
        let image = |of, sign| Image { of, sign };
        let reflection = Reflection::new(vec![image(1, -1.0), image(0, -1.0), image(2, 1.0)]);
        let mut images = rows();
        for (image, row) in images.chunks_exact_mut(3).zip(rows().chunks_exact(3)) {
            reflection.apply(row, image);
        }
        let (mut mirrored, mut together) = (Normalizer::new(3, 1).unwrap(), Normalizer::new(3, 1).unwrap());
        mirrored.update_mirrored(&rows(), &reflection).unwrap();
        together.update(&[rows(), images].concat()).unwrap();
        assert_eq!(mirrored.count(), together.count());
        assert_close(mirrored.mean(), together.mean(), 1e-9);
        assert_close(&mirrored.variance(), &together.variance(), 1e-9);
        assert!((mirrored.mean()[0] + mirrored.mean()[1]).abs() < 1e-9);
    }

    #[test]
    fn normalised_rows_equal_numpy_and_the_code_passes_unchanged() {
        let mut normalizer = Normalizer::new(3, 1).unwrap();
        normalizer.update(&rows()).unwrap();
        assert_eq!(normalizer.mean().len(), 2);
        let normalized = normalizer.transform().unwrap().apply(&rows()).unwrap();
        // (rows[7, :2] - mean) / np.sqrt(var + 1e-8); rows[7, 2]
        let expected = [1.195_631_187, 0.428_078_980, 1.0];
        let got: Vec<f64> = normalized[21..24].iter().map(|x| f64::from(*x)).collect();
        assert_close(&got, &expected, 1e-5);
    }

    #[test]
    fn the_code_is_multiplied_by_its_factor_and_nothing_else_is() {
        let mut plain = Normalizer::new(3, 1).unwrap();
        plain.update(&rows()).unwrap();
        let scaled = plain.clone().with_code_scale(4.0).transform().unwrap().apply(&rows()).unwrap();
        for (plain, scaled) in
            plain.transform().unwrap().apply(&rows()).unwrap().chunks(3).zip(scaled.chunks(3))
        {
            assert_eq!(scaled, [plain[0], plain[1], 4.0 * plain[2]]);
        }
    }

    #[test]
    fn a_normaliser_that_has_seen_nothing_changes_nothing() {
        let normalizer = Normalizer::new(3, 1).unwrap();
        assert_eq!(normalizer.transform().unwrap().apply(&rows()).unwrap(), rows());
    }

    #[test]
    fn constant_entries_become_zero_and_outliers_are_clipped() {
        let mut normalizer = Normalizer::new(2, 0).unwrap();
        normalizer.update(&[3.0, 0.0, 3.0, 1.0, 3.0, 2.0]).unwrap();
        assert_eq!(normalizer.transform().unwrap().apply(&[3.0, 1e9]).unwrap(), [0.0, CLIP]);
    }

    #[test]
    fn statistics_do_not_depend_on_the_number_of_threads_and_survive_toml_to_the_bit() {
        let run = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let mut normalizer = Normalizer::new(3, 1).unwrap();
            pool.install(|| normalizer.update(&rows())).unwrap();
            normalizer
        };
        let normalizer = run(1);
        assert_eq!(run(3), normalizer);
        let text = toml::to_string(&normalizer).unwrap();
        assert_eq!(toml::from_str::<Normalizer>(&text).unwrap(), normalizer);
    }

    #[test]
    fn statistics_that_no_observations_have_are_rejected() {
        let mut normalizer = Normalizer::new(3, 1).unwrap();
        normalizer.update(&rows()).unwrap();
        normalizer.check().unwrap();
        let refuse = |change: fn(&mut Normalizer), expected: &str| {
            let mut other = normalizer.clone();
            change(&mut other);
            let message = other.check().unwrap_err().to_string();
            assert!(message.contains(expected), "{message}");
        };
        refuse(|n| n.squares.truncate(1), "squares of the normaliser has 1 elements, expected 2");
        refuse(|n| n.squares[1] = f64::NAN, "squares of observation entry 1 is NaN");
        refuse(|n| n.squares[1] = -1.0, "squares is -1, expected sums of squares");
        refuse(|n| n.mean[0] = f64::INFINITY, "mean of observation entry 0 is inf");
        refuse(|n| n.code_scale = f32::NAN, "the factor of the damage code is NaN");
        refuse(|n| n.count = u64::MAX, "expected at most 2^53 rows");
    }

    #[test]
    fn observations_that_are_not_finite_are_rejected_and_change_nothing() {
        let mut normalizer = Normalizer::new(2, 0).unwrap();
        normalizer.update(&[1.0, 2.0]).unwrap();
        let before = normalizer.clone();
        let message = normalizer.update(&[1.0, f32::NAN]).unwrap_err().to_string();
        assert_eq!(message, "mean of observation entry 1 is NaN, expected a finite number");
        assert_eq!(normalizer, before);
        assert!(normalizer.update(&[1.0]).is_err());
        assert!(Normalizer::new(2, 3).is_err());
    }
}
