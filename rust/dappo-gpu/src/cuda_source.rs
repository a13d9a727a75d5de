//! The kernels as CUDA C++: what a build for CUDA would give to its compiler. No GPU is needed, nor a driver of one.
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
use dappo_lanes::Model;

use crate::device::THREADS;
use crate::error::Error;
use crate::kernel::advance::Advance;
use crate::kernel::evaluate::Evaluate;
use crate::networks::gather::Gather;
use crate::networks::layer::Layer;
use crate::networks::prepare::Prepare;
use crate::networks::sample::Sample;
use crate::skeleton::Skeleton;
use crate::task::kernels::begin_episodes::BeginEpisodes;
use crate::task::kernels::begin_step::BeginStep;
use crate::task::kernels::end_step::EndStep;
use crate::task::kernels::observe_placed::ObservePlaced;
use crate::task::places::Places;
use crate::task::plan::{Plan, Task};
use crate::task::variation::vary::Vary;

/// A kernel in single precision, given what follows its launch settings.
macro_rules! kernel {
    ($kernel:ty, $($argument:expr),*) => {{
        let settings =
            KernelSettings::new(*CubeDim::new_1d(THREADS as u32), ExecutionMode::Unchecked, AddressType::U32);
        source(&<$kernel>::new(settings, Arc::new(properties()), Arc::default(), $($argument),*))
    }};
}

fn buffer() -> BufferCompilationArg {
    BufferCompilationArg { inplace: None }
}

/// The kernel that advances worlds of a robot, given by the models of all damage classes.
///
/// # Errors
/// If the kernel does not support the robot, or CUDA C++ cannot express the kernel.
pub fn advance(classes: &[Model]) -> Result<String, Error> {
    let shape = Skeleton::new(classes)?.shape;
    let b = buffer;
    kernel!(Advance<f32>, b(), b(), b(), b(), b(), (), (), shape)
}

/// All other kernels of a rollout, with their names.
///
/// # Errors
/// If the kernels do not support the robot, or CUDA C++ cannot express them.
pub fn rollout(classes: &[Model], plan: &Plan) -> Result<Vec<(&'static str, String)>, Error> {
    let skeleton = Skeleton::new(classes)?;
    let task = || Task { plan: plan.clone(), places: Places::new(&skeleton) };
    let (b, shape) = (buffer, skeleton.shape);
    Ok(vec![
        ("begin_episodes", {
            kernel!(BeginEpisodes<f32>, b(), b(), b(), b(), b(), b(), b(), b(), b(), (), (), task())?
        }),
        ("begin_step", kernel!(BeginStep<f32>, b(), b(), b(), b(), b(), b(), b(), b(), (), (), (), task())?),
        ("vary", kernel!(Vary<f32>, b(), b(), b(), b(), b(), (), (), task())?),
        ("evaluate", kernel!(Evaluate<f32>, b(), b(), b(), b(), b(), b(), (), false, shape)?),
        ("end_step", {
            let (next, last, shown) = ((), (), ());
            kernel!(
                EndStep<f32>,
                b(),
                b(),
                b(),
                b(),
                b(),
                b(),
                b(),
                b(),
                b(),
                b(),
                b(),
                b(),
                next,
                last,
                shown,
                (),
                (),
                task()
            )?
        }),
        ("observe_placed", {
            kernel!(ObservePlaced<f32>, b(), b(), b(), b(), b(), b(), b(), b(), (), (), task())?
        }),
        ("prepare", kernel!(Prepare, b(), b(), b(), (), (), (), (), 40, 30, 8)?),
        ("layer", kernel!(Layer, b(), b(), b(), (), (), (), 128, 128, true)?),
        ("sample", kernel!(Sample<f32>, b(), b(), b(), b(), b(), (), (), (), (), (), (), plan.nu())?),
        ("gather", kernel!(Gather, b(), b(), b(), (), ())?),
    ])
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
