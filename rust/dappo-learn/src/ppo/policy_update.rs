//! The policy's part of an update.

use burn::module::Module;
use burn::optim::{GradientsParams, ModuleOptimizer};
use burn::tensor::{Device, Tensor};
use dappo_sim::rng::Stream;

use super::PpoConfig;
use super::loss::{Adaptation, kl_divergence, kl_penalty, log_prob, surrogate};
use super::minibatch::{PolicyBatch, evenly_spaced, shuffled};
use crate::error::{Result, check_finite};
use crate::nn::{GaussianPolicy, scalar};

/// Rows that the KL divergence is measured on after an epoch, at most: a pass over a batch of 32 thousand takes
/// a fifth of an update, and this many tell the divergence to about one percent.
const EVALUATION_ROWS: usize = 8192;

/// The policy and what trains it.
pub(super) struct PolicyUpdate<'a> {
    pub config: &'a PpoConfig,
    pub adaptation: Adaptation,
    /// The device without autodiff.
    pub device: &'a Device,
    pub policy: &'a mut GaussianPolicy,
    pub optimizer: &'a mut ModuleOptimizer,
}

/// What the policy's part of an update measured.
pub(super) struct PolicyOutcome {
    pub loss: f64,
    pub kl: f64,
    pub clip_fraction: f64,
    pub epochs_run: usize,
}

impl PolicyUpdate<'_> {
    /// At most `epochs` passes over the batch, fewer once KL > `kl_stop` · d*.
    pub fn run(mut self, batch: &PolicyBatch, mut stream: Stream) -> Result<PolicyOutcome> {
        let old_log_std = self.policy.valid().log_std.val();
        let probe = batch.select(&evenly_spaced(batch.rows(), EVALUATION_ROWS, self.device));
        let mut outcome = PolicyOutcome { loss: 0.0, kl: 0.0, clip_fraction: 0.0, epochs_run: 0 };
        for epoch in 1..=self.config.epochs {
            let minibatches = shuffled(batch.rows(), self.config.minibatch_size, &mut stream, self.device);
            let count = minibatches.len() as f64;
            let mut sum = Tensor::<1>::zeros([1], self.device);
            for rows in minibatches {
                sum = sum + self.step(&batch.select(&rows), old_log_std.clone());
            }
            let (kl, clip_fraction) = self.evaluate(&probe, old_log_std.clone())?;
            let loss = check_finite(format!("policy loss of epoch {epoch}"), scalar(sum)? / count)?;
            check_finite(format!("KL divergence after epoch {epoch}"), kl)?;
            outcome = PolicyOutcome { loss, kl, clip_fraction, epochs_run: epoch };
            if kl > self.config.kl_stop * self.config.kl_target {
                break;
            }
        }
        Ok(outcome)
    }

    /// One gradient step of the policy; returns the loss before it.
    fn step(&mut self, batch: &PolicyBatch, old_log_std: Tensor<1>) -> Tensor<1> {
        let config = &self.config;
        let policy = &*self.policy;
        let (mean, log_std) = (policy.mean.forward(batch.obs.clone()), policy.log_std.val());
        let log_prob = log_prob(batch.actions.clone(), mean.clone(), log_std.clone());
        let ratio = (log_prob - batch.log_probs.clone()).exp();
        let kl = kl_divergence(batch.means.clone(), old_log_std, mean, log_std);
        let penalty = kl_penalty(kl, self.adaptation.kl_coef, config.kl_target, config.kl_hinge);
        let loss = penalty - surrogate(ratio, batch.advantages.clone(), config.clip_range);
        let gradients = GradientsParams::from_grads(loss.backward(), policy);
        let learning_rate = config.learning_rate * self.adaptation.lr_factor;
        *self.policy = self.optimizer.step(learning_rate, policy.clone(), gradients);
        loss.without_autodiff()
    }

    /// KL(old ‖ current) and the share of clipped ratios.
    fn evaluate(&self, batch: &PolicyBatch, old_log_std: Tensor<1>) -> Result<(f64, f64)> {
        let policy = self.policy.valid();
        let (mean, log_std) = (policy.mean.forward(batch.obs.clone()), policy.log_std.val());
        let log_prob = log_prob(batch.actions.clone(), mean.clone(), log_std.clone());
        let ratio = (log_prob - batch.log_probs.clone()).exp();
        let outside = ratio.sub_scalar(1.0).abs().greater_elem(self.config.clip_range);
        let kl = kl_divergence(batch.means.clone(), old_log_std, mean, log_std);
        Ok((scalar(kl)?, scalar(outside.float().mean())?))
    }
}
