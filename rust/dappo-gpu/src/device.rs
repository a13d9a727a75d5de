//! The devices of this machine.

use std::sync::OnceLock;

use cubecl::client::Client;
use cubecl::device::WgpuDeviceKind;
use cubecl::ir::{ElemType, FloatKind};
use cubecl::prelude::*;
use dappo_lanes::Precision;

use crate::error::Error;
use crate::kernel::exchange;

/// Environment variable that allows devices which are none, such as Mesa's lavapipe: for tests.
pub const ALLOW_SOFTWARE: &str = "DAPPO_GPU_SOFTWARE";

/// Threads of a cube, a multiple of all numbers of threads of a world.
pub(crate) const THREADS: usize = 64;

/// A device that kernels can run on.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Device {
    device: cubecl::Device,
    /// Whether a processor only imitates it.
    pub software: bool,
}

impl Device {
    /// The device of this machine: discrete GPUs before integrated ones, software only if [`ALLOW_SOFTWARE`] is set.
    ///
    /// # Errors
    /// If there is none.
    pub fn find() -> Result<Self, Error> {
        Self::allowing(
            std::env::var_os(ALLOW_SOFTWARE).is_some_and(|value| !value.is_empty() && value != "0"),
        )
    }

    /// The same, with software allowed or not whatever the environment.
    ///
    /// # Errors
    /// If there is none.
    pub fn allowing(software: bool) -> Result<Self, Error> {
        // Asking the drivers takes a while, and their answer stays the same.
        static BEST: OnceLock<Option<Device>> = OnceLock::new();
        match BEST.get_or_init(best) {
            Some(device) if software || !device.software => Ok(device.clone()),
            Some(_) => unsupported(&format!(
                "the only device that Vulkan finds is a processor that imitates a GPU; {ALLOW_SOFTWARE}=1 allows it, \
                 for tests"
            )),
            None => unsupported(
                "this machine has no GPU that Vulkan, Metal or DirectX 12 can find (a container needs libvulkan1 and \
                 the driver's files, which for NVIDIA need NVIDIA_DRIVER_CAPABILITIES=graphics,compute)",
            ),
        }
    }

    /// How the device names itself.
    #[must_use]
    pub fn name(&self) -> String {
        self.client().properties().identity.name.clone()
    }

    pub(crate) fn client(&self) -> Client {
        self.device.client()
    }
}

/// The best device, whether it is allowed or not.
fn best() -> Option<Device> {
    [
        WgpuDeviceKind::DiscreteGpu(0),
        WgpuDeviceKind::IntegratedGpu(0),
        WgpuDeviceKind::VirtualGpu(0),
        WgpuDeviceKind::Other(0),
        WgpuDeviceKind::Cpu,
    ]
    .into_iter()
    .find_map(|kind| {
        let software = kind == WgpuDeviceKind::Cpu;
        // Where Vulkan is the API, no other is asked.
        let vulkan = cfg!(not(any(target_vendor = "apple", windows)));
        let device = if vulkan { cubecl::Device::vulkan(kind) } else { cubecl::Device::wgpu(kind) };
        Some(Device { device: device.ok()?, software })
    })
}

fn unsupported<T>(why: &str) -> Result<T, Error> {
    Err(Error::Unsupported(vec![why.into()]))
}

/// Checks that a device has what worlds of `lanes` threads need.
pub(crate) fn check(client: &Client, lanes: usize, precision: Precision) -> Result<(), Error> {
    let properties = client.properties();
    let mut reasons = Vec::new();
    if precision == Precision::F64 && !properties.supports_type(ElemType::Float(FloatKind::F64)) {
        reasons.push("this GPU does not compute in double precision (`f64`)".to_owned());
    }
    let smallest = properties.hardware.plane_size_min as usize;
    if smallest < lanes {
        reasons.push(format!(
            "its {lanes} threads a robot exchange numbers within a subgroup, and those of this GPU may be as small as \
             {smallest}"
        ));
    } else if !exchanges(client, lanes)? {
        reasons.push("this GPU does not put neighbouring threads into the same subgroup".to_owned());
    }
    if reasons.is_empty() { Ok(()) } else { Err(Error::Unsupported(reasons)) }
}

/// Whether neighbouring threads can exchange numbers: everywhere they can, but no specification says so.
fn exchanges(client: &Client, lanes: usize) -> Result<bool, Error> {
    let bits = lanes.trailing_zeros();
    if bits == 0 {
        return Ok(true);
    }
    let threads = 4 * THREADS;
    let len = threads * bits as usize;
    let out = client.empty(len * size_of::<u32>());
    // SAFETY: the buffer has as many entries as the kernel writes, and the kernel has no loop.
    unsafe {
        exchange::launch_unchecked(
            client,
            CubeCount::Static((threads / THREADS) as u32, 1, 1),
            CubeDim::new_1d(THREADS as u32),
            BufferArg::from_raw_parts(out.clone(), len),
            threads,
            bits,
        );
    }
    let bytes = client.read_one(out).map_err(|error| Error::Device(format!("{error:?}")))?;
    let partners = u32::from_bytes(&bytes).chunks_exact(threads);
    Ok(partners.enumerate().all(|(bit, partners)| {
        partners.iter().enumerate().all(|(thread, partner)| *partner == thread as u32 ^ 1 << bit)
    }))
}
