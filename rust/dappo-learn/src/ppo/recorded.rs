//! Gradients by burn's autodiff: for every device, and to check those of [`super::written`].

use burn::module::Module;
use burn::optim::GradientsParams;
use burn::tensor::{Device, Int, Tensor, TensorData};
use dappo_nn::{GaussianPolicy, Mlp, MlpSymmetry, PolicySymmetry, scalar};

use super::batch::{PolicyBatch, Sequences, ValueBatch};
use super::descent::{Distance, PolicyProblem, Problem};
use super::loss::{Objective, kl_divergence, kl_penalty, log_prob, ratio, surrogate};
use crate::error::Result;

/// How rows follow each other, for a recurrent policy: T steps of N robots.
struct SequenceTensors {
    steps: usize,
    /// What it remembered before the first step, `[N, 2, H]`.
    state: Tensor<3>,
    /// 1 where an episode begins and else 0, `[N, T]`.
    begins: Tensor<2>,
}

impl SequenceTensors {
    fn new(sequences: &Sequences, device: &Device) -> Self {
        let (steps, units) = (sequences.steps, sequences.state.units());
        let robots = sequences.begins.len() / steps;
        let begins = (0..robots).flat_map(|robot| (0..steps).map(move |step| step * robots + robot));
        let begins: Vec<f32> = begins.map(|row| if sequences.begins[row] { 1.0 } else { 0.0 }).collect();
        let state = TensorData::new(sequences.state.numbers().to_vec(), [robots, 2, units]);
        Self { steps, state: Tensor::from_data(state, device), begins: matrix(&begins, robots, device) }
    }

    /// The rows of some robots in a batch `[T, N]`, those of a robot side by side.
    fn rows(&self, robots: &[i32]) -> Vec<i32> {
        let (steps, all) = (self.steps as i32, self.begins.dims()[0] as i32);
        robots.iter().flat_map(|robot| (0..steps).map(move |step| step * all + robot)).collect()
    }

    fn select(&self, robots: &Tensor<1, Int>) -> Self {
        let begins = self.begins.clone().select(0, robots.clone());
        Self { steps: self.steps, state: self.state.clone().select(0, robots.clone()), begins }
    }
}

/// A policy's batch as tensors.
struct Rows {
    sequences: Option<SequenceTensors>,
    obs: Tensor<2>,
    actions: Tensor<2>,
    means: Tensor<2>,
    log_probs: Tensor<2>,
    advantages: Tensor<2>,
}

impl Rows {
    fn new(batch: &PolicyBatch, device: &Device) -> Self {
        let tensor = |values: &[f32]| matrix(values, batch.rows(), device);
        Self {
            sequences: batch.sequences.as_ref().map(|sequences| SequenceTensors::new(sequences, device)),
            obs: tensor(batch.obs),
            actions: tensor(batch.actions),
            means: tensor(batch.means),
            log_probs: tensor(batch.log_probs),
            advantages: tensor(&batch.advantages),
        }
    }

    /// Some samples of the batch: rows, or all steps of robots.
    fn select(&self, samples: Vec<i32>) -> Self {
        let device = self.obs.device();
        let rows = self.sequences.as_ref().map(|sequences| sequences.rows(&samples));
        let samples = indices(samples, &device);
        let rows = rows.map_or_else(|| samples.clone(), |rows| indices(rows, &device));
        let take = |tensor: &Tensor<2>| tensor.clone().select(0, rows.clone());
        Self {
            sequences: self.sequences.as_ref().map(|sequences| sequences.select(&samples)),
            obs: take(&self.obs),
            actions: take(&self.actions),
            means: take(&self.means),
            log_probs: take(&self.log_probs),
            advantages: take(&self.advantages),
        }
    }

    /// The means of a policy's actions in these rows, which those of whole sequences are if it is recurrent.
    fn means(&self, policy: &GaussianPolicy) -> Tensor<2> {
        let (Some(SequenceTensors { steps, state, begins }), Some(memory)) =
            (&self.sequences, &policy.memory)
        else {
            return policy.mean.forward(self.obs.clone());
        };
        let [rows, width] = self.obs.dims();
        let x = self.obs.clone().reshape([rows / steps, *steps, width]);
        let hidden = memory.forward(x, state, begins);
        let hidden = hidden.reshape([rows, memory.units()]);
        policy.mean.forward(Tensor::cat(vec![self.obs.clone(), hidden], 1))
    }
}

/// The policy's problem.
pub(super) struct RecordedPolicy<'a> {
    objective: Objective,
    symmetry: Option<&'a PolicySymmetry>,
    steps: usize,
    old_log_std: Tensor<1>,
    batch: Rows,
    /// The rows that distances are measured on.
    probe: Rows,
}

