//! The memory of a recurrent policy: an LSTM over its observations.

use std::borrow::Cow;

use burn::module::{Module, Param};
use burn::nn::Linear;
use burn::optim::GradientsParams;
use burn::tensor::{Device, Tensor, TensorData};

use crate::error::{NnError, Result, check_length};
use crate::host::read;
use crate::kernels::{Level, lstm_sequence};
use crate::lstm::{composed_step, gates};
use crate::mlp::replaced;

/// An LSTM, as it is trained.
///
/// Parameters are ordinary burn parameters; on a CPU whole sequences go through [`lstm_sequence`]. The four gates lie side by
/// side in the order input, forget, cell, output, which is PyTorch's; PyTorch has two biases, whose sum is the one here.
#[derive(Module, Debug)]
pub struct Lstm {
    /// From the inputs to the four gates; weight `[I, 4 H]`, bias `[4 H]`.
    pub input: Linear,
    /// From the hidden state to the four gates, `[H, 4 H]`.
    pub recurrent: Param<Tensor<2>>,
}

impl Lstm {
    /// Draws the weights; `normal` yields independent standard normals.
    pub fn new(inputs: usize, units: usize, normal: &mut dyn FnMut() -> f64, device: &Device) -> Self {
        let (input, recurrent) = gates(inputs, units, normal, device);
        Self { input, recurrent }
    }

    /// Width of the hidden state, H.
    #[must_use]
    pub fn units(&self) -> usize {
        self.recurrent.lazy_shape()[0]
    }

    /// The hidden states after every step, of burn's own operations.
    ///
    /// # Shapes
    /// x `[B, T, I]`; state, hidden and cell, before the first step `[B, 2, H]`; begins, 1 where a sequence begins anew and
    /// else 0, `[B, T]`; returns `[B, T, H]`
    #[must_use]
    pub fn forward(&self, x: Tensor<3>, state: &Tensor<3>, begins: &Tensor<2>) -> Tensor<3> {
        let ([rows, steps, inputs], units) = (x.dims(), self.units());
        let entering = self.input.forward(x.reshape([rows * steps, inputs]));
        let entering = entering.reshape([rows, steps, 4 * units]);
        let part = |index: usize| state.clone().narrow(1, index, 1).reshape([rows, units]);
        let (mut h, mut c) = (part(0), part(1));
        let mut hidden = Vec::with_capacity(steps);
        for step in 0..steps {
            let goes_on = begins.clone().narrow(1, step, 1).neg().add_scalar(1.0);
            let entering = entering.clone().narrow(1, step, 1).reshape([rows, 4 * units]);
            (h, c) = composed_step(entering, self.recurrent.val(), h * goes_on.clone(), c * goes_on);
            hidden.push(h.clone().reshape([rows, 1, units]));
        }
        Tensor::cat(hidden, 1)
    }

    /// All parameters: input weight `[I, 4 H]`, bias `[4 H]` and recurrent weight `[H, 4 H]`.
    pub fn parameters(&self) -> Result<Vec<f32>> {
        let mut parameters = read(self.input.weight.val())?;
        if let Some(bias) = &self.input.bias {
            parameters.extend(read(bias.val())?);
        }
        parameters.extend(read(self.recurrent.val())?);
        Ok(parameters)
    }

    /// The same LSTM with other parameters, laid out like [`Lstm::parameters`].
    #[must_use]
    pub fn with_parameters(mut self, parameters: &[f32]) -> Self {
        let [inputs, gates] = self.input.weight.lazy_shape().dims();
        let (weight, rest) = parameters.split_at(inputs * gates);
        let (bias, recurrent) = rest.split_at(gates);
        self.input.weight = replaced(&self.input.weight, TensorData::new(weight.to_vec(), [inputs, gates]));
        self.input.bias = self.input.bias.map(|old| replaced(&old, TensorData::new(bias.to_vec(), [gates])));
        self.recurrent = replaced(&self.recurrent, TensorData::new(recurrent.to_vec(), [gates / 4, gates]));
        self
    }

    /// Hands a gradient that is laid out like [`Lstm::parameters`] to the parameters, for an optimiser.
    pub fn register_gradient(&self, gradient: &[f32], gradients: &mut GradientsParams) {
        let device = self.recurrent.lazy_device().without_autodiff();
        let [inputs, gates] = self.input.weight.lazy_shape().dims();
        let (weight, rest) = gradient.split_at(inputs * gates);
        let (bias_gradient, recurrent) = rest.split_at(gates);
        let matrix = |values: &[f32]| {
            let rows = values.len() / gates;
            Tensor::<2>::from_data(TensorData::new(values.to_vec(), [rows, gates]), &device)
        };
        gradients.register(self.input.weight.id, matrix(weight));
        if let Some(bias) = &self.input.bias {
            gradients.register(bias.id, Tensor::<1>::from_data(bias_gradient, &device));
        }
        gradients.register(self.recurrent.id, matrix(recurrent));
    }

    /// Replaces the gradient of the parameters, laid out like [`Lstm::parameters`], by what `change` makes of it.
    pub(crate) fn change_gradient(
        &self,
        gradients: &mut GradientsParams,
        change: impl FnOnce(&mut [f32]),
    ) -> Result<()> {
        let bias = self.input.bias.as_ref();
        let parts = (
            gradients.remove::<2>(self.input.weight.id),
            bias.and_then(|bias| gradients.remove::<1>(bias.id)),
            gradients.remove::<2>(self.recurrent.id),
        );
        let (Some(weight), Some(bias_gradient), Some(recurrent)) = parts else { return Ok(()) };
        let mut flat = [read(weight)?, read(bias_gradient)?, read(recurrent)?].concat();
        change(&mut flat);
        self.register_gradient(&flat, gradients);
        Ok(())
    }

