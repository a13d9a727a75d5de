//! Elementwise loops of an LSTM: one time step of a block of windows, forward and backward.
//!
//! Hochreiter and Schmidhuber (1997) with the forget gate of Gers et al. (2000):
//!
//! ```text
//! i = σ(aᵢ)   f = σ(a_f)   g = tanh(a_g)   o = σ(aₒ)      a = W x + U h' + b
//! c = f c' + i g           h = o tanh(c)
//! ```
//!
//! The four gates of a row lie side by side in the order `i f g o`, which is PyTorch's.

#![expect(
    clippy::inline_always,
    reason = "a body is compiled for an instruction set only inside the function that enables it"
)]

use super::elementwise::multiply_add;
use super::level::for_every_level;
use super::tanh::tanh;

/// Units computed at once by the backward pass.
const LANES: usize = 16;

/// The stored results of a block of M windows of T steps; H is the width of the hidden state.
pub(super) struct Block<'a> {
    /// Gates `[M, T, 4 H]`: first what enters them without bias, then their activations.
    pub gates: &'a mut [f32],
    /// Cell states before and after every step `[M, T, 2, H]`; those before the first step are given.
    pub cells: &'a mut [f32],
    /// Hidden states before every step `[M, T, H]`; those before the first step are given.
    pub hidden: &'a mut [f32],
    /// Hidden states after the last step `[M, H]`.
    pub last: &'a mut [f32],
}

/// What the backward pass reads of a block of M windows.
pub(super) struct Saved<'a> {
    /// T.
    pub steps: usize,
    /// H.
    pub width: usize,
    /// Activations of the gates `[M, T, 4 H]`.
    pub gates: &'a [f32],
    /// Cell states before and after every step `[M, T, 2, H]`.
    pub cells: &'a [f32],
}

/// What the backward pass of a block writes.
pub(super) struct Gradients<'a> {
    /// Gradients of the hidden states after the step `[M, H]`; only read.
    pub hidden: &'a [f32],
    /// Gradients of the cell states after the step, turned into those before it, `[M, H]`.
    pub cells: &'a mut [f32],
    /// Gradients of what enters the gates `[M, T, 4 H]`, of which one step is written.
    pub gates: &'a mut [f32],
}

#[inline(always)]
fn sigmoid<const FMA: bool>(x: f32) -> f32 {
    multiply_add::<FMA>(0.5, tanh::<FMA>(0.5 * x), 0.5)
}

/// The four equal parts of a row of gates.
#[inline(always)]
fn quarters(row: &[f32]) -> [&[f32]; 4] {
    let (front, back) = row.split_at(row.len() / 2);
    let (a, b) = front.split_at(front.len() / 2);
    let (c, d) = back.split_at(back.len() / 2);
    [a, b, c, d]
}

#[inline(always)]
fn quarters_mut(row: &mut [f32]) -> [&mut [f32]; 4] {
    let (front, back) = row.split_at_mut(row.len() / 2);
    let (a, b) = front.split_at_mut(front.len() / 2);
    let (c, d) = back.split_at_mut(back.len() / 2);
    [a, b, c, d]
}

#[inline(always)]
fn step_forward_body<const FMA: bool>(block: &mut Block<'_>, bias: &[f32], step: usize) {
    let width = bias.len() / 4;
    let rows = block.last.len() / width;
    let steps = block.hidden.len() / block.last.len();
    for row in 0..rows {
        let gates = &mut block.gates[(row * steps + step) * 4 * width..][..4 * width];
        for (index, (gate, bias)) in quarters_mut(gates).into_iter().zip(quarters(bias)).enumerate() {
            if index == 2 {
                gate.iter_mut().zip(bias).for_each(|(x, b)| *x = tanh::<FMA>(*x + *b));
            } else {
                gate.iter_mut().zip(bias).for_each(|(x, b)| *x = sigmoid::<FMA>(*x + *b));
            }
        }
        let [i, f, g, o] = quarters(gates);
        let (cells, later) = block.cells[(row * steps + step) * 2 * width..].split_at_mut(2 * width);
        let (before, after) = cells.split_at_mut(width);
        for ((((after, before), i), f), g) in after.iter_mut().zip(before).zip(i).zip(f).zip(g) {
            *after = multiply_add::<FMA>(*f, *before, i * g);
        }
        let hidden = if step + 1 < steps {
            later[..width].copy_from_slice(after);
            &mut block.hidden[(row * steps + step + 1) * width..][..width]
        } else {
            &mut block.last[row * width..][..width]
        };
        for ((hidden, o), cell) in hidden.iter_mut().zip(o).zip(after) {
            *hidden = o * tanh::<FMA>(*cell);
        }
    }
}

