//! Dropouts: times in which the actions of a policy do not arrive, and the last control is held.

use std::ops::Range;

use serde::Deserialize;

use super::draws::{steps, within};
use super::memory::{Clock, Slots};
use crate::rng::{Purpose, Stream};

/// `[events.action_dropout]`.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
pub struct ActionDropout {
    /// Share of the episodes that have dropouts.
    pub share: f64,
    /// Range of the time until the first dropout, and from the end of one to the next, s.
    pub every: [f64; 2],
    /// Range of the duration of a dropout, s.
    pub duration: [f64; 2],
}

/// The dropouts of a task, compiled for a robot.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Dropouts {
    settings: ActionDropout,
    /// Its numbers in a row: those that are shown, then first step, first step after it, and the last action.
    slots: Range<usize>,
}

/// What infos and a privileged critic may see: whether the next action is lost, and when the present or next dropout
/// begins and ends, s.
const SHOWN: [&str; 3] = ["action_dropout active", "action_dropout onset", "action_dropout end"];

impl Dropouts {
    pub fn new(settings: ActionDropout, actuators: usize, slots: &mut Slots) -> Self {
        Self { settings, slots: slots.take(SHOWN.len() + 2 + actuators) }
    }

    /// Draws whether an episode has dropouts, and its first one.
    pub fn begin(&self, clock: Clock, dt: f64, row: &mut [f64]) {
        let mut stream = clock.stream(Purpose::ActionDropout);
        if stream.uniform() < self.settings.share {
            self.draw(&mut stream, 0, dt, row);
        }
    }

    fn draw(&self, stream: &mut Stream, step: u64, dt: f64, row: &mut [f64]) {
        let onset = (step + steps(within(stream, self.settings.every), dt)) as f64;
        let end = onset + steps(within(stream, self.settings.duration), dt) as f64;
        row[self.slots.clone()][..5].copy_from_slice(&[0.0, onset * dt, end * dt, onset, end]);
    }

    /// Notes at a step whether the next action is lost.
    pub fn advance(&self, clock: Clock, dt: f64, row: &mut [f64]) {
        let [onset, end] = self.span(row);
        // 0 is the end of no dropout: the episode has none.
        if end > 0.0 && clock.step as f64 >= end {
            self.draw(&mut clock.stream(Purpose::ActionDropout), clock.step, dt, row);
        }
        let is_active = (onset..end).contains(&(clock.step as f64));
        row[self.slots.start] = f64::from(u8::from(is_active));
    }

    fn span(&self, row: &[f64]) -> [f64; 2] {
        let numbers = &row[self.slots.clone()];
        [numbers[SHOWN.len()], numbers[SHOWN.len() + 1]]
    }

    /// Replaces an action that is lost with the last one that arrived.
    pub fn hold(&self, row: &mut [f64], action: &mut [f64]) {
        let (head, last) = row[self.slots.clone()].split_at_mut(SHOWN.len() + 2);
        if head[0] == 0.0 {
            last.copy_from_slice(action);
        } else {
            action.copy_from_slice(last);
        }
    }

    pub fn shown<'a>(&self, row: &'a [f64]) -> &'a [f64] {
        &row[self.slots.clone()][..SHOWN.len()]
    }

    pub fn names() -> [String; 3] {
        SHOWN.map(str::to_owned)
    }
}
