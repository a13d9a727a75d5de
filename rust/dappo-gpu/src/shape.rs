//! What the compiler of a kernel knows of a robot: a kernel is compiled for each shape by itself.

use dappo_lanes::model::{Integrator, RimPlace};

/// The most joints of a limb.
pub const MAX_JOINTS: usize = 8;
/// The most contact points that one thread tests.
pub const MAX_SLOTS: usize = 32;
/// The most threads of a world.
pub const MAX_LANES: usize = 32;

/// Shape of a robot with one thread a limb.
#[derive(Clone, Copy, Debug, Hash, PartialEq, Eq)]
pub struct Shape {
    /// Threads of a world: its limbs, and threads without a limb up to a power of two.
    pub lanes: usize,
    /// Joints of each limb; shorter limbs end in joints that are always at rest.
    pub joints: usize,
    pub joint: [JointShape; MAX_JOINTS],
    /// Contact points of each thread: those of its limb, and its share of those of the root.
    pub slots: usize,
    pub slot: [Slot; MAX_SLOTS],
    /// Bodies of each thread on which contact forces act.
    pub bodies: usize,
    /// Touch sensors of each thread.
    pub touches: usize,
    pub integrator: Integrator,
    /// Whether the weight of some body is compensated.
    pub compensates: bool,
    /// Whether the free joint has damping.
    pub damps_root: bool,
}

/// What some joint has of those which are equally far from the root.
#[derive(Clone, Copy, Debug, Default, Hash, PartialEq, Eq)]
#[expect(clippy::struct_excessive_bools, reason = "each is a feature that costs nothing where it is absent")]
pub struct JointShape {
    /// Whether the axes at rest are those of the parent.
    pub aligned: bool,
    /// Whether an actuator moves it.
    pub actuated: bool,
    /// Whether the actuator's force depends on position or velocity.
    pub servo: bool,
    /// Whether the torque of the actuator is limited at the joint.
    pub limited_torque: bool,
    pub spring: bool,
    pub dry_friction: bool,
    /// Power of the sigmoid of its limits' impedance.
    pub limit_power: u8,
}

/// A contact point of each thread; a thread without one there has a point that never touches.
#[derive(Clone, Copy, Debug, Hash, PartialEq, Eq)]
pub struct Slot {
    /// How many joints of the limb move the point.
    pub moved_by: usize,
    pub surface: SurfaceShape,
    /// Whether the first friction axis follows a direction of the geom.
    pub follows: bool,
    /// Power of the sigmoid of the impedance.
    pub power: u8,
    /// Which of the thread's bodies has the point.
    pub body: usize,
    /// Which of the thread's touch sensors feels the point.
    pub touch: Option<usize>,
}

/// Kind of a surface: [`Surface`](dappo_lanes::model::Surface) without its numbers.
#[derive(Clone, Copy, Debug, Hash, PartialEq, Eq, PartialOrd, Ord)]
pub enum SurfaceShape {
    Ball,
    Corner,
    Rim(RimPlace),
    Ellipsoid,
}

impl Default for Slot {
    fn default() -> Self {
        Self { moved_by: 0, surface: SurfaceShape::Ball, follows: false, power: 1, body: 0, touch: None }
    }
}

impl Shape {
    /// Entries of the joints in a row of coordinates.
    pub const fn dofs(&self) -> usize {
        self.lanes * self.joints
    }

    /// Numbers of a state: qpos, qvel and the solver's guess, each with the root's first.
    pub const fn state(&self) -> usize {
        7 + 6 + 6 + 3 * self.dofs()
    }

    /// Where velocities begin in a state.
    pub const fn velocity(&self) -> usize {
        7 + self.dofs()
    }

    /// Where the solver's guess begins in a state.
    pub const fn guess(&self) -> usize {
        self.velocity() + 6 + self.dofs()
    }

    /// Numbers that a world shows: x of the root, forces of motors, of bodies and of touch sensors.
    pub const fn readings(&self) -> usize {
        self.touch_readings() + self.lanes * self.touches
    }

    /// Where the forces on bodies begin among the readings.
    pub const fn body_readings(&self) -> usize {
        1 + self.dofs()
    }

    /// Where the touch sensors begin among the readings.
    pub const fn touch_readings(&self) -> usize {
        self.body_readings() + self.lanes * self.bodies * 6
    }

    /// Sum over the sizes of a packed lower triangle of a limb.
    pub const fn block(&self) -> usize {
        lower(self.joints, 0)
    }
}

/// Place of entry (i, j) in a packed lower triangle.
pub const fn lower(i: usize, j: usize) -> usize {
    if j <= i { i * (i + 1) / 2 + j } else { j * (j + 1) / 2 + i }
}
