//! One update of the policy and the value net from one rollout.

use burn::module::Module;
use burn::optim::GradientsParams;
use burn::tensor::Tensor;
use dappo_sim::rng::{Purpose, Stream};

use super::Ppo;
use super::loss::{PpoLosses, entropy, kl_divergence, kl_penalty, log_prob, surrogate};
use super::minibatch::{PolicyBatch, ValueBatch, batches, ranges, shuffled};
use crate::error::{LearnError, Result, check_finite, check_length};
use crate::gae::{Targets, explained_variance};
use crate::nn::actor_critic::read;
use crate::rollout::Rollout;

/// Rows that are evaluated at a time when no gradient is needed; bounds the memory of other devices.
const EVALUATION_ROWS: usize = 65_536;

/// What the policy's part of an update measured.
struct PolicyOutcome {
    loss: f64,
    kl: f64,
    clip_fraction: f64,
    epochs_run: usize,
}

impl Ppo {
    /// Trains both networks on a rollout, adapts β and the learning rate, and shows the rollout's
    /// observations to the normaliser.
    ///
    /// The policy makes at most `epochs` passes and stops early once KL > `kl_stop` · d*; the value net is
    /// trained on this batch and the previous one. The outcome is a function of the learner, the rollout
    /// and the targets alone.
    pub fn update(&mut self, rollout: &Rollout, targets: &Targets) -> Result<PpoLosses> {
        self.check(rollout, targets)?;
        let inner = self.device.clone().without_autodiff();
        let (policy_batch, value_batch) = batches(rollout, targets, &inner)?;
        let mut stream = Stream::new(self.seed, self.updates, Purpose::Shuffle);
        let policy = self.update_policy(&policy_batch, &mut stream)?;
        let value_loss = self.update_value(&value_batch, &mut stream)?;
        self.previous = Some(value_batch);
        self.adaptation = self.adaptation.after(policy.kl, self.config.kl_target, self.config.max_lr_factor);
        self.normalizer.update(&rollout.obs)?;
        self.updates += 1;
        Ok(PpoLosses {
            policy_loss: policy.loss,
            value_loss,
            kl: policy.kl,
            kl_coef: self.adaptation.kl_coef,
            learning_rate: self.policy_learning_rate(),
            entropy: entropy(&self.actor_critic.log_std()?),
            explained_variance: explained_variance(&rollout.values, &targets.returns),
            clip_fraction: policy.clip_fraction,
            epochs_run: policy.epochs_run,
        })
    }

    fn policy_learning_rate(&self) -> f64 {
        self.config.learning_rate * self.adaptation.lr_factor
    }

    fn check(&self, rollout: &Rollout, targets: &Targets) -> Result<()> {
        rollout.check()?;
        check_length("advantages [T, N]", &targets.advantages, rollout.len())?;
        check_length("returns [T, N]", &targets.returns, rollout.len())?;
        for (key, got, expected) in [
            ("obs_dim of the rollout", rollout.obs_dim, self.actor_critic.obs_dim()),
            ("action_dim of the rollout", rollout.action_dim, self.actor_critic.action_dim()),
        ] {
            if got != expected {
                return Err(LearnError::Length { what: key, got, expected });
            }
        }
        if rollout.is_empty() {
            let expected = "at least one transition";
            return Err(LearnError::Config { key: "rollout", got: "empty".into(), expected });
        }
        Ok(())
    }

