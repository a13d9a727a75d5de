//! Lanes in AVX-512 registers.

// SAFETY of every block in this file: values of these types are made only by an engine for `Simd::Avx512`,
// which exists only on processors that have these instructions (see `engine::Engine::new`).
#![expect(clippy::undocumented_unsafe_blocks, reason = "one reason for all, given above")]
#![allow(clippy::wildcard_imports, reason = "as the documentation of the intrinsics does")]

use std::arch::x86_64::*;
use std::ops::{Add, AddAssign, BitAnd, BitOr, BitXor, Div, Mul, Neg, Not, Sub, SubAssign};

use super::x86::x86_lane;
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

#[inline(always)]
unsafe fn lt_ps(a: __m512, b: __m512) -> Mask16 {
    unsafe { Mask16(_mm512_cmp_ps_mask::<_CMP_LT_OQ>(a, b)) }
}

#[inline(always)]
unsafe fn select_ps(mask: Mask16, yes: __m512, no: __m512) -> __m512 {
    unsafe { _mm512_mask_blend_ps(mask.0, no, yes) }
}

#[inline(always)]
unsafe fn lt_pd(a: __m512d, b: __m512d) -> Mask8 {
    unsafe { Mask8(_mm512_cmp_pd_mask::<_CMP_LT_OQ>(a, b)) }
}

#[inline(always)]
unsafe fn select_pd(mask: Mask8, yes: __m512d, no: __m512d) -> __m512d {
    unsafe { _mm512_mask_blend_pd(mask.0, no, yes) }
}

x86_lane!(
    F32x16, Mask16: 16 x f32 in __m512, "avx512f,avx512dq,avx512vl,avx512bw,avx2,fma,bmi1,bmi2",
    _mm512_set1_ps, _mm512_add_ps, _mm512_sub_ps, _mm512_mul_ps, _mm512_div_ps, _mm512_fmadd_ps, _mm512_fnmadd_ps, _mm512_sqrt_ps,
    _mm512_min_ps, _mm512_max_ps, _mm512_roundscale_ps, _mm512_abs_ps, lt_ps, select_ps
);
x86_lane!(
    F64x8, Mask8: 8 x f64 in __m512d, "avx512f,avx512dq,avx512vl,avx512bw,avx2,fma,bmi1,bmi2",
    _mm512_set1_pd, _mm512_add_pd, _mm512_sub_pd, _mm512_mul_pd, _mm512_div_pd, _mm512_fmadd_pd, _mm512_fnmadd_pd, _mm512_sqrt_pd,
    _mm512_min_pd, _mm512_max_pd, _mm512_roundscale_pd, _mm512_abs_pd, lt_pd, select_pd
);
