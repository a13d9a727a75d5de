//! Batches as tensors, and their division into shuffled minibatches.

use std::ops::Range;

use burn::module::{Module, Param};
use burn::tensor::{Device, Int, Tensor, TensorData};
use dappo_sim::rng::Stream;

use crate::error::Result;
use crate::gae::Targets;
use crate::rollout::Rollout;

/// What the policy is trained on; B = T · N rows.
pub(super) struct PolicyBatch {
    /// Normalised observations `[B, O]`.
    pub obs: Tensor<2>,
    /// Actions `[B, A]`.
    pub actions: Tensor<2>,
    /// Means of the old policy `[B, A]`.
    pub means: Tensor<2>,
    /// Log-densities under the old policy `[B, 1]`.
    pub log_probs: Tensor<2>,
    /// Advantages, normalised over the whole batch, `[B, 1]`.
    pub advantages: Tensor<2>,
}

/// What the value net is trained on. A module, so that checkpoints store it as they store networks.
#[derive(Module, Debug)]
pub(super) struct ValueBatch {
    /// Observations as normalised when they were collected, `[B, O]`.
    pub obs: Param<Tensor<2>>,
    /// Returns `[B, 1]`.
    pub returns: Param<Tensor<2>>,
}

/// Both batches of a rollout, on `device`.
pub(super) fn batches(
    rollout: &Rollout,
    targets: &Targets,
    device: &Device,
) -> Result<(PolicyBatch, ValueBatch)> {
    let (rows, actions) = (rollout.len(), rollout.action_dim);
    let tensor = |values: Vec<f32>, width| Tensor::from_data(TensorData::new(values, [rows, width]), device);
    let obs: Tensor<2> = tensor(rollout.normalizer.apply(&rollout.obs)?, rollout.obs_dim);
    let policy = PolicyBatch {
        obs: obs.clone(),
        actions: tensor(rollout.actions.clone(), actions),
        means: tensor(rollout.means.clone(), actions),
        log_probs: tensor(rollout.log_probs.clone(), 1),
        advantages: tensor(standardize(&targets.advantages), 1),
    };
    Ok((policy, ValueBatch::new(obs, tensor(targets.returns.clone(), 1))))
}

/// Shifted and scaled to mean 0 and standard deviation 1.
pub(super) fn standardize(values: &[f32]) -> Vec<f32> {
    let count = values.len() as f64;
    let mean = values.iter().map(|x| f64::from(*x)).sum::<f64>() / count;
    let variance = values.iter().map(|x| (f64::from(*x) - mean).powi(2)).sum::<f64>() / count;
    let scale = 1.0 / (variance.sqrt() + 1e-8);
    values.iter().map(|x| ((f64::from(*x) - mean) * scale) as f32).collect()
}

impl PolicyBatch {
    pub fn rows(&self) -> usize {
        self.obs.dims()[0]
    }

    pub fn select(&self, rows: &Tensor<1, Int>) -> Self {
        Self {
            obs: self.obs.clone().select(0, rows.clone()),
            actions: self.actions.clone().select(0, rows.clone()),
            means: self.means.clone().select(0, rows.clone()),
            log_probs: self.log_probs.clone().select(0, rows.clone()),
            advantages: self.advantages.clone().select(0, rows.clone()),
        }
    }
}

impl ValueBatch {
    pub fn new(obs: Tensor<2>, returns: Tensor<2>) -> Self {
        let constant = |tensor: Tensor<2>| Param::from_tensor(tensor).set_require_grad(false);
        Self { obs: constant(obs), returns: constant(returns) }
    }

    pub fn rows(&self) -> usize {
        self.obs.lazy_shape()[0]
    }

    pub fn select(&self, rows: &Tensor<1, Int>) -> (Tensor<2>, Tensor<2>) {
        let take = |tensor: Tensor<2>| tensor.select(0, rows.clone());
        (take(self.obs.val()), take(self.returns.val()))
    }

    /// This batch followed by `other`.
    pub fn union(&self, other: Option<&Self>) -> Self {
        let Some(other) = other else {
            return self.clone();
        };
        Self::new(
            Tensor::cat(vec![self.obs.val(), other.obs.val()], 0),
            Tensor::cat(vec![self.returns.val(), other.returns.val()], 0),
        )
    }
}

