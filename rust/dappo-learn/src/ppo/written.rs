//! Gradients on CPUs, without a graph of tensors: block by block a minibatch goes forwards, through the loss and back.

use std::borrow::Cow;

use burn::optim::GradientsParams;
use burn::tensor::Tensor;
use dappo_nn::kernels::lstm_sequence::{self, Activations, Sequences};
use dappo_nn::kernels::{Inputs, Level, MlpPass};
use dappo_nn::{GaussianPolicy, Mlp, MlpSymmetry, PolicyState, PolicySymmetry, cpu, read, with_hidden};

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
    /// The samples that distances are measured on.
    probe: Vec<i32>,
    old_log_std: Vec<f32>,
    pass: MlpPass,
}

/// What the net for the mean is given in some samples of the batch.
struct Given<'a> {
    inputs: Cow<'a, [f32]>,
    /// Rows of the inputs.
    order: Vec<i32>,
    /// The row of the batch of each of the inputs, for those of a recurrent policy.
    rows: Option<Vec<i32>>,
    memory: Option<Remembering>,
}

/// The way of sequences through the memory of a recurrent policy.
struct Remembering {
    units: usize,
    parameters: Vec<f32>,
    steps: usize,
    /// Observations `[M, T, O]`.
    x: Vec<f32>,
    /// `[M, 2, H]`
    state: PolicyState,
    /// `[M, T]`
    begins: Vec<f32>,
    kept: Activations,
}

impl<'a> Given<'a> {
    /// Samples of a batch: rows, or all steps of robots for a recurrent policy.
    fn new(policy: &GaussianPolicy, batch: &'a PolicyBatch<'a>, samples: &[i32]) -> Result<Self> {
        let (Some(sequences), Some(memory)) = (&batch.sequences, &policy.memory) else {
            let inputs = Cow::Borrowed(batch.obs);
            return Ok(Self { inputs, order: samples.to_vec(), rows: None, memory: None });
        };
        let (steps, units) = (sequences.steps, memory.units());
        let (robots, width) = (sequences.begins.len() / steps, batch.obs.len() / batch.rows());
        let chosen: Vec<usize> = samples.iter().map(|robot| *robot as usize).collect();
        let of_robot = |robot| (0..steps).map(move |step| step * robots + robot);
        let rows: Vec<usize> = chosen.iter().copied().flat_map(of_robot).collect();
        let x: Vec<f32> = rows.iter().flat_map(|row| &batch.obs[row * width..][..width]).copied().collect();
        let begins: Vec<f32> =
            rows.iter().map(|row| if sequences.begins[*row] { 1.0 } else { 0.0 }).collect();
        let (state, parameters) = (sequences.state.of_robots(&chosen), memory.parameters()?);
        let mut hidden = vec![0.0; rows.len() * units];
        let given = Sequences { steps, x: &x, state: state.numbers(), begins: &begins };
        let kept = lstm_sequence::forward(Level::chosen(), units, &parameters, given, &mut hidden);
        let inputs = with_hidden(Cow::Borrowed(&x), &hidden, units).into_owned().into();
        let order = (0..rows.len() as i32).collect();
        let rows = Some(rows.into_iter().map(|row| row as i32).collect());
        let memory = Some(Remembering { units, parameters, steps, x, state, begins, kept });
        Ok(Self { inputs, order, rows, memory })
    }

    /// Rows of the batch for rows of the inputs.
    fn rows<'b>(&'b self, order: &'b [i32]) -> &'b [i32] {
        match (&self.rows, order) {
            // The inputs of a recurrent policy are taken in their order.
            (Some(rows), [first, ..]) => &rows[*first as usize..][..order.len()],
            _ => order,
        }
    }
}

