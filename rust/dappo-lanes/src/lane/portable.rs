//! Lanes as arrays, in plain Rust: for processors without a hand-written type, and to check those.

use std::array::from_fn;
use std::ops::{Add, AddAssign, BitAnd, BitOr, BitXor, Div, Mul, Neg, Not, Sub, SubAssign};

use super::{Lane, Mask};

const WIDTH: usize = 4;

/// Four truth values.
#[derive(Clone, Copy)]
pub struct Mask4([bool; WIDTH]);

impl BitAnd for Mask4 {
    type Output = Self;
    #[inline(always)]
    fn bitand(self, other: Self) -> Self {
        Self(from_fn(|lane| self.0[lane] & other.0[lane]))
    }
}

impl BitOr for Mask4 {
    type Output = Self;
    #[inline(always)]
    fn bitor(self, other: Self) -> Self {
        Self(from_fn(|lane| self.0[lane] | other.0[lane]))
    }
}

impl BitXor for Mask4 {
    type Output = Self;
    #[inline(always)]
    fn bitxor(self, other: Self) -> Self {
        Self(from_fn(|lane| self.0[lane] ^ other.0[lane]))
    }
}

impl Not for Mask4 {
    type Output = Self;
    #[inline(always)]
    fn not(self) -> Self {
        Self(from_fn(|lane| !self.0[lane]))
    }
}

impl Mask for Mask4 {
    #[inline(always)]
    fn none() -> Self {
        Self([false; WIDTH])
    }
    #[inline(always)]
    fn from_bits(bits: u32) -> Self {
        Self(from_fn(|lane| bits >> lane & 1 == 1))
    }
    #[inline(always)]
    fn any(self) -> bool {
        self.0.iter().any(|&lane| lane)
    }
}

macro_rules! portable_lane {
    ($name:ident, $scalar:ty, $double:literal) => {
        #[doc = concat!("Four numbers of type `", stringify!($scalar), "`.")]
        #[derive(Clone, Copy)]
        #[repr(C, align(32))]
        pub struct $name([$scalar; WIDTH]);

        impl $name {
            #[inline(always)]
            fn map(self, f: impl Fn($scalar) -> $scalar) -> Self {
                Self(from_fn(|lane| f(self.0[lane])))
            }
            #[inline(always)]
            fn zip(self, other: Self, f: impl Fn($scalar, $scalar) -> $scalar) -> Self {
                Self(from_fn(|lane| f(self.0[lane], other.0[lane])))
            }
        }

        impl Add for $name {
            type Output = Self;
            #[inline(always)]
            fn add(self, other: Self) -> Self {
                self.zip(other, |a, b| a + b)
            }
        }
        impl Sub for $name {
            type Output = Self;
            #[inline(always)]
            fn sub(self, other: Self) -> Self {
                self.zip(other, |a, b| a - b)
            }
        }
        impl Mul for $name {
            type Output = Self;
            #[inline(always)]
            fn mul(self, other: Self) -> Self {
                self.zip(other, |a, b| a * b)
            }
        }
        impl Div for $name {
            type Output = Self;
            #[inline(always)]
            fn div(self, other: Self) -> Self {
                self.zip(other, |a, b| a / b)
            }
        }
        impl Neg for $name {
            type Output = Self;
            #[inline(always)]
            fn neg(self) -> Self {
                self.map(|a| 0.0 - a)
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
            const WIDTH: usize = WIDTH;
            const DOUBLE: bool = $double;
            type Mask = Mask4;
            type Scalar = $scalar;

            #[inline(always)]
            fn scalar(value: f64) -> $scalar {
                value as $scalar
            }
            #[inline(always)]
            fn splat(value: $scalar) -> Self {
                Self([value; WIDTH])
            }
            #[inline(always)]
            fn mul_add(self, factor: Self, addend: Self) -> Self {
                Self(from_fn(|lane| self.0[lane].mul_add(factor.0[lane], addend.0[lane])))
            }
            #[inline(always)]
            fn neg_mul_add(self, factor: Self, minuend: Self) -> Self {
                Self(from_fn(|lane| (-self.0[lane]).mul_add(factor.0[lane], minuend.0[lane])))
            }
            #[inline(always)]
            fn sqrt(self) -> Self {
                self.map(<$scalar>::sqrt)
            }
            #[inline(always)]
            fn min(self, other: Self) -> Self {
                self.zip(other, |a, b| if a < b { a } else { b })
            }
            #[inline(always)]
            fn max(self, other: Self) -> Self {
                self.zip(other, |a, b| if a > b { a } else { b })
            }
            #[inline(always)]
            fn abs(self) -> Self {
                self.map(<$scalar>::abs)
            }
            #[inline(always)]
            fn round(self) -> Self {
                self.map(<$scalar>::round_ties_even)
            }
            #[inline(always)]
            fn lt(self, other: Self) -> Mask4 {
                Mask4(from_fn(|lane| self.0[lane] < other.0[lane]))
            }
            #[inline(always)]
            fn select(mask: Mask4, yes: Self, no: Self) -> Self {
                Self(from_fn(|lane| if mask.0[lane] { yes.0[lane] } else { no.0[lane] }))
            }
            #[inline(always)]
            fn get(&self, lane: usize) -> f64 {
                f64::from(self.0[lane])
            }
            #[inline(always)]
            fn set(&mut self, lane: usize, value: f64) {
                self.0[lane] = value as $scalar;
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

portable_lane!(F32x4, f32, false);
portable_lane!(F64x4, f64, true);
