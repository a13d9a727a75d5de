//! What a user requests: a device, a backend and a precision. They resolve to [`Physics`](super::Physics).

use std::str::FromStr;

use serde::{Deserialize, Serialize};
use strum::{EnumString, IntoStaticStr, VariantNames};

use super::lanes::LaneTable;
use crate::error::SimError;

/// The backend that a user requests.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[derive(EnumString, IntoStaticStr, VariantNames)]
#[strum(serialize_all = "lowercase")]
pub enum BackendKind {
    /// The lane engine where it supports the robot, libmujoco otherwise.
    #[default]
    Auto,
    /// The lane engine, or an error with the reason why it cannot.
    Lanes,
    /// libmujoco.
    Mujoco,
}

/// Floating-point format of the lane engine; libmujoco always computes in double precision.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[derive(EnumString, IntoStaticStr, VariantNames)]
#[strum(serialize_all = "lowercase")]
pub enum Precision {
    /// Single precision: twice the envs in a register.
    #[default]
    F32,
    /// Double precision: equal to MuJoCo up to rounding.
    F64,
}

/// A device for physics.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[derive(EnumString, IntoStaticStr, VariantNames)]
#[strum(serialize_all = "kebab-case")]
pub enum Device {
    /// A CUDA GPU where one can be used, the CPU otherwise.
    #[default]
    Auto,
    /// The CPU, with the backend `lanes` or `mujoco`.
    Cpu,
    /// A GPU of any maker, with the backend `gpu`.
    Gpu,
    /// A CUDA GPU, with the backend `warp`.
    Cuda,
    /// The CPU with the kernels of the backend `warp`: slow, and as on a GPU.
    WarpCpu,
}

impl BackendKind {
    /// Reads a name.
    pub fn parse(text: &str) -> Result<Self, SimError> {
        choose("backend", text)
    }

    /// Its name.
    #[must_use]
    pub fn name(self) -> &'static str {
        self.into()
    }

    /// A robot compiled for the lane engine by `compile`, or else why libmujoco simulates it on the
    /// CPU; empty where nothing else was requested. Fails where the lane engine was requested and cannot.
    pub fn lane_table(
        self,
        compile: impl FnOnce() -> Result<LaneTable, SimError>,
    ) -> Result<Result<LaneTable, String>, SimError> {
        if self == Self::Mujoco {
            return Ok(Err(String::new()));
        }
        match compile() {
            Ok(table) => Ok(Ok(table)),
            Err(error @ SimError::Unsupported(_)) if self == Self::Auto => Ok(Err(error.to_string())),
            Err(error) => Err(error),
        }
    }
}

impl Precision {
    /// Reads a name.
    pub fn parse(text: &str) -> Result<Self, SimError> {
        choose("precision", text)
    }

    /// Its name.
    #[must_use]
    pub fn name(self) -> &'static str {
        self.into()
    }
}

impl Device {
    /// Reads a name.
    pub fn parse(text: &str) -> Result<Self, SimError> {
        choose("device", text)
    }

    /// Its name.
    #[must_use]
    pub fn name(self) -> &'static str {
        self.into()
    }
}

impl From<Precision> for dappo_lanes::Precision {
    fn from(precision: Precision) -> Self {
        match precision {
            Precision::F32 => Self::F32,
            Precision::F64 => Self::F64,
        }
    }
}

fn choose<T: FromStr + VariantNames>(what: &str, text: &str) -> Result<T, SimError> {
    text.parse().map_err(|_| {
        let names: Vec<String> = T::VARIANTS.iter().map(|name| format!("`{name}`")).collect();
        SimError::Config(format!("{what} is `{text}`, expected one of {}", names.join(", ")))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn unsupported() -> Result<LaneTable, SimError> {
        Err(SimError::Unsupported(vec!["it has wheels".into()]))
    }

    #[test]
    fn auto_falls_back_with_the_reason_and_a_wish_for_lanes_is_rejected_with_it() {
        let note = BackendKind::Auto.lane_table(unsupported).unwrap().err().unwrap();
        assert!(note.contains("it has wheels"), "{note}");
        let refusal = BackendKind::Lanes.lane_table(unsupported).err().unwrap();
        assert!(refusal.to_string().contains("it has wheels"), "{refusal}");
    }

    #[test]
    fn the_backend_mujoco_compiles_no_lane_table() {
        let table = BackendKind::Mujoco.lane_table(|| unreachable!("the lane engine was not requested"));
        assert_eq!(table.unwrap().err().unwrap(), "");
    }

    #[test]
    fn errors_other_than_an_unknown_robot_are_no_reason_to_fall_back() {
        let broken = || Err(SimError::Config("DAPPO_SIMD is `mmx`".into()));
        assert!(BackendKind::Auto.lane_table(broken).is_err());
    }

    #[test]
    fn unknown_names_are_rejected_with_the_known_ones() {
        let message = BackendKind::parse("brax").unwrap_err().to_string();
        assert_eq!(message, "backend is `brax`, expected one of `auto`, `lanes`, `mujoco`");
        let message = Precision::parse("f16").unwrap_err().to_string();
        assert_eq!(message, "precision is `f16`, expected one of `f32`, `f64`");
    }

    #[test]
    fn every_device_reads_back_from_its_name_and_others_are_rejected() {
        for (name, device) in [
            ("auto", Device::Auto),
            ("cpu", Device::Cpu),
            ("gpu", Device::Gpu),
            ("cuda", Device::Cuda),
            ("warp-cpu", Device::WarpCpu),
        ] {
            assert_eq!((Device::parse(name).unwrap(), device.name()), (device, name));
        }
        let message = Device::parse("tpu").unwrap_err().to_string();
        assert_eq!(message, "device is `tpu`, expected one of `auto`, `cpu`, `gpu`, `cuda`, `warp-cpu`");
    }
}
