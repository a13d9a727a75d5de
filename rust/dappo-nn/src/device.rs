//! Where networks are computed.

use burn::tensor::Device;
use dappo_sim::simd;
use serde::{Deserialize, Serialize};
use strum::{EnumString, IntoStaticStr, VariantNames};

use crate::error::{NnError, Result};

/// The device of networks on CPUs.
#[must_use]
pub fn cpu() -> Device {
    Device::flex()
}

/// The device that a learner computes its networks on; checkpoints fit all of them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[derive(EnumString, IntoStaticStr, VariantNames)]
#[strum(serialize_all = "lowercase")]
pub enum LearnerDevice {
    /// The CPU, with operations made for networks as small as these.
    #[default]
    Cpu,
    /// A GPU of any maker by way of Vulkan or Metal, with burn's own operations. Runs of earlier versions name it `wgpu`.
    #[serde(alias = "wgpu")]
    Gpu,
}

impl LearnerDevice {
    /// Its name.
    #[must_use]
    pub fn name(self) -> &'static str {
        self.into()
    }

    /// The device itself, or an error with what it lacks.
    pub fn open(self) -> Result<Device> {
        match self {
            Self::Cpu => {
                simd::chosen().map_err(|error| NnError::Invalid(error.to_string()))?;
                Ok(cpu())
            }
            Self::Gpu => gpu(),
        }
    }
}

#[cfg(feature = "gpu")]
fn gpu() -> Result<Device> {
    use burn::tensor::{DeviceKind, DeviceType};

    // A tensor on a machine without any adapter would end the program.
    if Device::enumerate(DeviceType::Wgpu).is_empty() {
        let message = "ppo.device is gpu, but no Vulkan driver offers a device: install the driver of the GPU, or Mesa's";
        return Err(NnError::Invalid(message.into()));
    }
    Ok(Device::wgpu(DeviceKind::DefaultDevice))
}

#[cfg(not(feature = "gpu"))]
fn gpu() -> Result<Device> {
    let message = "ppo.device is gpu, which this build lacks: build with the feature `gpu` \
                   (docs/guides/gpu.md), or take cpu";
    Err(NnError::Invalid(message.into()))
}
