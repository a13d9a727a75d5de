//! Lanes in AVX registers, with AVX2 and FMA.

// SAFETY of every block in this file: values of these types are made only by an engine for `Simd::Avx2`,
// which exists only on processors that have these instructions (see `engine::Engine::new`).
#![expect(clippy::undocumented_unsafe_blocks, reason = "one reason for all, given above")]
#![allow(clippy::wildcard_imports, reason = "as the documentation of the intrinsics does")]

use std::arch::x86_64::*;
use std::ops::{Add, AddAssign, BitAnd, BitOr, BitXor, Div, Mul, Neg, Not, Sub, SubAssign};

use super::x86::x86_lane;
use super::{Lane, Mask};

/// Truth values, and the three operations that depend on their form.
macro_rules! avx2_mask {
    ($mask:ident: $width:literal x $scalar:ident in $register:ident as $integer:ident, $set1:ident,
     $and:ident, $or:ident, $xor:ident, $movemask:ident, $andnot:ident, $cmp:ident, $blend:ident,
     $abs:ident, $lt:ident, $select:ident) => {
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

        #[inline(always)]
        unsafe fn $abs(a: $register) -> $register {
            unsafe { $andnot($set1(-0.0), a) }
        }

        #[inline(always)]
        unsafe fn $lt(a: $register, b: $register) -> $mask {
            unsafe { $mask($cmp::<_CMP_LT_OQ>(a, b)) }
        }

        #[inline(always)]
        unsafe fn $select(mask: $mask, yes: $register, no: $register) -> $register {
            unsafe { $blend(no, yes, mask.0) }
        }
    };
}

avx2_mask!(
    Mask8: 8 x f32 in __m256 as u32, _mm256_set1_ps,
    _mm256_and_ps, _mm256_or_ps, _mm256_xor_ps, _mm256_movemask_ps, _mm256_andnot_ps, _mm256_cmp_ps, _mm256_blendv_ps,
    abs_ps, lt_ps, select_ps
);
avx2_mask!(
    Mask4: 4 x f64 in __m256d as u64, _mm256_set1_pd,
    _mm256_and_pd, _mm256_or_pd, _mm256_xor_pd, _mm256_movemask_pd, _mm256_andnot_pd, _mm256_cmp_pd, _mm256_blendv_pd,
    abs_pd, lt_pd, select_pd
);

x86_lane!(
    F32x8, Mask8: 8 x f32 in __m256, "avx2,fma,bmi1,bmi2",
    _mm256_set1_ps, _mm256_add_ps, _mm256_sub_ps, _mm256_mul_ps, _mm256_div_ps, _mm256_fmadd_ps, _mm256_fnmadd_ps, _mm256_sqrt_ps,
    _mm256_min_ps, _mm256_max_ps, _mm256_round_ps, abs_ps, lt_ps, select_ps
);
x86_lane!(
    F64x4, Mask4: 4 x f64 in __m256d, "avx2,fma,bmi1,bmi2",
    _mm256_set1_pd, _mm256_add_pd, _mm256_sub_pd, _mm256_mul_pd, _mm256_div_pd, _mm256_fmadd_pd, _mm256_fnmadd_pd, _mm256_sqrt_pd,
    _mm256_min_pd, _mm256_max_pd, _mm256_round_pd, abs_pd, lt_pd, select_pd
);
