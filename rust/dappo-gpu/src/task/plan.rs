//! What the compiler of the task's kernels knows of a task: kernels are compiled for each task by itself.
#![allow(missing_docs, reason = "terms and events are those of robot files")]

use std::ops::Range;

use super::places::Places;

/// A constant of a task, by its bits: what kernels are compiled for must have an equality.
#[derive(Clone, Copy, Debug, Hash, PartialEq, Eq)]
pub struct Constant(u64);

impl From<f64> for Constant {
    fn from(value: f64) -> Self {
        Self(value.to_bits())
    }
}

impl Constant {
    /// The number.
    #[must_use]
    pub const fn get(self) -> f64 {
        f64::from_bits(self.0)
    }
}

/// A range of a constant.
pub type Interval = [Constant; 2];

/// A task of a robot: what its envs observe, are rewarded for, and draw.
///
/// Indices of positions, velocities, actuators, bodies and limbs are MuJoCo's; `actuated` and `feet` say which numbers
/// of a model's kernels they are.
#[derive(Clone, Debug, Hash, PartialEq, Eq)]
pub struct Plan {
    /// Duration of an env step, s.
    pub dt: Constant,
    /// Physics substeps an env step.
    pub substeps: u32,
    /// Half-width of the noise of the initial positions.
    pub qpos_noise: Constant,
    /// Standard deviation of that of the initial velocities.
    pub qvel_noise: Constant,
    /// Actuators, in the order of the actions.
    pub actuators: Vec<Actuator>,
    /// Number of bodies, the world included.
    pub bodies: usize,
    /// Number of damage classes.
    pub classes: u32,
    /// Bodies of each limb.
    pub limbs: Vec<Vec<usize>>,
    /// Touch sensor of each limb; empty without touch sensors.
    pub touches: Vec<usize>,
    /// Bodies between the root and each foot.
    pub feet: Vec<Foot>,
    /// Joints whose limits move in a damage class, at most.
    pub jams: usize,
    /// Compiled variants of each damage class.
    pub variants: usize,
    /// Numbers of a compiled variant.
    pub variant_numbers: usize,
    pub command: Option<Command>,
    pub events: Events,
    /// What the policy observes.
    pub policy: Vec<Observed>,
    /// What the value net is given besides.
    pub critic: Vec<Observed>,
    /// Entries of a damage code; 0 if damage is not observed.
    pub code: usize,
    pub rewards: Vec<Reward>,
    pub limits: Limits,
    pub memory: Memory,
    pub episode: Episode,
}

/// One actuator and its hinge.
#[derive(Clone, Debug, Hash, PartialEq, Eq)]
pub struct Actuator {
    /// ctrl = offset + scale · clip(action, ±1).
    pub offset: Constant,
    pub scale: Constant,
    /// Index of the hinge in qpos and in qvel.
    pub qpos: usize,
    pub dof: usize,
    /// Position of the hinge in the default pose, rad.
    pub start: Constant,
    /// Lowest and highest position, rad; infinite without limits.
    pub range: Interval,
    /// Whether its control is a joint position.
    pub is_position: bool,
}

/// A point that is fixed to the last body of a limb.
#[derive(Clone, Debug, Hash, PartialEq, Eq)]
pub struct Foot {
    pub body: usize,
    /// Index in qpos of the hinge of each body from the root outwards, if it has one.
    pub hinges: Vec<Option<usize>>,
}

/// Numbers of a link of a foot: position in the parent (3), orientation there (4), axis (3) and anchor (3) of its hinge,
/// and the hinge's reference position.
pub const FOOT_LINK: usize = 14;

impl Foot {
    /// Numbers that a model has of it: those of its links, and where the point is in the last body.
    #[must_use]
    pub fn len(&self) -> usize {
        self.hinges.len() * FOOT_LINK + 3
    }

    /// Whether it has none, which no foot does.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        false
    }
}

/// A commanded velocity.
#[derive(Clone, Copy, Debug, Hash, PartialEq, Eq)]
pub struct Command {
    pub lin_vel_x: Interval,
    pub lin_vel_y: Interval,
    pub ang_vel_z: Interval,
    /// Share of commands to stand still.
    pub standing: Constant,
    /// Time from one command to the next, s.
    pub resample_every: Interval,
    /// Share of the ranges at the start, and steps of an env until it is 1.
    pub ramp: Option<[Constant; 2]>,
}

