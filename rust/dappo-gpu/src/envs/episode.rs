//! The episode of an env, and its row on the device.

use crate::task::scene::clock;

/// The episode of an env.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Clock {
    /// Random key of the env.
    pub key: u64,
    /// Number of the episode.
    pub number: u64,
    /// Steps done.
    pub step: u32,
    /// Damage class of the episode.
    pub class: u32,
    /// Steps of the episodes before, back to that which drew the class.
    pub class_steps: u32,
    /// Step at which the damage strikes.
    pub onset: u32,
    /// Steps for which it lasts; 0: for good.
    pub duration: u32,
    /// Steps until it returns; 0: never.
    pub pause: u32,
    /// Steps by which its code is late.
    pub code_delay: u32,
    /// Damage class of the physics.
    pub in_force: u32,
    /// Compiled model of the physics.
    pub model: u32,
}

impl Clock {
    pub(super) fn read(row: &[u32]) -> Self {
        let whole = |at: usize| u64::from(row[at]) | u64::from(row[at + 1]) << 32;
        Self {
            key: whole(clock::KEY_LOW),
            number: whole(clock::NUMBER_LOW),
            step: row[clock::STEP],
            class: row[clock::CLASS],
            class_steps: row[clock::CLASS_STEPS],
            onset: row[clock::ONSET],
            duration: row[clock::DURATION],
            pause: row[clock::PAUSE],
            code_delay: row[clock::CODE_DELAY],
            in_force: row[clock::IN_FORCE],
            model: 0,
        }
    }

    pub(super) fn write(&self, varies: bool) -> [u32; clock::LEN] {
        let mut row = [0; clock::LEN];
        row[clock::KEY_LOW..=clock::KEY_HIGH].copy_from_slice(&halves(self.key));
        row[clock::NUMBER_LOW..=clock::NUMBER_HIGH].copy_from_slice(&halves(self.number));
        row[clock::STEP] = self.step;
        row[clock::CLASS] = self.class;
        row[clock::CLASS_STEPS] = self.class_steps;
        row[clock::ONSET] = self.onset;
        row[clock::DURATION] = self.duration;
        row[clock::PAUSE] = self.pause;
        row[clock::CODE_DELAY] = self.code_delay;
        row[clock::IN_FORCE] = self.in_force;
        row[clock::VARIES] = if varies { self.model + 1 } else { 0 };
        row
    }
}

pub(super) fn halves(whole: u64) -> [u32; 2] {
    [whole as u32, (whole >> 32) as u32]
}
