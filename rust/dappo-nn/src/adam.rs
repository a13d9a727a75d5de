//! Adam (Kingma and Ba, 2015), written out: for networks this small burn's own, a dozen passes over memory for every
//! parameter, would take a fifth of a training step.

use burn::optim::{
    Adam, AdamConfig, AdamState, AdaptiveMomentumState, LearningRate, ModuleOptimizer, Optimizer,
};
use burn::tensor::{Device, Tensor};
use serde::{Deserialize, Serialize};

use super::kernels::Level;
use super::kernels::adam::{AdamStep, adam_step};

/// The decay rates that Kingma and Ba recommend.
const BETAS: [f32; 2] = [0.9, 0.999];

/// Whether the gradients of networks and the steps of Adam are written out, or burn's.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Gradients {
    /// Written out for these networks, on CPUs.
    Written,
    /// Recorded by burn's autodiff from its own operations, on every device.
    Recorded,
}

/// One pass over memory a parameter, in the host's; states and records are burn's.
#[derive(Clone)]
struct WrittenAdam {
    epsilon: f32,
    level: Level,
}

/// Adam with a guard `epsilon` against division by zero. Both kinds take the same steps, and continue from
/// each other's records.
#[must_use]
pub fn adam(epsilon: f32, gradients: Gradients) -> ModuleOptimizer {
    match gradients {
        Gradients::Written => ModuleOptimizer::from(WrittenAdam { epsilon, level: Level::chosen() }),
        Gradients::Recorded => {
            AdamConfig::new().with_beta_1(BETAS[0]).with_beta_2(BETAS[1]).with_epsilon(epsilon).init()
        }
    }
}

impl Optimizer for WrittenAdam {
    type State<const D: usize> = AdamState<D>;

    fn step<const D: usize>(
        &self,
        learning_rate: LearningRate,
        parameter: Tensor<D>,
        gradient: Tensor<D>,
        state: Option<AdamState<D>>,
    ) -> (Tensor<D>, Option<AdamState<D>>) {
        let device = parameter.device();
        let moments = state.map_or_else(
            || AdaptiveMomentumState::new(0, parameter.zeros_like(), parameter.zeros_like()),
            |state| state.momentum,
        );
        let time = moments.time + 1;
        let [correction_1, correction_2] = BETAS.map(|beta| 1.0 - beta.powi(time as i32));
        let step = AdamStep {
            beta_1: BETAS[0],
            beta_2: BETAS[1],
            epsilon: self.epsilon * correction_2.sqrt(),
            step_size: learning_rate as f32 * correction_2.sqrt() / correction_1,
        };
        // Data of a tensor without other owners is moved, not copied: the moments are, the parameter is not.
        let gradient = gradient.into_data();
        let (mut p, mut m, mut v) =
            (parameter.into_data(), moments.moment_1.into_data(), moments.moment_2.into_data());
        // All networks are of f32.
        if let (Ok(p), Ok(g), Ok(m), Ok(v)) =
            (p.as_mut_slice(), gradient.as_slice(), m.as_mut_slice(), v.as_mut_slice())
        {
            adam_step(self.level, p, g, m, v, step);
        }
        let tensor = |data| Tensor::from_data(data, &device);
        let moments = AdaptiveMomentumState::new(time, tensor(m), tensor(v));
        (tensor(p), Some(AdamState::new(moments)))
    }

    fn to_device<const D: usize>(state: AdamState<D>, device: &Device) -> AdamState<D> {
        Adam::to_device(state, device)
    }
}

#[cfg(test)]
mod tests {
    use burn::nn::{Linear, LinearConfig};
    use burn::optim::GradientsParams;
    use burn::tensor::TensorData;

    use super::*;
    use crate::read;

    /// Weights after some steps down Σ (net(x) − 1)².
    fn train(
        mut optimizer: ModuleOptimizer,
        mut net: Linear,
        steps: usize,
    ) -> (Vec<f32>, ModuleOptimizer, Linear) {
        let device = Device::flex();
        let x: Vec<f32> = (0..400 * 200).map(|i| (i as f32 * 0.7).sin()).collect();
        let x = Tensor::<2>::from_data(TensorData::new(x, [400, 200]), &device);
        for _ in 0..steps {
            let loss = (net.forward(x.clone()) - 1.0).square().sum();
            let gradients = GradientsParams::from_grads(loss.backward(), &net);
            net = optimizer.step(0.01, net.clone(), gradients);
        }
        let weights = read(net.weight.val()).unwrap();
        (weights, optimizer, net)
    }

    #[test]
    fn weights_follow_those_of_burns_adam() {
        let net = LinearConfig::new(200, 150).init(&Device::flex().autodiff());
        for epsilon in [1e-8, 1e-2] {
            let (got, ..) = train(adam(epsilon, Gradients::Written), net.clone(), 5);
            let (expected, ..) = train(adam(epsilon, Gradients::Recorded), net.clone(), 5);
            for (got, expected) in got.iter().zip(&expected) {
                assert!((got - expected).abs() < 1e-5, "{got}, expected {expected}");
            }
        }
    }

    #[test]
    fn a_saved_optimiser_goes_on_to_the_bit() {
        let path = std::env::temp_dir().join(format!("dappo-adam-{}.bpk", std::process::id()));
        let net = LinearConfig::new(200, 3).init(&Device::flex().autodiff());
        let (_, optimizer, net) = train(adam(1e-8, Gradients::Written), net, 2);
        optimizer.save(&path).unwrap();
        let loaded = adam(1e-8, Gradients::Written).load(&path).unwrap();
        let (expected, ..) = train(optimizer, net.clone(), 2);
        assert_eq!(expected, train(loaded, net.clone(), 2).0);
        // The other kind reads the same record, and continues with the same moments.
        let other = adam(1e-8, Gradients::Recorded).load(&path).unwrap();
        for (got, expected) in train(other, net, 2).0.iter().zip(&expected) {
            assert!((got - expected).abs() < 1e-6, "{got}, expected {expected}");
        }
        std::fs::remove_file(path).unwrap();
    }
}
