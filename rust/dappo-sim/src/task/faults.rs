//! Faults of sensors that begin within an episode: an encoder or the inertial measurement unit (IMU) is stuck, biased or
//! lost, for a while or until the end.
//!
//! Which fault an episode has, and when, is drawn at its start from (key of the env, episode). The true state is
//! unchanged: a fault changes what the policy observes, and neither the servos nor rewards, terminations or the
//! observations of the critic.

use std::ops::Range;

use serde::Deserialize;

use super::anatomy::Anatomy;
use super::draws::{steps, within};
use super::events::Events;
use super::memory::Slots;
use super::{ObservationTerm, Quantity};
use crate::rng::Stream;
use crate::robot::pattern;

/// What a faulty sensor reads.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SensorFaultKind {
    /// What it read last before the fault.
    Stuck,
    /// What it should read plus a constant.
    Biased,
    /// 0.
    Lost,
}

/// `[events.encoder_fault]`: the encoder of one actuated joint.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct EncoderFault {
    /// When, how often and which.
    #[serde(flatten)]
    pub course: FaultCourse,
    /// Joints of which one is drawn, a regular expression; all actuated ones when absent.
    #[serde(default)]
    pub joints: Option<String>,
    /// Range of the constant of a biased encoder, rad.
    #[serde(default)]
    pub offset: Option<[f64; 2]>,
}

/// `[events.imu_fault]`: all readings of the IMU.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct ImuFault {
    /// When, how often and which.
    #[serde(flatten)]
    pub course: FaultCourse,
    /// Ranges of the constants of a biased IMU.
    #[serde(default)]
    pub offset: ImuOffset,
}

/// Ranges of constants that are drawn for each axis.
#[derive(Debug, Clone, Copy, PartialEq, Default, Deserialize)]
pub struct ImuOffset {
    /// Angular velocity, rad/s.
    #[serde(default)]
    pub base_ang_vel: Option<[f64; 2]>,
    /// Unit vector of gravity.
    #[serde(default)]
    pub projected_gravity: Option<[f64; 2]>,
    /// Linear velocity, m/s.
    #[serde(default)]
    pub base_lin_vel: Option<[f64; 2]>,
}

/// How often a fault occurs, when, and which.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct FaultCourse {
    /// Share of the episodes that have it.
    pub share: f64,
    /// Kinds of which one is drawn.
    pub kinds: Vec<SensorFaultKind>,
    /// Range of the time at which it begins, s.
    pub onset: [f64; 2],
    /// Range of the time until it ends, s; the end of the episode when absent.
    #[serde(default)]
    pub duration: Option<[f64; 2]>,
}

/// Readings of an encoder: position and velocity.
pub(super) const ENCODER: usize = 2;
/// Readings of the IMU: angular velocity, gravity, linear velocity.
pub(super) const IMU: usize = 9;

/// A reading of a sensor: which of its readings begin a term of the observation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Reading {
    JointPos = 0,
    JointVel = 1,
    AngVel = 2,
    Gravity = 5,
    LinVel = 8,
}

/// The sensor faults of a task, compiled for a robot.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct SensorFaults {
    encoder: Option<Sensor>,
    imu: Option<Sensor>,
}

/// A sensor that may be faulty.
#[derive(Debug, Clone, PartialEq)]
struct Sensor {
    /// Name of the event.
    name: &'static str,
    course: FaultCourse,
    /// Actuators whose joints' encoders may be faulty; one part, 0, for the IMU.
    parts: Vec<usize>,
    /// Range of the constant of each reading when it is biased, where there is one.
    offsets: Vec<Option<[f64; 2]>>,
    /// Names of what [`Self::shown`] holds.
    names: Vec<String>,
    /// Its numbers in a row: first those that others may see, then step of the onset, step of the end, kind, part,
    /// constants and last readings.
    slots: Range<usize>,
}

/// A fault that is active now.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ActiveFault<'a> {
    kind: SensorFaultKind,
    /// Index of the actuator, for an encoder.
    pub part: usize,
    first: usize,
    offsets: &'a [f64],
    held: &'a [f64],
}

impl ActiveFault<'_> {
    /// Replaces entries of an observation that begin with a reading.
    pub fn distort<'e>(&self, reading: Reading, entries: impl Iterator<Item = &'e mut f32>) {
        let first = reading as usize - self.first;
        for (index, entry) in entries.enumerate() {
            *entry = match self.kind {
                SensorFaultKind::Stuck => self.held[first + index] as f32,
                SensorFaultKind::Biased => *entry + self.offsets[first + index] as f32,
                SensorFaultKind::Lost => 0.0,
            };
        }
    }
}

