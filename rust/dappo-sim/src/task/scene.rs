//! One env as the terms see it.

use super::anatomy::{apply_inverse, root_rotation};
use super::command::COMMAND;
use super::events::Drawn;
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
    pub(super) fn events(&self) -> &'a [f64] {
        self.drawn.shown(self.slot(&self.slots.events))
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
