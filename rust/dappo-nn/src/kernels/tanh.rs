//! tanh, and a bias with a tanh after it.

#![expect(
    clippy::inline_always,
    reason = "a body is compiled for an instruction set only inside the function that enables it"
)]

use super::Level;
use super::elementwise::multiply_add;
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

/// `rows = tanh(rows + bias)`, in place.
///
/// # Shapes
/// rows `[M, W]`, bias `[W]`
pub(super) fn bias_tanh(level: Level, rows: &mut [f32], bias: &[f32]) {
    #[cfg(target_arch = "x86_64")]
    if level.simd() == dappo_sim::simd::Simd::Avx512 {
        // SAFETY: a `Level` of this kind exists only if the machine reported AVX-512 F, and every such machine has FMA.
        unsafe { avx512::bias_tanh(rows, bias) };
        return;
    }
    divided(level, rows, bias);
}

for_every_level! {
    /// The same with a division for every number.
    fn divided(rows: &mut [f32], bias: &[f32]) = bias_tanh_body;
}

/// The same with an estimate of the reciprocal in the place of a division, which takes longer than all the rest.
#[cfg(target_arch = "x86_64")]
mod avx512 {
    use std::arch::x86_64::{
        __m512, __mmask16, _mm512_add_ps, _mm512_fmadd_ps, _mm512_fnmadd_ps, _mm512_mask_storeu_ps,
        _mm512_maskz_loadu_ps, _mm512_max_ps, _mm512_min_ps, _mm512_mul_ps, _mm512_rcp14_ps, _mm512_set1_ps,
    };

    use super::{CLAMP_FMA, DENOMINATOR, NUMERATOR};

    /// Numbers in a register.
    const LANES: usize = 16;

    #[target_feature(enable = "avx512f,fma")]
    pub fn bias_tanh(rows: &mut [f32], bias: &[f32]) {
        for row in rows.chunks_exact_mut(bias.len()) {
            for (x, b) in row.chunks_mut(LANES).zip(bias.chunks(LANES)) {
                let mask = __mmask16::MAX >> (LANES - x.len());
                // SAFETY: the numbers of `mask` are those of the two chunks, which are of one length.
                unsafe {
                    let sum = _mm512_add_ps(
                        _mm512_maskz_loadu_ps(mask, x.as_ptr()),
                        _mm512_maskz_loadu_ps(mask, b.as_ptr()),
                    );
                    _mm512_mask_storeu_ps(x.as_mut_ptr(), mask, tanh(sum));
                }
            }
        }
    }

    #[inline]
    #[target_feature(enable = "avx512f,fma")]
    fn tanh(x: __m512) -> __m512 {
        let x = clamp(x, CLAMP_FMA);
        let square = _mm512_mul_ps(x, x);
        let numerator = _mm512_mul_ps(x, horner(&NUMERATOR, square));
        let denominator = horner(&DENOMINATOR, square);
        // The estimate has 14 bits; a step of Newton's method doubles them.
        let estimate = _mm512_rcp14_ps(denominator);
        let error = _mm512_fnmadd_ps(denominator, estimate, _mm512_set1_ps(1.0));
        let reciprocal = _mm512_fmadd_ps(error, estimate, estimate);
        // Rounding may have gone beyond ±1.
        clamp(_mm512_mul_ps(numerator, reciprocal), 1.0)
    }

    /// `x` within ±`bound`. Of a NaN and a number, minimum and maximum are the second argument.
    #[inline]
    #[target_feature(enable = "avx512f")]
    fn clamp(x: __m512, bound: f32) -> __m512 {
        _mm512_max_ps(_mm512_set1_ps(-bound), _mm512_min_ps(_mm512_set1_ps(bound), x))
    }

    #[inline]
    #[target_feature(enable = "avx512f,fma")]
    fn horner(coefficients: &[f32], x: __m512) -> __m512 {
        let mut value = _mm512_set1_ps(coefficients[0]);
        for coefficient in &coefficients[1..] {
            value = _mm512_fmadd_ps(value, x, _mm512_set1_ps(*coefficient));
        }
        value
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tanh_of(level: Level, xs: &[f32]) -> Vec<f32> {
        let mut values = xs.to_vec();
        bias_tanh(level, &mut values, &vec![0.0; xs.len()]);
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
}
