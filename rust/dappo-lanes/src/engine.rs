//! Chooses the lane type and the shape of the robot at run time.

use std::sync::{Arc, Mutex};

use crate::error::Unsupported;
use crate::group::Group;
use crate::lane::Lane;
#[cfg(target_arch = "aarch64")]
use crate::lane::neon;
use crate::lane::portable;
#[cfg(target_arch = "x86_64")]
use crate::lane::{avx2, avx512};
use crate::model::Model;
use crate::skeleton::Skeleton;
use crate::worlds::{Robot, Worlds};

/// Floating-point format of the simulation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Precision {
    /// Single precision: twice the worlds in a register.
    F32,
    /// Double precision: equal to MuJoCo up to rounding.
    F64,
}

/// Instruction set.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Simd {
    /// AVX-512.
    Avx512,
    /// AVX2 with FMA.
    Avx2,
    /// NEON, which every aarch64 processor has.
    Neon,
    /// Plain Rust.
    Portable,
}

impl Simd {
    /// The instruction sets of this processor, the fastest first.
    #[must_use]
    pub fn available() -> Vec<Self> {
        [Self::Avx512, Self::Avx2, Self::Neon, Self::Portable]
            .into_iter()
            .filter(|simd| simd.is_available())
            .collect()
    }

    /// Whether this processor has it.
    #[must_use]
    pub(crate) fn is_available(self) -> bool {
        match self {
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => {
                is_x86_feature_detected!("avx512f")
                    && is_x86_feature_detected!("avx512dq")
                    && is_x86_feature_detected!("avx512vl")
                    && is_x86_feature_detected!("avx512bw")
                    && Self::Avx2.is_available()
            }
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => {
                is_x86_feature_detected!("avx2")
                    && is_x86_feature_detected!("fma")
                    && is_x86_feature_detected!("bmi1")
                    && is_x86_feature_detected!("bmi2")
            }
            #[cfg(not(target_arch = "x86_64"))]
            Self::Avx512 | Self::Avx2 => false,
            Self::Neon => cfg!(target_arch = "aarch64"),
            Self::Portable => true,
        }
    }

    /// Number of worlds in a group.
    #[must_use]
    pub fn worlds(self, precision: Precision) -> usize {
        match (self, precision) {
            (Self::Avx512, Precision::F32) => 16,
            (Self::Avx512, Precision::F64) | (Self::Avx2, Precision::F32) => 8,
            (Self::Neon, Precision::F64) => 2,
            _ => 4,
        }
    }

    /// Name in texts and environment variables.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Avx512 => "avx512",
            Self::Avx2 => "avx2",
            Self::Neon => "neon",
            Self::Portable => "portable",
        }
    }
}

type NewGroup = Box<dyn Fn() -> Box<dyn Group> + Send + Sync>;

/// The damage classes of one robot, ready to be simulated.
pub struct Engine {
    width: usize,
    new_group: NewGroup,
}

impl Engine {
    /// An engine for one robot, given by the models of all its damage classes.
    ///
    /// # Errors
    /// If the robot's shape is not among the compiled ones, if the processor lacks the instruction set, or if
    /// a class changes something that all classes must share.
    pub fn new(classes: Vec<Model>, precision: Precision, simd: Simd) -> Result<Self, Unsupported> {
        if !simd.is_available() {
            let names: Vec<_> = Simd::available().into_iter().map(Simd::name).collect();
            return Err(Unsupported(format!(
                "this processor has no {}; it has {}",
                simd.name(),
                names.join(", ")
            )));
        }
        match (simd, precision) {
            #[cfg(target_arch = "x86_64")]
            (Simd::Avx512, Precision::F32) => Self::of::<avx512::F32x16>(classes),
            #[cfg(target_arch = "x86_64")]
            (Simd::Avx512, Precision::F64) => Self::of::<avx512::F64x8>(classes),
            #[cfg(target_arch = "x86_64")]
            (Simd::Avx2, Precision::F32) => Self::of::<avx2::F32x8>(classes),
            #[cfg(target_arch = "x86_64")]
            (Simd::Avx2, Precision::F64) => Self::of::<avx2::F64x4>(classes),
            #[cfg(target_arch = "aarch64")]
            (Simd::Neon, Precision::F32) => Self::of::<neon::F32x4>(classes),
            #[cfg(target_arch = "aarch64")]
            (Simd::Neon, Precision::F64) => Self::of::<neon::F64x2>(classes),
            (_, Precision::F32) => Self::of::<portable::F32x4>(classes),
            (_, Precision::F64) => Self::of::<portable::F64x4>(classes),
        }
    }

    /// Chooses the shape: the engine is compiled for each one by itself.
    fn of<T: Lane>(classes: Vec<Model>) -> Result<Self, Unsupported> {
        let model = classes.first().ok_or_else(|| Unsupported("there is no damage class".into()))?;
        let limbs = model.limbs.len();
        let trunk = model.trunk_joints();
        let own = model.limbs.iter().skip(usize::from(trunk > 0));
        let joints = own.map(Vec::len).max().unwrap_or(0);
        match (limbs, joints, trunk) {
            (1..=3, 1..=2, 0) => Self::shaped::<T, 3, 2, 0>(classes),
            (4, 1..=2, 0) => Self::shaped::<T, 4, 2, 0>(classes),
            (1..=4, 1..=3, 0) => Self::shaped::<T, 4, 3, 0>(classes),
            (5..=6, 1..=3, 0) => Self::shaped::<T, 6, 3, 0>(classes),
            (1..=2, 4..=6, 0) => Self::shaped::<T, 2, 6, 0>(classes),
            (3..=5, 4..=7, 0) => Self::shaped::<T, 5, 7, 0>(classes),
            (2..=6, 1..=7, 1..=3) => Self::shaped::<T, 6, 7, 3>(classes),
            (_, _, 0) => Err(Unsupported(format!(
                "it has {limbs} limbs of up to {joints} joints; the lane engine is compiled for up to 6 limbs of \
                 up to 3 joints and for up to 5 limbs of up to 7"
            ))),
            _ => Err(Unsupported(format!(
                "it has a trunk of {trunk} joints and {} other limbs of up to {joints}; the lane engine is compiled \
                 for up to 3 joints of the trunk and up to 5 other limbs of up to 7",
                limbs - 1
            ))),
        }
    }

    fn shaped<T: Lane, const L: usize, const J: usize, const W: usize>(
        classes: Vec<Model>,
    ) -> Result<Self, Unsupported> {
        let skeleton = Skeleton::new(&classes)?;
        let robot = Arc::new(Robot::<T, L, J, W> { skeleton, classes, spare: Mutex::default() });
        let new_group: NewGroup = Box::new(move || Box::new(Worlds::new(Arc::clone(&robot))));
        Ok(Self { width: T::WIDTH, new_group })
    }

    /// Number of worlds in a group.
    #[must_use]
    pub fn width(&self) -> usize {
        self.width
    }

    /// A new group of worlds, all of class 0 and with all positions and velocities zero.
    #[must_use]
    pub fn group(&self) -> Box<dyn Group> {
        (self.new_group)()
    }
}
