//! Choice of the instruction set at run time: one binary serves every CPU.

/// An instruction set that this machine is known to have.
///
/// A value exists only if the machine was asked first, which is what makes calling the corresponding
/// kernel sound.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Level(Kind);

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd)]
pub(super) enum Kind {
    /// What every CPU of the target has.
    Portable,
    /// AVX2 with fused multiply-add.
    #[cfg(target_arch = "x86_64")]
    Avx2,
    /// AVX-512 F and VL.
    #[cfg(target_arch = "x86_64")]
    Avx512,
}

impl Level {
    /// The widest level of this machine.
    #[must_use]
    pub fn best() -> Self {
        #[cfg(target_arch = "x86_64")]
        {
            if is_x86_feature_detected!("avx512f") && is_x86_feature_detected!("avx512vl") {
                return Self(Kind::Avx512);
            }
            if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
                return Self(Kind::Avx2);
            }
        }
        Self(Kind::Portable)
    }

    /// Every level of this machine, narrowest first.
    #[must_use]
    pub fn available() -> Vec<Self> {
        let all = [
            Kind::Portable,
            #[cfg(target_arch = "x86_64")]
            Kind::Avx2,
            #[cfg(target_arch = "x86_64")]
            Kind::Avx512,
        ];
        // A CPU with AVX-512 has AVX2 as well.
        let Self(best) = Self::best();
        all.into_iter().filter(|kind| *kind <= best).map(Self).collect()
    }

    pub(super) fn kind(self) -> Kind {
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
        pub(super) fn $name(level: $crate::nn::kernels::Level, $($argument: $type),*) {
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
            match level.kind() {
                $crate::nn::kernels::level::Kind::Portable => {
                    $body::<{ $crate::nn::kernels::level::PORTABLE_FMA }>($($argument),*);
                }
                // SAFETY: a `Level` of this kind exists only if the machine reported AVX2 and FMA.
                #[cfg(target_arch = "x86_64")]
                $crate::nn::kernels::level::Kind::Avx2 => unsafe { avx2($($argument),*) },
                // SAFETY: a `Level` of this kind exists only if the machine reported AVX-512 F and VL,
                // and every such machine has FMA.
                #[cfg(target_arch = "x86_64")]
                $crate::nn::kernels::level::Kind::Avx512 => unsafe { avx512($($argument),*) },
            }
        }
    };
}
pub(super) use for_every_level;
