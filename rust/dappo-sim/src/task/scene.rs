//! One env as the terms see it.

use super::anatomy::{JointParts, apply_inverse, root_rotation};
use super::command::COMMAND;
use super::events::Drawn;
use super::faults::{ActiveFault, ENCODER, IMU};
use super::memory::{Clock, FootRow, Slots};
use super::{Signals, Task};
use crate::backend::Layout;

/// One env as the terms see it.
pub(crate) struct Scene<'a> {
    pub(super) signals: &'a Signals<'a>,
    pub(super) layout: &'a Layout,
    /// What the task remembers of the env.
    pub(super) row: &'a [f64],
    pub(super) slots: &'a Slots,
    pub(super) drawn: &'a Drawn,
    pub(super) task: &'a Task,
    /// Whether sensors read what they do with their faults.
    pub(super) has_faults: bool,
    /// Duration of an env step, s.
    pub(super) dt: f64,
    /// Unit vector of gravity in the root's frame.
    pub(super) gravity: [f64; 3],
    /// Linear velocity of the root in its frame.
    pub(super) lin_vel: [f64; 3],
}

impl Task {
    pub(super) fn scene<'a>(&'a self, row: &'a [f64], signals: &'a Signals<'a>) -> Scene<'a> {
        let rotation = root_rotation(signals.qpos);
        Scene {
            signals,
            layout: &self.layout,
            row,
            slots: &self.slots,
            drawn: &self.drawn,
            task: self,
            has_faults: true,
            dt: self.dt(),
            gravity: apply_inverse(&rotation, [0.0, 0.0, -1.0]),
            lin_vel: apply_inverse(&rotation, [signals.qvel[0], signals.qvel[1], signals.qvel[2]]),
        }
    }
}

impl<'a> Scene<'a> {
    pub(super) fn slot(&self, range: &std::ops::Range<usize>) -> &'a [f64] {
        &self.row[range.clone()]
    }

    /// Commanded velocity: forward, to the left, rate of turn.
    pub(super) fn command(&self) -> &'a [f64] {
        &self.slot(&self.slots.command)[..COMMAND]
    }

    /// The last action, clipped to ±1, `[nu]`.
    pub(super) fn action(&self) -> &'a [f64] {
        &self.slot(&self.slots.actions)[..self.layout.nu]
    }

    /// The action before the last one.
    pub(super) fn previous_action(&self) -> &'a [f64] {
        &self.slot(&self.slots.actions)[self.layout.nu..]
    }

    pub(super) fn feet(&self) -> impl Iterator<Item = FootRow<'a>> {
        self.slot(&self.slots.feet).chunks_exact(FootRow::LENGTH).map(FootRow)
    }

    /// What the events have drawn.
    pub(super) fn events(&self) -> impl Iterator<Item = f64> + use<'a> {
        self.task.events(self.row)
    }

    /// Position of a joint relative to the default pose, rad.
    pub(super) fn joint_pos(&self, joint: &JointParts) -> f32 {
        (self.signals.qpos[joint.qpos] - self.layout.anatomy.start[joint.qpos]) as f32
    }

    /// What the encoder of an actuator's joint reads without a fault.
    pub(super) fn encoder(&self, actuator: usize) -> [f32; ENCODER] {
        let joint = self.layout.anatomy.actuators.get(actuator).and_then(|actuator| actuator.joint.as_ref());
        let bias = self.encoder_bias().get(actuator).map_or(0.0, |bias| *bias as f32);
        let reading =
            |joint: &JointParts| [self.joint_pos(joint) + bias, self.signals.qvel[joint.dof] as f32];
        joint.map_or([0.0; ENCODER], reading)
    }

    /// What the IMU reads without a fault.
    pub(super) fn imu(&self) -> [f32; IMU] {
        let [gx, gy, gz] = self.gravity;
        let [vx, vy, vz] = self.lin_vel;
        let spin = &self.signals.qvel[3..6];
        [spin[0], spin[1], spin[2], gx, gy, gz, vx, vy, vz].map(|reading| reading as f32)
    }

    /// The fault of an encoder, if there is one now.
    pub(super) fn encoder_fault(&self) -> Option<ActiveFault<'a>> {
        self.task.sensor_faults.of_encoder(self.row).filter(|_| self.has_faults)
    }

    /// The fault of the IMU, if there is one now.
    pub(super) fn imu_fault(&self) -> Option<ActiveFault<'a>> {
        self.task.sensor_faults.of_imu(self.row).filter(|_| self.has_faults)
    }

    pub(super) fn encoder_bias(&self) -> &'a [f64] {
        self.drawn.encoder_bias(self.slot(&self.slots.events))
    }

    pub(super) fn clock(&self) -> Clock {
        Clock::read(self.slot(&self.slots.episode))
    }

    /// Time since the episode began, s.
    pub(super) fn time(&self) -> f64 {
        self.clock().step as f64 * self.dt
    }
}
