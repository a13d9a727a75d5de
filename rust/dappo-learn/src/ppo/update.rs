//! One update of the policy and the value net from one rollout.

use std::borrow::Cow;

use dappo_nn::error::check_length;
use dappo_nn::minibatch::evenly_spaced;
use dappo_nn::{Gradients, Mlp, NnError, unprivileged};
use dappo_sim::rng::{Purpose, Stream};

use super::batch::{PolicyBatch, ValueBatch};
use super::descent::{Descent, PolicyOutcome, PolicyProblem, Problem};
use super::loss::{Objective, PpoLosses, entropy};
use super::recorded::{RecordedPolicy, RecordedValue};
use super::written::{WrittenPolicy, WrittenValue};
use super::{Ppo, PpoConfig};
use crate::error::{LearnError, Result};
use crate::gae::{Targets, explained_variance};
use crate::rollout::Rollout;

/// Rows that the KL divergence is measured on after an epoch, at most: a pass over a batch of 32 thousand takes a
/// fifth of an update, and this many give the divergence to a few percent, where a factor of two decides.
const PROBE_ROWS: usize = 4096;

impl Ppo {
    /// Trains both networks on a rollout, adapts β and the learning rate, and shows the rollout's
    /// observations to the normaliser.
    ///
    /// The policy makes at most `epochs` passes and stops early once KL > `kl_stop` · d*; the value net is
    /// trained on this batch and the previous one. `done` is the share of the run's budget that is spent, for the
    /// schedule of the learning rates. The outcome is a function of the learner and the arguments alone.
    pub fn update(&mut self, rollout: &Rollout, targets: &Targets, done: f64) -> Result<PpoLosses> {
        self.check(rollout, targets)?;
        let value_batch = ValueBatch::new(rollout, targets)?;
        let schedule = self.config.schedule.factor(done);
        let privileged = self.actor_critic.privileged();
        // The rows of the value net hold the hidden states of a recurrent policy, too.
        let all = match rollout.state.units() {
            0 => Cow::Borrowed(&value_batch.obs),
            _ => Cow::Owned(rollout.transform.apply(&rollout.obs)?),
        };
        let seen = unprivileged(&all, &rollout.transform, rollout.transform.obs_dim() - privileged);
        let (policy, value_loss) =
            self.train(&PolicyBatch::new(rollout, &seen, targets), &value_batch, schedule)?;
        drop(seen);
        drop(all);
        self.previous = Some(value_batch);
        self.adaptation = self.adaptation.after(policy.kl, self.config.kl_target, self.config.max_lr_factor);
        match &self.mirror {
            None => self.normalizer.update(&rollout.obs)?,
            Some(mirror) => self.normalizer.update_mirrored(&rollout.obs, &mirror.obs)?,
        }
        self.updates += 1;
        Ok(PpoLosses {
            policy_loss: policy.loss,
            value_loss,
            kl: policy.kl,
            kl_coef: self.adaptation.kl_coef,
            learning_rate: schedule * self.policy_learning_rate(),
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
        policy_batch: &PolicyBatch,
        value_batch: &ValueBatch,
        schedule: f64,
    ) -> Result<(PolicyOutcome, f64)> {
        let stream = |purpose| Stream::new(self.seed, self.updates, purpose);
        let (shuffle, value_shuffle) = (stream(Purpose::Shuffle), stream(Purpose::ValueShuffle));
        let (objective, mirror) = (self.objective(), self.mirror.as_ref());
        let policy = Descent {
            learning_rate: schedule * self.policy_learning_rate(),
            net: &mut self.actor_critic.policy,
            optimizer: &mut self.policy_optimizer,
        };
        let value = Descent {
            learning_rate: schedule * self.config.value_learning_rate,
            net: &mut self.actor_critic.value,
            optimizer: &mut self.value_optimizer,
        };
        let (config, previous, device) = (&self.config, self.previous.as_ref(), &self.device);
        let gradients = config.gradients();
        let (policy, value_loss) = rayon::join(
            move || {
                let (batch, probe) = (policy_batch, probe(policy_batch));
                let symmetry = mirror.map(|mirror| &mirror.policy);
                let mut problem: Box<dyn PolicyProblem> = match gradients {
                    Gradients::Written => {
                        Box::new(WrittenPolicy::new(objective, policy.net, symmetry, batch, probe)?)
                    }
                    Gradients::Recorded => {
                        Box::new(RecordedPolicy::new(objective, policy.net, symmetry, batch, probe))
                    }
                };
                policy.run(problem.as_mut(), config, shuffle)
            },
            move || {
                let symmetry = mirror.map(|mirror| &mirror.value);
                let mut problem: Box<dyn Problem<Mlp>> = match gradients {
                    Gradients::Written => {
                        Box::new(WrittenValue::new(value.net, symmetry, value_batch, previous))
                    }
                    Gradients::Recorded => {
                        Box::new(RecordedValue::new(symmetry, &value_batch.union(previous), device))
                    }
                };
                value.run(problem.as_mut(), config, value_shuffle)
            },
        );
        Ok((policy?, value_loss?))
    }

    fn objective(&self) -> Objective {
        let PpoConfig { clip_range, kl_target, kl_hinge, .. } = self.config;
        Objective { clip_range, kl_coef: self.adaptation.kl_coef, kl_target, kl_hinge }
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
            ("units of the rollout's states", rollout.state.units(), self.actor_critic.memory()),
        ] {
            if got != expected {
                return Err(NnError::Length { what: key, got, expected }.into());
            }
        }
        if rollout.is_empty() {
            let expected = "at least one transition";
            return Err(LearnError::Config { key: "rollout", got: "empty".into(), expected });
        }
        Ok(())
    }
}

/// The samples that the KL divergence is measured on.
fn probe(batch: &PolicyBatch) -> Vec<i32> {
    let steps = batch.steps();
    evenly_spaced(batch.rows() / steps, PROBE_ROWS.div_ceil(steps))
}