impl SensorFaults {
    /// Compiles the faults for a robot; `terms` are what the policy observes.
    pub fn new(
        events: &Events,
        anatomy: &Anatomy,
        terms: &[ObservationTerm],
        slots: &mut Slots,
    ) -> Result<Self, String> {
        let observes = |wanted: fn(&Quantity) -> bool| terms.iter().any(|term| wanted(&term.quantity));
        let mut faults = Self::default();
        if let Some(fault) = &events.encoder_fault {
            if !observes(|quantity| matches!(quantity, Quantity::JointPos | Quantity::JointVel)) {
                return Err(
                    "[events.encoder_fault] needs `joint_pos` or `joint_vel` in [observation.policy]".into(),
                );
            }
            faults.encoder = Some(Sensor::encoder(fault, anatomy, slots)?);
        }
        if let Some(fault) = &events.imu_fault {
            let is_read = |quantity: &Quantity| {
                matches!(quantity, Quantity::BaseAngVel | Quantity::ProjectedGravity | Quantity::BaseLinVel)
            };
            if !observes(is_read) {
                return Err(
                    "[events.imu_fault] needs `base_ang_vel`, `projected_gravity` or `base_lin_vel` in \
                            [observation.policy]"
                        .into(),
                );
            }
            faults.imu = Some(Sensor::imu(fault, slots));
        }
        Ok(faults)
    }

    fn sensors(&self) -> impl Iterator<Item = &Sensor> {
        self.encoder.iter().chain(&self.imu)
    }

    pub fn is_empty(&self) -> bool {
        self.sensors().next().is_none()
    }

    /// Draws the faults of an episode.
    pub fn draw(&self, stream: &mut Stream, dt: f64, row: &mut [f64]) {
        for sensor in self.sensors() {
            sensor.draw(stream, dt, &mut row[sensor.slots.clone()]);
        }
    }

    /// The actuator whose joint's encoder is faulty at some time in the episode; any, if none is.
    pub fn faulty_actuator(&self, row: &[f64]) -> usize {
        self.encoder.as_ref().map_or(0, |sensor| row[sensor.slots.clone()][sensor.names.len() + 3] as usize)
    }

    /// Takes up what the sensors should read at a step: the encoder of [`Self::faulty_actuator`], and the IMU.
    pub fn sense(&self, step: u64, encoder: [f32; ENCODER], imu: [f32; IMU], row: &mut [f64]) {
        for (sensor, truth) in [(&self.encoder, &encoder[..]), (&self.imu, &imu[..])] {
            if let Some(sensor) = sensor {
                sensor.sense(step, truth, &mut row[sensor.slots.clone()]);
            }
        }
    }

    /// The fault of an encoder, if there is one now.
    pub fn of_encoder<'a>(&self, row: &'a [f64]) -> Option<ActiveFault<'a>> {
        self.encoder.as_ref()?.active(Reading::JointPos, row)
    }

    /// The fault of the IMU, if there is one now.
    pub fn of_imu<'a>(&self, row: &'a [f64]) -> Option<ActiveFault<'a>> {
        self.imu.as_ref()?.active(Reading::AngVel, row)
    }

    /// What infos and a privileged critic may see.
    pub fn shown<'a>(&'a self, row: &'a [f64]) -> impl Iterator<Item = f64> + use<'a> {
        self.sensors().flat_map(|sensor| &row[sensor.slots.clone()][..sensor.names.len()]).copied()
    }

    /// Names of what is shown.
    pub fn names(&self) -> impl Iterator<Item = &String> {
        self.sensors().flat_map(|sensor| &sensor.names)
    }
}

impl Sensor {
    fn encoder(fault: &EncoderFault, anatomy: &Anatomy, slots: &mut Slots) -> Result<Self, String> {
        let joints: Vec<&str> = anatomy
            .actuators
            .iter()
            .filter_map(|actuator| Some(actuator.joint.as_ref()?.name.as_str()))
            .collect();
        let text = fault.joints.as_deref().unwrap_or(".*");
        let wanted = pattern(text).map_err(|why| format!("[events.encoder_fault] joints: {why}"))?;
        let parts: Vec<usize> = (0..joints.len()).filter(|&index| wanted.is_match(joints[index])).collect();
        if parts.is_empty() {
            return Err(format!(
                "[events.encoder_fault] joints: no actuated joint has a name that matches {text:?}; expected some of {}",
                joints.join(", ")
            ));
        }
        let names = parts.iter().map(|&part| joints[part].to_owned()).collect();
        let offset = fault.offset.map(|range| ("offset".to_owned(), range));
        Ok(Self::new("encoder_fault", &fault.course, parts, names, vec![offset, None], slots))
    }

