//! Lanes in AVX registers, with AVX2 and FMA.

// SAFETY of every block in this file: values of these types are made only by an engine for `Simd::Avx2`,
// which exists only on processors that have these instructions (see `engine::Engine::new`).
#![expect(clippy::undocumented_unsafe_blocks, reason = "one reason for all, given above")]
#![allow(clippy::wildcard_imports, reason = "as the documentation of the intrinsics does")]

use std::arch::x86_64::*;
use std::ops::{Add, AddAssign, BitAnd, BitOr, BitXor, Div, Mul, Neg, Not, Sub, SubAssign};

use super::{Lane, Mask};

macro_rules! avx2_lane {
    ($name:ident, $mask:ident, $register:ty, $scalar:ty, $width:literal, $double:literal, $integer:ty,
     $set1:ident, $add:ident, $sub:ident, $mul:ident, $div:ident, $fmadd:ident, $fnmadd:ident, $sqrt:ident,
     $min:ident, $max:ident, $andnot:ident, $round:ident, $cmp:ident, $blend:ident,
     $and:ident, $or:ident, $xor:ident, $movemask:ident) => {
        #[doc = concat!(stringify!($width), " truth values, all bits of a number set for true.")]
        #[derive(Clone, Copy)]
        #[repr(transparent)]
        pub struct $mask($register);

        impl BitAnd for $mask {
            type Output = Self;
            #[inline(always)]
            fn bitand(self, other: Self) -> Self {
                unsafe { Self($and(self.0, other.0)) }
            }
        }
        impl BitOr for $mask {
            type Output = Self;
            #[inline(always)]
            fn bitor(self, other: Self) -> Self {
                unsafe { Self($or(self.0, other.0)) }
            }
        }
        impl BitXor for $mask {
            type Output = Self;
            #[inline(always)]
            fn bitxor(self, other: Self) -> Self {
                unsafe { Self($xor(self.0, other.0)) }
            }
        }
        impl Not for $mask {
            type Output = Self;
            #[inline(always)]
            fn not(self) -> Self {
                unsafe { Self($xor(self.0, $set1(<$scalar>::from_bits(!0)))) }
            }
        }
        impl Mask for $mask {
            #[inline(always)]
            fn none() -> Self {
                unsafe { Self($set1(0.0)) }
            }
            #[inline(always)]
            fn from_bits(bits: u32) -> Self {
                let lanes: [$integer; $width] =
                    std::array::from_fn(|lane| if bits >> lane & 1 == 1 { !0 } else { 0 });
                unsafe { Self(std::mem::transmute::<[$integer; $width], $register>(lanes)) }
            }
            #[inline(always)]
            fn any(self) -> bool {
                unsafe { $movemask(self.0) != 0 }
            }
        }

        #[doc = concat!(stringify!($width), " numbers of type `", stringify!($scalar), "`.")]
        #[derive(Clone, Copy)]
        #[repr(transparent)]
        pub struct $name($register);

        impl Add for $name {
            type Output = Self;
            #[inline(always)]
            fn add(self, other: Self) -> Self {
                unsafe { Self($add(self.0, other.0)) }
            }
        }
        impl Sub for $name {
            type Output = Self;
            #[inline(always)]
            fn sub(self, other: Self) -> Self {
                unsafe { Self($sub(self.0, other.0)) }
            }
        }
        impl Mul for $name {
            type Output = Self;
            #[inline(always)]
            fn mul(self, other: Self) -> Self {
                unsafe { Self($mul(self.0, other.0)) }
            }
        }
        impl Div for $name {
            type Output = Self;
            #[inline(always)]
            fn div(self, other: Self) -> Self {
                unsafe { Self($div(self.0, other.0)) }
            }
        }
        impl Neg for $name {
            type Output = Self;
            #[inline(always)]
            fn neg(self) -> Self {
                unsafe { Self($sub($set1(0.0), self.0)) }
            }
        }
        impl AddAssign for $name {
            #[inline(always)]
            fn add_assign(&mut self, other: Self) {
                *self = *self + other;
            }
        }
        impl SubAssign for $name {
            #[inline(always)]
            fn sub_assign(&mut self, other: Self) {
                *self = *self - other;
            }
        }

        impl Lane for $name {
            const WIDTH: usize = $width;
            const DOUBLE: bool = $double;
            type Mask = $mask;
            type Scalar = $scalar;

            #[inline(always)]
            fn scalar(value: f64) -> $scalar {
                value as $scalar
            }
            #[inline(always)]
            fn splat(value: $scalar) -> Self {
                unsafe { Self($set1(value)) }
            }
            #[inline(always)]
            fn mul_add(self, factor: Self, addend: Self) -> Self {
                unsafe { Self($fmadd(self.0, factor.0, addend.0)) }
            }
            #[inline(always)]
            fn neg_mul_add(self, factor: Self, minuend: Self) -> Self {
                unsafe { Self($fnmadd(self.0, factor.0, minuend.0)) }
            }
            #[inline(always)]
            fn sqrt(self) -> Self {
                unsafe { Self($sqrt(self.0)) }
            }
            #[inline(always)]
            fn min(self, other: Self) -> Self {
                unsafe { Self($min(self.0, other.0)) }
            }
            #[inline(always)]
            fn max(self, other: Self) -> Self {
                unsafe { Self($max(self.0, other.0)) }
            }
            #[inline(always)]
            fn abs(self) -> Self {
                unsafe { Self($andnot($set1(-0.0), self.0)) }
            }
            #[inline(always)]
            fn round(self) -> Self {
                unsafe { Self($round::<{ _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC }>(self.0)) }
            }
            #[inline(always)]
            fn lt(self, other: Self) -> $mask {
                unsafe { $mask($cmp::<_CMP_LT_OQ>(self.0, other.0)) }
            }
            #[inline(always)]
            fn select(mask: $mask, yes: Self, no: Self) -> Self {
                unsafe { Self($blend(no.0, yes.0, mask.0)) }
            }
            #[inline(always)]
            fn get(&self, lane: usize) -> f64 {
                // A register is laid out in memory as an array of its numbers.
                let numbers: &[$scalar; $width] = unsafe { &*std::ptr::from_ref(self).cast() };
                f64::from(numbers[lane])
            }
            #[inline(always)]
            fn set(&mut self, lane: usize, value: f64) {
                let numbers: &mut [$scalar; $width] = unsafe { &mut *std::ptr::from_mut(self).cast() };
                numbers[lane] = value as $scalar;
            }
            #[inline(always)]
            fn run<R>(function: impl FnOnce() -> R) -> R {
                #[inline(never)]
                #[target_feature(enable = "avx2,fma,bmi1,bmi2")]
                fn compiled<R>(function: impl FnOnce() -> R) -> R {
                    function()
                }
                unsafe { compiled(function) }
            }
        }
    };
}

