//! One env's current episode.

use serde::{Deserialize, Serialize};

use super::VectorEnvConfig;
use crate::error::SimError;
use crate::rng::{Purpose, Stream};

/// Numbers of steps, both ends included.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct StepRange {
    /// Fewest.
    pub first: usize,
    /// Most.
    pub last: usize,
}

impl StepRange {
    fn check(self, name: &str, least: usize) -> Result<(), SimError> {
        // Steps are counted in signed numbers where others see them.
        if least <= self.first && self.first <= self.last && i64::try_from(self.last).is_ok() {
            return Ok(());
        }
        Err(SimError::Config(format!(
            "{name} is ({}, {}), expected (first, last) in order, at least {least} and below 2^63",
            self.first, self.last
        )))
    }

    fn draw(self, stream: &mut Stream) -> usize {
        self.first + stream.below((self.last - self.first) as u64 + 1) as usize
    }
}

/// When the damage of an episode is active, in env steps.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct DamageCourse {
    /// Step at which it strikes; (0, 0) = from the start.
    pub onset: StepRange,
    /// How long it lasts, at least 1; `None`: for good.
    pub duration: Option<StepRange>,
    /// How long the robot has recovered until the damage returns, at least 1; `None`: it does not return.
    pub pause: Option<StepRange>,
    /// How long the damage code lags behind the damage, as after a diagnosis; (0, 0) = not at all.
    pub code_delay: StepRange,
}

impl DamageCourse {
    pub(super) fn check(self) -> Result<(), SimError> {
        self.onset.check("onset", 0)?;
        self.duration.map_or(Ok(()), |duration| duration.check("damage_duration", 1))?;
        self.pause.map_or(Ok(()), |pause| pause.check("damage_pause", 1))?;
        self.code_delay.check("code_delay", 0)?;
        if self.pause.is_some() && self.duration.is_none() {
            let message =
                "damage_pause is set, but damage_duration is not: damage that stays does not return";
            return Err(SimError::Config(message.into()));
        }
        Ok(())
    }
}

/// What an explicit reset fixes about an episode.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct EpisodeStart {
    pub class: Option<usize>,
    pub onset: Option<usize>,
    pub duration: Option<usize>,
    pub pause: Option<usize>,
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
    /// Steps of the episodes before this one, back to that which drew the class.
    pub class_steps: usize,
    /// Step at which the damage strikes.
    pub onset: usize,
    /// Steps for which it lasts; 0: for good.
    pub duration: usize,
    /// Steps from its end until it returns; 0: it does not.
    pub pause: usize,
    /// Steps by which the damage code is late.
    pub code_delay: usize,
    /// The episode has ended and the env waits for its reset.
    pub ended: bool,
}

impl Episode {
    pub fn before_the_first(key: u64) -> Self {
        Self {
            key,
            number: u64::MAX,
            step: 0,
            class: 0,
            class_steps: 0,
            onset: 0,
            duration: 0,
            pause: 0,
            code_delay: 0,
            ended: false,
        }
    }

    /// Starts the next episode.
    pub fn next(&mut self, config: &VectorEnvConfig, fixed: EpisodeStart) {
        let course = config.course;
        let number = self.number.wrapping_add(1);
        let class_steps = self.class_steps.saturating_add(self.step);
        let keeps = (1..config.min_class_steps).contains(&class_steps);
        let drawn = || config.classes.at(Stream::new(self.key, number, Purpose::DamageClass).uniform());
        let (class, class_steps) = match fixed.class {
            Some(class) => (class, 0),
            None if keeps => (self.class, class_steps),
            None => (drawn(), 0),
        };
        let onset = || course.onset.draw(&mut Stream::new(self.key, number, Purpose::Onset));
        let mut stream = Stream::new(self.key, number, Purpose::DamageDuration);
        let mut draw_steps = |steps: Option<StepRange>| steps.map_or(0, |steps| steps.draw(&mut stream));
        let [duration, pause] = [draw_steps(course.duration), draw_steps(course.pause)];
        *self = Self {
            key: self.key,
            number,
            step: 0,
            class,
            class_steps,
            onset: fixed.onset.unwrap_or_else(onset),
            duration: fixed.duration.unwrap_or(duration),
            pause: fixed.pause.unwrap_or(pause),
            code_delay: course.code_delay.draw(&mut Stream::new(self.key, number, Purpose::CodeDelay)),
            ended: false,
        };
    }

    /// The damage class from the next step on, if it is another one than in the last step.
    pub fn changes_to(&self) -> Option<usize> {
        let class = self.class_in_force();
        (!self.ended && self.step > 0 && class != self.class_at(self.step - 1)).then_some(class)
    }

    /// The damage class that acts now: healthy before the onset and while the robot has recovered.
    pub fn class_in_force(&self) -> usize {
        self.class_at(self.step)
    }

    /// The damage class whose code is observed from the next step on, if it is another one than in the last step.
    pub fn code_changes_to(&self) -> Option<usize> {
        let class = self.class_of_code();
        (!self.ended && self.step > 0 && class != self.class_of_code_at(self.step - 1)).then_some(class)
    }

    /// The damage class whose code is observed now: healthy until the first diagnosis.
    pub fn class_of_code(&self) -> usize {
        self.class_of_code_at(self.step)
    }

    /// The damage class whose code the last observation has.
    pub fn class_of_last_code(&self) -> usize {
        self.class_of_code_at(self.step.saturating_sub(1))
    }

    fn class_of_code_at(&self, step: usize) -> usize {
        step.checked_sub(self.code_delay).map_or(0, |diagnosed| self.class_at(diagnosed))
    }

    fn class_at(&self, step: usize) -> usize {
        let Some(since) = step.checked_sub(self.onset) else { return 0 };
        let is_active = match (self.duration, self.pause) {
            (0, _) => true,
            (duration, 0) => since < duration,
            (duration, pause) => since % duration.saturating_add(pause) < duration,
        };
        if is_active { self.class } else { 0 }
    }
}
