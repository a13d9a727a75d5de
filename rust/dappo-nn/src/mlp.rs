//! A multilayer perceptron: tanh after every hidden layer, a linear output layer.

use burn::module::{Module, Param};
use burn::nn::Linear;
use burn::optim::GradientsParams;
use burn::tensor::{Device, Tensor, TensorData};

use super::init::{linear, orthogonal};
use super::kernels::{self, Level, parameter_count};
use crate::error::{NnError, Result, check_length};
use crate::host::read;

/// A tanh MLP of any number of layers.
///
/// The layers are ordinary burn `Linear`s, so optimisers, records and exports see nothing special. On a CPU
/// rows of numbers go through the whole net at once ([`FrozenMlp::apply`], [`kernels::MlpPass`]).
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

    /// The net's output, of burn's own operations: works on every device, and gradients flow back.
    ///
    /// # Shapes
    /// x `[N, inputs]`; returns `[N, outputs]`
    #[must_use]
    pub fn forward(&self, x: Tensor<2>) -> Tensor<2> {
        let last = self.layers.len() - 1;
        self.layers.iter().enumerate().fold(x, |x, (index, layer)| {
            let y = layer.forward(x);
            if index < last { y.tanh() } else { y }
        })
    }

    /// The device that the net lives on.
    #[must_use]
    pub fn device(&self) -> Device {
        self.layers[0].weight.lazy_device()
    }

    /// All parameters, layer after layer: the matrix `[inputs, outputs]` row by row, then the biases.
    pub fn parameters(&self) -> Result<Vec<f32>> {
        let mut parameters = Vec::with_capacity(parameter_count(&self.sizes()).unwrap_or_default());
        for layer in &self.layers {
            parameters.extend(read(layer.weight.val())?);
            if let Some(bias) = &layer.bias {
                parameters.extend(read(bias.val())?);
            }
        }
        Ok(parameters)
    }

    /// The net as it is now, in the host's memory.
    pub fn frozen(&self) -> Result<FrozenMlp> {
        FrozenMlp::new(self.sizes(), self.parameters()?)
    }

    /// The same net with other parameters, laid out like [`Mlp::parameters`].
    #[must_use]
    pub fn with_parameters(mut self, parameters: &[f32]) -> Self {
        let mut rest = parameters;
        for layer in &mut self.layers {
            let [inputs, outputs] = layer.weight.lazy_shape().dims();
            let (weight, after) = rest.split_at(inputs * outputs);
            layer.weight = replaced(&layer.weight, TensorData::new(weight.to_vec(), [inputs, outputs]));
            rest = after;
            if let Some(bias) = &mut layer.bias {
                let (values, after) = rest.split_at(outputs);
                *bias = replaced(bias, TensorData::new(values.to_vec(), [outputs]));
                rest = after;
            }
        }
        self
    }

    /// Takes the gradient of the parameters out of `gradients`, laid out like [`Mlp::parameters`]; 0 where there is none.
    pub fn take_gradient(&self, gradients: &mut GradientsParams) -> Result<Vec<f32>> {
        let mut gradient = Vec::with_capacity(parameter_count(&self.sizes()).unwrap_or_default());
        for layer in &self.layers {
            let [inputs, outputs] = layer.weight.lazy_shape().dims();
            match gradients.remove::<2>(layer.weight.id) {
                Some(weight) => gradient.extend(read(weight)?),
                None => gradient.resize(gradient.len() + inputs * outputs, 0.0),
            }
            if let Some(bias) = &layer.bias {
                match gradients.remove::<1>(bias.id) {
                    Some(values) => gradient.extend(read(values)?),
                    None => gradient.resize(gradient.len() + outputs, 0.0),
                }
            }
        }
        Ok(gradient)
    }

    /// Hands a gradient that is laid out like [`Mlp::parameters`] to the parameters, for an optimiser.
    pub fn register_gradient(&self, gradient: &[f32], gradients: &mut GradientsParams) {
        let device = self.device().without_autodiff();
        let mut rest = gradient;
        for layer in &self.layers {
            let [inputs, outputs] = layer.weight.lazy_shape().dims();
            let (weight, after) = rest.split_at(inputs * outputs);
            let weight = Tensor::<2>::from_data(TensorData::new(weight.to_vec(), [inputs, outputs]), &device);
            gradients.register(layer.weight.id, weight);
            rest = after;
            if let Some(bias) = &layer.bias {
                let (values, after) = rest.split_at(outputs);
                gradients.register(bias.id, Tensor::<1>::from_data(values, &device));
                rest = after;
            }
        }
    }
}

