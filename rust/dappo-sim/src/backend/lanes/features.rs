//! Features of MuJoCo that the lane engine lacks, as the fields that switch them on.

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
