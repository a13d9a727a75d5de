//! Gradients on CPUs, without a graph of tensors: a minibatch goes forwards, through the loss and back in buffers
//! that the next one uses again.

use burn::optim::GradientsParams;
use burn::tensor::Tensor;

use super::batch::{PolicyBatch, ValueBatch};
use super::descent::{Distance, PolicyProblem, Problem};
use super::gaussian::Gaussian;
use super::loss::Objective;
use super::minibatch::ranges;
use crate::cpu;
use crate::error::Result;
use crate::nn::kernels::{Level, MlpPass};
use crate::nn::{GaussianPolicy, Mlp, read};

/// Distances are measured on about this many rows at a time, so that they need no larger buffers than a minibatch.
const PROBE_PIECE: usize = 2048;

/// The policy's problem.
pub(super) struct FusedPolicy<'a> {
    objective: Objective,
    batch: &'a PolicyBatch<'a>,
    /// The rows that distances are measured on.
    probe: Vec<i32>,
    old_log_std: Vec<f32>,
    pass: MlpPass,
    mean_gradient: Vec<f32>,
    log_std_gradient: Vec<f32>,
}

impl<'a> FusedPolicy<'a> {
    /// The problem of moving on from `old`, which collected the batch; `probe` names the rows that distances are
    /// measured on.
    pub fn new(
        objective: Objective,
        old: &GaussianPolicy,
        batch: &'a PolicyBatch<'a>,
        probe: Vec<i32>,
    ) -> Result<Self> {
        let old_log_std = read(old.log_std.val())?;
        Ok(Self {
            objective,
            batch,
            probe,
            pass: MlpPass::new(Level::best(), old.mean.sizes()),
            mean_gradient: Vec::new(),
            log_std_gradient: vec![0.0; old_log_std.len()],
            old_log_std,
        })
    }

    fn gaussian(&self, policy: &GaussianPolicy) -> Result<Gaussian> {
        Ok(Gaussian::new(&read(policy.log_std.val())?, &self.old_log_std))
    }
}

impl Problem<GaussianPolicy> for FusedPolicy<'_> {
    fn rows(&self) -> usize {
        self.batch.rows()
    }

    fn gradients(
        &mut self,
        policy: &GaussianPolicy,
        minibatch: Vec<i32>,
    ) -> Result<(Tensor<1>, GradientsParams)> {
        let (parameters, gaussian) = (policy.mean.parameters()?, self.gaussian(policy)?);
        let means = self.pass.forward(&parameters, self.batch.obs, &minibatch);
        self.mean_gradient.resize(means.len(), 0.0);
        let loss = gaussian.loss(
            &self.objective,
            self.batch,
            &minibatch,
            means,
            &mut self.mean_gradient,
            &mut self.log_std_gradient,
        );
        let gradient = self.pass.backward(&parameters, &self.mean_gradient);
        let mut gradients = GradientsParams::new();
        policy.mean.register_gradient(gradient, &mut gradients);
        gradients.register(policy.log_std.id, vector(&self.log_std_gradient));
        Ok((vector(&[loss as f32]), gradients))
    }
}

impl PolicyProblem for FusedPolicy<'_> {
    fn distance(&mut self, policy: &GaussianPolicy) -> Result<Distance> {
        let (parameters, gaussian) = (policy.mean.parameters()?, self.gaussian(policy)?);
        let (mut kl, mut clipped) = (0.0, 0);
        for range in ranges(self.probe.len(), PROBE_PIECE) {
            let rows = &self.probe[range];
            let means = self.pass.forward(&parameters, self.batch.obs, rows);
            kl += gaussian.kl_sum(self.batch, rows, means);
            clipped += gaussian.clipped(self.batch, rows, means, self.objective.clip_range);
        }
        let count = self.probe.len() as f64;
        Ok(Distance { kl: kl / count, clip_fraction: clipped as f64 / count })
    }
}

/// The value net's problem.
pub(super) struct FusedValue<'a> {
    batch: &'a ValueBatch,
    pass: MlpPass,
    out_gradient: Vec<f32>,
}

impl<'a> FusedValue<'a> {
    /// The problem of predicting the returns of a batch with a net of these sizes.
    pub fn new(batch: &'a ValueBatch, sizes: Vec<usize>) -> Self {
        Self { batch, pass: MlpPass::new(Level::best(), sizes), out_gradient: Vec::new() }
    }
}

impl Problem<Mlp> for FusedValue<'_> {
    fn rows(&self) -> usize {
        self.batch.rows()
    }

    fn gradients(&mut self, value: &Mlp, minibatch: Vec<i32>) -> Result<(Tensor<1>, GradientsParams)> {
        let parameters = value.parameters()?;
        let values = self.pass.forward(&parameters, &self.batch.obs, &minibatch);
        let count = minibatch.len() as f32;
        self.out_gradient.clear();
        let mut squares = 0.0;
        for (value, index) in values.iter().zip(&minibatch) {
            let error = value - self.batch.returns[*index as usize];
            squares += error * error;
            self.out_gradient.push(2.0 * error / count);
        }
        let mut gradients = GradientsParams::new();
        let gradient = self.pass.backward(&parameters, &self.out_gradient);
        value.register_gradient(gradient, &mut gradients);
        Ok((vector(&[squares / count]), gradients))
    }
}

fn vector(values: &[f32]) -> Tensor<1> {
    Tensor::from_data(values, &cpu())
}

#[cfg(test)]
mod tests {
    use burn::tensor::Device;
    use dappo_sim::rng::{Purpose, Stream};

