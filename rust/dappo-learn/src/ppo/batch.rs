//! What the networks are trained on, in the host's memory.

use dappo_nn::{PolicyState, with_hidden};

use crate::error::Result;
use crate::gae::Targets;
use crate::rollout::Rollout;

/// What the policy is trained on; B = T · N rows.
pub(super) struct PolicyBatch<'a> {
    /// Normalised observations `[B, O]`.
    pub obs: &'a [f32],
    /// Actions `[B, A]`.
    pub actions: &'a [f32],
    /// Means of the old policy `[B, A]`.
    pub means: &'a [f32],
    /// Log-densities under the old policy `[B]`.
    pub log_probs: &'a [f32],
    /// Advantages, normalised over the whole batch, `[B]`.
    pub advantages: Vec<f32>,
    /// How rows follow each other, for a recurrent policy.
    pub sequences: Option<Sequences<'a>>,
}

/// T steps of N robots, time-major.
pub(super) struct Sequences<'a> {
    /// T.
    pub steps: usize,
    /// What the policy remembered before the first step, of N robots.
    pub state: &'a PolicyState,
    /// Where episodes begin, `[T, N]`.
    pub begins: Vec<bool>,
}

/// What the value net is trained on.
#[derive(Clone)]
pub(super) struct ValueBatch {
    /// Observations as normalised when they were collected, and the hidden states of the policy's memory, if it has one,
    /// `[B, O + H]`.
    pub obs: Vec<f32>,
    /// Returns `[B]`.
    pub returns: Vec<f32>,
}

impl<'a> PolicyBatch<'a> {
    /// The policy's batch of a rollout whose normalised observations are `obs`, `[B, O]`.
    pub fn new(rollout: &'a Rollout, obs: &'a [f32], targets: &Targets) -> Self {
        Self {
            obs,
            actions: &rollout.actions,
            means: &rollout.means,
            log_probs: &rollout.log_probs,
            advantages: standardize(&targets.advantages),
            sequences: (rollout.state.units() > 0).then(|| Sequences {
                steps: rollout.horizon,
                state: &rollout.state,
                begins: rollout.begins(),
            }),
        }
    }

    /// Rows of a sample: a recurrent policy is trained on whole sequences.
    pub fn steps(&self) -> usize {
        self.sequences.as_ref().map_or(1, |sequences| sequences.steps)
    }

    pub fn rows(&self) -> usize {
        self.log_probs.len()
    }
}

impl ValueBatch {
    /// The value net's batch of a rollout.
    pub fn new(rollout: &Rollout, targets: &Targets) -> Result<Self> {
        let obs = rollout.transform.apply(&rollout.obs)?;
        let obs = with_hidden(obs.into(), &rollout.hidden, rollout.state.units()).into_owned();
        Ok(Self { obs, returns: targets.returns.clone() })
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
