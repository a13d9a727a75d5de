//! The self-diagnose network of Verma et al. (2019), section III: embedding, LSTM, dense layers.

use burn::module::Module;
use burn::nn::Linear;
use burn::tensor::{Device, Tensor, activation};
use dappo_sim::rng::{Purpose, Stream};

use super::EmbeddedLstm;
use super::init::normal_linear;
use super::kernels::lstm::LstmSizes;
use super::kernels::parameter_count;

/// Widths of a [`DiagnoserNet`].
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DiagnoserSizes {
    /// Numbers of one time step.
    pub inputs: usize,
    /// Width of the embedding of a time step.
    pub embedding: usize,
    /// Width of the LSTM's hidden state.
    pub lstm: usize,
    /// Widths of the dense layers.
    pub hidden: Vec<usize>,
    /// Number of outputs.
    pub outputs: usize,
}

impl DiagnoserSizes {
    /// Number of weights and biases of a network of these widths; `None` if they cannot be counted.
    #[must_use]
    pub fn parameter_count(&self) -> Option<usize> {
        let lstm = LstmSizes { inputs: self.inputs, embedding: self.embedding, hidden: self.lstm };
        lstm.parameter_count()?.checked_add(parameter_count(&self.dense())?)
    }

    /// Widths from the LSTM's hidden state to the outputs.
    #[must_use]
    pub fn dense(&self) -> Vec<usize> {
        [&[self.lstm], self.hidden.as_slice(), &[self.outputs]].concat()
    }
}

/// A linear embedding of every time step, an LSTM, dense layers with `ReLU` and dropout, a linear head.
#[derive(Module, Debug)]
pub struct DiagnoserNet {
    /// From a window to one hidden state.
    pub lstm: EmbeddedLstm,
    /// The dense layers.
    pub hidden: Vec<Linear>,
    /// The last layer.
    pub head: Linear,
}

impl DiagnoserNet {
    /// Draws the weights as a function of `seed`.
    #[must_use]
    pub fn new(sizes: &DiagnoserSizes, seed: u64, device: &Device) -> Self {
        let mut stream = Stream::new(seed, 0, Purpose::Weights);
        let normal: &mut dyn FnMut() -> f64 = &mut || stream.normal();
        let lstm = LstmSizes { inputs: sizes.inputs, embedding: sizes.embedding, hidden: sizes.lstm };
        let lstm = EmbeddedLstm::new(lstm, normal, device);
        let widths = [&[sizes.lstm], sizes.hidden.as_slice()].concat();
        let dense = |pair: &[usize]| normal_linear(pair[0], pair[1], 2.0, normal, device);
        let hidden = widths.windows(2).map(dense).collect();
        let last = widths.last().copied().unwrap_or(sizes.lstm);
        Self { lstm, hidden, head: normal_linear(last, sizes.outputs, 1.0, normal, device) }
    }

    /// The head's output, before any softmax or sigmoid; `dropout` is empty outside of training.
    ///
    /// # Shapes
    /// x `[B, T, F]`, dropout `[B, width]` for every dense layer; returns `[B, outputs]`
    #[must_use]
    pub fn forward(&self, x: Tensor<3>, dropout: &[Tensor<2>]) -> Tensor<2> {
        let mut h = self.lstm.forward(x);
        for (index, layer) in self.hidden.iter().enumerate() {
            h = activation::relu(layer.forward(h));
            if let Some(mask) = dropout.get(index) {
                h = h * mask.clone();
            }
        }
        self.head.forward(h)
    }
}

/// What dropout multiplies the units of one training step by: 0 with probability `rate`, else 1 / (1 − rate),
/// as a function of `seed` and `step`. Empty when nothing is dropped.
///
/// # Shapes
/// returns `[rows, width]` for every width
#[must_use]
pub fn dropout_masks(rate: f64, rows: usize, widths: &[usize], seed: u64, step: u64) -> Vec<Vec<f32>> {
    if rate == 0.0 {
        return Vec::new();
    }
    // A unit is dropped when 32 random bits fall below this.
    let threshold = (rate * 2.0_f64.powi(32)) as u32;
    let kept = (1.0 / (1.0 - rate)) as f32;
    let mut stream = Stream::new(seed, step, Purpose::Dropout);
    let mut mask = |&width: &usize| -> Vec<f32> {
        let mut words = vec![0; rows * width];
        stream.fill(&mut words);
        words.into_iter().map(|word| if word < threshold { 0.0 } else { kept }).collect()
    };
    widths.iter().map(&mut mask).collect()
}

#[cfg(test)]
mod tests {
    use burn::tensor::TensorData;

    use super::*;
    use crate::read;

    fn sizes() -> DiagnoserSizes {
        DiagnoserSizes { inputs: 3, embedding: 8, lstm: 4, hidden: vec![6, 5], outputs: 2 }
    }

    fn output(net: &DiagnoserNet, dropout: &[Tensor<2>]) -> Vec<f32> {
        let x = TensorData::new((0..24_u8).map(|x| f32::from(x) * 0.1 - 1.0).collect(), [2, 4, 3]);
        read(net.forward(Tensor::from_data(x, &Device::flex()), dropout)).unwrap()
    }

    #[test]
    fn the_weights_are_a_function_of_the_seed_alone_and_of_the_widths_asked_for() {
        let make = |seed| DiagnoserNet::new(&sizes(), seed, &Device::flex());
        assert_eq!(output(&make(1), &[]), output(&make(1), &[]));
        assert_ne!(output(&make(1), &[]), output(&make(2), &[]));
        // 3·8 + 8 + 8·16 + 16 + 4·16 of the LSTM, 4·6 + 6 + 6·5 + 5 of the dense layers, 5·2 + 2 of the head.
        assert_eq!(make(1).num_params(), 240 + 65 + 12);
        assert_eq!(sizes().parameter_count(), Some(240 + 65 + 12));
        assert_eq!(DiagnoserSizes { lstm: usize::MAX / 2, ..sizes() }.parameter_count(), None);
    }

    #[test]
    fn dropped_units_do_not_reach_the_output() {
        let net = DiagnoserNet::new(&sizes(), 1, &Device::flex());
        let none = [Tensor::zeros([2, 6], &Device::flex()), Tensor::zeros([2, 5], &Device::flex())];
        assert_eq!(output(&net, &none), [0.0; 4]);
        let all = [Tensor::ones([2, 6], &Device::flex()), Tensor::ones([2, 5], &Device::flex())];
        assert_eq!(output(&net, &all), output(&net, &[]));
    }

    #[test]
    fn dropout_keeps_the_mean_and_is_a_function_of_seed_and_step() {
        let masks = |seed, step| -> Vec<Vec<f32>> { dropout_masks(0.1, 100, &[300, 200], seed, step) };
        let [first, second] = <[Vec<f32>; 2]>::try_from(masks(1, 7)).unwrap();
        assert_eq!((first.len(), second.len()), (30_000, 20_000));
        let kept = 1.0 / 0.9_f32;
        assert!(first.iter().chain(&second).all(|&factor| factor == 0.0 || factor == kept));
        let dropped = first.iter().chain(&second).filter(|&&factor| factor == 0.0).count();
        // Four standard deviations of a binomial of 50 000 draws.
        assert!(dropped.abs_diff(5000) < 4 * 67, "{dropped} of 50000 dropped");
        assert_eq!(masks(1, 7), [first.clone(), second]);
        assert!(masks(2, 7)[0] != first && masks(1, 8)[0] != first);
        assert!(dropout_masks(0.0, 9, &[9], 1, 1).is_empty());
    }
}
