//! Events: what is random about a robot and its world besides damage (domain randomisation).
//!
//! Everything is drawn at the start of an episode from (key of the env, episode), so that it depends neither on the
//! backend nor on the number of threads.

use serde::Deserialize;

use super::draws::{steps, within};
use super::dropout::ActionDropout;
use super::faults::{EncoderFault, ImuFault};
use super::memory::Slots;
use super::variants::{BodyEvents, Variants};
use crate::rng::Stream;

/// The section `[events]`; what is absent stays as in the MJCF.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
pub struct Events {
    /// Friction of all contacts.
    #[serde(default)]
    pub friction: Option<Scaling>,
    /// Strength of the actuators: what they turn a control into, and the limits of their force.
    #[serde(default)]
    pub motor_strength: Option<Scaling>,
    /// Stiffness of position servos.
    #[serde(default)]
    pub kp: Option<Scaling>,
    /// Damping of position servos.
    #[serde(default)]
    pub kd: Option<Scaling>,
    /// Damping of joints.
    #[serde(default)]
    pub joint_damping: Option<Scaling>,
    /// Rotor inertia of joints. The softness of constraints stays as compiled.
    #[serde(default)]
    pub joint_armature: Option<Scaling>,
    /// Error of each joint encoder, rad, which position servos have, too.
    #[serde(default)]
    pub encoder_bias: Option<Offset>,
    /// Whole env steps until an action arrives.
    #[serde(default)]
    pub action_delay: Option<Delay>,
    /// Direction of gravity: its angle to the vertical.
    #[serde(default)]
    pub gravity: Option<Tilt>,
    /// Sudden changes of the root's velocity.
    #[serde(default)]
    pub push: Option<Push>,
    /// Faults of joint encoders.
    #[serde(default)]
    pub encoder_fault: Option<EncoderFault>,
    /// Faults of the IMU.
    #[serde(default)]
    pub imu_fault: Option<ImuFault>,
    /// Times in which actions do not arrive.
    #[serde(default)]
    pub action_dropout: Option<ActionDropout>,
    /// Masses, centres of mass and lengths.
    #[serde(flatten)]
    pub bodies: BodyEvents,
}

/// A factor.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
pub struct Scaling {
    /// Range of the factor.
    pub scale: [f64; 2],
}

/// A number that is added.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
pub struct Offset {
    /// Range of the number.
    pub offset: [f64; 2],
}

/// A delay.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
pub struct Delay {
    /// Fewest and most steps.
    pub steps: [usize; 2],
}

/// An angle.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
pub struct Tilt {
    /// Range of the angle, rad.
    pub angle: [f64; 2],
}

/// A change of velocity at random times.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
pub struct Push {
    /// Range of the time from one push to the next, s.
    pub every: [f64; 2],
    /// Half-width of the change of each of the root's linear velocities along the floor, m/s.
    pub lin_vel: f64,
    /// Half-width of the change of each of the root's angular velocities, rad/s.
    #[serde(default)]
    pub ang_vel: f64,
}

/// How the physics of one env differs from that of its damage class.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Variation {
    /// Factor of the friction of contacts.
    pub friction: f64,
    /// Factor of what actuators turn a control into, of their passive forces and of the limits of their force.
    pub motor_strength: f64,
    /// Factor of the stiffness of position servos.
    pub kp: f64,
    /// Factor of the damping of position servos.
    pub kd: f64,
    /// Factor of the damping of joints.
    pub joint_damping: f64,
    /// Factor of the rotor inertia of joints.
    pub joint_armature: f64,
    /// Direction of gravity, a unit vector; that of the MJCF for `None`.
    pub gravity: Option<[f64; 3]>,
}

impl Variation {
    /// The physics of the damage class.
    pub const NONE: Self = Self {
        friction: 1.0,
        motor_strength: 1.0,
        kp: 1.0,
        kd: 1.0,
        joint_damping: 1.0,
        joint_armature: 1.0,
        gravity: None,
    };
}

/// Where what the events have drawn is among the numbers of `Slots::events`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Drawn {
    /// Whether the physics varies; its numbers are the first ones then.
    varies: bool,
    /// Number of encoders whose errors follow.
    encoders: usize,
    /// Whether the delay of actions follows.
    delays: bool,
    /// Numbers of the compiled variant that follow.
    compiled: usize,
    /// Whether the step of the next push follows.
    pushes: bool,
}

/// Numbers of a [`Variation`].
const VARIATION: usize = VARIED.len();
/// Their names.
const VARIED: [&str; 9] = [
    "friction",
    "motor_strength",
    "kp",
    "kd",
    "joint_damping",
    "joint_armature",
    "gravity x",
    "gravity y",
    "gravity z",
];

impl Events {
    /// What this task draws, and the room for it.
    pub(super) fn layout(&self, joints: usize, variants: &Variants, slots: &mut Slots) -> Drawn {
        let drawn = Drawn {
            varies: self.varies(),
            encoders: if self.encoder_bias.is_some() { joints } else { 0 },
            delays: self.action_delay.is_some(),
            compiled: variants.names.len(),
            pushes: self.push.is_some(),
        };
        slots.events = slots.take(drawn.len());
        drawn
    }

