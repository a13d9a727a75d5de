//! How severe damage is.

use std::fmt;

use serde::de::{Error, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};

/// The severity of the damage of all episodes, or the range that it is drawn from; 1 is the full damage.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(untagged)]
pub enum Severity {
    /// The same in all episodes.
    Same(f64),
    /// Lowest and highest severity.
    Drawn([f64; 2]),
}

impl Severity {
    /// Whether damage can have it.
    #[must_use]
    pub fn is_valid(self) -> bool {
        match self {
            Self::Same(severity) => severity > 0.0 && severity <= 1.0,
            Self::Drawn([low, high]) => 0.0 < low && low < high && high <= 1.0,
        }
    }
}

impl fmt::Display for Severity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Same(severity) => severity.fmt(f),
            Self::Drawn([low, high]) => write!(f, "[{low}, {high}]"),
        }
    }
}

impl<'de> Deserialize<'de> for Severity {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(NumberOrRange)
    }
}

struct NumberOrRange;

impl<'de> Visitor<'de> for NumberOrRange {
    type Value = Severity;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a number, or a range [low, high]")
    }

    fn visit_f64<E: Error>(self, number: f64) -> Result<Severity, E> {
        Ok(Severity::Same(number))
    }

    fn visit_i64<E: Error>(self, number: i64) -> Result<Severity, E> {
        Ok(Severity::Same(number as f64))
    }

    fn visit_u64<E: Error>(self, number: u64) -> Result<Severity, E> {
        Ok(Severity::Same(number as f64))
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut bounds: A) -> Result<Severity, A::Error> {
        let (Some(low), Some(high)) = (bounds.next_element()?, bounds.next_element()?) else {
            return Err(A::Error::custom("expected a range [low, high]"));
        };
        match bounds.next_element::<f64>()? {
            None => Ok(Severity::Drawn([low, high])),
            Some(_) => Err(A::Error::custom("expected a range [low, high], got more than two numbers")),
        }
    }
}