/// Gradients of one unit, given its gates, its cell states and the gradients of its states after the step: of
/// what enters `i`, `f`, `g` and `o`, and of the cell state before the step.
#[inline(always)]
fn unit_backward<const FMA: bool>(
    [i, f, g, o]: [f32; 4],
    [before, after]: [f32; 2],
    hidden: f32,
    cell: f32,
) -> [f32; 5] {
    let tanh_cell = tanh::<FMA>(after);
    let cell = cell + hidden * o * (1.0 - tanh_cell * tanh_cell);
    [
        cell * g * i * (1.0 - i),
        cell * before * f * (1.0 - f),
        cell * i * (1.0 - g * g),
        hidden * tanh_cell * o * (1.0 - o),
        cell * f,
    ]
}

#[inline(always)]
fn step_backward_body<const FMA: bool>(saved: &Saved<'_>, gradients: &mut Gradients<'_>, step: usize) {
    let &Saved { steps, width, .. } = saved;
    let states = gradients.hidden.chunks_exact(width).zip(gradients.cells.chunks_exact_mut(width));
    for (row, (hidden, cell)) in states.enumerate() {
        let at = (row * steps + step) * 4 * width;
        let gates = quarters(&saved.gates[at..at + 4 * width]);
        let [di, df, dg, d_o] = quarters_mut(&mut gradients.gates[at..at + 4 * width]);
        let mut outputs = [di, df, dg, d_o, cell];
        let cells = &saved.cells[(row * steps + step) * 2 * width..][..2 * width];
        let (before, after) = cells.split_at(width);
        // A compiler cannot see that twelve slices do not overlap and would compute one unit at a time, but it
        // sees that arrays do not.
        let full = width / LANES * LANES;
        for at in (0..full).step_by(LANES) {
            let load = |from: &[f32]| {
                let mut lanes = [0.0; LANES];
                lanes.copy_from_slice(&from[at..at + LANES]);
                lanes
            };
            let (gates, before, after) = (gates.map(load), load(before), load(after));
            let (hidden, cell) = (load(hidden), load(outputs[4]));
            let mut results = [[0.0; LANES]; 5];
            for lane in 0..LANES {
                let gates = [gates[0][lane], gates[1][lane], gates[2][lane], gates[3][lane]];
                let cells = [before[lane], after[lane]];
                let unit = unit_backward::<FMA>(gates, cells, hidden[lane], cell[lane]);
                results[0][lane] = unit[0];
                results[1][lane] = unit[1];
                results[2][lane] = unit[2];
                results[3][lane] = unit[3];
                results[4][lane] = unit[4];
            }
            for (output, result) in outputs.iter_mut().zip(&results) {
                output[at..at + LANES].copy_from_slice(result);
            }
        }
        for at in full..width {
            let cells = [before[at], after[at]];
            let unit = unit_backward::<FMA>(gates.map(|gate| gate[at]), cells, hidden[at], outputs[4][at]);
            for (output, value) in outputs.iter_mut().zip(unit) {
                output[at] = value;
            }
        }
    }
}

for_every_level! {
    /// One time step: adds the bias to what enters the gates and computes gates, cell and hidden states.
    ///
    /// # Shapes
    /// bias `[4 H]`
    fn step_forward(block: &mut Block<'_>, bias: &[f32], step: usize) = step_forward_body;
}
for_every_level! {
    /// The backward pass of one time step: from the gradients of hidden and cell states after it to those
    /// of what enters its gates and of the cell states before it.
    fn step_backward(saved: &Saved<'_>, gradients: &mut Gradients<'_>, step: usize) = step_backward_body;
}
