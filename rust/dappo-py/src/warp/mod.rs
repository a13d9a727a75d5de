//! The backend `warp`: MuJoCo's equations on a GPU, in kernels that Python launches (`kernels/`).

pub mod arrays;
mod backend;
mod engine;
mod task;

use dappo_sim::backend::gpu;
use dappo_sim::{Device, SimError};
use pyo3::prelude::*;

use crate::errors::{Kind, is_ours, raise, to_sim};

pub use backend::WarpBackend;
pub use engine::WarpEngine;
pub use task::check;

/// Room for contacts and constraints; what the robot can need at most for `None`.
#[derive(Debug, Clone, Copy, Default)]
pub struct Room {
    /// Constraints of an env.
    pub njmax: Option<usize>,
    /// Contacts, an env on average.
    pub nconmax: Option<usize>,
}

/// Resolves a requested device on this machine: `auto` becomes another one, and an unusable one is an error.
pub fn resolve(wish: Device) -> Result<Device, SimError> {
    match wish {
        Device::Cpu => return Ok(wish),
        Device::Gpu => return gpu::device().map(|_| wish),
        Device::Auto | Device::Cuda | Device::WarpCpu => {}
    }
    let name: String = undisturbed(|py| devices(py)?.call_method1("resolve", (wish.name(),))?.extract())?;
    Device::parse(&name)
}

/// An object of Python that owns memory of a device.
struct Handle {
    object: Option<Py<PyAny>>,
    /// The process that opened the device.
    process: u32,
}

impl Handle {
    fn new(object: Bound<'_, PyAny>) -> Self {
        Self { object: Some(object.unbind()), process: std::process::id() }
    }

    fn bind<'py>(&self, py: Python<'py>) -> PyResult<&Bound<'py, PyAny>> {
        if self.process != std::process::id() {
            let message = "the device was opened before this process was forked, and a GPU cannot be used on both \
                           sides of a fork; start processes with the method `spawn` or `forkserver`";
            return Err(raise(Kind::Simulation, message));
        }
        let closed = || raise(Kind::Simulation, "the device has been closed");
        Ok(self.object.as_ref().ok_or_else(closed)?.bind(py))
    }
}

impl Drop for Handle {
    /// Freeing runs Python code too, which a Ctrl-C that waits in the main thread would hit.
    fn drop(&mut self) {
        let Some(object) = self.object.take() else { return };
        if self.process != std::process::id() {
            // The memory is the parent's.
            return std::mem::forget(object);
        }
        let is_finalizing = |py: Python<'_>| py.import("sys")?.call_method0("is_finalizing")?.extract();
        // An interpreter that is shutting down runs no other thread.
        if !Python::attach(is_finalizing).unwrap_or(true) {
            // An error of Warp while it frees memory has no receiver left.
            let _ = undisturbed(move |_| {
                drop(object);
                Ok(())
            });
        }
    }
}

fn devices(py: Python<'_>) -> PyResult<Bound<'_, PyModule>> {
    py.import("dappo_batch.devices")
}

/// Runs Python code in a thread of its own. Python raises Ctrl-C in its main thread alone, so it cannot end a
/// step halfway; the calling thread may hold the GIL or not.
fn undisturbed<T: Send>(work: impl FnOnce(Python<'_>) -> PyResult<T> + Send) -> Result<T, SimError> {
    let run = || {
        std::thread::scope(|scope| {
            let worker = scope.spawn(|| Python::attach(|py| work(py).map_err(|error| explain(py, &error))));
            worker
                .join()
                .unwrap_or_else(|_| Err(SimError::Device("the thread of the device has died".into())))
        })
    };
    Python::attach(|py| py.detach(run))
}

/// An exception of Warp or of the kernels as an error for a user.
fn explain(py: Python<'_>, error: &PyErr) -> SimError {
    if is_ours(py, error) {
        return to_sim(py, error);
    }
    let text = devices(py).and_then(|module| module.call_method1("explain", (error.value(py),))?.extract());
    SimError::Device(text.unwrap_or_else(|_| error.to_string()))
}
