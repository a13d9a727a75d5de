//! Lanes in NEON registers: every aarch64 processor has them.

// SAFETY of every block in this file: the intrinsics need NEON alone, which is part of the targets that this
// file is compiled for.
#![expect(clippy::undocumented_unsafe_blocks, reason = "one reason for all, given above")]
#![allow(clippy::wildcard_imports, reason = "as the documentation of the intrinsics does")]

use std::arch::aarch64::*;
use std::ops::{Add, AddAssign, BitAnd, BitOr, BitXor, Div, Mul, Neg, Not, Sub, SubAssign};

use super::{Lane, Mask};

macro_rules! neon_lane {
    ($name:ident, $mask:ident: $width:literal x $scalar:ident in $register:ident,
     masks of $integer:ident in $bits:ident, $dup:ident, $add:ident, $sub:ident, $mul:ident, $div:ident,
     $fma:ident, $fms:ident, $sqrt:ident, $abs:ident, $round:ident, $lt:ident, $select:ident,
     $dup_bits:ident, $and:ident, $or:ident, $xor:ident, $any:ident) => {
        #[doc = concat!(stringify!($width), " truth values, all bits of a number set for true.")]
        #[derive(Clone, Copy)]
        #[repr(transparent)]
        pub struct $mask($bits);

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
                unsafe { Self($xor(self.0, $dup_bits(!0))) }
            }
        }
        impl Mask for $mask {
            #[inline(always)]
            fn none() -> Self {
                unsafe { Self($dup_bits(0)) }
            }
            #[inline(always)]
            fn from_bits(bits: u32) -> Self {
                let lanes: [$integer; $width] =
                    std::array::from_fn(|lane| if bits >> lane & 1 == 1 { !0 } else { 0 });
                unsafe { Self(std::mem::transmute::<[$integer; $width], $bits>(lanes)) }
            }
            #[inline(always)]
            fn any(self) -> bool {
                unsafe { $any(self.0) != 0 }
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
                unsafe { Self($sub($dup(0.0), self.0)) }
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
            const DOUBLE: bool = size_of::<$scalar>() == 8;
            type Mask = $mask;
            type Scalar = $scalar;

            #[inline(always)]
            fn scalar(value: f64) -> $scalar {
                value as $scalar
            }
            #[inline(always)]
            fn splat(value: $scalar) -> Self {
                unsafe { Self($dup(value)) }
            }
            #[inline(always)]
            fn mul_add(self, factor: Self, addend: Self) -> Self {
                unsafe { Self($fma(addend.0, self.0, factor.0)) }
            }
            #[inline(always)]
            fn neg_mul_add(self, factor: Self, minuend: Self) -> Self {
                unsafe { Self($fms(minuend.0, self.0, factor.0)) }
            }
            #[inline(always)]
            fn sqrt(self) -> Self {
                unsafe { Self($sqrt(self.0)) }
            }
            // NEON's own minimum and maximum return NaN where one of the numbers is NaN.
            #[inline(always)]
            fn min(self, other: Self) -> Self {
                Self::select(self.lt(other), self, other)
            }
            #[inline(always)]
            fn max(self, other: Self) -> Self {
                Self::select(other.lt(self), self, other)
            }
            #[inline(always)]
            fn abs(self) -> Self {
                unsafe { Self($abs(self.0)) }
            }
            #[inline(always)]
            fn round(self) -> Self {
                unsafe { Self($round(self.0)) }
            }
            #[inline(always)]
            fn lt(self, other: Self) -> $mask {
                unsafe { $mask($lt(self.0, other.0)) }
            }
            #[inline(always)]
            fn select(mask: $mask, yes: Self, no: Self) -> Self {
                unsafe { Self($select(mask.0, yes.0, no.0)) }
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
                fn compiled<R>(function: impl FnOnce() -> R) -> R {
                    function()
                }
                compiled(function)
            }
        }
    };
}

neon_lane!(
    F32x4, Mask4: 4 x f32 in float32x4_t, masks of u32 in uint32x4_t,
    vdupq_n_f32, vaddq_f32, vsubq_f32, vmulq_f32, vdivq_f32, vfmaq_f32, vfmsq_f32, vsqrtq_f32, vabsq_f32,
    vrndnq_f32, vcltq_f32, vbslq_f32, vdupq_n_u32, vandq_u32, vorrq_u32, veorq_u32, vmaxvq_u32
);
neon_lane!(
    F64x2, Mask2: 2 x f64 in float64x2_t, masks of u64 in uint64x2_t,
    vdupq_n_f64, vaddq_f64, vsubq_f64, vmulq_f64, vdivq_f64, vfmaq_f64, vfmsq_f64, vsqrtq_f64, vabsq_f64,
    vrndnq_f64, vcltq_f64, vbslq_f64, vdupq_n_u64, vandq_u64, vorrq_u64, veorq_u64, any_u64
);

/// A number that is not zero if an entry is not.
#[inline(always)]
unsafe fn any_u64(a: uint64x2_t) -> u32 {
    unsafe { vmaxvq_u32(vreinterpretq_u32_u64(a)) }
}
