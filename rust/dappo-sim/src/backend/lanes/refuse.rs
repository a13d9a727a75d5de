//! What the lane engine does not support: a robot that has any of it belongs to libmujoco.

use dappo_lanes::Unsupported;

use super::arrays::ModelArrays;
use super::features::OFF;

/// `mjDSBL_ISLAND`: constraint islands are a matter of speed, and the class table switches them off.
const ISLANDS_OFF: i32 = 1 << 18;
/// `mjSOL_NEWTON`.
const NEWTON: f64 = 2.0;
/// MuJoCo's Newton solver needs fewer iterations, so a limit from here on does not act.
const ENOUGH_ITERATIONS: f64 = 10.0;

/// A refusal.
pub(super) fn refuse<T>(why: impl Into<String>) -> Result<T, Unsupported> {
    Err(Unsupported(why.into()))
}

/// Refuses a model that has a feature or an option unknown to the engine.
pub(super) fn check_features(model: &ModelArrays) -> Result<(), Unsupported> {
    if let Some(on) = model.switched.first() {
        let (name, owner, what) = OFF[on.feature];
        let index = (on.share * model.count(owner) as f64 + 1e-9) as usize;
        let called = model.called(owner, index);
        return refuse(format!("{called} has {what} ({name} = {}), which it does not support", on.value));
    }
    check_options(model)
}

fn check_options(model: &ModelArrays) -> Result<(), Unsupported> {
    let disabled = model.disableflags & !ISLANDS_OFF;
    if disabled != 0 {
        return refuse(format!("opt.disableflags switches parts of MuJoCo off (bits {disabled:#x})"));
    }
    if model.solver != NEWTON {
        return refuse(format!("opt.solver is {}; it supports Newton's method alone", model.solver));
    }
    for (name, limit) in [("iterations", model.iterations), ("ls_iterations", model.ls_iterations)] {
        if limit < ENOUGH_ITERATIONS {
            return refuse(format!("opt.{name} is {limit}; it solves to the end"));
        }
    }
    if model.impratio != 1.0 {
        return refuse(format!("opt.impratio is {}, expected 1", model.impratio));
    }
    if model.gravity[..2] != [0.0, 0.0] {
        return refuse(format!("opt.gravity is {:?}, which is not along z", model.gravity));
    }
    Ok(())
}