    fn update_policy(&mut self, batch: &PolicyBatch, stream: &mut Stream) -> Result<PolicyOutcome> {
        let old_log_std = self.actor_critic.policy.valid().log_std.val();
        let inner = self.device.clone().without_autodiff();
        let mut outcome = PolicyOutcome { loss: 0.0, kl: 0.0, clip_fraction: 0.0, epochs_run: 0 };
        for epoch in 1..=self.config.epochs {
            let minibatches = shuffled(batch.rows(), self.config.minibatch_size, stream, &inner);
            let count = minibatches.len() as f64;
            let mut sum = Tensor::<1>::zeros([1], &inner);
            for rows in minibatches {
                sum = sum + self.policy_step(&batch.select(&rows), old_log_std.clone());
            }
            let (kl, clip_fraction) = self.evaluate_policy(batch, &old_log_std)?;
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
    fn policy_step(&mut self, batch: &PolicyBatch, old_log_std: Tensor<1>) -> Tensor<1> {
        let config = &self.config;
        let policy = &self.actor_critic.policy;
        let (mean, log_std) = (policy.mean.forward(batch.obs.clone()), policy.log_std.val());
        let log_prob = log_prob(batch.actions.clone(), mean.clone(), log_std.clone());
        let ratio = (log_prob - batch.log_probs.clone()).exp();
        let kl = kl_divergence(batch.means.clone(), old_log_std, mean, log_std);
        let penalty = kl_penalty(kl, self.adaptation.kl_coef, config.kl_target, config.kl_hinge);
        let loss = penalty - surrogate(ratio, batch.advantages.clone(), config.clip_range);
        let gradients = GradientsParams::from_grads(loss.backward(), policy);
        let learning_rate = self.policy_learning_rate();
        self.actor_critic.policy = self.policy_optimizer.step(learning_rate, policy.clone(), gradients);
        loss.without_autodiff()
    }

    /// KL(old ‖ current) and the share of clipped ratios, over the whole batch.
    fn evaluate_policy(&self, batch: &PolicyBatch, old_log_std: &Tensor<1>) -> Result<(f64, f64)> {
        let policy = self.actor_critic.policy.valid();
        let log_std = policy.log_std.val();
        let (mut kl, mut clipped) = (0.0, 0.0);
        for rows in ranges(batch.rows(), EVALUATION_ROWS) {
            let part = |tensor: &Tensor<2>| tensor.clone().slice([rows.clone()]);
            let mean = policy.mean.forward(part(&batch.obs));
            let log_prob = log_prob(part(&batch.actions), mean.clone(), log_std.clone());
            let ratio = (log_prob - part(&batch.log_probs)).exp();
            let outside = ratio.sub_scalar(1.0).abs().greater_elem(self.config.clip_range);
            let divergence = kl_divergence(part(&batch.means), old_log_std.clone(), mean, log_std.clone());
            kl += scalar(divergence)? * rows.len() as f64;
            clipped += scalar(outside.float().sum())?;
        }
        let count = batch.rows() as f64;
        Ok((kl / count, clipped / count))
    }

    fn update_value(&mut self, current: &ValueBatch, stream: &mut Stream) -> Result<f64> {
        let inner = self.device.clone().without_autodiff();
        let batch = current.union(self.previous.as_ref());
        let mut loss = 0.0;
        for epoch in 1..=self.config.value_epochs {
            let minibatches = shuffled(batch.rows(), self.config.value_minibatch_size, stream, &inner);
            let count = minibatches.len() as f64;
            let mut sum = Tensor::<1>::zeros([1], &inner);
            for rows in minibatches {
                let (obs, returns) = batch.select(&rows);
                sum = sum + self.value_step(obs, returns);
            }
            loss = check_finite(format!("value loss of epoch {epoch}"), scalar(sum)? / count)?;
        }
        Ok(loss)
    }

    /// One gradient step of the value net; returns the loss before it.
    fn value_step(&mut self, obs: Tensor<2>, returns: Tensor<2>) -> Tensor<1> {
        let value = &self.actor_critic.value;
        let loss = (value.forward(obs) - returns).square().mean();
        let gradients = GradientsParams::from_grads(loss.backward(), value);
        let learning_rate = self.config.value_learning_rate;
        self.actor_critic.value = self.value_optimizer.step(learning_rate, value.clone(), gradients);
        loss.without_autodiff()
    }
}

fn scalar(tensor: Tensor<1>) -> Result<f64> {
    Ok(read(tensor)?.first().copied().map_or(f64::NAN, f64::from))
}
