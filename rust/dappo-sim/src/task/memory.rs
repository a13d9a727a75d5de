//! What a task remembers of an env between steps.
//!
//! One row of numbers an env, so that a backend saves and restores it with the state of the physics. A task that
//! remembers nothing has rows of length 0.

use std::ops::Range;

use crate::rng::{Purpose, Stream};

/// Where each quantity is in a row.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub(super) struct Slots {
    /// Steps of the episode; key of the env and number of the episode, in halves of 32 bits.
    pub episode: Range<usize>,
    /// Commanded velocity, and the step at which it is drawn again.
    pub command: Range<usize>,
    /// Steps of the env in all episodes.
    pub total: Range<usize>,
    /// Actions of the last two steps, the last one first, `[2, nu]`.
    pub actions: Range<usize>,
    /// Actions that wait, the oldest first, `[delay, nu]`.
    pub waiting: Range<usize>,
    /// What the events have drawn.
    pub events: Range<usize>,
    /// Index of the compiled variant.
    pub variant: Range<usize>,
    /// By how much the limits of jammed joints have moved, rad.
    pub jams: Range<usize>,
    /// Motion and contact of each foot, `[feet, FOOT]`.
    pub feet: Range<usize>,
    /// Numbers in a row.
    pub len: usize,
}

impl Slots {
    /// The next `length` numbers.
    pub fn take(&mut self, length: usize) -> Range<usize> {
        let start = self.len;
        self.len += length;
        start..self.len
    }
}

/// A foot, as its numbers in a row: position (m) and velocity (m/s) along the world's axes, contact force (N), time since
/// it left the floor (s), and how long it was in the air if it has landed in the last step (s).
pub(super) struct FootRow<'a>(pub &'a [f64]);

impl FootRow<'_> {
    /// Numbers that it takes.
    pub const LENGTH: usize = 9;

    pub fn height(&self) -> f64 {
        self.0[2]
    }

    pub fn velocity(&self) -> [f64; 3] {
        [self.0[3], self.0[4], self.0[5]]
    }

    /// Speed along the floor, m/s.
    pub fn speed(&self) -> f64 {
        (self.0[3] * self.0[3] + self.0[4] * self.0[4]).sqrt()
    }

    pub fn force(&self) -> f64 {
        self.0[6]
    }

    pub fn is_in_contact(&self) -> bool {
        self.force() > CONTACT_FORCE
    }

    pub fn air_time(&self) -> f64 {
        self.0[7]
    }

    /// Time in the air that has ended in the last step; 0 otherwise.
    pub fn landed_after(&self) -> f64 {
        self.0[8]
    }

    /// Takes up where a foot is after a step of `dt` seconds.
    pub fn update(row: &mut [f64], position: [f64; 3], velocity: [f64; 3], force: f64, dt: f64) {
        row[..3].copy_from_slice(&position);
        row[3..6].copy_from_slice(&velocity);
        row[6] = force;
        let is_in_contact = force > CONTACT_FORCE;
        row[8] = if is_in_contact { row[7] } else { 0.0 };
        row[7] = if is_in_contact { 0.0 } else { row[7] + dt };
    }
}

/// Contact force from which a foot or a body counts as touching, N.
pub(super) const CONTACT_FORCE: f64 = 1.0;

/// Which episode a row belongs to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Clock {
    /// Steps done.
    pub step: u64,
    /// Random key of the env.
    pub key: u64,
    /// Number of the episode.
    pub episode: u64,
}

impl Clock {
    /// Numbers that it takes.
    pub const LENGTH: usize = 5;

    /// The random numbers of this step for a purpose.
    pub fn stream(self, purpose: Purpose) -> Stream {
        // Neither episodes of an env nor steps of an episode reach 2³².
        Stream::new(self.key, self.episode << 32 | self.step, purpose)
    }

    pub fn read(row: &[f64]) -> Self {
        let whole = |low: f64, high: f64| low as u64 | (high as u64) << 32;
        Self { step: row[0] as u64, key: whole(row[1], row[2]), episode: whole(row[3], row[4]) }
    }

    pub fn write(self, row: &mut [f64]) {
        let halves = |whole: u64| [f64::from(whole as u32), f64::from((whole >> 32) as u32)];
        row[0] = self.step as f64;
        row[1..3].copy_from_slice(&halves(self.key));
        row[3..5].copy_from_slice(&halves(self.episode));
    }
}
