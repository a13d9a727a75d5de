//! Where physics is computed.

use serde::{Deserialize, Serialize};

use super::choice::choose;
use crate::error::SimError;

/// A device for physics.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Device {
    /// A CUDA GPU where one can be used, the CPU otherwise.
    #[default]
    Auto,
    /// The CPU, with the backend `lanes` or `mujoco`.
    Cpu,
    /// A CUDA GPU, with the backend `warp`.
    Cuda,
    /// The CPU with the kernels of the backend `warp`: slow, and as on a GPU.
    WarpCpu,
}

impl Device {
    /// All devices and their names.
    pub const ALL: [(&'static str, Self); 4] =
        [("auto", Self::Auto), ("cpu", Self::Cpu), ("cuda", Self::Cuda), ("warp-cpu", Self::WarpCpu)];

    /// Reads a name.
    pub fn parse(text: &str) -> Result<Self, SimError> {
        choose("device", text, &Self::ALL)
    }

    /// Its name.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::Cpu => "cpu",
            Self::Cuda => "cuda",
            Self::WarpCpu => "warp-cpu",
        }
    }

    /// Whether the backend `warp` simulates.
    #[must_use]
    pub fn is_warp(self) -> bool {
        matches!(self, Self::Cuda | Self::WarpCpu)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_device_reads_back_from_its_name_and_others_are_refused() {
        for (name, device) in Device::ALL {
            assert_eq!((Device::parse(name).unwrap(), device.name()), (device, name));
        }
        let message = Device::parse("tpu").unwrap_err().to_string();
        assert_eq!(message, "device is `tpu`, expected one of `auto`, `cpu`, `cuda`, `warp-cpu`");
    }

    #[test]
    fn only_the_devices_of_warp_are_warp() {
        let warp = Device::ALL.map(|(_, device)| device.is_warp());
        assert_eq!(warp, [false, false, true, true]);
    }
}
