//! Where networks are computed.

use burn::tensor::Device;
use serde::{Deserialize, Serialize};

use crate::error::{LearnError, Result};

/// The device of networks on CPUs.
#[must_use]
pub fn cpu() -> Device {
    Device::flex()
}

/// The device that a learner computes its networks on; checkpoints fit all of them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LearnerDevice {
    /// The CPU, with operations made for networks as small as these.
    #[default]
    Cpu,
    /// A GPU of any maker by way of Vulkan or Metal, with burn's own operations.
    Wgpu,
}

impl LearnerDevice {
    /// All devices.
    pub const ALL: [Self; 2] = [Self::Cpu, Self::Wgpu];

    /// Reads a name.
    pub fn parse(text: &str) -> Result<Self> {
        let device = Self::ALL.into_iter().find(|device| device.name() == text);
        let expected = "cpu or wgpu";
        device.ok_or_else(|| LearnError::Config { key: "ppo.device", got: text.into(), expected })
    }

    /// Its name.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Cpu => "cpu",
            Self::Wgpu => "wgpu",
        }
    }

    /// The device itself, or an error that says what it lacks.
    pub fn open(self) -> Result<Device> {
        match self {
            Self::Cpu => Ok(cpu()),
            Self::Wgpu => wgpu(),
        }
    }
}

#[cfg(feature = "wgpu")]
fn wgpu() -> Result<Device> {
    use burn::tensor::{DeviceKind, DeviceType};

    // A tensor on a machine without any adapter would end the program.
    if Device::enumerate(DeviceType::Wgpu).is_empty() {
        let message = "ppo.device is wgpu, but no Vulkan driver offers a device: install the driver of the GPU, or Mesa's";
        return Err(LearnError::Invalid(message.into()));
    }
    Ok(Device::wgpu(DeviceKind::DefaultDevice))
}

#[cfg(not(feature = "wgpu"))]
fn wgpu() -> Result<Device> {
    let message = "ppo.device is wgpu, which this build lacks: build with the feature `wgpu` \
                   (docs/guides/gpu.md), or take cpu";
    Err(LearnError::Invalid(message.into()))
}
