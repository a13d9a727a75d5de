//! Gradients on CPUs, without a graph of tensors: block by block a minibatch goes forwards, through the loss and back.

use burn::optim::GradientsParams;
use burn::tensor::Tensor;
use dappo_nn::kernels::{Inputs, Level, MlpPass};
use dappo_nn::{GaussianPolicy, Mlp, MlpSymmetry, PolicySymmetry, cpu, read};

use super::batch::{PolicyBatch, ValueBatch};
use super::descent::{Distance, PolicyProblem, Problem};
use super::gaussian::{Gaussian, Weights};
use super::loss::Objective;
use crate::error::Result;

/// The policy's problem.
pub(super) struct WrittenPolicy<'a> {
    objective: Objective,
    symmetry: Option<&'a PolicySymmetry>,
    batch: &'a PolicyBatch<'a>,
    /// The rows that distances are measured on.
    probe: Vec<i32>,
    old_log_std: Vec<f32>,
    pass: MlpPass,
}

impl<'a> WrittenPolicy<'a> {
    /// The problem of moving on from `old`, which collected the batch and may be its own mirror image; `probe` lists the rows
    /// that distances are measured on.
    pub fn new(
        objective: Objective,
        old: &GaussianPolicy,
        symmetry: Option<&'a PolicySymmetry>,
        batch: &'a PolicyBatch<'a>,
        probe: Vec<i32>,
    ) -> Result<Self> {
        let old_log_std = read(old.log_std.val())?;
        let pass = pass(&old.mean, symmetry.map(PolicySymmetry::mean));
        Ok(Self { objective, symmetry, batch, probe, old_log_std, pass })
    }

    fn gaussian(&self, policy: &GaussianPolicy) -> Result<Gaussian> {
        Ok(Gaussian::new(&read(policy.log_std.val())?, &self.old_log_std))
    }
}

impl Problem<GaussianPolicy> for WrittenPolicy<'_> {
    fn rows(&self) -> usize {
        self.batch.rows()
    }

    fn gradients(
        &mut self,
        policy: &GaussianPolicy,
        minibatch: Vec<i32>,
    ) -> Result<(Tensor<1>, GradientsParams)> {
        let (parameters, gaussian) = (policy.mean.parameters()?, self.gaussian(policy)?);
        let Self { objective, batch, .. } = *self;
        let count = minibatch.len() as f64;
        let mut pass = |kl_slope: f64| {
            let weights = Weights {
                kl: kl_slope as f32,
                clip_range: objective.clip_range as f32,
                row: 1.0 / minibatch.len() as f32,
            };
            let loss = |rows: &[i32], means: &[f32], gradients: &mut [f32]| {
                gaussian.gradients(weights, batch, rows, means, gradients)
            };
            let (sums, gradient) = self.pass.gradient(&parameters, batch.obs, &minibatch, loss);
            (sums, gradient.to_vec())
        };
        // The gradient depends on the mean KL divergence where that exceeds the hinge, which is known only
        // after all rows. It rarely does: so assume that it does not, and pass again with the known
        // divergence if it did.
        let supposed = objective.kl_slope(0.0);
        let (mut sums, mut gradient) = pass(supposed);
        let kl = sums.iter().map(|sums| sums.kl).sum::<f64>() / count;
        let kl_slope = objective.kl_slope(kl);
        if kl_slope != supposed {
            (sums, gradient) = pass(kl_slope);
        }
        let surrogate = sums.iter().map(|sums| sums.surrogate).sum::<f64>() / count;
        let mut log_std_gradient = vec![0.0; self.old_log_std.len()];
        for sums in &sums {
            log_std_gradient.iter_mut().zip(&sums.log_std_gradient).for_each(|(sum, x)| *sum += x);
        }
        if let Some(symmetry) = self.symmetry {
            log_std_gradient = symmetry.average_log_std(&log_std_gradient);
        }
        let mut gradients = GradientsParams::new();
        policy.mean.register_gradient(&gradient, &mut gradients);
        gradients.register(policy.log_std.id, vector(&log_std_gradient));
        Ok((vector(&[(objective.kl_penalty(kl) - surrogate) as f32]), gradients))
    }
}

impl PolicyProblem for WrittenPolicy<'_> {
    fn distance(&mut self, policy: &GaussianPolicy) -> Result<Distance> {
        let (parameters, gaussian) = (policy.mean.parameters()?, self.gaussian(policy)?);
        let (batch, clip_range) = (self.batch, self.objective.clip_range);
        let sums = self.pass.evaluate(&parameters, batch.obs, &self.probe, |rows, means| {
            (gaussian.kl_sum(batch, rows, means), gaussian.clipped(batch, rows, means, clip_range))
        });
        let count = self.probe.len() as f64;
        let kl = sums.iter().map(|(kl, _)| kl).sum::<f64>() / count;
        let clipped: usize = sums.iter().map(|(_, clipped)| clipped).sum();
        Ok(Distance { kl, clip_fraction: clipped as f64 / count })
    }
}

