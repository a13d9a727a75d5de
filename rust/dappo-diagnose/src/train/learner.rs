//! The network while it learns.

use burn::optim::{GradientsParams, ModuleOptimizer};
use burn::tensor::{Device, Tensor, TensorData};
use dappo_learn::error::Result;
use dappo_nn::diagnoser::{DiagnoserNet, DiagnoserSizes};
use dappo_nn::{Gradients, adam, scalar};

use crate::{DiagnoserConfig, Head};

/// Adam's guard against division by zero, as in Kingma and Ba (2015).
const ADAM_EPSILON: f32 = 1e-8;

/// A network and what trains it.
pub struct Learner {
    pub net: DiagnoserNet,
    pub optimizer: ModuleOptimizer,
    /// The device without autodiff.
    device: Device,
    sizes: DiagnoserSizes,
    head: Head,
}

/// Inputs and targets of one training step.
pub struct Minibatch {
    /// `[B, T, F]`, standardised.
    pub inputs: Vec<f32>,
    /// `[B, W]`
    pub targets: Vec<f32>,
    /// What dropout multiplies the dense layers by, `[B, width]` each.
    pub dropout: Vec<Vec<f32>>,
}

pub fn optimizer() -> ModuleOptimizer {
    adam(ADAM_EPSILON, Gradients::Written)
}

impl Learner {
    /// A new network; its weights are a function of the configuration's seed.
    pub fn new(config: &DiagnoserConfig, sizes: DiagnoserSizes, device: &Device) -> Self {
        Self {
            net: DiagnoserNet::new(&sizes, config.seed, &device.clone().autodiff()),
            optimizer: optimizer(),
            device: device.clone(),
            sizes,
            head: config.head,
        }
    }

    /// One gradient step; returns the loss before it.
    pub fn step(&mut self, batch: Minibatch, learning_rate: f64) -> Result<f64> {
        let DiagnoserSizes { inputs, outputs, hidden, .. } = &self.sizes;
        let rows = batch.targets.len() / outputs;
        let steps = batch.inputs.len() / (rows * inputs);
        let matrix = |values: Vec<f32>, width: usize| {
            Tensor::from_data(TensorData::new(values, [rows, width]), &self.device)
        };
        let x = Tensor::from_data(TensorData::new(batch.inputs, [rows, steps, *inputs]), &self.device);
        let dropout: Vec<Tensor<2>> =
            batch.dropout.into_iter().zip(hidden).map(|(mask, width)| matrix(mask, *width)).collect();
        let loss = self.head.loss(self.net.forward(x, &dropout), matrix(batch.targets, *outputs));
        let gradients = GradientsParams::from_grads(loss.backward(), &self.net);
        self.net = self.optimizer.step(learning_rate, self.net.clone(), gradients);
        Ok(scalar(loss.without_autodiff())?)
    }
}
