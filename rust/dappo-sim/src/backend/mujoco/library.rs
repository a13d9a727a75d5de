//! libmujoco, loaded at run time.
//!
//! Only functions are used whose signature has been stable for years, with opaque pointers: Rust depends on
//! no struct layout, so one build serves every MuJoCo from 3.x to 4.x.

use std::ffi::{c_int, c_uint, c_void};
use std::path::Path;
use std::sync::Arc;

use libloading::Library;

use crate::error::SimError;

/// `mjModel*`.
pub(super) type Model = *const c_void;
/// `mjData*`.
pub(super) type Data = *mut c_void;

type OnData = unsafe extern "C" fn(Model, Data);
type GetState = unsafe extern "C" fn(Model, Data, *mut f64, c_uint);
type SetState = unsafe extern "C" fn(Model, Data, *const f64, c_uint);
type StateSize = unsafe extern "C" fn(Model, c_uint) -> c_int;

/// The functions of libmujoco that a worker calls.
#[derive(Clone)]
pub struct MujocoLibrary {
    pub(super) step: OnData,
    pub(super) forward: OnData,
    pub(super) reset_data: OnData,
    pub(super) rne_post_constraint: OnData,
    pub(super) get_state: GetState,
    pub(super) set_state: SetState,
    pub(super) state_size: StateSize,
    /// Keeps the library mapped while a function pointer exists.
    _library: Arc<Library>,
}

impl MujocoLibrary {
    /// Loads the shared library at `path`, normally the one inside the `mujoco` Python package.
    pub fn load(path: &Path) -> Result<Self, SimError> {
        let failed = |error: libloading::Error| SimError::Library {
            path: path.display().to_string(),
            reason: error.to_string(),
        };
        // SAFETY: loading libmujoco runs its static initialisers only; Python has usually loaded it before.
        let library = unsafe { Library::new(path) }.map_err(failed)?;
        macro_rules! symbol {
            ($name:literal) => {
                // SAFETY: the types above are the signatures of MuJoCo's C API, unchanged since 3.0.
                *unsafe { library.get($name) }.map_err(failed)?
            };
        }
        Ok(Self {
            step: symbol!(b"mj_step\0"),
            forward: symbol!(b"mj_forward\0"),
            reset_data: symbol!(b"mj_resetData\0"),
            rne_post_constraint: symbol!(b"mj_rnePostConstraint\0"),
            get_state: symbol!(b"mj_getState\0"),
            set_state: symbol!(b"mj_setState\0"),
            state_size: symbol!(b"mj_stateSize\0"),
            _library: Arc::new(library),
        })
    }
}