/// The value net's problem.
pub(super) struct WrittenValue<'a> {
    obs: Inputs<'a>,
    returns: Vec<f32>,
    pass: MlpPass,
}

impl<'a> WrittenValue<'a> {
    /// The problem of predicting the returns of a batch, and of one before it, with `value`, which may be its own mirror
    /// image.
    pub fn new(
        value: &Mlp,
        symmetry: Option<&MlpSymmetry>,
        batch: &'a ValueBatch,
        previous: Option<&'a ValueBatch>,
    ) -> Self {
        let (obs, returns) = previous.map_or((&[][..], &[][..]), |batch| (&batch.obs, &batch.returns));
        Self {
            obs: Inputs::of_two(&batch.obs, obs),
            returns: [&batch.returns, returns].concat(),
            pass: pass(value, symmetry),
        }
    }
}

impl Problem<Mlp> for WrittenValue<'_> {
    fn rows(&self) -> usize {
        self.returns.len()
    }

    fn gradients(&mut self, value: &Mlp, minibatch: Vec<i32>) -> Result<(Tensor<1>, GradientsParams)> {
        let (returns, count) = (&self.returns, minibatch.len() as f32);
        let loss = |rows: &[i32], values: &[f32], gradients: &mut [f32]| {
            let mut squares = 0.0;
            for ((index, value), gradient) in rows.iter().zip(values).zip(gradients) {
                let error = value - returns[*index as usize];
                squares += f64::from(error * error);
                *gradient = 2.0 * error / count;
            }
            squares
        };
        let (squares, gradient) = self.pass.gradient(&value.parameters()?, self.obs, &minibatch, loss);
        let mut gradients = GradientsParams::new();
        value.register_gradient(gradient, &mut gradients);
        Ok((vector(&[squares.iter().sum::<f64>() as f32 / count]), gradients))
    }
}

/// Passes through a net and back.
fn pass(net: &Mlp, symmetry: Option<&MlpSymmetry>) -> MlpPass {
    match symmetry {
        None => MlpPass::new(Level::chosen(), net.sizes()),
        Some(symmetry) => MlpPass::mirrored(Level::chosen(), symmetry.levels()),
    }
}

fn vector(values: &[f32]) -> Tensor<1> {
    Tensor::from_data(values, &cpu())
}

#[cfg(test)]
mod tests {
    use burn::tensor::Device;
    use dappo_sim::rng::{Purpose, Stream};
    use dappo_sim::task::{Image, Reflection};

    use super::super::recorded::{RecordedPolicy, RecordedValue};
    use super::*;
    use dappo_nn::{ActorCritic, Gradients, adam, scalar};

    const ROWS: usize = 700;
    const OBS: usize = 11;
    const ACTIONS: usize = 3;
    const HIDDEN: [usize; 2] = [20, 30];
    /// A KL divergence far above 2 d*, so that the hinge takes part.
    const OBJECTIVE: Objective = Objective { clip_range: 0.2, kl_coef: 1.7, kl_target: 0.01, kl_hinge: 50.0 };

    fn normals(count: usize, scale: f32, seed: u64) -> Vec<f32> {
        let mut stream = Stream::new(seed, 0, Purpose::Weights);
        (0..count).map(|_| scale * stream.normal() as f32).collect()
    }

