//! A block of windows on its way through the time steps of an LSTM, forward and backward.

use super::Level;
use super::elementwise::column_sums;
use super::lstm_cell::{Block, Gradients, Saved, step_backward, step_forward};
use super::matmul::Destination::{Accumulate, Overwrite};
use super::matmul::{Matrix, matmul, matmul_strided};

/// The backward pass sums gradients in this many partitions and then adds those in order. The number is
/// fixed, so that the result does not depend on the number of threads.
pub(super) const PARTITIONS: usize = 8;
/// Windows of a block: what a block of this size computes on its way fits into a core's cache.
pub(super) const BLOCK: usize = 8;

/// The parameters of an LSTM with I inputs and a hidden state of H.
#[derive(Clone, Copy)]
pub(super) struct Recurrence<'a> {
    pub level: Level,
    /// From the inputs to the gates, `[I, 4 H]`.
    pub input: Matrix<'a>,
    /// `[4 H]`
    pub bias: &'a [f32],
    /// From the hidden state to the gates, `[H, 4 H]`.
    pub recurrent: Matrix<'a>,
}

/// M windows of T steps.
#[derive(Clone, Copy)]
pub(super) struct Windows<'a> {
    pub steps: usize,
    /// Inputs `[M, T, I]`.
    pub x: &'a [f32],
    /// Hidden and cell states before the first step, `[M, 2, H]`; empty for zeros.
    pub state: &'a [f32],
    /// 1 where the states before a step are zeros, whatever came before, or else 0, `[M, T]`; empty for nowhere.
    pub begins: &'a [f32],
}

impl Windows<'_> {
    fn begins(&self, row: usize, step: usize) -> bool {
        self.begins.get(row * self.steps + step).is_some_and(|begins| *begins != 0.0)
    }
}

/// The stored results of a block of M windows of T steps.
#[derive(Debug, Clone)]
pub(super) struct BlockActivations {
    /// `[M, T, 4 H]`
    gates: Vec<f32>,
    /// `[M, T, 2, H]`, before and after every step.
    cells: Vec<f32>,
    /// `[M, T, H]`, before every step.
    hidden: Vec<f32>,
}

impl Recurrence<'_> {
    /// H.
    fn width(&self) -> usize {
        self.recurrent.rows()
    }

    /// Takes a block through all steps. `each` gets the hidden states after each step of each window, given by
    /// (row, step).
    pub fn forward(
        &self,
        windows: Windows<'_>,
        mut each: impl FnMut(usize, usize, &[f32]),
    ) -> BlockActivations {
        let (width, Windows { steps, x, .. }) = (self.width(), windows);
        let rows = x.len() / self.input.rows() / steps;
        let mut kept = BlockActivations {
            gates: vec![0.0; rows * steps * 4 * width],
            cells: vec![0.0; rows * steps * 2 * width],
            hidden: vec![0.0; rows * steps * width],
        };
        let mut last = vec![0.0; rows * width];
        for (row, state) in windows.state.chunks_exact(2 * width).enumerate() {
            let (hidden, cells) = state.split_at(width);
            kept.hidden[row * steps * width..][..width].copy_from_slice(hidden);
            kept.cells[row * steps * 2 * width..][..width].copy_from_slice(cells);
        }
        let BlockActivations { gates, cells, hidden } = &mut kept;
        let mut block = Block { gates, cells, hidden, last: &mut last };
        let x = Matrix::new(x, rows * steps, self.input.rows());
        matmul(self.level, block.gates, Overwrite, x, self.input);
        for step in 0..steps {
            for row in (0..rows).filter(|row| windows.begins(*row, step)) {
                block.hidden[(row * steps + step) * width..][..width].fill(0.0);
                block.cells[(row * steps + step) * 2 * width..][..width].fill(0.0);
            }
            if step > 0 || !windows.state.is_empty() {
                self.add_recurrent(&mut block, step);
            }
            step_forward(self.level, &mut block, self.bias, step);
            for row in 0..rows {
                let after = if step + 1 < steps {
                    &block.hidden[(row * steps + step + 1) * width..][..width]
                } else {
                    &block.last[row * width..][..width]
                };
                each(row, step, after);
            }
        }
        kept
    }

    /// One step of a block, whose hidden and cell states become those after it.
    ///
    /// # Shapes
    /// x `[M, I]`, state `[M, 2, H]`
    pub fn step(&self, x: &[f32], state: &mut [f32]) {
        let width = self.width();
        let before = state.to_vec();
        let mut hidden = vec![0.0; state.len() / 2];
        let each = |row: usize, _: usize, after: &[f32]| {
            hidden[row * width..][..width].copy_from_slice(after);
        };
        let kept = self.forward(Windows { steps: 1, x, state: &before, begins: &[] }, each);
        for ((state, hidden), cells) in state
            .chunks_exact_mut(2 * width)
            .zip(hidden.chunks_exact(width))
            .zip(kept.cells.chunks_exact(2 * width))
        {
            state[..width].copy_from_slice(hidden);
            state[width..].copy_from_slice(&cells[width..]);
        }
    }

    /// Adds what the hidden states before a step contribute to its gates.
    fn add_recurrent(&self, block: &mut Block<'_>, step: usize) {
        let (width, gates) = (self.width(), self.recurrent.columns());
        let rows = block.last.len() / width;
        let steps = block.hidden.len() / block.last.len();
        let used = |columns| (rows - 1) * steps * columns + columns;
        let before = &block.hidden[step * width..][..used(width)];
        let before = Matrix::strided(before, rows, width, steps * width);
        let out = &mut block.gates[step * gates..][..used(gates)];
        matmul_strided(self.level, out, steps * gates, Accumulate, before, self.recurrent);
    }
}

