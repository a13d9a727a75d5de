//! One update of the policy and the value net from one rollout.

use burn::tensor::Device;
use dappo_sim::rng::{Purpose, Stream};

use super::Ppo;
use super::loss::{PpoLosses, entropy};
use super::minibatch::{PolicyBatch, ValueBatch, batches};
use super::policy_update::{PolicyOutcome, PolicyUpdate};
use super::value_update::ValueUpdate;
use crate::error::{LearnError, Result, check_length};
use crate::gae::{Targets, explained_variance};
use crate::rollout::Rollout;

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
        let (policy, value_loss) = self.train(&inner, &policy_batch, &value_batch)?;
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

    /// Trains both networks at the same time: they share nothing but the processor, which one alone does not
    /// keep busy. The outcome is that of one after the other. Inside of rayon's pool each keeps to its thread
    /// while the other is at work, and idle threads take over parts of whatever is left.
    fn train(
        &mut self,
        device: &Device,
        policy_batch: &PolicyBatch,
        value_batch: &ValueBatch,
    ) -> Result<(PolicyOutcome, f64)> {
        let stream = |purpose| Stream::new(self.seed, self.updates, purpose);
        let (shuffle, value_shuffle) = (stream(Purpose::Shuffle), stream(Purpose::ValueShuffle));
        let config = &self.config;
        let policy_update = PolicyUpdate {
            config,
            adaptation: self.adaptation,
            device,
            policy: &mut self.actor_critic.policy,
            optimizer: &mut self.policy_optimizer,
        };
        let value_update = ValueUpdate {
            config,
            device,
            value: &mut self.actor_critic.value,
            optimizer: &mut self.value_optimizer,
        };
        let previous = self.previous.as_ref();
        let (policy, value_loss) = rayon::join(
            move || policy_update.run(policy_batch, shuffle),
            move || value_update.run(value_batch, previous, value_shuffle),
        );
        Ok((policy?, value_loss?))
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
}
