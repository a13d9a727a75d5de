//! Lanes: a SIMD register as a number type whose every entry belongs to another world.
//!
//! All instruction sets compute bit for bit the same: every operation is the correctly rounded IEEE one, and
//! multiply-adds are fused everywhere.
//!
//! The functions that compute with lanes are `#[inline(always)]` and use loops rather than closures: what the
//! standard library calls for us (`map`, `from_fn`) would be compiled without the instruction set and be
//! thirty times slower.

#[cfg(target_arch = "x86_64")]
pub mod avx2;
#[cfg(target_arch = "x86_64")]
pub mod avx512;
#[cfg(target_arch = "aarch64")]
pub mod neon;
pub mod portable;
#[cfg(test)]
mod tests;
#[cfg(target_arch = "x86_64")]
mod x86;

use std::ops::{Add, AddAssign, BitAnd, BitOr, BitXor, Div, Mul, Neg, Not, Sub, SubAssign};

/// A truth value for every lane.
pub trait Mask:
    Copy
    + BitAnd<Output = Self>
    + BitOr<Output = Self>
    + BitXor<Output = Self>
    + Not<Output = Self>
    + Send
    + Sync
    + 'static
{
    /// False everywhere.
    fn none() -> Self;

    /// The mask whose lane i is bit i.
    fn from_bits(bits: u32) -> Self;

    /// Whether some lane is true.
    fn any(self) -> bool;
}

/// One number for every lane.
pub trait Lane:
    Copy
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + AddAssign
    + SubAssign
    + Send
    + Sync
    + 'static
{
    /// Number of lanes.
    const WIDTH: usize;

    /// Whether the numbers are doubles.
    const DOUBLE: bool;

    /// Truth values.
    type Mask: Mask;

    /// One lane's number.
    type Scalar: Copy + Send + Sync + 'static;

    /// Rounds a double to the format of a lane.
    fn scalar(value: f64) -> Self::Scalar;

    /// The same number in every lane.
    fn splat(value: Self::Scalar) -> Self;

    /// self · factor + addend, rounded once.
    fn mul_add(self, factor: Self, addend: Self) -> Self;

    /// minuend − self · factor, rounded once.
    fn neg_mul_add(self, factor: Self, minuend: Self) -> Self;

    /// Square root.
    fn sqrt(self) -> Self;

    /// The smaller number; `other` if one of them is NaN.
    fn min(self, other: Self) -> Self;

    /// The larger number; `other` if one of them is NaN.
    fn max(self, other: Self) -> Self;

    /// Absolute value.
    fn abs(self) -> Self;

    /// Nearest integer, ties to even.
    fn round(self) -> Self;

    /// self < other.
    fn lt(self, other: Self) -> Self::Mask;

    /// `yes` where the mask is true, `no` elsewhere.
    fn select(mask: Self::Mask, yes: Self, no: Self) -> Self;

    /// The number of a lane.
    fn get(&self, lane: usize) -> f64;

    /// Sets the number of a lane, rounded to its format.
    fn set(&mut self, lane: usize, value: f64);

    /// Runs a function that is compiled for the instruction set of this type, as a unit of its own. Everything
    /// it calls must be `#[inline(always)]`, itself included.
    fn run<R>(function: impl FnOnce() -> R) -> R;

    /// The constant `value` in every lane.
    #[inline(always)]
    fn of(value: f64) -> Self {
        Self::splat(Self::scalar(value))
    }

    /// 0 in every lane.
    #[inline(always)]
    fn zero() -> Self {
        Self::of(0.0)
    }

    /// self where the mask is true, 0 elsewhere.
    #[inline(always)]
    fn keep(self, mask: Self::Mask) -> Self {
        Self::select(mask, self, Self::zero())
    }

    /// self kept inside [low, high].
    #[inline(always)]
    fn clamp(self, low: Self, high: Self) -> Self {
        // NaN stays NaN: `min` and `max` return their argument then.
        low.max(high.min(self))
    }
}
