//! From an observation to the input of a network.

use rayon::prelude::*;

use crate::Standardizer;
use crate::error::{NnError, Result, check_length};

/// Rows that a thread transforms at a time, at least.
const ROWS: usize = 256;

/// What a network gets of an observation: its entries standardised and clipped, and the damage code at its end, whose
/// zeros and ones carry meaning, multiplied by a constant.
#[derive(Debug, Clone, PartialEq)]
pub struct InputTransform {
    /// Entries before the damage code.
    obs_dim: usize,
    /// Of these entries; `None` before any observation has been seen, when they pass as they are.
    standardizer: Option<Standardizer>,
    code_length: usize,
    code_scale: f32,
}

impl InputTransform {
    /// Observations of `obs_dim` entries that pass as they are, and damage codes that are multiplied by `code_scale`.
    pub fn new(obs_dim: usize, code_length: usize, code_scale: f32) -> Result<Self> {
        if !code_scale.is_finite() {
            return Err(NnError::Invalid(format!(
                "the scale of the damage code is {code_scale}, expected a finite number"
            )));
        }
        Ok(Self { obs_dim, standardizer: None, code_length, code_scale })
    }

    /// Observations that are standardised, and damage codes that are multiplied by `code_scale`.
    pub fn standardized(standardizer: Standardizer, code_length: usize, code_scale: f32) -> Result<Self> {
        let plain = Self::new(standardizer.input_dim(), code_length, code_scale)?;
        Ok(Self { standardizer: Some(standardizer), ..plain })
    }

    /// The same for rows without the last `privileged` of the entries before the damage code.
    pub(crate) fn without_privileged(&self, privileged: usize) -> Result<Self> {
        let Some(obs_dim) = self.obs_dim.checked_sub(privileged) else {
            return Err(NnError::Invalid(format!(
                "{privileged} entries of an observation are privileged, but it has {}",
                self.obs_dim
            )));
        };
        let kept = |values: &[f32]| values.iter().take(obs_dim).copied().collect();
        match &self.standardizer {
            None => Self::new(obs_dim, self.code_length, self.code_scale),
            Some(all) => Self::standardized(
                Standardizer::of(kept(all.mean()), kept(all.scale()))?,
                self.code_length,
                self.code_scale,
            ),
        }
    }

    /// What the entries before the damage code are standardised with; `None` if they pass as they are.
    #[must_use]
    pub fn standardizer(&self) -> Option<&Standardizer> {
        self.standardizer.as_ref()
    }

    /// Length of an observation, without damage code.
    #[must_use]
    pub fn obs_dim(&self) -> usize {
        self.obs_dim
    }

    /// Length of the damage code.
    #[must_use]
    pub fn code_length(&self) -> usize {
        self.code_length
    }

    /// What the entries of the damage code are multiplied by.
    #[must_use]
    pub fn code_scale(&self) -> f32 {
        self.code_scale
    }

    /// Length of a row, observation and damage code.
    #[must_use]
    pub fn width(&self) -> usize {
        self.obs_dim.saturating_add(self.code_length)
    }

    /// The inputs of rows of observations.
    ///
    /// # Shapes
    /// rows `[N, width]`, raw; returns the same shape
    pub fn apply(&self, rows: &[f32]) -> Result<Vec<f32>> {
        let width = self.width().max(1);
        check_length("obs [N, obs_dim]", rows, rows.len() / width * width)?;
        let mut inputs = rows.to_vec();
        inputs.par_chunks_mut(ROWS * width).for_each(|rows| {
            for row in rows.chunks_exact_mut(width) {
                let (observed, code) = row.split_at_mut(self.obs_dim);
                if let Some(standardizer) = &self.standardizer {
                    standardizer.apply(observed);
                }
                code.iter_mut().for_each(|x| *x *= self.code_scale);
            }
        });
        Ok(inputs)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn entries_are_standardised_and_codes_scaled() {
        let standardizer = Standardizer::of(vec![1.0, -2.0], vec![2.0, 0.5]).unwrap();
        let transform = InputTransform::standardized(standardizer, 1, 4.0).unwrap();
        assert_eq!((transform.obs_dim(), transform.width()), (2, 3));
        // (2 - 1) · 2, (0 + 2) / 2, 1 · 4; the second row is clipped to ±10.
        let inputs = transform.apply(&[2.0, 0.0, 1.0, 1e6, -1e6, 0.0]).unwrap();
        assert_eq!(inputs, [2.0, 1.0, 4.0, 10.0, -10.0, 0.0]);
    }

    #[test]
    fn entries_without_statistics_pass_as_they_are() {
        let transform = InputTransform::new(2, 1, 4.0).unwrap();
        assert_eq!(transform.apply(&[1e6, -2.0, 1.0]).unwrap(), [1e6, -2.0, 4.0]);
        assert!(transform.standardizer().is_none());
    }

    #[test]
    fn rows_of_another_length_and_scales_that_are_not_finite_are_rejected() {
        assert!(InputTransform::new(2, 1, 4.0).unwrap().apply(&[0.0; 4]).is_err());
        assert!(InputTransform::new(2, 1, f32::NAN).is_err());
    }
}
