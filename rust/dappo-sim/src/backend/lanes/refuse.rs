//! What the lane engine does not support: a robot that has any of it belongs to libmujoco.

use dappo_lanes::Unsupported;

use super::arrays::ModelArrays;
use super::features::{OFF, Owner};

/// Bits of `mjtDisableBit` that do not change the physics of a robot on a floor, or that the engine obeys:
/// warm starts, filtering of parents, sensors' order of evaluation, the search for collisions, islands and,
/// for Euler, damping.
const HARMLESS_OFF: i32 = (1 << 9) | (1 << 10) | (1 << 14) | EULER_DAMPING_OFF | (0b1111 << 16);
/// `mjDSBL_EULERDAMP`.
pub(super) const EULER_DAMPING_OFF: i32 = 1 << 15;
/// Bits of `mjtEnableBit` that compute something else besides: energy and inverse dynamics.
const HARMLESS_ON: i32 = (1 << 1) | (1 << 2) | (1 << 3);
/// `mjSOL_NEWTON`.
const NEWTON: f64 = 2.0;
/// MuJoCo's Newton solver needs fewer iterations, so a limit from here on does not act.
const ENOUGH_ITERATIONS: f64 = 10.0;

/// A refusal.
pub(super) fn refuse<T>(why: impl Into<String>) -> Result<T, Unsupported> {
    Err(Unsupported(why.into()))
}

/// The reasons why a model is refused, all that could be found.
#[derive(Debug, Default)]
pub(super) struct Reasons(Vec<String>);

impl Reasons {
    /// Adds a reason.
    pub fn add(&mut self, why: impl Into<String>) {
        let why = why.into();
        if !self.0.contains(&why) {
            self.0.push(why);
        }
    }

    /// What a result holds, or `None` with its reason added.
    pub fn keep<T>(&mut self, result: Result<T, Unsupported>) -> Option<T> {
        result.map_err(|Unsupported(why)| self.add(why)).ok()
    }

    /// The value that was built, if there was no reason against it.
    pub fn unless_any<T>(self, value: Option<T>) -> Result<T, Vec<String>> {
        match value {
            Some(value) if self.0.is_empty() => Ok(value),
            _ => Err(self.0),
        }
    }
}

/// Finds the features and options of a model that are unknown to the engine. `read` are the addresses of the
/// sensors that are read; others do not matter.
pub(super) fn check_features(model: &ModelArrays, read: &[usize], reasons: &mut Reasons) {
    for (feature, (name, owner, what)) in OFF.iter().enumerate() {
        let matters =
            |index: usize| *owner != Owner::Sensor || read.contains(&(model.sensor_adr[index] as usize));
        let on: Vec<_> = model
            .switched
            .iter()
            .filter(|on| on.feature == feature)
            .map(|on| ((on.share * model.count(*owner) as f64 + 1e-9) as usize, on.value))
            .filter(|(index, _)| matters(*index))
            .collect();
        let Some((first, value)) = on.first() else { continue };
        let mut owners: Vec<usize> = on.iter().map(|(index, _)| *index).collect();
        owners.dedup();
        let (called, verb) = model.called_with_others(*owner, *first, owners.len() - 1, ("has", "have"));
        reasons.add(format!("{called} {verb} {what} ({name} = {value}), which it does not support"));
    }
    check_options(model, reasons);
}

fn check_options(model: &ModelArrays, reasons: &mut Reasons) {
    let disabled = model.disableflags & !HARMLESS_OFF;
    if disabled != 0 {
        reasons.add(format!("opt.disableflags switches parts of MuJoCo off (bits {disabled:#x})"));
    }
    let enabled = model.enableflags & !HARMLESS_ON;
    if enabled != 0 {
        reasons.add(format!(
            "the model has special features switched on (opt.enableflags = {enabled:#x}), which it does not support"
        ));
    }
}

/// Where the engine deliberately differs from the model's options: it solves the constraints to the end.
pub(super) fn notes(model: &ModelArrays) -> Vec<String> {
    let mut options = Vec::new();
    if model.solver != NEWTON {
        options.push(format!("opt.solver is {} (Newton is {NEWTON})", model.solver));
    }
    for (name, limit) in [("iterations", model.iterations), ("ls_iterations", model.ls_iterations)] {
        if limit < ENOUGH_ITERATIONS {
            options.push(format!("opt.{name} is {limit}"));
        }
    }
    if options.is_empty() {
        return Vec::new();
    }
    vec![format!(
        "the lane engine solves contacts and limits to convergence, although {}",
        options.join(" and ")
    )]
}
