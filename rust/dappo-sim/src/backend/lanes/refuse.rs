//! What the lane engine does not know: a robot that has any of it belongs to libmujoco.

use dappo_lanes::Unsupported;

use super::arrays::ModelArrays;

/// Whose field it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Owner {
    Model,
    Body,
    Joint,
    Dof,
    Geom,
    Pair,
    Actuator,
    Sensor,
}

/// Fields that must be zero, whose they are, and what they stand for. Versions of MuJoCo that lack one lack
/// the feature too.
pub(super) const OFF: &[(&str, Owner, &str)] = &[
    ("neq", Owner::Model, "equality constraints"),
    ("ntendon", Owner::Model, "tendons"),
    ("na", Owner::Model, "actuator activations"),
    ("nflex", Owner::Model, "flexible bodies"),
    ("nmocap", Owner::Model, "mocap bodies"),
    ("nplugin", Owner::Model, "plugins"),
    ("nplastic", Owner::Model, "plasticity"),
    ("nhistory", Owner::Model, "delayed signals"),
    ("opt.cone", Owner::Model, "elliptic friction cones"),
    ("opt.enableflags", Owner::Model, "special features switched on"),
    ("opt.disableactuator", Owner::Model, "actuator groups switched off"),
    ("opt.noslip_iterations", Owner::Model, "a no-slip solver"),
    ("opt.density", Owner::Model, "a fluid's density"),
    ("opt.viscosity", Owner::Model, "a fluid's viscosity"),
    ("opt.wind", Owner::Model, "wind"),
    ("body_gravcomp", Owner::Body, "gravity compensation"),
    ("jnt_stiffness", Owner::Joint, "a spring"),
    ("jnt_stiffnesspoly", Owner::Joint, "a nonlinear spring"),
    ("jnt_springyield", Owner::Joint, "a yielding spring"),
    ("jnt_actfrclimited", Owner::Joint, "a limit of its actuators' force"),
    ("dof_frictionloss", Owner::Dof, "friction loss"),
    ("dof_dampingpoly", Owner::Dof, "nonlinear damping"),
    ("geom_adhesion", Owner::Geom, "adhesion"),
    ("geom_surfacevel", Owner::Geom, "a moving surface"),
    ("pair_adhesion", Owner::Pair, "adhesion"),
    ("pair_gap", Owner::Pair, "a gap"),
    ("pair_solreffriction", Owner::Pair, "a softness of its own for friction"),
    ("actuator_dyntype", Owner::Actuator, "activation dynamics"),
    ("actuator_trntype", Owner::Actuator, "a transmission other than a joint"),
    ("actuator_gaintype", Owner::Actuator, "a gain other than a fixed one"),
    ("actuator_damping", Owner::Actuator, "damping of its own"),
    ("actuator_dampingpoly", Owner::Actuator, "nonlinear damping"),
    ("actuator_armature", Owner::Actuator, "armature of its own"),
    ("actuator_delay", Owner::Actuator, "a delay"),
    ("sensor_type", Owner::Sensor, "a reading other than touch"),
    ("sensor_cutoff", Owner::Sensor, "a cutoff"),
    ("sensor_delay", Owner::Sensor, "a delay"),
    ("sensor_interval", Owner::Sensor, "an interval"),
];

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
        return refuse(format!("{called} has {what} ({name} = {}), which it does not know", on.value));
    }
    check_options(model)
}

fn check_options(model: &ModelArrays) -> Result<(), Unsupported> {
    let disabled = model.disableflags & !ISLANDS_OFF;
    if disabled != 0 {
        return refuse(format!("opt.disableflags switches parts of MuJoCo off (bits {disabled:#x})"));
    }
    if model.solver != NEWTON {
        return refuse(format!("opt.solver is {}; it knows Newton's method alone", model.solver));
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
