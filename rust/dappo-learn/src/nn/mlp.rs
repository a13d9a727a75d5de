//! A multilayer perceptron: tanh after every hidden layer, a linear output layer.

use burn::module::{Module, Param};
use burn::nn::Linear;
use burn::tensor::{Device, Tensor};

use super::fused;
use super::host::read;
use super::init::{linear, orthogonal};
use crate::error::Result;

/// A tanh MLP of any number of layers.
///
/// The layers are ordinary burn `Linear`s, so optimisers, records and exports see nothing special; on a
/// CPU the whole net runs as one fused operation.
#[derive(Module, Debug)]
pub struct Mlp {
    /// The layers, inputs to outputs; weights are `[inputs, outputs]`.
    pub layers: Vec<Linear>,
}

impl Mlp {
    /// Draws the weights of an MLP of `sizes = [inputs, hidden…, outputs]`; biases start at 0.
    ///
    /// Weights are random orthogonal matrices (Saxe et al., 2014): gain 1 in hidden layers, `output_gain`
    /// in the last. `normal` yields independent standard normals, so that the weights are a function of
    /// the caller's seed alone, unlike burn's process-wide generator.
    pub fn new(sizes: &[usize], output_gain: f64, normal: &mut dyn FnMut() -> f64, device: &Device) -> Self {
        let last = sizes.len().saturating_sub(2);
        let layer = |(index, pair): (usize, &[usize])| {
            let gain = if index == last { output_gain } else { 1.0 };
            linear(orthogonal(pair[0], pair[1], gain, normal), pair[0], pair[1], device)
        };
        Self { layers: sizes.windows(2).enumerate().map(layer).collect() }
    }

    /// `[inputs, hidden…, outputs]`.
    #[must_use]
    pub fn sizes(&self) -> Vec<usize> {
        let inputs = self.layers.iter().take(1).map(|layer| layer.weight.lazy_shape()[0]);
        inputs.chain(self.layers.iter().map(|layer| layer.weight.lazy_shape()[1])).collect()
    }

    /// The net's output, computed the fastest way that the device of `x` offers.
    ///
    /// # Shapes
    /// x `[N, inputs]`; returns `[N, outputs]`
    #[must_use]
    pub fn forward(&self, x: Tensor<2>) -> Tensor<2> {
        // Device equality ignores autodiff, which the fused operation has too.
        if x.device() == Device::flex() {
            fused::tanh_mlp(x, self.flat_parameters(), self.sizes())
        } else {
            self.forward_composed(x)
        }
    }

    /// The net's output, composed of burn's own operations: works on every device.
    ///
    /// # Shapes
    /// x `[N, inputs]`; returns `[N, outputs]`
    #[must_use]
    pub fn forward_composed(&self, x: Tensor<2>) -> Tensor<2> {
        let last = self.layers.len() - 1;
        self.layers.iter().enumerate().fold(x, |x, (index, layer)| {
            let y = layer.forward(x);
            if index < last { y.tanh() } else { y }
        })
    }

    /// All parameters, layer after layer: the matrix `[inputs, outputs]` row by row, then the biases.
    pub fn parameters(&self) -> Result<Vec<f32>> {
        read(self.flat_parameters())
    }

    /// All parameters in one tensor, laid out as the kernels read them. Gradients flow back through it.
    fn flat_parameters(&self) -> Tensor<1> {
        let mut parts = Vec::with_capacity(2 * self.layers.len());
        for layer in &self.layers {
            parts.push(layer.weight.val().flatten(0, 1));
            parts.extend(layer.bias.as_ref().map(Param::val));
        }
        Tensor::cat(parts, 0)
    }
}

#[cfg(test)]
mod tests {
    use dappo_sim::rng::{Purpose, Stream};

    use super::*;

    #[test]
    fn the_weights_are_a_function_of_the_stream_alone() {
        let make = |seed| {
            let mut stream = Stream::new(seed, 0, Purpose::Weights);
            let net = Mlp::new(&[5, 4, 2], 0.01, &mut || stream.normal(), &Device::flex());
            net.flat_parameters().into_data().try_into_vec::<f32>().unwrap()
        };
        assert_eq!(make(1), make(1));
        assert_ne!(make(1), make(2));
    }
}
