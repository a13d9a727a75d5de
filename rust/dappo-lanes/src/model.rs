//! The constants of a robot, as numbers: what the engine reads from a compiled model.
//!
//! A robot is a free root with L limbs of J hinges each, over a level floor. Limbs may hang on links of the first
//! limb instead of the root, which is then the trunk of the robot. Lengths are in m, angles in rad, masses in kg. A link's frame has its origin in the anchor of its hinge and its z axis along it; the
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
    /// Shape of friction cones.
    pub cone: Cone,
    /// Ratio of frictional to normal impedance of contacts (`opt.impratio`).
    pub impedance_ratio: f64,
    /// Gravitational acceleration, m/s².
    pub gravity: Vector,
    /// Height of the floor, m.
    pub floor: f64,
    /// Scale of the solver's stopping rule: mean diagonal of the mass matrix (`stat.meaninertia`).
    pub mean_inertia: f64,
    /// Inertia of the root and of everything fixed to it.
    pub root: Inertia,
    /// Inertia added to each of the root's coordinates (`armature` of the free joint).
    pub root_armature: f64,
    /// Viscous damping of each of the root's coordinates.
    pub root_damping: f64,
    /// Links of each limb, from the root outwards.
    pub limbs: Vec<Vec<Link>>,
    /// What each limb hangs on: a link of limb 0, which itself hangs on the root, or `None` for the root.
    pub parents: Vec<Option<usize>>,
    /// Points that can touch the floor.
    pub points: Vec<Point>,
    /// Number of bodies, the world included: rows of `cfrc_ext`.
    pub bodies: usize,
    /// Number of touch sensors.
    pub touch_sensors: usize,
    /// Number of actuators.
    pub actuators: usize,
}

impl Model {
    /// Number of degrees of freedom: entries of qvel.
    #[must_use]
    pub fn dofs(&self) -> usize {
        6 + self.limbs.iter().map(Vec::len).sum::<usize>()
    }

    /// Number of joints of the trunk: those of limb 0 if other limbs hang on it.
    #[must_use]
    pub fn trunk_joints(&self) -> usize {
        let is_trunk = self.parents.iter().any(Option::is_some);
        self.limbs.first().filter(|_| is_trunk).map_or(0, Vec::len)
    }
}

/// Friction cones of contacts (documentation: Computation, "Contact").
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Cone {
    /// A pyramid with a pair of edges for each friction dimension.
    Pyramidal,
    /// An elliptic cone.
    Elliptic,
}

/// MuJoCo's integrators (documentation: Computation, "Numerical integration").
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Integrator {
    /// Fourth-order Runge–Kutta.
    Rk4 {
        /// Whether the rates of the root's rotation are corrected for the curvature of the rotation group
        /// (Runge–Kutta–Munthe-Kaas), as MuJoCo does from 4.0 on.
        rotation_correction: bool,
    },
    /// Semi-implicit Euler.
    Euler {
        /// Whether it is implicit in joint damping (`eulerdamp`).
        implicit_damping: bool,
    },
    /// Semi-implicit Euler, implicit in the velocity derivatives of damping and actuators.
    ImplicitFast {
        /// Whether an actuator loses its derivative while its torque is clamped at the joint
        /// (`actuatorfrcrange`), as in MuJoCo from 4.0 on.
        clamped_without_derivative: bool,
    },
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
    /// Mass whose weight is compensated (`gravcomp`), kg.
    pub compensated: f64,
    /// Centre of the compensated mass.
    pub compensated_com: Vector,
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
    /// Stiffness of the joint's spring, N·m/rad.
    pub stiffness: f64,
    /// Joint position at which the spring is at rest.
    pub spring_reference: f64,
    /// Largest torque of dry friction, N·m.
    pub friction_loss: f64,
    /// Softness of dry friction.
    pub friction_softness: Softness,
    /// Range that the torque of the actuator is clamped to; infinite without limits.
    pub actuator_range: [f64; 2],
    /// Lowest and highest joint position; infinite without limits.
    pub range: [f64; 2],
    /// Distance from a limit at which it begins to push, rad.
    pub margin: f64,
    /// How the limits push back.
    pub limit: Softness,
    /// `dof_invweight0`: inverse inertia that scales the softness of limits and of dry friction.
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

/// A point that can touch the floor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Point {
    /// Limb and link that carry the point; `None` for the root.
    pub link: Option<(usize, usize)>,
    /// Where the point is on its geom.
    pub surface: Surface,
    /// Centre of the sphere around the point, or of its geom, in the carrier's frame.
    pub position: Vector,
    /// Size of the surface; what its numbers are depends on its shape.
    pub size: Vector,
    /// Direction that the first friction axis follows, in the carrier's frame; the world's y without it.
    pub tangent: Option<Vector>,
    /// Distance from the floor at which contact begins, m.
    pub margin: f64,
    /// How the floor pushes back.
    pub softness: Softness,
    /// Dimensions of the contact: 1 is frictionless, 3 has sliding, 4 also torsional and 6 also rolling friction.
    pub dimensions: usize,
    /// Coefficients of sliding, torsional (m) and rolling (m) friction.
    pub friction: Vector,
    /// `body_invweight0` of the point's body: inverse mass that scales the contact's softness.
    pub inverse_weight: f64,
    /// Body of the point, a row of `cfrc_ext`.
    pub body: usize,
    /// Touch sensor that feels the point.
    pub touch: Option<usize>,
}

/// What kind of point can touch the floor; directions are in the carrier's frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Surface {
    /// The lowest point of a sphere or of the end of a capsule. Size: the radius.
    Ball,
    /// A corner of a box, fixed to the carrier at `position`. It touches only while it is not above the middle.
    /// Size: the way to the corner from the middle of its box, in the carrier's frame.
    Corner,
    /// One of the four points of a cylinder that can touch a floor. Size: radius and half length.
    Rim {
        /// Axes of the cylinder; the third is that of its symmetry.
        axes: [Vector; 3],
        /// Which of the four.
        place: RimPlace,
    },
    /// The lowest point of an ellipsoid. Size: the semi-axes.
    Ellipsoid {
        /// Principal axes.
        axes: [Vector; 3],
    },
}

/// The points of a cylinder that can touch a floor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum RimPlace {
    /// The lowest point.
    Lowest,
    /// The lowest point of the other end.
    OtherEnd,
    /// The first of the two that complete an equilateral triangle on the lower end.
    Left,
    /// The second of them.
    Right,
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
    /// Power of the sigmoid.
    pub power: u8,
}