/// A parameter with other values, which keeps its id.
pub(crate) fn replaced<const D: usize>(parameter: &Param<Tensor<D>>, data: TensorData) -> Param<Tensor<D>> {
    parameter.clone().map(|old| {
        let new = Tensor::from_data(data, &old.device());
        if old.is_require_grad() { new.require_grad() } else { new }
    })
}

/// The parameters of a tanh MLP in one array: the fastest way to its outputs on a CPU.
#[derive(Debug, Clone, PartialEq)]
pub struct FrozenMlp {
    sizes: Vec<usize>,
    parameters: Vec<f32>,
    level: Level,
}

impl FrozenMlp {
    /// A net of `sizes = [inputs, hidden…, outputs]` with parameters laid out like [`Mlp::parameters`].
    pub fn new(sizes: Vec<usize>, parameters: Vec<f32>) -> Result<Self> {
        if sizes.len() < 2 || sizes[0] == 0 {
            return Err(NnError::Invalid(format!(
                "the layers of a net have widths {sizes:?}, expected at least one input, and outputs"
            )));
        }
        let expected = parameter_count(&sizes).unwrap_or(usize::MAX);
        check_length("parameters of a net", &parameters, expected)?;
        Ok(Self { sizes, parameters, level: Level::chosen() })
    }

    /// `[inputs, hidden…, outputs]`.
    #[must_use]
    pub fn sizes(&self) -> &[usize] {
        &self.sizes
    }

    /// Number of outputs.
    #[must_use]
    pub fn outputs(&self) -> usize {
        self.sizes[self.sizes.len() - 1]
    }

    /// All parameters, as [`Mlp::parameters`] lays them out.
    #[must_use]
    pub fn parameters(&self) -> &[f32] {
        &self.parameters
    }

    /// Weight `[inputs, outputs]` and bias `[outputs]` of every layer.
    pub fn layers(&self) -> impl Iterator<Item = ([usize; 2], &[f32], &[f32])> {
        let mut rest = self.parameters.as_slice();
        self.sizes.windows(2).map(move |pair| {
            let (weight, after) = rest.split_at(pair[0] * pair[1]);
            let (bias, after) = after.split_at(pair[1]);
            rest = after;
            ([pair[0], pair[1]], weight, bias)
        })
    }

    /// The net's output for every row.
    ///
    /// # Shapes
    /// rows `[N, inputs]`; returns `[N, outputs]`
    pub fn apply(&self, rows: &[f32]) -> Result<Vec<f32>> {
        let count = rows.len() / self.sizes[0];
        check_length("rows [N, inputs] of a net", rows, count * self.sizes[0])?;
        let mut out = vec![0.0; count * self.outputs()];
        kernels::forward(self.level, &self.sizes, &self.parameters, rows, &mut out);
        Ok(out)
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
            net.parameters().unwrap()
        };
        assert_eq!(make(1), make(1));
        assert_ne!(make(1), make(2));
    }

    #[test]
    fn a_frozen_net_has_the_layers_of_its_net_and_refuses_other_widths() {
        let mut stream = Stream::new(1, 0, Purpose::Weights);
        let net = Mlp::new(&[5, 4, 2], 1.0, &mut || stream.normal(), &Device::flex());
        let frozen = net.frozen().unwrap();
        for (([inputs, outputs], weight, bias), layer) in frozen.layers().zip(&net.layers) {
            assert_eq!([inputs, outputs], layer.weight.lazy_shape().dims());
            assert_eq!(weight, read(layer.weight.val()).unwrap());
            assert_eq!(bias, read(layer.bias.as_ref().unwrap().val()).unwrap());
        }
        assert_eq!(frozen.layers().count(), 2);
        assert!(frozen.apply(&[0.0; 7]).is_err());
        assert!(FrozenMlp::new(vec![5, 4, 2], vec![0.0; 33]).is_err());
        assert!(FrozenMlp::new(vec![5], Vec::new()).is_err());
    }
}
