//! What the lane types of x86-64 have in common: everything but masks, as the names of intrinsics.

/// A lane type around a register of `$width` numbers. The last three names are functions of the caller's:
/// absolute value, comparison and choice differ between instruction sets.
///
/// Callers state why its `unsafe` blocks are sound: the processor has the instructions.
macro_rules! x86_lane {
    ($name:ident, $mask:ident: $width:literal x $scalar:ident in $register:ident, $features:literal,
     $set1:ident, $add:ident, $sub:ident, $mul:ident, $div:ident, $fmadd:ident, $fnmadd:ident, $sqrt:ident,
     $min:ident, $max:ident, $round:ident, $abs:ident, $lt:ident, $select:ident) => {
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
            const DOUBLE: bool = size_of::<$scalar>() == 8;
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
                unsafe { $lt(self.0, other.0) }
            }
            #[inline(always)]
            fn select(mask: $mask, yes: Self, no: Self) -> Self {
                unsafe { Self($select(mask, yes.0, no.0)) }
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
                #[target_feature(enable = $features)]
                fn compiled<R>(function: impl FnOnce() -> R) -> R {
                    function()
                }
                unsafe { compiled(function) }
            }
        }
    };
}

pub(super) use x86_lane;