/// What is random about a robot.
#[derive(Clone, Copy, Debug, Default, Hash, PartialEq, Eq)]
pub struct Events {
    pub friction: Option<Interval>,
    pub motor_strength: Option<Interval>,
    pub kp: Option<Interval>,
    pub kd: Option<Interval>,
    pub joint_damping: Option<Interval>,
    pub joint_armature: Option<Interval>,
    pub gravity: Option<Interval>,
    pub encoder_bias: Option<Interval>,
    /// Fewest and most steps until an action arrives.
    pub action_delay: Option<[u32; 2]>,
    pub push: Option<Push>,
}

/// Sudden changes of the root's velocity.
#[derive(Clone, Copy, Debug, Hash, PartialEq, Eq)]
pub struct Push {
    pub every: Interval,
    pub lin_vel: Constant,
    pub ang_vel: Constant,
}

/// A quantity that is observed, and what becomes of it.
#[derive(Clone, Copy, Debug, Hash, PartialEq, Eq)]
pub struct Observed {
    pub quantity: Quantity,
    /// Entries of the quantity.
    pub width: usize,
    pub noise: Constant,
    pub clip: Option<Constant>,
    pub scale: Constant,
    /// Steps whose values are kept; 0 if none are.
    pub frames: usize,
    /// Steps whose values are observed.
    pub history: usize,
}

/// Something that can be observed.
#[derive(Clone, Copy, Debug, Hash, PartialEq, Eq)]
pub enum Quantity {
    Qpos { skip: usize },
    Qvel,
    CfrcExt,
    Touch,
    BaseHeight,
    BaseLinVel,
    BaseAngVel,
    ProjectedGravity,
    Command,
    JointPos,
    JointVel,
    LastAction,
    Clock { period: Constant },
    FootContact,
    FootVel,
    FootHeight,
    FootAirTime,
    Events,
}

/// A summand of the reward.
#[derive(Clone, Copy, Debug, Hash, PartialEq, Eq)]
pub struct Reward {
    pub weight: Constant,
    pub measure: Measure,
}

/// What a reward measures.
#[derive(Clone, Copy, Debug, Hash, PartialEq, Eq)]
pub enum Measure {
    ForwardVelocity,
    Survive,
    Termination,
    LimbContacts,
    CtrlSquared,
    ContactForcesSquared { clip: Constant },
    LinkLoadsSquared { clip: Constant },
    TrackLinVel { std: Constant },
    TrackAngVel { std: Constant },
    Upright { std: Constant },
    TiltSquared,
    LinVelZSquared,
    AngVelXySquared,
    BaseHeightSquared { target: Constant },
    ActionRateSquared,
    TorqueSquared,
    Power,
    JointLimits { soft: Constant },
    PoseSquared,
    Pose { std: Constant },
    StandStill,
    FeetAirTime { threshold: Constant },
    FeetSlip,
    FeetClearance { target: Constant },
    Landing,
}

/// When an episode has failed.
#[derive(Clone, Debug, Hash, PartialEq, Eq)]
pub struct Limits {
    /// Range of heights (z) of the root, m.
    pub height: Interval,
    /// Cosine of the largest tilt.
    pub cosine: Constant,
    /// Bodies that must not touch anything.
    pub bodies: Vec<usize>,
    /// Contact force that ends the episode, N.
    pub force: Constant,
}

/// Where each quantity is in what an env remembers; the episode's own numbers are elsewhere.
#[derive(Clone, Debug, Hash, PartialEq, Eq)]
pub struct Memory {
    /// Commanded velocity, and the step at which it is drawn again.
    pub command: Range<usize>,
    /// Steps of the env in all episodes.
    pub total: Range<usize>,
    /// Actions of the last two steps, the last one first.
    pub actions: Range<usize>,
    /// Actions that wait, the oldest first.
    pub waiting: Range<usize>,
    /// What the events have drawn.
    pub events: Range<usize>,
    /// Index of the compiled variant.
    pub variant: Range<usize>,
    /// By how much the limits of jammed joints have moved, rad.
    pub jams: Range<usize>,
    /// Motion and contact of each foot.
    pub feet: Range<usize>,
    /// Earlier values of observations; those of the critic follow those of the policy.
    pub frames: usize,
    /// Numbers that the host remembers, too.
    pub len: usize,
}

