//! The kernel as CUDA C++: what a build for CUDA would give to its compiler. No GPU is needed, nor a driver of one.
//!
//! Kernels that WGSL can express may be beyond CUDA C++, such as a `bool != bool`.

use std::sync::Arc;

use cubecl::ir::features::Features;
use cubecl::ir::{DeviceIdentity, HardwareProperties, MemoryDeviceProperties};
use cubecl::prelude::*;
use cubecl::profile::TimingMethod;
use cubecl::{Compiler, CubeKernel, define_kernel};
use cubecl_cpp::shared::{CompilationOptions, CppCompiler, CppSupportedFeatures};
use cubecl_cpp::target::Cuda;
use dappo_lanes::{Model, Precision};

use crate::device::THREADS;
use crate::error::Error;
use crate::kernel::advance::Advance;
use crate::skeleton::Skeleton;

/// The kernel that advances worlds of a robot, given by the models of all damage classes.
///
/// # Errors
/// If the kernel does not support the robot, or CUDA C++ cannot express the kernel.
pub fn advance(classes: &[Model], precision: Precision) -> Result<String, Error> {
    let shape = Skeleton::new(classes)?.shape;
    let settings =
        || KernelSettings::new(*CubeDim::new_1d(THREADS as u32), ExecutionMode::Unchecked, AddressType::U32);
    let buffer = || BufferCompilationArg { inplace: None };
    macro_rules! of {
        ($number:ty) => {
            source(&Advance::<$number>::new(
                settings(),
                Arc::new(properties()),
                Arc::default(),
                buffer(),
                buffer(),
                buffer(),
                buffer(),
                buffer(),
                (),
                (),
                (),
                shape,
            ))
        };
    }
    match precision {
        Precision::F32 => of!(f32),
        Precision::F64 => of!(f64),
    }
}

fn source(kernel: &dyn CubeKernel) -> Result<String, Error> {
    define_kernel(kernel)
        .and_then(|definition| CppCompiler::<Cuda>::default().compile(definition, &options()))
        .map(|kernel| kernel.to_string())
        .map_err(|error| Error::Device(format!("{error:?}")))
}

/// Those of cubecl-cuda for an H100.
fn options() -> CompilationOptions {
    CompilationOptions {
        warp_size: 32,
        supports_features: CppSupportedFeatures {
            grid_constants: true,
            clusters: true,
            fast_math: true,
            fast_tanh: true,
            elect_sync: true,
            dp4a: true,
        },
        ..Default::default()
    }
}

/// Some device. The kernels ask for none of its properties.
fn properties() -> DeviceProperties {
    DeviceProperties::new(
        Features::default(),
        MemoryDeviceProperties::new(u64::MAX, 256),
        HardwareProperties {
            load_width: 128,
            vector_register_count: None,
            plane_size_min: 32,
            plane_size_max: 32,
            max_bindings: 32,
            max_shared_memory_size: 48 << 10,
            max_cube_count: (u32::MAX, 65_535, 65_535),
            max_units_per_cube: 1024,
            max_cube_dim: (1024, 1024, 64),
            num_streaming_multiprocessors: None,
            num_cpu_cores: None,
            last_level_cache_size: None,
            num_tensor_cores: None,
            min_tensor_cores_dim: None,
            max_vector_size: 4,
            cube_mma_reserved_shared_memory: 0,
        },
        TimingMethod::System,
        DeviceIdentity::default(),
    )
}
