//! Terms of the observation vector.

use serde::{Deserialize, Serialize};
use strum::IntoStaticStr;

use super::command::COMMAND;
use super::faults::Reading;
use super::memory::FootRow;
use super::{Scene, Signals};
use crate::backend::Layout;
use crate::rng::{Purpose, Stream};

/// One block of the observation vector: a quantity, to which noise, clip, scale, delay and history apply in this
/// order.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ObservationTerm {
    /// What is observed.
    #[serde(flatten)]
    pub quantity: Quantity,
    /// Half-width of uniform noise on every entry.
    #[serde(default, skip_serializing_if = "is_default")]
    pub noise: f64,
    /// Bound of every entry's absolute value.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub clip: Option<f64>,
    /// Factor of every entry.
    #[serde(default = "one", skip_serializing_if = "is_one")]
    pub scale: f64,
    /// Env steps by which the term is late.
    #[serde(default, skip_serializing_if = "is_default")]
    pub delay: usize,
    /// Number of steps whose values the block holds, the oldest first.
    #[serde(default = "one_step", skip_serializing_if = "is_one_step")]
    pub history: usize,
}

/// Something that can be observed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, IntoStaticStr)]
#[serde(tag = "term", rename_all = "snake_case")]
#[strum(serialize_all = "snake_case")]
pub enum Quantity {
    /// Positions but for the first `skip` entries (2 leaves out the root's x and y).
    Qpos {
        /// Entries left out.
        #[serde(default)]
        skip: usize,
    },
    /// Velocities.
    Qvel,
    /// External contact forces of all bodies, the world's zero row included, N and N·m.
    CfrcExt,
    /// One 0/1 entry a limb: its touch sensor reads a positive force.
    Touch,
    /// Height (z) of the root, m.
    BaseHeight,
    /// Linear velocity of the root in its own frame, m/s.
    BaseLinVel,
    /// Angular velocity of the root in its own frame, rad/s: what a gyroscope measures.
    BaseAngVel,
    /// Unit vector of gravity in the frame of the root.
    ProjectedGravity,
    /// Commanded velocity: forward and to the left, m/s, and rate of turn, rad/s.
    Command,
    /// Positions of the actuated joints, as their encoders read them, relative to the default pose, rad; in the order
    /// of the actuators.
    JointPos,
    /// Velocities of the actuated joints, rad/s, in the order of the actuators.
    JointVel,
    /// The last action, clipped to ±1.
    LastAction,
    /// Sine and cosine of a phase that advances with the episode.
    Clock {
        /// Duration of a cycle, s.
        period: f64,
    },
    /// One 0/1 entry a foot: its body carries a contact force.
    FootContact,
    /// Velocity of each foot along the world's axes, m/s.
    FootVel,
    /// Height (z) of each foot, m.
    FootHeight,
    /// Time since each foot left the floor, s.
    FootAirTime,
    /// What the events have drawn for this episode: factors, direction of gravity, encoder errors and delay.
    Events,
    /// What a Python function returns, which whoever runs Python writes.
    Python {
        /// `module:function`.
        function: String,
        /// Number of entries.
        size: usize,
    },
}

fn one() -> f64 {
    1.0
}

