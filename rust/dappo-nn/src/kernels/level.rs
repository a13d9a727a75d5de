//! Choice of the instruction set at run time: one binary serves every CPU.

use dappo_sim::simd::{self, Simd};

/// An instruction set that this machine has.
///
/// A value exists only if the machine was checked first, which is what makes calling the corresponding
/// kernel sound.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Level(Simd);

impl Level {
    /// The widest level of this machine, or the one that the environment variable `DAPPO_SIMD` selects, as
    /// the lane engine has it. A name that this machine does not support is refused where a learner is made
    /// ([`LearnerDevice::open`](crate::LearnerDevice::open)), and counts for nothing here. The products that
    /// the `gemm` crate computes are out of its reach: that crate detects it itself.
    #[must_use]
    pub fn chosen() -> Self {
        simd::chosen().map_or_else(|_| Self::best(), Self)
    }

    /// The widest level of this machine.
    #[must_use]
    pub fn best() -> Self {
        Self(Simd::available()[0])
    }

    /// Every level of this machine, narrowest first.
    #[must_use]
    pub fn available() -> Vec<Self> {
        Simd::available().into_iter().rev().map(Self).collect()
    }

    pub(super) fn simd(self) -> Simd {
        self.0
    }
}

/// Whether portable code may use fused multiply-add. Without the instruction, `mul_add` becomes a call of
/// a library function and costs a hundred times as much as a product and a sum.
pub(super) const PORTABLE_FMA: bool = cfg!(any(target_feature = "fma", target_arch = "aarch64"));

/// Defines a kernel `fn name(level, arguments…)` that runs `body::<FMA>(arguments…)` compiled for `level`.
///
/// `body` must be `#[inline(always)]`: only code inlined into a function with a target feature is
/// compiled with that feature.
macro_rules! for_every_level {
    ($(#[$attribute:meta])* fn $name:ident($($argument:ident: $type:ty),* $(,)?) = $body:ident;) => {
        $(#[$attribute])*
        pub(super) fn $name(level: $crate::kernels::Level, $($argument: $type),*) {
            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx2,fma")]
            fn avx2($($argument: $type),*) {
                $body::<true>($($argument),*);
            }
            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx512f,avx512vl,fma")]
            fn avx512($($argument: $type),*) {
                $body::<true>($($argument),*);
            }
            match level.simd() {
                // SAFETY: a `Level` of this kind exists only if the machine reported AVX2 and FMA.
                #[cfg(target_arch = "x86_64")]
                dappo_sim::simd::Simd::Avx2 => unsafe { avx2($($argument),*) },
                // SAFETY: a `Level` of this kind exists only if the machine reported AVX-512 F and VL,
                // and every such machine has FMA.
                #[cfg(target_arch = "x86_64")]
                dappo_sim::simd::Simd::Avx512 => unsafe { avx512($($argument),*) },
                _ => $body::<{ $crate::kernels::level::PORTABLE_FMA }>($($argument),*),
            }
        }
    };
}
pub(super) use for_every_level;
