//! The constants of a robot, as numbers: what the engine reads from a compiled model.
//!
//! A robot is a free root with L limbs of J hinges each, over a level floor. Lengths are in m, angles in
//! rad, masses in kg. A link's frame has its origin in the anchor of its hinge and its z axis along it; the
//! root's frame is that of its body.

/// A 3-vector.
pub type Vector = [f64; 3];

/// One robot: a damage class is another `Model` of the same robot.
#[derive(Debug, Clone, PartialEq)]
pub struct Model {
    /// Duration of a substep, s.
    pub timestep: f64,
    /// How a substep is integrated.
    pub integrator: Integrator,
    /// Gravitational acceleration along −z, m/s².
    pub gravity: f64,
    /// Height of the floor, m.
    pub floor: f64,
    /// Scale of the solver's stopping rule: mean diagonal of the mass matrix (`stat.meaninertia`).
    pub mean_inertia: f64,
    /// Inertia of the root and of everything fixed to it.
    pub root: Inertia,
    /// Links of each limb, from the root outwards.
    pub limbs: Vec<Vec<Link>>,
    /// Points that can touch the floor.
    pub points: Vec<Point>,
    /// How the floor pushes back.
    pub contact: Softness,
    /// How joint limits push back.
    pub limit: Softness,
    /// Number of bodies, the world included: rows of `cfrc_ext`.
    pub bodies: usize,
    /// Number of touch sensors.
    pub touch_sensors: usize,
    /// Number of actuators.
    pub actuators: usize,
}

/// MuJoCo's integrators (documentation: Computation, "Numerical integration").
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Integrator {
    /// Fourth-order Runge–Kutta.
    Rk4 {
        /// Whether the rates of the root's rotation are corrected for the curvature of the rotation group
        /// (Runge–Kutta–Munthe-Kaas), as MuJoCo does from 4.0 on.
        rotation_correction: bool,
    },
    /// Semi-implicit Euler, implicit in joint damping.
    Euler,
    /// Semi-implicit Euler, implicit in the velocity derivatives of damping and actuators.
    ImplicitFast,
}

/// Mass distribution of a rigid body in its frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Inertia {
    /// Mass, kg.
    pub mass: f64,
    /// Centre of mass.
    pub com: Vector,
    /// Inertia about the centre of mass: xx, yy, zz, xy, xz, yz, kg·m².
    pub tensor: [f64; 6],
}

/// A hinge and the rigid body behind it.
#[derive(Debug, Clone, PartialEq)]
pub struct Link {
    /// Anchor of the hinge in the parent's frame.
    pub offset: Vector,
    /// Axes of this link's frame at angle `zero`, each in the parent's frame.
    pub axes: [Vector; 3],
    /// Joint position (entry of qpos) at which `axes` hold.
    pub zero: f64,
    /// Mass distribution of the link and everything fixed to it.
    pub inertia: Inertia,
    /// Rotor inertia, kg·m².
    pub armature: f64,
    /// Viscous damping, N·m·s.
    pub damping: f64,
    /// Lowest and highest joint position; infinite without limits.
    pub range: [f64; 2],
    /// Distance from a limit at which it begins to push, rad.
    pub margin: f64,
    /// `dof_invweight0`: inverse inertia that scales the limit's softness.
    pub inverse_weight: f64,
    /// Index of the joint in qvel; its index in qpos is one more.
    pub dof: usize,
    /// The joint's motor or servo.
    pub actuator: Option<Actuator>,
}

/// An actuator on a hinge: force = gain · ctrl + bias₀ + bias₁ · length + bias₂ · velocity.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Actuator {
    /// Index in ctrl.
    pub index: usize,
    /// Ratio of actuator length to joint position.
    pub gear: f64,
    /// Force per unit of control.
    pub gain: f64,
    /// Constant, position and velocity coefficients of the passive force.
    pub bias: Vector,
    /// Range that the control is clamped to; infinite without limits.
    pub ctrl_range: [f64; 2],
    /// Range that the force is clamped to; infinite without limits.
    pub force_range: [f64; 2],
}

/// A point that can touch the floor: a sphere, one end of a capsule or a corner of a box.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Point {
    /// Limb and link that carry the point; `None` for the root.
    pub link: Option<(usize, usize)>,
    /// Centre of the sphere around the point, in the carrier's frame.
    pub position: Vector,
    /// Radius of that sphere; 0 for a corner.
    pub radius: f64,
    /// Direction that the first friction axis follows, in the carrier's frame; the world's y without it.
    pub tangent: Option<Vector>,
    /// For a corner: the way to it from the middle of its box, in the carrier's frame. It must lead down.
    pub corner: Option<Vector>,
    /// Distance from the floor at which contact begins, m.
    pub margin: f64,
    /// Coefficient of sliding friction.
    pub friction: f64,
    /// `body_invweight0` of the point's body: inverse mass that scales the contact's softness.
    pub inverse_weight: f64,
    /// Body of the point, a row of `cfrc_ext`.
    pub body: usize,
    /// Touch sensor that feels the point.
    pub touch: Option<usize>,
}

/// Softness of a constraint (documentation: Modeling, "Solver parameters").
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Softness {
    /// Stiffness k of the reference acceleration −b·v − k·d·r, 1/s².
    pub stiffness: f64,
    /// Damping b of the reference acceleration, 1/s.
    pub damping: f64,
    /// Impedance d at no and at full violation.
    pub impedance: [f64; 2],
    /// Violation at which the impedance is full.
    pub width: f64,
    /// Share of the width at which the two branches of the sigmoid meet.
    pub midpoint: f64,
    /// Power of the sigmoid, 1 or 2.
    pub power: u8,
}