    /// Whether the physics of the envs differs.
    #[must_use]
    pub fn varies(&self) -> bool {
        let scaled =
            [self.friction, self.motor_strength, self.kp, self.kd, self.joint_damping, self.joint_armature];
        self.gravity.is_some() || scaled.iter().any(Option::is_some)
    }

    /// How the physics of an env differs; `None` if that of no env does.
    pub(super) fn variation(&self, drawn: &Drawn, numbers: &[f64]) -> Option<Variation> {
        drawn.varies.then(|| {
            let [friction, motor_strength, kp, kd, joint_damping, joint_armature] =
                std::array::from_fn(|index| numbers[index]);
            let gravity = self.gravity.map(|_| [numbers[6], numbers[7], numbers[8]]);
            Variation { friction, motor_strength, kp, kd, joint_damping, joint_armature, gravity }
        })
    }

    /// Most steps until an action arrives.
    pub(super) fn longest_delay(&self) -> usize {
        self.action_delay.map_or(0, |delay| delay.steps[1])
    }

    /// Draws everything for an episode; `compiled` are the numbers of its variant.
    pub(super) fn draw(
        &self,
        drawn: &Drawn,
        stream: &mut Stream,
        dt: f64,
        compiled: &[f64],
        numbers: &mut [f64],
    ) {
        let mut rest = numbers;
        let mut put = |count: usize| {
            let (first, others) = std::mem::take(&mut rest).split_at_mut(count);
            rest = others;
            first
        };
        if drawn.varies {
            let [x, y, z] = self.gravity.map_or([0.0, 0.0, -1.0], |tilt| {
                let (sin, cos) = within(stream, tilt.angle).sin_cos();
                let (y, x) = within(stream, [0.0, std::f64::consts::TAU]).sin_cos();
                [sin * x, sin * y, -cos]
            });
            let mut factor =
                |scaling: Option<Scaling>| scaling.map_or(1.0, |scaling| within(stream, scaling.scale));
            put(VARIATION).copy_from_slice(&[
                factor(self.friction),
                factor(self.motor_strength),
                factor(self.kp),
                factor(self.kd),
                factor(self.joint_damping),
                factor(self.joint_armature),
                x,
                y,
                z,
            ]);
        }
        if let Some(bias) = self.encoder_bias {
            put(drawn.encoders).fill_with(|| within(stream, bias.offset));
        }
        if let Some(Delay { steps: [fewest, most] }) = self.action_delay {
            put(1)[0] = (fewest + stream.below((most - fewest) as u64 + 1) as usize) as f64;
        }
        put(drawn.compiled).copy_from_slice(compiled);
        if let Some(push) = self.push {
            put(1)[0] = steps(within(stream, push.every), dt) as f64;
        }
    }
}

impl Drawn {
    fn len(&self) -> usize {
        self.start_of_push() + usize::from(self.pushes)
    }

    fn start_of_encoders(&self) -> usize {
        if self.varies { VARIATION } else { 0 }
    }

    fn start_of_delay(&self) -> usize {
        self.start_of_encoders() + self.encoders
    }

    fn start_of_compiled(&self) -> usize {
        self.start_of_delay() + usize::from(self.delays)
    }

    fn start_of_push(&self) -> usize {
        self.start_of_compiled() + self.compiled
    }

    /// Errors of the encoders, rad, one an actuated joint; empty without such errors.
    pub fn encoder_bias<'a>(&self, numbers: &'a [f64]) -> &'a [f64] {
        &numbers[self.start_of_encoders()..self.start_of_delay()]
    }

    /// Steps until an action arrives.
    pub fn action_delay(&self, numbers: &[f64]) -> usize {
        if self.delays { numbers[self.start_of_delay()] as usize } else { 0 }
    }

    /// Step of the next push; `None` without pushes.
    pub fn next_push<'a>(&self, numbers: &'a mut [f64]) -> Option<&'a mut f64> {
        self.pushes.then(|| &mut numbers[self.start_of_push()])
    }

    /// What a privileged critic may see, in the order of [`Variation`]'s fields, then encoders, delay and the
    /// numbers of the compiled variant.
    pub fn shown<'a>(&self, numbers: &'a [f64]) -> &'a [f64] {
        &numbers[..self.start_of_push()]
    }

    /// Names of the entries of [`Self::shown`], given those of the actuated joints.
    pub fn names<'a>(&self, joints: impl Iterator<Item = &'a str>, variants: &Variants) -> Vec<String> {
        let varied = if self.varies { &VARIED[..] } else { &[] };
        let encoders = joints.take(self.encoders).map(|joint| format!("encoder_bias {joint}"));
        let delay = self.delays.then(|| "action_delay".to_owned());
        let varied = varied.iter().map(|name| (*name).to_owned());
        varied.chain(encoders).chain(delay).chain(variants.names.iter().cloned()).collect()
    }

    /// Number of entries of [`Self::shown`].
    pub fn shown_len(&self) -> usize {
        self.start_of_push()
    }
}

impl Push {
    /// Draws a change of the root's velocities, linear along the world's axes, angular along its own.
    pub(super) fn draw(&self, stream: &mut Stream) -> [f64; 6] {
        let mut change = |half: f64| within(stream, [-half, half]);
        let [x, y] = [change(self.lin_vel), change(self.lin_vel)];
        [x, y, 0.0, change(self.ang_vel), change(self.ang_vel), change(self.ang_vel)]
    }
}