    /// The LSTM as it is now, in the host's memory.
    pub fn frozen(&self) -> Result<FrozenLstm> {
        FrozenLstm::new(self.units(), self.parameters()?)
    }
}

/// An LSTM that no longer changes.
#[derive(Debug, Clone, PartialEq)]
pub struct FrozenLstm {
    units: usize,
    parameters: Vec<f32>,
    level: Level,
}

impl FrozenLstm {
    /// An LSTM of so many units with parameters laid out like [`Lstm::parameters`].
    pub fn new(units: usize, parameters: Vec<f32>) -> Result<Self> {
        let inputs =
            (parameters.len() / (4 * units).max(1)).checked_sub(units + 1).filter(|inputs| *inputs > 0);
        let expected = inputs.and_then(|inputs| lstm_sequence::parameter_count(inputs, units));
        if expected != Some(parameters.len()) {
            return Err(NnError::Invalid(format!(
                "an LSTM of {units} units has {} parameters, expected 4 · {units} · (inputs + {units} + 1) with at least \
                 one input",
                parameters.len()
            )));
        }
        Ok(Self { units, parameters, level: Level::chosen() })
    }

    /// Width of the hidden state, H.
    #[must_use]
    pub fn units(&self) -> usize {
        self.units
    }

    /// Number of inputs, I.
    #[must_use]
    pub fn inputs(&self) -> usize {
        self.parameters.len() / (4 * self.units) - self.units - 1
    }

    /// All parameters, as [`Lstm::parameters`] lays them out.
    #[must_use]
    pub fn parameters(&self) -> &[f32] {
        &self.parameters
    }

    /// One step of N robots, whose states become those after it.
    ///
    /// # Shapes
    /// rows `[N, I]`, states of N robots
    pub fn step(&self, rows: &[f32], state: &mut PolicyState) -> Result<()> {
        check_length(
            "states of a recurrent policy [N, 2, H]",
            &state.numbers,
            rows.len() / self.inputs() * 2 * self.units,
        )?;
        lstm_sequence::step(self.level, self.units, &self.parameters, rows, &mut state.numbers);
        Ok(())
    }
}

/// What a recurrent policy remembers of N robots: hidden and cell states, all zero before the first step of an episode.
/// That of other policies has no numbers.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct PolicyState {
    /// Width of the hidden state, H; 0 for a policy without memory.
    units: usize,
    /// `[N, 2, H]`
    numbers: Vec<f32>,
}

impl PolicyState {
    /// That of `robots` robots at the start of their episodes.
    #[must_use]
    pub fn new(robots: usize, units: usize) -> Self {
        Self { units, numbers: vec![0.0; robots * 2 * units] }
    }

    /// A state of these numbers, `[N, 2, H]`; `None` if they are not those of whole robots, or not finite.
    #[must_use]
    pub fn of(units: usize, numbers: Vec<f32>) -> Option<Self> {
        let is_whole = numbers.len().checked_rem(2 * units).unwrap_or(numbers.len()) == 0;
        (is_whole && numbers.iter().all(|x| x.is_finite())).then_some(Self { units, numbers })
    }

    /// Width of the hidden state, H.
    #[must_use]
    pub fn units(&self) -> usize {
        self.units
    }

    /// Hidden and cell states, `[N, 2, H]`.
    #[must_use]
    pub fn numbers(&self) -> &[f32] {
        &self.numbers
    }

    /// Begins an episode of a robot: nothing is remembered of the one before.
    pub fn begin(&mut self, robot: usize) {
        self.numbers[robot * 2 * self.units..][..2 * self.units].fill(0.0);
    }

    /// Those of some robots, in this order.
    #[must_use]
    pub fn of_robots(&self, robots: &[usize]) -> Self {
        let of_robot = |robot: &usize| &self.numbers[robot * 2 * self.units..][..2 * self.units];
        Self { units: self.units, numbers: robots.iter().flat_map(of_robot).copied().collect() }
    }

    /// The hidden states, `[N, H]`.
    #[must_use]
    pub fn hidden(&self) -> Vec<f32> {
        let robots = self.numbers.chunks_exact((2 * self.units).max(1));
        robots.flat_map(|state| &state[..self.units]).copied().collect()
    }
}

/// Rows with the hidden states of a recurrent policy behind them.
///
/// # Shapes
/// rows `[N, W]`, hidden `[N, H]`; returns `[N, W + H]`
#[must_use]
pub fn with_hidden<'a>(rows: Cow<'a, [f32]>, hidden: &[f32], units: usize) -> Cow<'a, [f32]> {
    if units == 0 {
        return rows;
    }
    let count = hidden.len() / units;
    let width = rows.len() / count.max(1);
    let mut joined = Vec::with_capacity(rows.len() + hidden.len());
    for (row, hidden) in rows.chunks_exact(width.max(1)).zip(hidden.chunks_exact(units)) {
        joined.extend_from_slice(row);
        joined.extend_from_slice(hidden);
    }
    joined.into()
}