/// The rows 0..`rows` in random order, in minibatches of about `size`.
pub(super) fn shuffled(
    rows: usize,
    size: usize,
    stream: &mut Stream,
    device: &Device,
) -> Vec<Tensor<1, Int>> {
    let mut order: Vec<i32> = (0..rows as i32).collect();
    stream.shuffle(&mut order);
    ranges(rows, size).map(|range| indices(order[range].to_vec(), device)).collect()
}

/// Of the rows 0..`rows`, as many as possible but no more than `most`, with equal gaps.
pub(super) fn evenly_spaced(rows: usize, most: usize, device: &Device) -> Tensor<1, Int> {
    indices((0..rows as i32).step_by(rows.div_ceil(most)).collect(), device)
}

fn indices(rows: Vec<i32>, device: &Device) -> Tensor<1, Int> {
    let length = rows.len();
    Tensor::from_data(TensorData::new(rows, [length]), device)
}

/// Cuts 0..`rows` into pieces of nearly equal length, as close to `size` as possible: a short rest would
/// take a step as long as a full minibatch on far noisier gradients.
pub(crate) fn ranges(rows: usize, size: usize) -> impl Iterator<Item = Range<usize>> {
    let count = (rows as f64 / size as f64).round().max(1.0) as usize;
    (0..count).map(move |piece| piece * rows / count..(piece + 1) * rows / count)
}

#[cfg(test)]
mod tests {
    use dappo_sim::rng::Purpose;

    use super::*;

    fn order(rows: usize, size: usize, episode: u64) -> Vec<Vec<i32>> {
        let mut stream = Stream::new(5, episode, Purpose::Shuffle);
        let minibatches = shuffled(rows, size, &mut stream, &Device::flex());
        minibatches.into_iter().map(|rows| rows.into_data().try_into_vec().unwrap()).collect()
    }

    #[test]
    fn every_row_appears_once_in_minibatches_of_nearly_equal_size() {
        for (rows, size, expected) in
            [(10, 3, vec![3, 3, 4]), (10, 100, vec![10]), (11, 4, vec![3, 4, 4]), (1, 1, vec![1])]
        {
            let minibatches = order(rows, size, 0);
            assert_eq!(minibatches.iter().map(Vec::len).collect::<Vec<_>>(), expected);
            let mut all = minibatches.concat();
            all.sort_unstable();
            assert_eq!(all, (0..rows as i32).collect::<Vec<_>>());
        }
    }

    #[test]
    fn evenly_spaced_rows_keep_equal_gaps_and_the_limit() {
        for (rows, most, expected) in [
            (7, 7, vec![0, 1, 2, 3, 4, 5, 6]),
            (8, 7, vec![0, 2, 4, 6]),
            (9, 3, vec![0, 3, 6]),
            (1, 5, vec![0]),
        ] {
            let got: Vec<i32> =
                evenly_spaced(rows, most, &Device::flex()).into_data().try_into_vec().unwrap();
            assert_eq!(got, expected);
        }
    }

    #[test]
    fn the_order_is_a_function_of_the_stream() {
        assert_eq!(order(100, 10, 0), order(100, 10, 0));
        assert_ne!(order(100, 10, 0), order(100, 10, 1));
        assert_ne!(order(100, 100, 0)[0], (0..100).collect::<Vec<i32>>());
    }

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
        let batch = |values: [f32; 2]| {
            let column = Tensor::from_data(TensorData::new(values.to_vec(), [2, 1]), &Device::flex());
            ValueBatch::new(column.clone(), column.mul_scalar(10.0))
        };
        let union = batch([1.0, 2.0]).union(Some(&batch([3.0, 4.0])));
        assert_eq!(union.rows(), 4);
        let read = |tensor: Tensor<2>| tensor.into_data().try_into_vec::<f32>().unwrap();
        assert_eq!(read(union.obs.val()), [1.0, 2.0, 3.0, 4.0]);
        assert_eq!(read(union.returns.val()), [10.0, 20.0, 30.0, 40.0]);
        assert_eq!(batch([1.0, 2.0]).union(None).rows(), 2);
    }
}
