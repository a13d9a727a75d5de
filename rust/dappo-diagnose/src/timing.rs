//! When the damage strikes, and when the diagnosis begins.

use std::str::FromStr;

use dappo_learn::error::{LearnError, Result};
use dappo_sim::rng::{Purpose, Stream};
use serde::{Deserialize, Serialize};

/// A range of whole numbers, both ends included.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Span {
    /// Smallest number.
    pub first: u32,
    /// Largest number.
    pub last: u32,
}

/// The steps of a rollout at which something happens. Each rollout draws its own, the same for all damage classes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Timing {
    /// Steps that the robot walks healthily before the damage strikes; (0, 0) = damaged from the start.
    pub onset: Span,
    /// Steps between the damage and the first step of the window. Without a twin: steps from the damage to the end of
    /// the window, which may begin before it, as that of a controller without a twin does.
    pub delay: Span,
}

impl FromStr for Span {
    type Err = String;

    /// Reads `20-150`, or one number.
    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let (first, last) = text.split_once('-').unwrap_or((text, text));
        match (first.parse(), last.parse()) {
            (Ok(first), Ok(last)) => Ok(Self { first, last }),
            _ => Err("expected a number of steps, or a range such as 20-150".to_owned()),
        }
    }
}

impl Span {
    fn check(self, name: &'static str) -> Result<()> {
        if self.first <= self.last {
            return Ok(());
        }
        let got = format!("{} to {}", self.first, self.last);
        Err(LearnError::Config { key: name, got, expected: "a range in ascending order" })
    }

    fn draw(self, stream: &mut Stream) -> u32 {
        self.first + stream.below(u64::from(self.last - self.first) + 1) as u32
    }
}

impl Timing {
    /// Whether every window begins with the episode.
    #[must_use]
    pub(crate) fn starts_at_reset(&self) -> bool {
        (self.onset.last, self.delay.last) == (0, 0)
    }

    /// Fails for ranges whose ends are exchanged.
    pub fn check(&self) -> Result<()> {
        self.onset.check("onset")?;
        self.delay.check("delay")
    }

    /// The onset and the delay of the rollout with this random key.
    pub(super) fn draw(&self, key: u64) -> (u32, u32) {
        let mut stream = Stream::new(key, 0, Purpose::Timing);
        (self.onset.draw(&mut stream), self.delay.draw(&mut stream))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_are_read_from_both_ends_or_one_number() {
        assert_eq!("20-150".parse(), Ok(Span { first: 20, last: 150 }));
        assert_eq!("7".parse(), Ok(Span { first: 7, last: 7 }));
        for text in ["", "-", "20-", "-5", "1-2-3", "a", "4294967296"] {
            assert!(text.parse::<Span>().unwrap_err().contains("such as 20-150"), "{text}");
        }
    }

    #[test]
    fn rollouts_draw_every_number_of_both_ranges_and_none_outside() {
        let timing = Timing { onset: Span { first: 3, last: 5 }, delay: Span { first: 0, last: 1 } };
        timing.check().unwrap();
        let mut drawn: Vec<(u32, u32)> = (0..200).map(|key| timing.draw(key)).collect();
        drawn.sort_unstable();
        drawn.dedup();
        assert_eq!(drawn, [(3, 0), (3, 1), (4, 0), (4, 1), (5, 0), (5, 1)]);
    }

    #[test]
    fn ranges_with_exchanged_ends_are_rejected() {
        let timing = Timing { onset: Span::default(), delay: Span { first: 2, last: 1 } };
        assert!(timing.check().unwrap_err().to_string().starts_with("delay is 2 to 1"));
    }
}