avx2_lane!(
    F32x8,
    Mask8,
    __m256,
    f32,
    8,
    false,
    u32,
    _mm256_set1_ps,
    _mm256_add_ps,
    _mm256_sub_ps,
    _mm256_mul_ps,
    _mm256_div_ps,
    _mm256_fmadd_ps,
    _mm256_fnmadd_ps,
    _mm256_sqrt_ps,
    _mm256_min_ps,
    _mm256_max_ps,
    _mm256_andnot_ps,
    _mm256_round_ps,
    _mm256_cmp_ps,
    _mm256_blendv_ps,
    _mm256_and_ps,
    _mm256_or_ps,
    _mm256_xor_ps,
    _mm256_movemask_ps
);
avx2_lane!(
    F64x4,
    Mask4,
    __m256d,
    f64,
    4,
    true,
    u64,
    _mm256_set1_pd,
    _mm256_add_pd,
    _mm256_sub_pd,
    _mm256_mul_pd,
    _mm256_div_pd,
    _mm256_fmadd_pd,
    _mm256_fnmadd_pd,
    _mm256_sqrt_pd,
    _mm256_min_pd,
    _mm256_max_pd,
    _mm256_andnot_pd,
    _mm256_round_pd,
    _mm256_cmp_pd,
    _mm256_blendv_pd,
    _mm256_and_pd,
    _mm256_or_pd,
    _mm256_xor_pd,
    _mm256_movemask_pd
);