fn one_step() -> usize {
    1
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde passes references")]
fn is_one(value: &f64) -> bool {
    *value == 1.0
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde passes references")]
fn is_one_step(value: &usize) -> bool {
    *value == 1
}

fn is_default<T: Default + PartialEq>(value: &T) -> bool {
    *value == T::default()
}

impl ObservationTerm {
    /// A quantity as it is.
    fn plain(quantity: Quantity) -> Self {
        Self { quantity, noise: 0.0, clip: None, scale: 1.0, delay: 0, history: 1 }
    }

    /// Number of entries.
    #[must_use]
    pub fn len(&self, layout: &Layout, events: usize) -> usize {
        self.history * self.quantity.len(layout, events)
    }

    /// Whether the block is the positions as they are, but for x and y of the root.
    pub(super) fn shows_positions(&self) -> bool {
        matches!(self.quantity, Quantity::Qpos { skip: 0..=2 }) && self.is_plain()
    }

    /// Whether the block is the velocities as they are.
    pub(super) fn shows_velocities(&self) -> bool {
        self.quantity == Quantity::Qvel && self.is_plain()
    }

    fn is_plain(&self) -> bool {
        *self == Self::plain(self.quantity.clone())
    }

    /// Steps whose values have to be kept.
    pub(super) fn frames(&self) -> usize {
        if self.delay == 0 && self.history == 1 { 0 } else { self.delay + self.history }
    }

    /// Writes the block of one env into `out`, which has the term's length. `frames` are the values of earlier steps,
    /// all of which take the present one at the start of an episode.
    pub(super) fn write(
        &self,
        scene: &Scene<'_>,
        stream: Option<&mut Stream>,
        is_first: bool,
        frames: &mut [f64],
        out: &mut [f32],
    ) {
        let width = out.len() / self.history;
        let newest = out.len() - width;
        let block = &mut out[newest..];
        self.quantity.write(scene, block);
        if let Some(stream) = stream.filter(|_| self.noise > 0.0) {
            stream.uniform_for_each(block, |entry, uniform| {
                *entry += (self.noise * (2.0 * uniform - 1.0)) as f32;
            });
        }
        if let Some(clip) = self.clip {
            block.iter_mut().for_each(|entry| *entry = entry.clamp(-clip as f32, clip as f32));
        }
        if self.scale != 1.0 {
            block.iter_mut().for_each(|entry| *entry *= self.scale as f32);
        }
        if frames.is_empty() {
            return;
        }
        let present = || block.iter().map(|entry| f64::from(*entry));
        if is_first {
            for frame in frames.chunks_exact_mut(width) {
                frame.iter_mut().zip(present()).for_each(|(kept, entry)| *kept = entry);
            }
        } else {
            frames.copy_within(width.., 0);
            let last = frames.len() - width;
            frames[last..].iter_mut().zip(present()).for_each(|(kept, entry)| *kept = entry);
        }
        out.iter_mut().zip(&*frames).for_each(|(entry, kept)| *entry = *kept as f32);
    }
}

impl Quantity {
    /// Name of the term.
    #[must_use]
    pub fn name(&self) -> &'static str {
        self.into()
    }

    /// Number of entries.
    #[must_use]
    pub fn len(&self, layout: &Layout, events: usize) -> usize {
        let feet = layout.anatomy.feet.first().map_or(0, Vec::len);
        match self {
            Self::Qpos { skip } => layout.nq.saturating_sub(*skip),
            Self::Qvel => layout.nv,
            Self::CfrcExt => layout.nbody * 6,
            Self::Touch => layout.touch_addresses.len(),
            Self::BaseHeight => 1,
            Self::BaseLinVel | Self::BaseAngVel | Self::ProjectedGravity => 3,
            Self::Command => COMMAND,
            Self::JointPos | Self::JointVel | Self::LastAction => layout.nu,
            Self::Clock { .. } => 2,
            Self::FootContact | Self::FootHeight | Self::FootAirTime => feet,
            Self::FootVel => 3 * feet,
            Self::Events => events,
            Self::Python { size, .. } => *size,
        }
    }

    /// Whether it follows from the motion of the feet.
    pub(super) fn needs_feet(&self) -> bool {
        matches!(self, Self::FootContact | Self::FootVel | Self::FootHeight | Self::FootAirTime)
    }

    fn write(&self, scene: &Scene<'_>, out: &mut [f32]) {
        let Scene { signals, layout, .. } = scene;
        let Signals { qpos, qvel, .. } = signals;
        let actuated = || layout.anatomy.actuators.iter().filter_map(|actuator| actuator.joint.as_ref());
        match self {
            Self::Qpos { skip } => put(out, &qpos[*skip..]),
            Self::Qvel => put(out, qvel),
            Self::CfrcExt => put(out, signals.cfrc_ext),
            Self::Touch => {
                for ((entry, &address), &disabled) in
                    out.iter_mut().zip(&layout.touch_addresses).zip(signals.disabled_touch)
                {
                    *entry = if !disabled && signals.sensordata[address] > 0.0 { 1.0 } else { 0.0 };
                }
            }
            Self::BaseHeight => put(out, &qpos[2..3]),
            Self::BaseLinVel => imu(scene, out, &scene.lin_vel, Reading::LinVel),
            Self::BaseAngVel => imu(scene, out, &qvel[3..6], Reading::AngVel),
            Self::ProjectedGravity => imu(scene, out, &scene.gravity, Reading::Gravity),
            Self::Command => put(out, scene.command()),
            Self::JointPos => {
                for (entry, joint) in out.iter_mut().zip(actuated()) {
                    *entry = scene.joint_pos(joint);
                }
                for (entry, bias) in out.iter_mut().zip(scene.encoder_bias()) {
                    *entry += *bias as f32;
                }
                distort_encoder(scene, out, Reading::JointPos);
            }
            Self::JointVel => {
                for (entry, joint) in out.iter_mut().zip(actuated()) {
                    *entry = qvel[joint.dof] as f32;
                }
                distort_encoder(scene, out, Reading::JointVel);
            }
            Self::LastAction => put(out, scene.action()),
            Self::Clock { period } => {
                let (sin, cos) = (std::f64::consts::TAU * scene.time() / period).sin_cos();
                put(out, &[sin, cos]);
            }
            Self::FootContact => {
                for (entry, foot) in out.iter_mut().zip(scene.feet()) {
                    *entry = if foot.is_in_contact() { 1.0 } else { 0.0 };
                }
            }
            Self::FootVel => {
                for (entries, foot) in out.chunks_exact_mut(3).zip(scene.feet()) {
                    put(entries, &foot.velocity());
                }
            }
            Self::FootHeight => each_foot(scene, out, FootRow::height),
            Self::FootAirTime => each_foot(scene, out, FootRow::air_time),
            Self::Events => {
                out.iter_mut().zip(scene.events()).for_each(|(entry, value)| *entry = value as f32);
            }
            Self::Python { .. } => out.fill(0.0),
        }
    }
}

fn put(out: &mut [f32], values: &[f64]) {
    for (entry, value) in out.iter_mut().zip(values) {
        *entry = *value as f32;
    }
}

/// Writes readings of the IMU.
fn imu(scene: &Scene<'_>, out: &mut [f32], truth: &[f64], reading: Reading) {
    put(out, truth);
    if let Some(fault) = scene.imu_fault() {
        fault.distort(reading, out.iter_mut());
    }
}

/// Replaces the reading of an encoder that is faulty.
fn distort_encoder(scene: &Scene<'_>, out: &mut [f32], reading: Reading) {
    if let Some(fault) = scene.encoder_fault() {
        let joint = out.iter_mut().skip(fault.part).take(1);
        fault.distort(reading, joint);
    }
}

fn each_foot<'a>(scene: &Scene<'a>, out: &mut [f32], value: impl Fn(&FootRow<'a>) -> f64) {
    for (entry, foot) in out.iter_mut().zip(scene.feet()) {
        *entry = value(&foot) as f32;
    }
}

/// The terms of a group of observations, compiled for a robot.
#[derive(Debug, Clone)]
pub(super) struct ObservationGroup {
    terms: Vec<ObservationTerm>,
    /// Number of entries of each term.
    lengths: Vec<usize>,
    /// Numbers that each term keeps of earlier steps.
    frames: Vec<usize>,
    is_noisy: bool,
}

impl ObservationGroup {
    pub fn new(terms: &[ObservationTerm], layout: &Layout, events: usize) -> Self {
        let frames = |term: &ObservationTerm| term.frames() * term.quantity.len(layout, events);
        Self {
            terms: terms.to_vec(),
            lengths: terms.iter().map(|term| term.len(layout, events)).collect(),
            frames: terms.iter().map(frames).collect(),
            is_noisy: terms.iter().any(|term| term.noise > 0.0),
        }
    }

    /// Numbers that are kept of earlier steps.
    pub fn frames_len(&self) -> usize {
        self.frames.iter().sum()
    }

    /// Number of entries.
    pub fn len(&self) -> usize {
        self.lengths.iter().sum()
    }

    /// The terms, and which entries each has.
    pub fn blocks(&self) -> impl Iterator<Item = (&ObservationTerm, std::ops::Range<usize>)> {
        self.terms.iter().zip(&self.lengths).scan(0, |start, (term, length)| {
            let block = *start..*start + length;
            *start = block.end;
            Some((term, block))
        })
    }

    pub fn needs_feet(&self) -> bool {
        self.terms.iter().any(|term| term.quantity.needs_feet())
    }

    pub fn is_noisy(&self) -> bool {
        self.is_noisy
    }

    /// Writes the observation of an env, `[len]`; `frames` is what is kept of its earlier steps, `[frames_len]`.
    pub fn write(
        &self,
        scene: &Scene<'_>,
        noise: Purpose,
        is_first: bool,
        frames: &mut [f64],
        out: &mut [f32],
    ) {
        let mut stream = self.is_noisy.then(|| scene.clock().stream(noise));
        let (mut out, mut frames) = (out, frames);
        for ((term, &length), &kept) in self.terms.iter().zip(&self.lengths).zip(&self.frames) {
            let (block, later) = out.split_at_mut(length);
            let (kept, others) = frames.split_at_mut(kept);
            term.write(scene, stream.as_mut(), is_first, kept, block);
            (out, frames) = (later, others);
        }
    }
}
