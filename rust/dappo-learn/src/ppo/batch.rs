//! What the networks are trained on, in the host's memory.

use std::borrow::Cow;

use dappo_nn::unprivileged;
use dappo_sim::task::{Reflection, Reflections};
use rayon::prelude::*;

use crate::error::Result;
use crate::gae::Targets;
use crate::rollout::Rollout;

/// What the policy is trained on; B = T · N rows, or twice as many where each is followed by its mirror image.
pub(super) struct PolicyBatch<'a> {
    /// Normalised observations `[B, O]`.
    pub obs: Cow<'a, [f32]>,
    /// Actions `[B, A]`.
    pub actions: Cow<'a, [f32]>,
    /// Means of the old policy `[B, A]`.
    pub means: Cow<'a, [f32]>,
    /// Log-densities under the old policy `[B]`.
    pub log_probs: Cow<'a, [f32]>,
    /// Advantages, normalised over the whole batch, `[B]`.
    pub advantages: Vec<f32>,
}

/// What the value net is trained on: as many rows as for the policy.
#[derive(Clone)]
pub(super) struct ValueBatch {
    /// Observations as normalised when they were collected, `[B, O]`.
    pub obs: Vec<f32>,
    /// Returns `[B]`.
    pub returns: Vec<f32>,
}

impl<'a> PolicyBatch<'a> {
    /// The policy's batch of a rollout whose normalised observations are `obs`, `[B, O]`, privileged entries included,
    /// the last `privileged` of them before the damage code.
    pub fn new(
        rollout: &'a Rollout,
        obs: &'a [f32],
        privileged: usize,
        targets: &Targets,
        mirror: Option<&Reflections>,
    ) -> Self {
        let action = mirror.map(|mirror| &mirror.action);
        Self {
            obs: unprivileged(obs, &rollout.transform, rollout.transform.obs_dim() - privileged),
            actions: with_images(&rollout.actions, action),
            means: with_images(&rollout.means, action),
            log_probs: twice(Cow::Borrowed(&rollout.log_probs), mirror),
            advantages: twice(Cow::Owned(standardize(&targets.advantages)), mirror).into_owned(),
        }
    }

    pub fn rows(&self) -> usize {
        self.log_probs.len()
    }
}

impl ValueBatch {
    /// The value net's batch of a rollout.
    pub fn new(rollout: &Rollout, targets: &Targets, mirror: Option<&Reflections>) -> Result<Self> {
        let obs = rollout.transform.apply(&rollout.obs)?;
        Ok(Self {
            obs: match mirror {
                None => obs,
                Some(mirror) => with_images(&obs, Some(&mirror.obs)).into_owned(),
            },
            returns: twice(Cow::Borrowed(&targets.returns), mirror).into_owned(),
        })
    }

    pub fn rows(&self) -> usize {
        self.returns.len()
    }

    /// This batch followed by `other`.
    pub fn union(&self, other: Option<&Self>) -> Self {
        let mut union = self.clone();
        if let Some(other) = other {
            union.obs.extend(&other.obs);
            union.returns.extend(&other.returns);
        }
        union
    }
}

/// Rows, each followed by its mirror image where there is a reflection.
fn with_images<'a>(rows: &'a [f32], reflection: Option<&Reflection>) -> Cow<'a, [f32]> {
    let Some(reflection) = reflection else { return Cow::Borrowed(rows) };
    let width = reflection.len();
    let mut pairs = vec![0.0; 2 * rows.len()];
    pairs.par_chunks_mut(2 * width * ROWS).zip(rows.par_chunks(width * ROWS)).for_each(|(pairs, rows)| {
        for (pair, row) in pairs.chunks_exact_mut(2 * width).zip(rows.chunks_exact(width)) {
            let (same, image) = pair.split_at_mut(width);
            same.copy_from_slice(row);
            reflection.apply(row, image);
        }
    });
    Cow::Owned(pairs)
}

/// Rows that a thread reflects at a time.
const ROWS: usize = 256;

/// Values that hold for a row, and for its mirror image where there is one.
fn twice<'a>(values: Cow<'a, [f32]>, mirror: Option<&Reflections>) -> Cow<'a, [f32]> {
    match mirror {
        None => values,
        Some(_) => Cow::Owned(values.iter().flat_map(|value| [*value; 2]).collect()),
    }
}

/// Shifted and scaled to mean 0 and standard deviation 1.
fn standardize(values: &[f32]) -> Vec<f32> {
    let count = values.len() as f64;
    let mean = values.iter().map(|x| f64::from(*x)).sum::<f64>() / count;
    let variance = values.iter().map(|x| (f64::from(*x) - mean).powi(2)).sum::<f64>() / count;
    let scale = 1.0 / (variance.sqrt() + 1e-8);
    values.iter().map(|x| ((f64::from(*x) - mean) * scale) as f32).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn advantages_are_standardised_as_numpy_does() {
        // (z - z.mean()) / z.std() with z = np.array([1., 2., 4., 9.])
        let expected = [-0.973_328_5, -0.648_885_7, 0.0, 1.622_214_2];
        for (got, expected) in standardize(&[1.0, 2.0, 4.0, 9.0]).iter().zip(expected) {
            assert!((got - expected).abs() < 1e-6, "{got}, expected {expected}");
        }
        assert_eq!(standardize(&[3.0; 4]), [0.0; 4]);
    }

    #[test]
    fn the_union_of_value_batches_keeps_both_in_order() {
        let batch = |values: [f32; 2]| ValueBatch {
            obs: values.to_vec(),
            returns: values.iter().map(|x| 10.0 * x).collect(),
        };
        let union = batch([1.0, 2.0]).union(Some(&batch([3.0, 4.0])));
        assert_eq!((union.rows(), union.obs), (4, vec![1.0, 2.0, 3.0, 4.0]));
        assert_eq!(union.returns, [10.0, 20.0, 30.0, 40.0]);
        assert_eq!(batch([1.0, 2.0]).union(None).rows(), 2);
    }
}