/// The gradients of the parameters of an LSTM, summed over blocks.
pub(super) struct GradientSums {
    /// Input weight `[I, 4 H]`, bias `[4 H]` and recurrent weight `[H, 4 H]`.
    pub sums: Vec<f32>,
    /// `[BLOCK, H]`
    hidden: Vec<f32>,
    /// `[BLOCK, H]`
    cells: Vec<f32>,
    /// `[BLOCK, T, 4 H]`
    gates: Vec<f32>,
}

impl GradientSums {
    /// Zeros, for windows of `steps`.
    pub fn new(inputs: usize, width: usize, steps: usize) -> Self {
        let zeros = |length| vec![0.0; BLOCK * length];
        Self {
            sums: vec![0.0; (inputs + 1 + width) * 4 * width],
            hidden: zeros(width),
            cells: zeros(width),
            gates: zeros(steps * 4 * width),
        }
    }

    /// Adds the gradients of a block. `gradient_of` adds the gradients of the hidden states after a step, `[M, H]`.
    ///
    /// # Shapes
    /// back: the recurrent weight, transposed, `[4 H, H]`
    pub fn add(
        &mut self,
        level: Level,
        windows: Windows<'_>,
        kept: &BlockActivations,
        back: Matrix<'_>,
        mut gradient_of: impl FnMut(usize, &mut [f32]),
    ) {
        let (columns, width, steps) = (back.rows(), back.columns(), windows.steps);
        let rows = kept.hidden.len() / steps / width;
        let hidden = &mut self.hidden[..rows * width];
        let cells = &mut self.cells[..rows * width];
        let gates = &mut self.gates[..rows * steps * columns];
        let saved = Saved { steps, width, gates: &kept.gates, cells: &kept.cells };
        hidden.fill(0.0);
        cells.fill(0.0);
        for step in (0..steps).rev() {
            gradient_of(step, hidden);
            step_backward(level, &saved, &mut Gradients { hidden, cells, gates }, step);
            if step > 0 {
                let used = (rows - 1) * steps * columns + columns;
                let entering = &gates[step * columns..][..used];
                let entering = Matrix::strided(entering, rows, columns, steps * columns);
                matmul(level, hidden, Overwrite, entering, back);
            }
            for row in (0..rows).filter(|row| windows.begins(*row, step)) {
                hidden[row * width..][..width].fill(0.0);
                cells[row * width..][..width].fill(0.0);
            }
        }
        let inputs = windows.x.len() / (rows * steps);
        let gates_matrix = Matrix::new(gates, rows * steps, columns);
        let (input, rest) = self.sums.split_at_mut(inputs * columns);
        let (bias, recurrent) = rest.split_at_mut(columns);
        let x = Matrix::new(windows.x, rows * steps, inputs);
        matmul(level, input, Accumulate, x.transposed(), gates_matrix);
        column_sums(level, gates, bias);
        let before = Matrix::new(&kept.hidden, rows * steps, width);
        matmul(level, recurrent, Accumulate, before.transposed(), gates_matrix);
    }
}
