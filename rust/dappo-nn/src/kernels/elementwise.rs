//! Elementwise loops: bias, the derivative of tanh, column sums.

#![expect(
    clippy::inline_always,
    reason = "a body is compiled for an instruction set only inside the function that enables it"
)]

use super::level::for_every_level;

/// `a · b + c`.
#[inline(always)]
pub(super) fn multiply_add<const FMA: bool>(a: f32, b: f32, c: f32) -> f32 {
    if FMA { a.mul_add(b, c) } else { a * b + c }
}

#[inline(always)]
fn bias_add_body<const FMA: bool>(rows: &mut [f32], bias: &[f32]) {
    for row in rows.chunks_exact_mut(bias.len()) {
        for (x, b) in row.iter_mut().zip(bias) {
            *x += *b;
        }
    }
}

#[inline(always)]
fn tanh_backward_body<const FMA: bool>(gradient: &mut [f32], output: &[f32], bias_gradient: &mut [f32]) {
    let width = bias_gradient.len();
    for (gradient, output) in gradient.chunks_exact_mut(width).zip(output.chunks_exact(width)) {
        for ((g, y), sum) in gradient.iter_mut().zip(output).zip(bias_gradient.iter_mut()) {
            *g *= 1.0 - *y * *y;
            *sum += *g;
        }
    }
}

#[inline(always)]
fn column_sums_body<const FMA: bool>(rows: &[f32], sums: &mut [f32]) {
    for row in rows.chunks_exact(sums.len()) {
        for (sum, x) in sums.iter_mut().zip(row) {
            *sum += *x;
        }
    }
}

for_every_level! {
    /// `rows += bias`.
    ///
    /// # Shapes
    /// rows `[M, W]`, bias `[W]`
    fn bias_add(rows: &mut [f32], bias: &[f32]) = bias_add_body;
}
for_every_level! {
    /// Turns the gradient of a tanh's output into that of its input, `gradient *= 1 − output²`, and adds
    /// the column sums of the result to the gradient of the bias.
    ///
    /// # Shapes
    /// gradient `[M, W]`, output `[M, W]`, `bias_gradient` `[W]`
    fn tanh_backward(gradient: &mut [f32], output: &[f32], bias_gradient: &mut [f32]) = tanh_backward_body;
}
for_every_level! {
    /// Adds the column sums of `rows` to `sums`.
    ///
    /// # Shapes
    /// rows `[M, W]`, sums `[W]`
    fn column_sums(rows: &[f32], sums: &mut [f32]) = column_sums_body;
}

#[cfg(test)]
mod tests {
    use super::super::Level;
    use super::super::tanh::bias_tanh;
    use super::*;

    #[test]
    fn all_levels_agree_on_every_kernel() {
        let rows: Vec<f32> = (0..33 * 37).map(|i| (i as f32 * 0.37).sin() * 3.0).collect();
        let bias: Vec<f32> = (0..37).map(|i| (i as f32).cos()).collect();
        let run = |level| {
            let mut activation = rows.clone();
            bias_tanh(level, &mut activation, &bias);
            let mut gradient: Vec<f32> = rows.iter().map(|x| x.cos()).collect();
            let mut bias_gradient = vec![0.0; 37];
            tanh_backward(level, &mut gradient, &activation, &mut bias_gradient);
            let mut sums = bias.clone();
            column_sums(level, &gradient, &mut sums);
            bias_add(level, &mut gradient, &bias);
            [activation, gradient, bias_gradient, sums]
        };
        let expected = run(Level::available()[0]);
        // Column sums add up the differences of 33 rows.
        let tolerances = [1e-6, 1e-6, 33e-6, 33e-6];
        for level in Level::available() {
            for ((got, expected), tolerance) in run(level).iter().zip(&expected).zip(tolerances) {
                for (got, expected) in got.iter().zip(expected) {
                    let error = (got - expected).abs();
                    assert!(
                        error <= tolerance * expected.abs().max(1.0),
                        "{level:?}: {got}, expected {expected}"
                    );
                }
            }
        }
    }
}
