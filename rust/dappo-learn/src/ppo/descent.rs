//! Gradient descent on a batch, whatever computes the gradients.

use burn::module::Module;
use burn::optim::{GradientsParams, ModuleOptimizer};
use burn::tensor::Tensor;
use dappo_nn::minibatch::shuffled;
use dappo_nn::{GaussianPolicy, Mlp, scalar};
use dappo_sim::rng::Stream;

use super::PpoConfig;
use crate::error::{Result, check_converging};

/// A batch, and the loss of a network on it.
pub(super) trait Problem<Net> {
    /// Rows of the batch.
    fn rows(&self) -> usize;

    /// Rows of a sample, which stay together: the steps of a sequence for a recurrent network.
    fn steps(&self) -> usize {
        1
    }

    /// The loss of `net` on a minibatch of samples, `[1]`, and its gradients: for a net that is its own mirror image averaged with their
    /// mirror images, so that it stays one.
    fn gradients(&mut self, net: &Net, minibatch: Vec<i32>) -> Result<(Tensor<1>, GradientsParams)>;
}

/// How far a policy has moved from the one that collected the batch.
pub(super) struct Distance {
    /// KL(old ‖ current).
    pub kl: f64,
    /// Share of the rows whose probability ratio lies outside 1 ± ε.
    pub clip_fraction: f64,
}

/// The policy's problem.
pub(super) trait PolicyProblem: Problem<GaussianPolicy> {
    /// Measures the distance of `policy` from the old one.
    fn distance(&mut self, policy: &GaussianPolicy) -> Result<Distance>;
}

/// A network, and what changes it.
pub(super) struct Descent<'a, Net> {
    pub net: &'a mut Net,
    pub optimizer: &'a mut ModuleOptimizer,
    pub learning_rate: f64,
}

impl<Net: Module> Descent<'_, Net> {
    /// One pass over the batch in minibatches of about `size` rows; returns the mean of their losses before each step.
    fn pass(
        &mut self,
        problem: &mut (impl Problem<Net> + ?Sized),
        size: usize,
        stream: &mut Stream,
    ) -> Result<f64> {
        let steps = problem.steps();
        let minibatches = shuffled(problem.rows() / steps, size.div_ceil(steps), stream);
        let count = minibatches.len() as f64;
        let mut sum: Option<Tensor<1>> = None;
        for minibatch in minibatches {
            let (loss, gradients) = problem.gradients(self.net, minibatch)?;
            sum = Some(match sum {
                Some(sum) => sum + loss,
                None => loss,
            });
            *self.net = self.optimizer.step(self.learning_rate, self.net.clone(), gradients);
        }
        Ok(sum.map_or(Ok(0.0), scalar)? / count)
    }
}

/// What the policy's part of an update measured.
pub(super) struct PolicyOutcome {
    pub loss: f64,
    pub kl: f64,
    pub clip_fraction: f64,
    pub epochs_run: usize,
}

impl Descent<'_, GaussianPolicy> {
    /// At most `epochs` passes over the batch, fewer once KL > `kl_stop` · d*.
    pub fn run(
        mut self,
        problem: &mut dyn PolicyProblem,
        config: &PpoConfig,
        mut stream: Stream,
    ) -> Result<PolicyOutcome> {
        let mut outcome = PolicyOutcome { loss: 0.0, kl: 0.0, clip_fraction: 0.0, epochs_run: 0 };
        for epoch in 1..=config.epochs {
            let loss = self.pass(problem, config.minibatch_size, &mut stream)?;
            let Distance { kl, clip_fraction } = problem.distance(self.net)?;
            check_converging(format!("policy loss of epoch {epoch}"), loss, ADVICE)?;
            check_converging(format!("KL divergence after epoch {epoch}"), kl, ADVICE)?;
            outcome = PolicyOutcome { loss, kl, clip_fraction, epochs_run: epoch };
            if kl > config.kl_stop * config.kl_target {
                break;
            }
        }
        check_weights("policy", &self.net.mean)?;
        Ok(outcome)
    }
}

impl Descent<'_, Mlp> {
    /// `value_epochs` passes over the batch; returns the mean loss of the last one.
    pub fn run(
        mut self,
        problem: &mut dyn Problem<Mlp>,
        config: &PpoConfig,
        mut stream: Stream,
    ) -> Result<f64> {
        let mut loss = 0.0;
        for epoch in 1..=config.value_epochs {
            loss = self.pass(problem, config.value_minibatch_size, &mut stream)?;
            check_converging(format!("value loss of epoch {epoch}"), loss, ADVICE)?;
        }
        // The losses are those before each step; the last step shows only here.
        check_weights("value net", self.net)?;
        Ok(loss)
    }
}

/// What to do where a training has diverged; the caller that has the run adds more.
const ADVICE: &str = "train with lower learning rates";

/// Fails unless all weights are finite, so that no checkpoint holds a network that is of no use.
fn check_weights(name: &str, net: &Mlp) -> Result<()> {
    let bad = net.parameters()?.into_iter().find(|weight| !weight.is_finite());
    bad.map_or(Ok(()), |weight| {
        check_converging(format!("weight of the {name}"), f64::from(weight), ADVICE).map(drop)
    })
}
