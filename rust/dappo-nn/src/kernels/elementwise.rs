//! Elementwise loops: bias and tanh, their derivatives, column sums.

#![expect(
    clippy::inline_always,
    reason = "a body is compiled for an instruction set only inside the function that enables it"
)]

use super::level::for_every_level;

/// Beyond this |x|, tanh(x) rounds to ±1 and the approximation below is not used.
/// Without fused multiply-add the rational function exceeds 1 a little earlier.
const CLAMP_FMA: f32 = 7.998_811_7;
const CLAMP_NO_FMA: f32 = 7.905_311;

/// Numerator coefficients of x¹, x³ … x¹³, highest power first.
///
/// The rational approximation 13/6 of tanh used by Eigen (`MathFunctionsImpl.h`,
/// `generic_fast_tanh_float`); its absolute error is below 5e-7 for every f32.
const NUMERATOR: [f32; 7] = [
    -2.760_768_5e-16,
    2.000_188e-13,
    -8.604_672e-11,
    5.122_297_1e-8,
    1.485_722_4e-5,
    6.372_619_3e-4,
    4.893_524_6e-3,
];

/// Denominator coefficients of x⁰, x² … x⁶, highest power first.
const DENOMINATOR: [f32; 4] = [1.198_258_4e-6, 1.185_347_1e-4, 2.268_434_6e-3, 4.893_525e-3];

/// `a · b + c`.
#[inline(always)]
pub(super) fn multiply_add<const FMA: bool>(a: f32, b: f32, c: f32) -> f32 {
    if FMA { a.mul_add(b, c) } else { a * b + c }
}

#[inline(always)]
fn horner<const FMA: bool>(coefficients: &[f32], x: f32) -> f32 {
    let mut value = coefficients[0];
    for coefficient in &coefficients[1..] {
        value = multiply_add::<FMA>(value, x, *coefficient);
    }
    value
}

/// tanh(x) to 5e-7.
#[inline(always)]
pub(super) fn tanh<const FMA: bool>(x: f32) -> f32 {
    let bound = if FMA { CLAMP_FMA } else { CLAMP_NO_FMA };
    let x = x.clamp(-bound, bound);
    let square = x * x;
    x * horner::<FMA>(&NUMERATOR, square) / horner::<FMA>(&DENOMINATOR, square)
}

#[inline(always)]
fn bias_tanh_body<const FMA: bool>(rows: &mut [f32], bias: &[f32]) {
    for row in rows.chunks_exact_mut(bias.len()) {
        for (x, b) in row.iter_mut().zip(bias) {
            *x = tanh::<FMA>(*x + *b);
        }
    }
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
    /// `rows = tanh(rows + bias)`, in place.
    ///
    /// # Shapes
    /// rows `[M, W]`, bias `[W]`
    fn bias_tanh(rows: &mut [f32], bias: &[f32]) = bias_tanh_body;
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
    use super::*;

    fn tanh_of(level: Level, xs: &[f32]) -> Vec<f32> {
        let mut values = xs.to_vec();
        bias_tanh(level, &mut values, &[0.0]);
        values
    }

    #[test]
    fn tanh_agrees_with_the_f64_function_on_a_dense_grid_at_every_level() {
        let xs: Vec<f32> = (-240_000..=240_000).map(|i| i as f32 * 5e-5).collect();
        for level in Level::available() {
            for (x, y) in xs.iter().zip(tanh_of(level, &xs)) {
                let expected = f64::from(*x).tanh();
                let error = (f64::from(y) - expected).abs();
                assert!(error <= 5e-7, "{level:?}: tanh({x}) = {y}, expected {expected}");
                assert!(y.abs() <= 1.0, "{level:?}: |tanh({x})| = {y} exceeds 1");
            }
        }
    }

    #[test]
    fn tanh_keeps_small_arguments_saturates_large_ones_and_passes_nan_on() {
        for level in Level::available() {
            let y = tanh_of(level, &[0.0, 1e-6, -1e-6, 50.0, -50.0, f32::INFINITY, f32::NAN]);
            assert_eq!(y[0], 0.0, "{level:?}");
            assert!((y[1] / 1e-6 - 1.0).abs() < 1e-6 && y[2] == -y[1], "{level:?}: {y:?}");
            assert!((y[3] - 1.0).abs() < 3e-7 && y[4] == -y[3] && y[5] == y[3], "{level:?}: {y:?}");
            assert!(y[6].is_nan(), "{level:?}: {y:?}");
        }
    }

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
