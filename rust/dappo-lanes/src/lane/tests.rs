//! Every lane type against plain numbers.

use super::{Lane, Mask};
use crate::engine::Simd;
use crate::math::sin_cos;

/// Numbers of all kinds, more than any register holds.
const SAMPLES: [f64; 16] = [
    0.0,
    -0.0,
    1.0,
    -1.5,
    2.5,
    3.5,
    1e-30,
    -1e30,
    0.1,
    123.456,
    -0.75,
    7.0,
    f64::INFINITY,
    f64::NAN,
    -2.0,
    0.5,
];

/// Runs a check for every lane type of this processor.
macro_rules! for_each_lane_type {
    ($check:ident) => {
        #[cfg(target_arch = "x86_64")]
        {
            use super::{avx2, avx512};
            if Simd::Avx512.is_available() {
                $check::<avx512::F32x16>();
                $check::<avx512::F64x8>();
            }
            if Simd::Avx2.is_available() {
                $check::<avx2::F32x8>();
                $check::<avx2::F64x4>();
            }
        }
        #[cfg(target_arch = "aarch64")]
        {
            use super::neon;
            assert!(Simd::Neon.is_available());
            $check::<neon::F32x4>();
            $check::<neon::F64x2>();
        }
        assert!(Simd::Portable.is_available());
        $check::<super::portable::F32x4>();
        $check::<super::portable::F64x4>();
    };
}

/// Rounds to the format of a lane type.
fn rounded<T: Lane>(value: f64) -> f64 {
    if T::DOUBLE { value } else { f64::from(value as f32) }
}

fn fused<T: Lane>(a: f64, b: f64, c: f64) -> f64 {
    if T::DOUBLE { a.mul_add(b, c) } else { f64::from((a as f32).mul_add(b as f32, c as f32)) }
}

fn fill<T: Lane>(offset: usize) -> T {
    let mut lanes = T::zero();
    for lane in 0..T::WIDTH {
        lanes.set(lane, SAMPLES[(lane + offset) % SAMPLES.len()]);
    }
    lanes
}

fn assert_same<T: Lane>(what: &str, lanes: T, expected: impl Fn(usize) -> f64) {
    for lane in 0..T::WIDTH {
        let (got, expected) = (lanes.get(lane), expected(lane));
        let same = got.to_bits() == expected.to_bits() || (got.is_nan() && expected.is_nan());
        assert!(same, "{what} in lane {lane} of {}: got {got}, expected {expected}", T::WIDTH);
    }
}

fn arithmetic<T: Lane>() {
    for offset in 0..SAMPLES.len() {
        let (a, b, c) = (fill::<T>(0), fill::<T>(offset), fill::<T>(offset / 2));
        let (x, y, z) = (|lane| a.get(lane), |lane| b.get(lane), |lane| c.get(lane));
        // A sum, product or quotient of singles, rounded from doubles, is the correctly rounded one.
        let op = |f: fn(f64, f64) -> f64| move |lane| rounded::<T>(f(a.get(lane), b.get(lane)));
        assert_same("a + b", T::run(|| a + b), op(|x, y| x + y));
        assert_same("a - b", T::run(|| a - b), op(|x, y| x - y));
        assert_same("a * b", T::run(|| a * b), op(|x, y| x * y));
        assert_same("a / b", T::run(|| a / b), op(|x, y| x / y));
        assert_same("-a", T::run(|| -a), |lane| 0.0 - x(lane));
        assert_same("a * b + c", a.mul_add(b, c), |lane| fused::<T>(x(lane), y(lane), z(lane)));
        assert_same("c - a * b", a.neg_mul_add(b, c), |lane| fused::<T>(-x(lane), y(lane), z(lane)));
        assert_same("sqrt a", a.sqrt(), |lane| rounded::<T>(x(lane).sqrt()));
        assert_same("|a|", a.abs(), |lane| x(lane).abs());
        assert_same("round a", a.round(), |lane| x(lane).round_ties_even());
        assert_same("min", a.min(b), |lane| if x(lane) < y(lane) { x(lane) } else { y(lane) });
        assert_same("max", a.max(b), |lane| if x(lane) > y(lane) { x(lane) } else { y(lane) });
        assert_same(
            "select",
            T::select(a.lt(b), a, b),
            |lane| if x(lane) < y(lane) { x(lane) } else { y(lane) },
        );
    }
    assert!(T::of(f64::NAN).clamp(T::zero(), T::of(1.0)).get(0).is_nan(), "clamp hides a NaN");
}

#[test]
fn lanes_compute_what_numbers_compute() {
    for_each_lane_type!(arithmetic);
}

fn masks<T: Lane>() {
    let bits = |mask: T::Mask| {
        let chosen = T::select(mask, T::of(1.0), T::zero());
        (0..T::WIDTH).filter(|&lane| chosen.get(lane) == 1.0).fold(0_u32, |bits, lane| bits | 1 << lane)
    };
    let (a, b) = (0b0110_1001_0110_0101, 0b1010_0110_1100_0011);
    let in_width = (1 << T::WIDTH) - 1;
    let (x, y) = (T::Mask::from_bits(a), T::Mask::from_bits(b));
    assert_eq!(bits(x), a & in_width);
    assert_eq!(bits(x & y), a & b & in_width);
    assert_eq!(bits(x | y), (a | b) & in_width);
    assert_eq!(bits(x ^ y), (a ^ b) & in_width);
    assert_eq!(bits(!x), !a & in_width);
    assert!(x.any() && !T::Mask::none().any() && !(x & !x).any());
}

#[test]
fn masks_compute_what_bits_compute() {
    for_each_lane_type!(masks);
}

fn sines<T: Lane>() {
    let (relative, largest) = if T::DOUBLE { (3e-16, 1e4) } else { (1.5e-7, 1e2) };
    for step in 0..20_000 {
        let x = rounded::<T>(largest * (f64::from(step) / 10_000.0 - 1.0));
        let (sin, cos) = sin_cos(T::of(x));
        // The reduction's last bit of the multiple of π/2 grows with |x|.
        let tolerance = relative * (1.0 + x.abs() * if T::DOUBLE { 1e-3 } else { 0.0 });
        assert!((sin.get(0) - x.sin()).abs() <= tolerance, "sin {x}: {} instead of {}", sin.get(0), x.sin());
        assert!((cos.get(0) - x.cos()).abs() <= tolerance, "cos {x}: {} instead of {}", cos.get(0), x.cos());
    }
}

#[test]
fn sine_and_cosine_are_those_of_the_standard_library() {
    for_each_lane_type!(sines);
}
