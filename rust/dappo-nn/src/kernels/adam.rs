//! One step of Adam in one pass over memory.

#![expect(
    clippy::inline_always,
    reason = "a body is compiled for an instruction set only inside the function that enables it"
)]

use rayon::prelude::*;

use super::Level;
use super::elementwise::multiply_add;
use super::level::for_every_level;

/// Numbers of a parameter that one thread takes at a time.
const CHUNK: usize = 16_384;

/// The numbers of a step that all parameters share; see Kingma and Ba (2015), "Adam: a method for stochastic
/// optimization", end of section 2.
#[derive(Debug, Clone, Copy)]
pub struct AdamStep {
    /// Decay of the mean, β₁.
    pub beta_1: f32,
    /// Decay of the mean square, β₂.
    pub beta_2: f32,
    /// ε̂, the guard against division by zero after the correction of the bias.
    pub epsilon: f32,
    /// αₜ, the learning rate with the correction of the bias.
    pub step_size: f32,
}

#[inline(always)]
fn step_body<const FMA: bool>(
    parameter: &mut [f32],
    gradient: &[f32],
    moment_1: &mut [f32],
    moment_2: &mut [f32],
    step: AdamStep,
) {
    let AdamStep { beta_1, beta_2, epsilon, step_size } = step;
    for (((p, g), m), v) in parameter.iter_mut().zip(gradient).zip(moment_1).zip(moment_2) {
        *m = multiply_add::<FMA>(beta_1, *m, (1.0 - beta_1) * g);
        *v = multiply_add::<FMA>(beta_2, *v, (1.0 - beta_2) * g * g);
        *p -= step_size * *m / (v.sqrt() + epsilon);
    }
}

for_every_level! {
    /// One step for a piece of a parameter; all slices have its length.
    fn step(
        parameter: &mut [f32],
        gradient: &[f32],
        moment_1: &mut [f32],
        moment_2: &mut [f32],
        step: AdamStep,
    ) = step_body;
}

/// One step of a parameter of P numbers and its moments.
///
/// # Shapes
/// parameter, gradient, moments `[P]`
///
/// # Panics
/// If the slices differ in length.
pub fn adam_step(
    level: Level,
    parameter: &mut [f32],
    gradient: &[f32],
    moment_1: &mut [f32],
    moment_2: &mut [f32],
    with: AdamStep,
) {
    let length = parameter.len();
    assert_eq!([gradient.len(), moment_1.len(), moment_2.len()], [length; 3], "a parameter of {length}");
    parameter
        .par_chunks_mut(CHUNK)
        .zip(gradient.par_chunks(CHUNK))
        .zip(moment_1.par_chunks_mut(CHUNK).zip(moment_2.par_chunks_mut(CHUNK)))
        .for_each(|((p, g), (m, v))| step(level, p, g, m, v, with));
}