    fn networks() -> ActorCritic {
        let mut stream = Stream::new(2, 0, Purpose::Weights);
        let device = Device::flex().autodiff();
        let mut networks = ActorCritic::new(OBS, 0, &HIDDEN, ACTIONS, -0.5, &mut || stream.normal(), &device);
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

    /// Neighbours take each other's place with a sign of their own, and the last entry changes its sign.
    fn reflection(length: usize) -> Reflection {
        let image = |entry: usize| match entry {
            last if last + 1 == length => Image { of: last, sign: -1.0 },
            entry => Image { of: entry ^ 1, sign: if entry % 4 < 2 { -1.0 } else { 1.0 } },
        };
        Reflection::new((0..length).map(image).collect())
    }

    fn minibatch() -> Vec<i32> {
        (0..ROWS as i32).rev().step_by(2).collect()
    }

    #[test]
    fn loss_gradients_and_distance_of_the_policy_equal_those_of_autodiff() {
        let log_probs: Vec<f32> = normals(ROWS, 1.0, 6).iter().map(|x| x - 2.5).collect();
        assert_equal_to_autodiff(&log_probs, false);
    }

    #[test]
    fn so_they_do_for_networks_that_are_their_own_mirror_images() {
        let log_probs: Vec<f32> = normals(ROWS, 1.0, 6).iter().map(|x| x - 2.5).collect();
        assert_equal_to_autodiff(&log_probs, true);
    }

    #[test]
    fn they_are_finite_and_equal_where_ratios_are_bounded() {
        let old = |(row, x): (usize, &f32)| x - if row % 5 == 0 { 300.0 } else { 2.5 };
        let log_probs: Vec<f32> = normals(ROWS, 1.0, 6).iter().enumerate().map(old).collect();
        assert_equal_to_autodiff(&log_probs, false);
    }

    fn imposed(net: &Mlp, symmetry: &MlpSymmetry) -> Mlp {
        let mut parameters = net.parameters().unwrap();
        symmetry.impose(&mut parameters);
        net.clone().with_parameters(&parameters)
    }

    fn assert_equal_to_autodiff(log_probs: &[f32], is_mirrored: bool) {
        let obs = normals(ROWS * OBS, 1.0, 3);
        let means = normals(ROWS * ACTIONS, 0.4, 4);
        let noise = normals(ROWS * ACTIONS, 0.6, 5);
        let actions: Vec<f32> = means.iter().zip(noise).map(|(mean, z)| mean + z).collect();
        let advantages = normals(ROWS, 1.0, 7);
        let batch = PolicyBatch { obs: &obs, actions: &actions, means: &means, log_probs, advantages };
        let probe: Vec<i32> = (0..ROWS as i32).step_by(3).collect();
        let mut old = networks().policy;
        let symmetry = PolicySymmetry::new(reflection(OBS), &HIDDEN, reflection(ACTIONS));
        let symmetry = is_mirrored.then_some(&symmetry);
        if let Some(symmetry) = symmetry {
            old.mean = imposed(&old.mean, symmetry.mean());
        }
        let mut written = WrittenPolicy::new(OBJECTIVE, &old, symmetry, &batch, probe.clone()).unwrap();
        let mut recorded = RecordedPolicy::new(OBJECTIVE, &old, symmetry, &batch, probe);
        // Another policy than the old one, in its standard deviations too.
        let (_, gradients) = recorded.gradients(&old, minibatch()).unwrap();
        let policy = adam(1e-5, Gradients::Written).step(0.1, old.clone(), gradients);

        let (loss, gradients) = written.gradients(&policy, minibatch()).unwrap();
        let (expected_loss, expected) = recorded.gradients(&policy, minibatch()).unwrap();
        let (loss, expected_loss) = (scalar(loss).unwrap(), scalar(expected_loss).unwrap());
        assert!(
            loss.is_finite() && (loss - expected_loss).abs() < 1e-5 * expected_loss.abs(),
            "{loss}, {expected_loss}"
        );
        assert_near(&flat(&policy.mean, &gradients), &flat(&policy.mean, &expected));
        let of_log_std =
            |gradients: &GradientsParams| read(gradients.get::<1>(policy.log_std.id).unwrap()).unwrap();
        assert_near(&of_log_std(&gradients), &of_log_std(&expected));
        let Distance { kl, clip_fraction } = written.distance(&policy).unwrap();
        let expected = recorded.distance(&policy).unwrap();
        assert!((kl - expected.kl).abs() < 1e-5 * kl && kl > 0.1, "{kl}, expected {}", expected.kl);
        assert!((clip_fraction - expected.clip_fraction).abs() < 1e-6);
        assert!((0.2..0.98).contains(&clip_fraction), "both sides of the clip range: {clip_fraction}");
    }

    #[test]
    fn loss_and_gradients_of_the_value_net_equal_those_of_autodiff() {
        let symmetry = MlpSymmetry::new(reflection(OBS), &HIDDEN, Reflection::identity(1));
        let value = networks().value;
        assert_value_equal_to_autodiff(&value, None);
        assert_value_equal_to_autodiff(&imposed(&value, &symmetry), Some(&symmetry));
    }

    fn assert_value_equal_to_autodiff(value: &Mlp, symmetry: Option<&MlpSymmetry>) {
        let batch = |rows: usize, seed| ValueBatch {
            obs: normals(rows * OBS, 1.0, seed),
            returns: normals(rows, 2.0, seed + 1),
        };
        let (batch, previous) = (batch(ROWS - 300, 3), batch(300, 5));
        let mut written = WrittenValue::new(value, symmetry, &batch, Some(&previous));
        let mut recorded = RecordedValue::new(symmetry, &batch.union(Some(&previous)), &value.device());
        let (loss, gradients) = written.gradients(value, minibatch()).unwrap();
        let (expected_loss, expected) = recorded.gradients(value, minibatch()).unwrap();
        let (loss, expected_loss) = (scalar(loss).unwrap(), scalar(expected_loss).unwrap());
        assert!((loss - expected_loss).abs() < 1e-5 * expected_loss, "{loss}, expected {expected_loss}");
        assert_near(&flat(value, &gradients), &flat(value, &expected));
    }
}