impl<'a> RecordedPolicy<'a> {
    /// The problem of moving on from `old`, which collected the batch and may be its own mirror image; `probe` lists the samples
    /// that distances are measured on.
    pub fn new(
        objective: Objective,
        old: &GaussianPolicy,
        symmetry: Option<&'a PolicySymmetry>,
        batch: &PolicyBatch,
        probe: Vec<i32>,
    ) -> Self {
        let steps = batch.steps();
        let batch = Rows::new(batch, &old.mean.device().without_autodiff());
        let (old_log_std, probe) = (old.valid().log_std.val(), batch.select(probe));
        Self { objective, symmetry, steps, old_log_std, batch, probe }
    }
}

impl Problem<GaussianPolicy> for RecordedPolicy<'_> {
    fn rows(&self) -> usize {
        self.batch.obs.dims()[0]
    }

    fn steps(&self) -> usize {
        self.steps
    }

    fn gradients(
        &mut self,
        policy: &GaussianPolicy,
        minibatch: Vec<i32>,
    ) -> Result<(Tensor<1>, GradientsParams)> {
        let Objective { clip_range, kl_coef, kl_target, kl_hinge } = self.objective;
        let batch = self.batch.select(minibatch);
        let (mean, log_std) = (batch.means(policy), policy.log_std.val());
        let log_prob = log_prob(batch.actions, mean.clone(), log_std.clone());
        let ratio = ratio(log_prob, batch.log_probs);
        let kl = kl_divergence(batch.means, self.old_log_std.clone(), mean, log_std);
        let penalty = kl_penalty(kl, kl_coef, kl_target, kl_hinge);
        let loss = penalty - surrogate(ratio, batch.advantages, clip_range);
        let mut gradients = GradientsParams::from_grads(loss.backward(), policy);
        if let Some(symmetry) = self.symmetry {
            symmetry.average(policy, &mut gradients)?;
        }
        Ok((loss.without_autodiff(), gradients))
    }
}

impl PolicyProblem for RecordedPolicy<'_> {
    fn distance(&mut self, policy: &GaussianPolicy) -> Result<Distance> {
        let (batch, policy) = (&self.probe, policy.valid());
        let (mean, log_std) = (batch.means(&policy), policy.log_std.val());
        let log_prob = log_prob(batch.actions.clone(), mean.clone(), log_std.clone());
        let ratio = ratio(log_prob, batch.log_probs.clone());
        let outside = ratio.sub_scalar(1.0).abs().greater_elem(self.objective.clip_range);
        let kl = kl_divergence(batch.means.clone(), self.old_log_std.clone(), mean, log_std);
        Ok(Distance { kl: scalar(kl)?, clip_fraction: scalar(outside.float().mean())? })
    }
}

/// The value net's problem.
pub(super) struct RecordedValue<'a> {
    symmetry: Option<&'a MlpSymmetry>,
    device: Device,
    obs: Tensor<2>,
    returns: Tensor<2>,
}

impl<'a> RecordedValue<'a> {
    /// The problem of predicting the returns of a batch on `device`, with a net that may be its own mirror image.
    pub fn new(symmetry: Option<&'a MlpSymmetry>, batch: &ValueBatch, device: &Device) -> Self {
        let device = device.clone().without_autodiff();
        Self {
            symmetry,
            obs: matrix(&batch.obs, batch.rows(), &device),
            returns: matrix(&batch.returns, batch.rows(), &device),
            device,
        }
    }
}

impl Problem<Mlp> for RecordedValue<'_> {
    fn rows(&self) -> usize {
        self.returns.dims()[0]
    }

    fn gradients(&mut self, value: &Mlp, minibatch: Vec<i32>) -> Result<(Tensor<1>, GradientsParams)> {
        let rows = indices(minibatch, &self.device);
        let take = |tensor: &Tensor<2>| tensor.clone().select(0, rows.clone());
        let loss = (value.forward(take(&self.obs)) - take(&self.returns)).square().mean();
        let mut gradients = GradientsParams::from_grads(loss.backward(), value);
        if let Some(symmetry) = self.symmetry {
            symmetry.average(value, &mut gradients)?;
        }
        Ok((loss.without_autodiff(), gradients))
    }
}

/// `values` as `rows` rows.
fn matrix(values: &[f32], rows: usize, device: &Device) -> Tensor<2> {
    Tensor::from_data(TensorData::new(values.to_vec(), [rows, values.len() / rows]), device)
}

fn indices(rows: Vec<i32>, device: &Device) -> Tensor<1, Int> {
    let length = rows.len();
    Tensor::from_data(TensorData::new(rows, [length]), device)
}
