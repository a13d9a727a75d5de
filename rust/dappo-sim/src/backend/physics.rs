//! What simulates: no two of these give the same numbers.

use super::settings::{Device, Precision};

/// The physics of envs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Physics {
    /// The lane engine on the CPU.
    Lanes(Precision),
    /// libmujoco on the CPU, in double precision.
    Mujoco,
    /// The GPU engine.
    Gpu(Precision),
    /// The kernels of the backend `warp`, in single precision.
    Warp(WarpDevice),
}

/// Where the kernels of the backend `warp` run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WarpDevice {
    /// A CUDA GPU.
    Cuda,
    /// The CPU: slow, and as on a GPU.
    Cpu,
}

impl Physics {
    /// What settings mean for a robot that on the CPU the lane engine simulates, or libmujoco without
    /// `has_lanes`. A device that is still `auto` is the CPU.
    #[must_use]
    pub fn new(device: Device, has_lanes: bool, precision: Precision) -> Self {
        match device {
            Device::Gpu => Self::Gpu(precision),
            Device::Cuda => Self::Warp(WarpDevice::Cuda),
            Device::WarpCpu => Self::Warp(WarpDevice::Cpu),
            Device::Auto | Device::Cpu if has_lanes => Self::Lanes(precision),
            Device::Auto | Device::Cpu => Self::Mujoco,
        }
    }

    /// Name of the backend.
    #[must_use]
    pub fn backend(self) -> &'static str {
        match self {
            Self::Lanes(_) => "lanes",
            Self::Mujoco => "mujoco",
            Self::Gpu(_) => "gpu",
            Self::Warp(_) => "warp",
        }
    }

    /// Name of its floating-point format.
    #[must_use]
    pub fn precision(self) -> &'static str {
        match self {
            Self::Lanes(precision) | Self::Gpu(precision) => precision.name(),
            Self::Mujoco => Precision::F64.name(),
            Self::Warp(_) => Precision::F32.name(),
        }
    }

    /// Name of the device.
    #[must_use]
    pub fn device(self) -> &'static str {
        match self {
            Self::Lanes(_) | Self::Mujoco => Device::Cpu.name(),
            Self::Gpu(_) => Device::Gpu.name(),
            Self::Warp(device) => device.name(),
        }
    }

    /// The most threads that have something to do for so many envs, at least 1.
    #[must_use]
    pub fn most_threads(self, num_envs: usize) -> usize {
        match self {
            // On a GPU the tasks are computed by the CPU.
            Self::Lanes(_) | Self::Mujoco | Self::Gpu(_) => num_envs.max(1),
            // One thread drives a device.
            Self::Warp(_) => 1,
        }
    }
}

impl WarpDevice {
    /// Its name among the [devices](Device).
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Cuda => Device::Cuda.name(),
            Self::Cpu => Device::WarpCpu.name(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_mean_what_results_record() {
        for (device, has_lanes, precision, expected) in [
            (Device::Cpu, true, Precision::F32, ["lanes", "f32", "cpu"]),
            (Device::Auto, true, Precision::F64, ["lanes", "f64", "cpu"]),
            // libmujoco and the kernels have one precision each, whatever is requested.
            (Device::Cpu, false, Precision::F32, ["mujoco", "f64", "cpu"]),
            (Device::Auto, false, Precision::F64, ["mujoco", "f64", "cpu"]),
            (Device::Cuda, true, Precision::F64, ["warp", "f32", "cuda"]),
            (Device::WarpCpu, false, Precision::F32, ["warp", "f32", "warp-cpu"]),
            (Device::Gpu, true, Precision::F64, ["gpu", "f64", "gpu"]),
        ] {
            let physics = Physics::new(device, has_lanes, precision);
            assert_eq!([physics.backend(), physics.precision(), physics.device()], expected);
        }
    }

    #[test]
    fn a_device_is_led_by_one_thread_and_every_env_on_the_cpu_by_one_at_most() {
        let threads = |physics: Physics| [0, 1, 8].map(|envs| physics.most_threads(envs));
        assert_eq!(threads(Physics::Warp(WarpDevice::Cpu)), [1, 1, 1]);
        assert_eq!(threads(Physics::Lanes(Precision::F32)), [1, 1, 8]);
        assert_eq!(threads(Physics::Mujoco), [1, 1, 8]);
    }
}