    use super::super::composed::{ComposedPolicy, ComposedValue};
    use super::*;
    use crate::nn::{ActorCritic, fused_adam, scalar};

    const ROWS: usize = 700;
    const OBS: usize = 11;
    const ACTIONS: usize = 3;
    /// A KL divergence far above 2 d*, so that the hinge takes part.
    const OBJECTIVE: Objective = Objective { clip_range: 0.2, kl_coef: 1.7, kl_target: 0.01, kl_hinge: 50.0 };

    fn normals(count: usize, scale: f32, seed: u64) -> Vec<f32> {
        let mut stream = Stream::new(seed, 0, Purpose::Weights);
        (0..count).map(|_| scale * stream.normal() as f32).collect()
    }

    fn networks() -> ActorCritic {
        let mut stream = Stream::new(2, 0, Purpose::Weights);
        let device = Device::flex().autodiff();
        let mut networks = ActorCritic::new(OBS, &[20, 30], ACTIONS, -0.5, &mut || stream.normal(), &device);
        // The last layer of a new policy is small; a policy that has learned differs between observations.
        let last = networks.policy.mean.layers.len() - 1;
        let layer = &mut networks.policy.mean.layers[last];
        layer.weight = layer.weight.clone().map(|weight| weight.mul_scalar(30.0).detach().require_grad());
        networks
    }

    /// The gradients of a net's parameters, laid out like these.
    fn flat(net: &Mlp, gradients: &GradientsParams) -> Vec<f32> {
        let mut flat = Vec::new();
        for layer in &net.layers {
            flat.extend(read(gradients.get::<2>(layer.weight.id).unwrap()).unwrap());
            flat.extend(read(gradients.get::<1>(layer.bias.as_ref().unwrap().id).unwrap()).unwrap());
        }
        flat
    }

    fn assert_near(got: &[f32], expected: &[f32]) {
        let scale = expected.iter().fold(0.0_f32, |scale, x| scale.max(x.abs()));
        for (got, expected) in got.iter().zip(expected) {
            assert!((got - expected).abs() <= 2e-5 * scale, "{got}, expected {expected} of at most {scale}");
        }
    }

    fn minibatch() -> Vec<i32> {
        (0..ROWS as i32).rev().step_by(2).collect()
    }

    #[test]
    fn loss_gradients_and_distance_of_the_policy_equal_those_of_autodiff() {
        let obs = normals(ROWS * OBS, 1.0, 3);
        let means = normals(ROWS * ACTIONS, 0.4, 4);
        let noise = normals(ROWS * ACTIONS, 0.6, 5);
        let actions: Vec<f32> = means.iter().zip(noise).map(|(mean, z)| mean + z).collect();
        let log_probs: Vec<f32> = normals(ROWS, 1.0, 6).iter().map(|x| x - 2.5).collect();
        let advantages = normals(ROWS, 1.0, 7);
        let batch =
            PolicyBatch { obs: &obs, actions: &actions, means: &means, log_probs: &log_probs, advantages };
        let probe: Vec<i32> = (0..ROWS as i32).step_by(3).collect();
        let old = networks().policy;
        let mut fused = FusedPolicy::new(OBJECTIVE, &old, &batch, probe.clone()).unwrap();
        let mut composed = ComposedPolicy::new(OBJECTIVE, &old, &batch, probe);
        // Another policy than the old one, in its standard deviations too.
        let (_, gradients) = composed.gradients(&old, minibatch()).unwrap();
        let policy = fused_adam(1e-5).step(0.1, old.clone(), gradients);

        let (loss, gradients) = fused.gradients(&policy, minibatch()).unwrap();
        let (expected_loss, expected) = composed.gradients(&policy, minibatch()).unwrap();
        let (loss, expected_loss) = (scalar(loss).unwrap(), scalar(expected_loss).unwrap());
        assert!((loss - expected_loss).abs() < 1e-5 * expected_loss.abs(), "{loss}, {expected_loss}");
        assert_near(&flat(&policy.mean, &gradients), &flat(&policy.mean, &expected));
        let of_log_std =
            |gradients: &GradientsParams| read(gradients.get::<1>(policy.log_std.id).unwrap()).unwrap();
        assert_near(&of_log_std(&gradients), &of_log_std(&expected));
        let Distance { kl, clip_fraction } = fused.distance(&policy).unwrap();
        let expected = composed.distance(&policy).unwrap();
        assert!((kl - expected.kl).abs() < 1e-5 * kl && kl > 0.1, "{kl}, expected {}", expected.kl);
        assert!((clip_fraction - expected.clip_fraction).abs() < 1e-6);
        assert!((0.2..0.95).contains(&clip_fraction), "both sides of the clip range: {clip_fraction}");
    }

    #[test]
    fn loss_and_gradients_of_the_value_net_equal_those_of_autodiff() {
        let value = networks().value;
        let batch = ValueBatch { obs: normals(ROWS * OBS, 1.0, 3), returns: normals(ROWS, 2.0, 4) };
        let mut fused = FusedValue::new(&batch, value.sizes());
        let mut composed = ComposedValue::new(&batch, &value.device());
        let (loss, gradients) = fused.gradients(&value, minibatch()).unwrap();
        let (expected_loss, expected) = composed.gradients(&value, minibatch()).unwrap();
        let (loss, expected_loss) = (scalar(loss).unwrap(), scalar(expected_loss).unwrap());
        assert!((loss - expected_loss).abs() < 1e-5 * expected_loss, "{loss}, expected {expected_loss}");
        assert_near(&flat(&value, &gradients), &flat(&value, &expected));
    }
}
