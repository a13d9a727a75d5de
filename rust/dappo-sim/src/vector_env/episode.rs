//! One env's current episode.

use serde::{Deserialize, Serialize};

use crate::curriculum::ClassDistribution;
use crate::error::SimError;
use crate::rng::{Purpose, Stream};

/// The steps of an episode among which the damage strikes, both ends included; (0, 0) = from the start.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Onset {
    /// First possible step.
    pub first: usize,
    /// Last possible step.
    pub last: usize,
}

impl Onset {
    pub(super) fn check(self) -> Result<(), SimError> {
        // Steps are counted in signed numbers where others see them.
        if self.first <= self.last && i64::try_from(self.last).is_ok() {
            return Ok(());
        }
        Err(SimError::Config(format!(
            "onset is ({}, {}), expected (first, last) in order and below 2^63",
            self.first, self.last
        )))
    }

    fn draw(self, key: u64, episode: u64) -> usize {
        let span = (self.last - self.first) as u64 + 1;
        self.first + Stream::new(key, episode, Purpose::Onset).below(span) as usize
    }
}

/// What an explicit reset fixes about an episode.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct EpisodeStart {
    pub class: Option<usize>,
    pub onset: Option<usize>,
}

/// Progress of an env.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Episode {
    /// Random key of the env.
    pub key: u64,
    /// Number of the episode; `u64::MAX` before the first.
    pub number: u64,
    /// Steps done.
    pub step: usize,
    /// Damage class of the episode, active from `onset` on.
    pub class: usize,
    /// Step at which the damage strikes.
    pub onset: usize,
    /// The episode has ended and the env waits for its reset.
    pub ended: bool,
}

impl Episode {
    pub fn before_the_first(key: u64) -> Self {
        Self { key, number: u64::MAX, step: 0, class: 0, onset: 0, ended: false }
    }

    /// Starts the next episode.
    pub fn next(&mut self, classes: &ClassDistribution, onset: Onset, fixed: EpisodeStart) {
        let number = self.number.wrapping_add(1);
        let draw = || classes.at(Stream::new(self.key, number, Purpose::DamageClass).uniform());
        *self = Self {
            key: self.key,
            number,
            step: 0,
            class: fixed.class.unwrap_or_else(draw),
            onset: fixed.onset.unwrap_or_else(|| onset.draw(self.key, number)),
            ended: false,
        };
    }

    /// Whether the damage strikes before the next step.
    pub fn is_struck(&self) -> bool {
        !self.ended && self.onset > 0 && self.step == self.onset && self.class != 0
    }

    /// The damage class that acts now: healthy until the onset.
    pub fn class_in_force(&self) -> usize {
        if self.step >= self.onset { self.class } else { 0 }
    }
}
