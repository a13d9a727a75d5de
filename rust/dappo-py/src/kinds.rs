//! What values of arguments can be: read from a word of a command line, and checked alike in keywords of Python.

use std::fmt;
use std::ops::Deref;
use std::str::FromStr;

use clap::ValueEnum;
use clap::builder::{PossibleValuesParser, TryMapValueParser, TypedValueParser, ValueParserFactory};
use dappo_learn::config::MOST_THREADS;
use pyo3::prelude::*;
use strum::{EnumString, IntoStaticStr, VariantNames};

/// A whole number between two bounds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, IntoPyObjectRef)]
pub struct Whole<const MIN: i64, const MAX: i64>(i64);

/// A number of things that are counted with 31 bits.
pub type Count<const MIN: i64> = Whole<MIN, { i32::MAX as i64 }>;
/// A number with a lower bound; TOML, which the configuration is written in, ends at 2⁶³ − 1.
pub type AtLeast<const MIN: i64> = Whole<MIN, { i64::MAX }>;
/// A number of threads or processes.
pub type Threads = Whole<1, { MOST_THREADS as i64 }>;

impl<const MIN: i64, const MAX: i64> Whole<MIN, MAX> {
    /// The number.
    pub fn get(self) -> i64 {
        self.0
    }

    /// The number, which the bounds of this kind keep from being negative.
    pub fn count(self) -> usize {
        const { assert!(MIN >= 0) };
        self.0 as usize
    }

    /// The same with 64 bits, as seeds and env steps have.
    pub fn wide(self) -> u64 {
        const { assert!(MIN >= 0) };
        self.0 as u64
    }
}

impl<const MIN: i64, const MAX: i64> TryFrom<i64> for Whole<MIN, MAX> {
    type Error = String;

    fn try_from(number: i64) -> Result<Self, String> {
        if (MIN..=MAX).contains(&number) {
            Ok(Self(number))
        } else {
            Err(format!("expected a whole number of at least {MIN} and at most {MAX}"))
        }
    }
}

impl<const MIN: i64, const MAX: i64> From<Whole<MIN, MAX>> for toml::Value {
    fn from(number: Whole<MIN, MAX>) -> Self {
        number.0.into()
    }
}

impl<const MIN: i64, const MAX: i64> FromStr for Whole<MIN, MAX> {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        // Fractions are refused like numbers that are too small. 1e6 is a whole number, exact up to its
        // digits.
        let exact = |number: &f64| number.fract() == 0.0 && number.abs() <= 2f64.powi(53);
        let float = || text.parse::<f64>().ok().filter(exact).map(|number| number as i64);
        Self::try_from(text.parse().ok().or_else(float).unwrap_or(i64::MIN))
    }
}

impl<const MIN: i64, const MAX: i64> fmt::Display for Whole<MIN, MAX> {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(formatter)
    }
}

/// A value of an enum, chosen by its name. As text it is that name, which is how settings take it.
#[derive(Debug, Clone, Copy)]
pub struct OneOf<T>(T);

/// Enums whose values have names.
pub trait Named: FromStr + VariantNames + Copy + Into<&'static str> + Send + Sync + 'static {}

impl<T: FromStr + VariantNames + Copy + Into<&'static str> + Send + Sync + 'static> Named for T {}

impl<T: Named> OneOf<T> {
    /// The value.
    pub fn get(self) -> T {
        self.0
    }
}

impl<T: Named> Deref for OneOf<T> {
    type Target = str;

    fn deref(&self) -> &str {
        self.0.into()
    }
}

impl<T: Named> From<OneOf<T>> for toml::Value {
    fn from(chosen: OneOf<T>) -> Self {
        Self::from(&*chosen)
    }
}

impl<T: Named> FromStr for OneOf<T> {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        name.parse().map(Self).map_err(|_| format!("expected one of {}", T::VARIANTS.join(", ")))
    }
}

impl<T: Named> ValueParserFactory for OneOf<T> {
    type Parser = TryMapValueParser<PossibleValuesParser, fn(String) -> Result<Self, String>>;

    fn value_parser() -> Self::Parser {
        PossibleValuesParser::new(T::VARIANTS).try_map(|name| name.parse())
    }
}

/// Integrators that a robot can be simulated with instead of its own.
#[derive(Debug, Clone, Copy, EnumString, IntoStaticStr, VariantNames)]
#[strum(serialize_all = "lowercase")]
pub enum Integrator {
    /// Runge-Kutta of fourth order.
    Rk4,
    /// Semi-implicit Euler.
    Euler,
}

/// What to do where a robot file has changed since the training; without it, a command stops.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum RobotChanged {
    /// Use the robot as the run has it
    UseRun,
    /// Use the robot file as it is now
    UseFile,
}

impl RobotChanged {
    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::UseRun => "use-run",
            Self::UseFile => "use-file",
        }
    }
}
