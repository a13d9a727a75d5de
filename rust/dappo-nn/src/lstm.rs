//! An LSTM behind a linear embedding of every time step, of which only the last hidden state is used.

use burn::module::{Module, Param};
use burn::nn::Linear;
use burn::tensor::{Device, Tensor, TensorData, activation};

use super::init::{linear, normal_linear, orthogonal};
use super::kernels::lstm::LstmSizes;
use super::lstm_op::embedded_lstm;

/// A linear embedding of every time step, and an LSTM over the embedded steps.
///
/// Parameters are ordinary burn parameters; on a CPU the whole runs as one operation. The four gates
/// lie side by side in the order input, forget, cell, output, which is PyTorch's; PyTorch has two biases,
/// whose sum is the one here.
#[derive(Module, Debug)]
pub struct EmbeddedLstm {
    /// Embedding of one time step; weight `[F, E]`.
    pub embedding: Linear,
    /// From the embedding to the four gates; weight `[E, 4 H]`, bias `[4 H]`.
    pub input: Linear,
    /// From the hidden state to the four gates, `[H, 4 H]`.
    pub recurrent: Param<Tensor<2>>,
}

impl EmbeddedLstm {
    /// Draws the weights; `normal` yields independent standard normals.
    pub fn new(sizes: LstmSizes, normal: &mut dyn FnMut() -> f64, device: &Device) -> Self {
        let LstmSizes { inputs, embedding, hidden } = sizes;
        let embedding_layer = normal_linear(inputs, embedding, 1.0, normal, device);
        let (input, recurrent) = gates(embedding, hidden, normal, device);
        Self { embedding: embedding_layer, input, recurrent }
    }

    /// The widths.
    #[must_use]
    pub fn sizes(&self) -> LstmSizes {
        let [inputs, embedding] = self.embedding.weight.lazy_shape().dims();
        LstmSizes { inputs, embedding, hidden: self.recurrent.lazy_shape()[0] }
    }

    /// The last hidden state of every window, computed the fastest way that the device of `x` offers.
    /// On a CPU there is no gradient of `x`.
    ///
    /// # Shapes
    /// x `[B, T, F]`; returns `[B, H]`
    #[must_use]
    pub fn forward(&self, x: Tensor<3>) -> Tensor<2> {
        // Device equality ignores autodiff, which the operation has too.
        if x.device() == Device::flex() {
            embedded_lstm(x, self.flat_parameters(), self.sizes())
        } else {
            self.forward_composed(x)
        }
    }

    /// The last hidden state of every window, composed of burn's own operations: works on every device.
    ///
    /// # Shapes
    /// x `[B, T, F]`; returns `[B, H]`
    #[must_use]
    pub fn forward_composed(&self, x: Tensor<3>) -> Tensor<2> {
        let ([windows, steps, inputs], hidden) = (x.dims(), self.sizes().hidden);
        let entering = self.input.forward(self.embedding.forward(x.reshape([windows * steps, inputs])));
        let entering = entering.reshape([windows, steps, 4 * hidden]);
        let mut h = Tensor::zeros([windows, hidden], &entering.device());
        let mut c = Tensor::zeros([windows, hidden], &entering.device());
        for step in 0..steps {
            let entering = entering.clone().narrow(1, step, 1).reshape([windows, 4 * hidden]);
            (h, c) = composed_step(entering, self.recurrent.val(), h, c);
        }
        h
    }

    /// All parameters in one tensor, laid out as the kernels read them. Gradients flow back through it.
    fn flat_parameters(&self) -> Tensor<1> {
        let mut parts = Vec::with_capacity(5);
        for layer in [&self.embedding, &self.input] {
            parts.push(layer.weight.val().flatten(0, 1));
            parts.extend(layer.bias.as_ref().map(Param::val));
        }
        parts.push(self.recurrent.val().flatten(0, 1));
        Tensor::cat(parts, 0)
    }
}

/// New weights from inputs and from the hidden state to the gates.
///
/// The recurrent weight is orthogonal, and the forget gates start open (bias 1; Jozefowicz et al., 2015,
/// "An empirical exploration of recurrent network architectures", section 2.2).
pub(crate) fn gates(
    inputs: usize,
    hidden: usize,
    normal: &mut dyn FnMut() -> f64,
    device: &Device,
) -> (Linear, Param<Tensor<2>>) {
    let gates = 4 * hidden;
    let deviation = (1.0 / inputs as f64).sqrt();
    let weight = (0..inputs * gates).map(|_| (deviation * normal()) as f32).collect();
    let recurrent = TensorData::new(orthogonal(hidden, gates, 1.0, normal), [hidden, gates]);
    let is_forget = |gate| (hidden..2 * hidden).contains(&gate);
    let bias: Vec<f32> = (0..gates).map(|gate| if is_forget(gate) { 1.0 } else { 0.0 }).collect();
    let input = Linear {
        bias: Some(Param::from_data(TensorData::new(bias, [gates]), device)),
        ..linear(weight, inputs, gates, device)
    };
    (input, Param::from_data(recurrent, device))
}

/// One step composed of burn's own operations: hidden and cell states after it.
///
/// # Shapes
/// entering the gates `[B, 4 H]`, recurrent `[H, 4 H]`, h and c `[B, H]`
pub(crate) fn composed_step(
    entering: Tensor<2>,
    recurrent: Tensor<2>,
    h: Tensor<2>,
    c: Tensor<2>,
) -> (Tensor<2>, Tensor<2>) {
    let hidden = h.dims()[1];
    let gates = entering + h.matmul(recurrent);
    let part = |index: usize| gates.clone().narrow(1, index * hidden, hidden);
    let (i, f) = (activation::sigmoid(part(0)), activation::sigmoid(part(1)));
    let (g, o) = (part(2).tanh(), activation::sigmoid(part(3)));
    let c = f * c + i * g;
    (o * c.clone().tanh(), c)
}