/// How episodes begin and end.
#[derive(Clone, Copy, Debug, Hash, PartialEq, Eq)]
pub struct Episode {
    /// Steps after which an episode is truncated.
    pub max_steps: u32,
    /// Steps for which an env has its class at least.
    pub min_class_steps: u32,
    /// First and last step at which damage strikes.
    pub onset: [u32; 2],
    /// How long it lasts; `None` for good.
    pub duration: Option<[u32; 2]>,
    /// How long until it returns; `None` for never.
    pub pause: Option<[u32; 2]>,
    /// Steps by which its code is late.
    pub code_delay: [u32; 2],
}

/// Numbers of a variation of the physics among those of the events: six factors and the direction of gravity.
pub const VARIATION: usize = 9;
/// Numbers of a foot that an env remembers.
pub const FOOT: usize = 9;
/// Numbers of a command.
pub const COMMAND: usize = 3;
/// Numbers of a jam that a model has: place of the joint, share, position for which the model was compiled, lowest and
/// highest position at which the joint jams.
pub const JAM: usize = 5;

impl Events {
    /// Whether the physics of the envs differs.
    #[must_use]
    pub fn varies(&self) -> bool {
        let scaled =
            [self.friction, self.motor_strength, self.kp, self.kd, self.joint_damping, self.joint_armature];
        self.gravity.is_some() || scaled.iter().any(Option::is_some)
    }
}

impl Plan {
    /// Whether envs have constants of their own.
    #[must_use]
    pub fn varies(&self) -> bool {
        self.events.varies() || self.jams > 0
    }

    /// Number of actuators.
    #[must_use]
    pub fn nu(&self) -> usize {
        self.actuators.len()
    }

    /// Whether a term follows from the motion of the feet.
    #[must_use]
    pub fn needs_feet(&self) -> bool {
        !self.memory.feet.is_empty()
    }

    /// Entries of an observation, privileged ones and the damage code included.
    #[must_use]
    pub fn obs_len(&self) -> usize {
        self.policy_len() + entries(&self.critic) + self.code
    }

    /// Entries of an observation that the policy is given, without the damage code.
    #[must_use]
    pub fn policy_len(&self) -> usize {
        entries(&self.policy)
    }

    /// Where encoder errors begin among the numbers of the events.
    pub(crate) fn encoders(&self) -> usize {
        if self.events.varies() { VARIATION } else { 0 }
    }

    /// Where the delay of actions is among the numbers of the events.
    pub(crate) fn delay(&self) -> usize {
        self.encoders() + if self.events.encoder_bias.is_some() { self.nu() } else { 0 }
    }

    /// Where the numbers of the compiled variant begin among those of the events.
    pub(crate) fn compiled(&self) -> usize {
        self.delay() + usize::from(self.events.action_delay.is_some())
    }

    /// Where the step of the next push is among the numbers of the events; before it is what may be observed.
    pub(crate) fn push(&self) -> usize {
        self.compiled() + self.variant_numbers
    }

    /// Numbers that an env remembers on the device: those of the host, x and y of the place from which its root counts,
    /// and x of the root at the last evaluation, counted from there.
    pub(crate) fn row(&self) -> usize {
        self.memory.len + 3
    }

    /// Where x and y of the place are from which the root counts.
    pub(crate) fn origin(&self) -> usize {
        self.memory.len
    }

    /// Where x of the root at the last evaluation is.
    pub(crate) fn evaluated(&self) -> usize {
        self.memory.len + 2
    }

    /// Numbers of a model that the task uses: its initial positions, its jams, the numbers of its variant, its feet.
    #[must_use]
    pub fn model_len(&self, nq: usize) -> usize {
        self.foot_numbers(nq, self.feet.len())
    }

    pub(crate) fn compiled_numbers(&self, nq: usize) -> usize {
        nq + self.jams * JAM
    }

    pub(crate) fn foot_numbers(&self, nq: usize, foot: usize) -> usize {
        let before = self.feet.iter().take(foot).map(Foot::len).sum::<usize>();
        self.compiled_numbers(nq) + self.variant_numbers + before
    }

    /// Numbers of a damage class: the sum of the probabilities up to it, whether it cuts off the touch signal of each
    /// limb, its models, its code.
    #[must_use]
    pub fn class_len(&self) -> usize {
        1 + self.limbs.len() + self.variants + self.code
    }
}

/// Entries of a group of observations.
fn entries(terms: &[Observed]) -> usize {
    terms.iter().map(|term| term.history * term.width).sum()
}

/// A task and where its numbers are.
#[derive(Clone, Debug, Hash, PartialEq, Eq)]
pub struct Task {
    pub plan: Plan,
    pub places: Places,
}
