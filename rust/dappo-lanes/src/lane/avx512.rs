//! Lanes in AVX-512 registers.

// SAFETY of every block in this file: values of these types are made only by an engine for `Simd::Avx512`,
// which exists only on processors that have these instructions (see `engine::Engine::new`).
#![expect(clippy::undocumented_unsafe_blocks, reason = "one reason for all, given above")]
#![allow(clippy::wildcard_imports, reason = "as the documentation of the intrinsics does")]

use std::arch::x86_64::*;
use std::ops::{Add, AddAssign, BitAnd, BitOr, BitXor, Div, Mul, Neg, Not, Sub, SubAssign};

use super::{Lane, Mask};

macro_rules! avx512_mask {
    ($name:ident, $bits:ty) => {
        #[doc = concat!("Truth values as the bits of a `", stringify!($bits), "`.")]
        #[derive(Clone, Copy)]
        #[repr(transparent)]
        pub struct $name($bits);

        impl BitAnd for $name {
            type Output = Self;
            #[inline(always)]
            fn bitand(self, other: Self) -> Self {
                Self(self.0 & other.0)
            }
        }
        impl BitOr for $name {
            type Output = Self;
            #[inline(always)]
            fn bitor(self, other: Self) -> Self {
                Self(self.0 | other.0)
            }
        }
        impl BitXor for $name {
            type Output = Self;
            #[inline(always)]
            fn bitxor(self, other: Self) -> Self {
                Self(self.0 ^ other.0)
            }
        }
        impl Not for $name {
            type Output = Self;
            #[inline(always)]
            fn not(self) -> Self {
                Self(!self.0)
            }
        }
        impl Mask for $name {
            #[inline(always)]
            fn none() -> Self {
                Self(0)
            }
            #[inline(always)]
            fn from_bits(bits: u32) -> Self {
                Self(bits as $bits)
            }
            #[inline(always)]
            fn any(self) -> bool {
                self.0 != 0
            }
        }
    };
}

avx512_mask!(Mask16, u16);
avx512_mask!(Mask8, u8);

macro_rules! avx512_lane {
    ($name:ident, $register:ty, $scalar:ty, $width:literal, $double:literal, $mask:ident,
     $set1:ident, $add:ident, $sub:ident, $mul:ident, $div:ident, $fmadd:ident, $fnmadd:ident, $sqrt:ident,
     $min:ident, $max:ident, $abs:ident, $round:ident, $cmp:ident, $blend:ident) => {
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
                unsafe { Self($abs(self.0)) }
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
                unsafe { Self($blend(mask.0, no.0, yes.0)) }
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
                #[target_feature(enable = "avx512f,avx512dq,avx512vl,avx512bw,avx2,fma,bmi1,bmi2")]
                fn compiled<R>(function: impl FnOnce() -> R) -> R {
                    function()
                }
                unsafe { compiled(function) }
            }
        }
    };
}

avx512_lane!(
    F32x16,
    __m512,
    f32,
    16,
    false,
    Mask16,
    _mm512_set1_ps,
    _mm512_add_ps,
    _mm512_sub_ps,
    _mm512_mul_ps,
    _mm512_div_ps,
    _mm512_fmadd_ps,
    _mm512_fnmadd_ps,
    _mm512_sqrt_ps,
    _mm512_min_ps,
    _mm512_max_ps,
    _mm512_abs_ps,
    _mm512_roundscale_ps,
    _mm512_cmp_ps_mask,
    _mm512_mask_blend_ps
);
avx512_lane!(
    F64x8,
    __m512d,
    f64,
    8,
    true,
    Mask8,
    _mm512_set1_pd,
    _mm512_add_pd,
    _mm512_sub_pd,
    _mm512_mul_pd,
    _mm512_div_pd,
    _mm512_fmadd_pd,
    _mm512_fnmadd_pd,
    _mm512_sqrt_pd,
    _mm512_min_pd,
    _mm512_max_pd,
    _mm512_abs_pd,
    _mm512_roundscale_pd,
    _mm512_cmp_pd_mask,
    _mm512_mask_blend_pd
);