impl Remembering {
    /// The gradient of the memory's parameters, given that of the inputs of the net, `[M T, O + H]`.
    fn gradient(&self, input_gradient: &[f32]) -> Vec<f32> {
        let Self { units, parameters, steps, x, state, begins, kept } = self;
        let width = input_gradient.len() / begins.len();
        let of_hidden = input_gradient.chunks_exact(width).flat_map(|row| &row[width - units..]);
        let of_hidden: Vec<f32> = of_hidden.copied().collect();
        let given = Sequences { steps: *steps, x, state: state.numbers(), begins };
        lstm_sequence::backward(Level::chosen(), *units, parameters, given, kept, &of_hidden)
    }
}

impl<'a> WrittenPolicy<'a> {
    /// The problem of moving on from `old`, which collected the batch and may be its own mirror image; `probe` lists the samples
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

    fn steps(&self) -> usize {
        self.batch.steps()
    }

    fn gradients(
        &mut self,
        policy: &GaussianPolicy,
        minibatch: Vec<i32>,
    ) -> Result<(Tensor<1>, GradientsParams)> {
        let (parameters, gaussian) = (policy.mean.parameters()?, self.gaussian(policy)?);
        let Self { objective, batch, .. } = *self;
        let given = Given::new(policy, batch, &minibatch)?;
        let mut input_gradient = vec![0.0; if given.memory.is_some() { given.inputs.len() } else { 0 }];
        let count = given.order.len() as f64;
        let mut pass = |kl_slope: f64| {
            let weights = Weights {
                kl: kl_slope as f32,
                clip_range: objective.clip_range as f32,
                row: 1.0 / given.order.len() as f32,
            };
            let loss = |order: &[i32], means: &[f32], gradients: &mut [f32]| {
                gaussian.gradients(weights, batch, given.rows(order), means, gradients)
            };
            let (inputs, order) = (&*given.inputs, &given.order);
            let (sums, gradient) =
                self.pass.gradient_and_inputs(&parameters, inputs, order, &mut input_gradient, loss);
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
        if let (Some(way), Some(memory)) = (&given.memory, &policy.memory) {
            let mut gradient = way.gradient(&input_gradient);
            if let Some(symmetry) = self.symmetry.and_then(PolicySymmetry::memory) {
                symmetry.average_flat(&mut gradient);
            }
            memory.register_gradient(&gradient, &mut gradients);
        }
        Ok((vector(&[(objective.kl_penalty(kl) - surrogate) as f32]), gradients))
    }
}

impl PolicyProblem for WrittenPolicy<'_> {
    fn distance(&mut self, policy: &GaussianPolicy) -> Result<Distance> {
        let (parameters, gaussian) = (policy.mean.parameters()?, self.gaussian(policy)?);
        let (batch, clip_range) = (self.batch, self.objective.clip_range);
        let given = Given::new(policy, batch, &self.probe)?;
        let sums = self.pass.evaluate(&parameters, &*given.inputs, &given.order, |order, means| {
            let rows = given.rows(order);
            (gaussian.kl_sum(batch, rows, means), gaussian.clipped(batch, rows, means, clip_range))
        });
        let count = given.order.len() as f64;
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

    use super::super::batch;
    use super::super::recorded::{RecordedPolicy, RecordedValue};
    use super::*;
    use dappo_nn::{ActorCritic, ActorCriticSizes, Gradients, adam, scalar};

    const ROWS: usize = 700;
    const OBS: usize = 11;
    const ACTIONS: usize = 3;
    const HIDDEN: [usize; 2] = [20, 30];
    /// A KL divergence far above 2 d*, so that the hinge takes part.
    const OBJECTIVE: Objective = Objective { clip_range: 0.2, kl_coef: 1.7, kl_target: 0.01, kl_hinge: 50.0 };
    const SIZES: ActorCriticSizes<'_> =
        ActorCriticSizes { obs_dim: OBS, privileged: 0, memory: 0, hidden: &HIDDEN, action_dim: ACTIONS };

    fn normals(count: usize, scale: f32, seed: u64) -> Vec<f32> {
        let mut stream = Stream::new(seed, 0, Purpose::Weights);
        (0..count).map(|_| scale * stream.normal() as f32).collect()
    }

    fn networks() -> ActorCritic {
        networks_with(0)
    }

    fn networks_with(memory: usize) -> ActorCritic {
        let mut stream = Stream::new(2, 0, Purpose::Weights);
        let device = Device::flex().autodiff();
        let sizes = ActorCriticSizes { memory, ..SIZES };
        let mut networks = ActorCritic::new(sizes, -0.5, &mut || stream.normal(), &device);
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
        assert_equal_to_autodiff(&log_probs, false, 0);
    }

    #[test]
    fn so_they_do_for_networks_that_are_their_own_mirror_images() {
        let log_probs: Vec<f32> = normals(ROWS, 1.0, 6).iter().map(|x| x - 2.5).collect();
        assert_equal_to_autodiff(&log_probs, true, 0);
    }

    #[test]
    fn so_they_do_for_recurrent_policies() {
        let log_probs: Vec<f32> = normals(ROWS, 1.0, 6).iter().map(|x| x - 2.5).collect();
        assert_equal_to_autodiff(&log_probs, false, 6);
        assert_equal_to_autodiff(&log_probs, true, 7);
    }

    #[test]
    fn they_are_finite_and_equal_where_ratios_are_bounded() {
        let old = |(row, x): (usize, &f32)| x - if row % 5 == 0 { 300.0 } else { 2.5 };
        let log_probs: Vec<f32> = normals(ROWS, 1.0, 6).iter().enumerate().map(old).collect();
        assert_equal_to_autodiff(&log_probs, false, 0);
    }

    fn imposed(net: &Mlp, symmetry: &MlpSymmetry) -> Mlp {
        let mut parameters = net.parameters().unwrap();
        symmetry.impose(&mut parameters);
        net.clone().with_parameters(&parameters)
    }

    fn assert_equal_to_autodiff(log_probs: &[f32], is_mirrored: bool, memory: usize) {
        let obs = normals(ROWS * OBS, 1.0, 3);
        let means = normals(ROWS * ACTIONS, 0.4, 4);
        let noise = normals(ROWS * ACTIONS, 0.6, 5);
        let actions: Vec<f32> = means.iter().zip(noise).map(|(mean, z)| mean + z).collect();
        let advantages = normals(ROWS, 1.0, 7);
        let steps = if memory > 0 { 7 } else { 1 };
        let samples = ROWS / steps;
        let state = PolicyState::of(memory, normals(samples * 2 * memory, 0.5, 8)).unwrap();
        let begins = (0..ROWS).map(|row| row % 5 == 1).collect();
        let sequences = (memory > 0).then_some(batch::Sequences { steps, state: &state, begins });
        let batch =
            PolicyBatch { obs: &obs, actions: &actions, means: &means, log_probs, advantages, sequences };
        let probe: Vec<i32> = (0..samples as i32).step_by(3).collect();
        let minibatch = || (0..samples as i32).rev().step_by(2).collect();
        let mut old = networks_with(memory).policy;
        let symmetry = PolicySymmetry::new(reflection(OBS), memory, &HIDDEN, reflection(ACTIONS));
        let symmetry = is_mirrored.then_some(&symmetry);
        if let Some(symmetry) = symmetry {
            old.mean = imposed(&old.mean, symmetry.mean());
            if let (Some(memory), Some(symmetry)) = (old.memory.take(), symmetry.memory()) {
                let mut parameters = memory.parameters().unwrap();
                symmetry.impose(&mut parameters);
                old.memory = Some(memory.with_parameters(&parameters));
            }
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
        if let Some(memory) = &policy.memory {
            for weight in [&memory.input.weight, &memory.recurrent] {
                let of = |gradients: &GradientsParams| read(gradients.get::<2>(weight.id).unwrap()).unwrap();
                assert_near(&of(&gradients), &of(&expected));
            }
            let bias = memory.input.bias.as_ref().unwrap().id;
            let of = |gradients: &GradientsParams| read(gradients.get::<1>(bias).unwrap()).unwrap();
            assert_near(&of(&gradients), &of(&expected));
        }
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
