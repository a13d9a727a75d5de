//! Adam (Kingma and Ba, 2015) for networks that are so fast that burn's own, a dozen passes over memory for every
//! parameter, would take a fifth of a training step.

use burn::optim::{
    Adam, AdamConfig, AdamState, AdaptiveMomentumState, LearningRate, ModuleOptimizer, Optimizer,
};
use burn::tensor::{DType, Device, Tensor};

use super::kernels::Level;
use super::kernels::adam::{AdamStep, adam_step};

/// The decay rates that Kingma and Ba recommend.
const BETAS: [f32; 2] = [0.9, 0.999];

/// Adam as one operation a parameter on CPUs, and burn's elsewhere; states and records are burn's.
#[derive(Clone)]
struct FusedAdam {
    composed: Adam,
    epsilon: f32,
}

/// Adam with a guard `epsilon` against division by zero.
#[must_use]
pub fn fused_adam(epsilon: f32) -> ModuleOptimizer {
    let composed =
        AdamConfig::new().with_beta_1(BETAS[0]).with_beta_2(BETAS[1]).with_epsilon(epsilon).build();
    ModuleOptimizer::from(FusedAdam { composed, epsilon })
}

impl Optimizer for FusedAdam {
    type State<const D: usize> = AdamState<D>;

    fn step<const D: usize>(
        &self,
        learning_rate: LearningRate,
        parameter: Tensor<D>,
        gradient: Tensor<D>,
        state: Option<AdamState<D>>,
    ) -> (Tensor<D>, Option<AdamState<D>>) {
        let device = parameter.device();
        if device != Device::flex() || parameter.dtype() != DType::F32 {
            return self.composed.step(learning_rate, parameter, gradient, state);
        }
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
        // Data of a tensor that nobody else holds is moved, not copied: the moments are, the parameter is not.
        let gradient = gradient.into_data();
        let (mut p, mut m, mut v) =
            (parameter.into_data(), moments.moment_1.into_data(), moments.moment_2.into_data());
        // The type has been checked, so all of them are slices of f32.
        if let (Ok(p), Ok(g), Ok(m), Ok(v)) =
            (p.as_mut_slice(), gradient.as_slice(), m.as_mut_slice(), v.as_mut_slice())
        {
            adam_step(Level::best(), p, g, m, v, step);
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
    use crate::nn::read;

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
            let (got, ..) = train(fused_adam(epsilon), net.clone(), 5);
            let (expected, ..) = train(AdamConfig::new().with_epsilon(epsilon).init(), net.clone(), 5);
            for (got, expected) in got.iter().zip(&expected) {
                assert!((got - expected).abs() < 1e-5, "{got}, expected {expected}");
            }
        }
    }

    #[test]
    fn a_saved_optimiser_goes_on_to_the_bit() {
        let path = std::env::temp_dir().join(format!("dappo-adam-{}.bpk", std::process::id()));
        let net = LinearConfig::new(200, 3).init(&Device::flex().autodiff());
        let (_, optimizer, net) = train(fused_adam(1e-8), net, 2);
        optimizer.save(&path).unwrap();
        let loaded = fused_adam(1e-8).load(&path).unwrap();
        assert_eq!(train(optimizer, net.clone(), 2).0, train(loaded, net, 2).0);
        std::fs::remove_file(path).unwrap();
    }
}