    fn imu(fault: &ImuFault, slots: &mut Slots) -> Self {
        let ImuOffset { base_ang_vel, projected_gravity, base_lin_vel } = fault.offset;
        let terms = [
            ("base_ang_vel", base_ang_vel),
            ("projected_gravity", projected_gravity),
            ("base_lin_vel", base_lin_vel),
        ];
        let offsets = terms.iter().flat_map(|(term, range)| {
            ["x", "y", "z"].map(|axis| range.map(|range| (format!("{term} {axis}"), range)))
        });
        Self::new("imu_fault", &fault.course, vec![0], Vec::new(), offsets.collect(), slots)
    }

    fn new(
        name: &'static str,
        course: &FaultCourse,
        parts: Vec<usize>,
        part_names: Vec<String>,
        offsets: Vec<Option<(String, [f64; 2])>>,
        slots: &mut Slots,
    ) -> Self {
        let mut names = vec!["active".to_owned()];
        let kinds = course.kinds.iter().map(|kind| match kind {
            SensorFaultKind::Stuck => "stuck",
            SensorFaultKind::Biased => "biased",
            SensorFaultKind::Lost => "lost",
        });
        names.extend(kinds.map(str::to_owned));
        names.extend(part_names);
        names.extend(offsets.iter().flatten().map(|(name, _)| name.clone()));
        names.push("onset".into());
        names.extend(course.duration.map(|_| "end".into()));
        let names: Vec<String> = names.iter().map(|of| format!("{name} {of}")).collect();
        let readings = offsets.len();
        Self {
            name,
            course: course.clone(),
            parts,
            offsets: offsets.into_iter().map(|offset| offset.map(|(_, range)| range)).collect(),
            slots: slots.take(names.len() + HEADER + 2 * readings),
            names,
        }
    }

    fn draw(&self, stream: &mut Stream, dt: f64, numbers: &mut [f64]) {
        let FaultCourse { share, kinds, onset, duration } = &self.course;
        let has_it = stream.uniform() < *share;
        let kind = stream.below(kinds.len() as u64) as usize;
        let part = stream.below(self.parts.len() as u64) as usize;
        let onset = (within(stream, *onset) / dt).round();
        let end = duration.map_or(f64::INFINITY, |range| onset + steps(within(stream, range), dt) as f64);
        let readings = self.offsets.len();
        let (shown, hidden) = numbers.split_at_mut(self.names.len());
        let (header, values) = hidden.split_at_mut(HEADER);
        let is_biased = kinds[kind] == SensorFaultKind::Biased;
        for (offset, range) in values[..readings].iter_mut().zip(&self.offsets) {
            let drawn = range.map_or(0.0, |range| within(stream, range));
            *offset = if has_it && is_biased { drawn } else { 0.0 };
        }
        if !has_it {
            return;
        }
        header.copy_from_slice(&[onset, end, kind as f64, self.parts[part] as f64]);
        shown[1 + kind] = 1.0;
        let mut rest = &mut shown[1 + kinds.len()..];
        // The IMU has one part, which is not listed.
        if self.name == "encoder_fault" {
            rest[part] = 1.0;
            rest = &mut rest[self.parts.len()..];
        }
        let listed = self.offsets.iter().zip(&values[..readings]).filter(|(range, _)| range.is_some());
        let offsets = listed.map(|(_, offset)| *offset);
        let times = [onset, end].map(|steps| steps * dt);
        rest.iter_mut().zip(offsets.chain(times)).for_each(|(entry, value)| *entry = value);
    }

    /// Keeps the true readings until the fault begins, and notes whether it is active.
    fn sense(&self, step: u64, truth: &[f32], numbers: &mut [f64]) {
        let (shown, hidden) = numbers.split_at_mut(self.names.len());
        let (header, values) = hidden.split_at_mut(HEADER);
        let is_active = (header[0]..header[1]).contains(&(step as f64));
        shown[0] = f64::from(u8::from(is_active));
        // A sensor that fails at the start is stuck at its first reading.
        if !is_active || step == 0 {
            let held = &mut values[self.offsets.len()..];
            held.iter_mut().zip(truth).for_each(|(held, reading)| *held = f64::from(*reading));
        }
    }

    fn active<'a>(&self, first: Reading, row: &'a [f64]) -> Option<ActiveFault<'a>> {
        let (shown, hidden) = row[self.slots.clone()].split_at(self.names.len());
        let (header, values) = hidden.split_at(HEADER);
        let (offsets, held) = values.split_at(self.offsets.len());
        let kind = *self.course.kinds.get(header[2] as usize)?;
        let fault = ActiveFault { kind, part: header[3] as usize, first: first as usize, offsets, held };
        (shown[0] != 0.0).then_some(fault)
    }
}

/// Step of the onset, step of the end, kind and part.
const HEADER: usize = 4;
