//! What values of arguments can be: read from a word of a command line, and checked alike in keywords of Python.

use std::fmt;
use std::marker::PhantomData;
use std::ops::Deref;
use std::str::FromStr;

use clap::builder::{MapValueParser, PossibleValuesParser, TypedValueParser, ValueParserFactory};
use dappo_diagnose::controller::Trigger;
use dappo_diagnose::{Method, Preset};
use dappo_learn::config::MOST_THREADS;
use dappo_learn::walk::Encoding;
use dappo_nn::LearnerDevice;
use dappo_sim::{BackendKind, Device, Precision};

/// A whole number between two bounds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
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

impl<const MIN: i64, const MAX: i64> FromStr for Whole<MIN, MAX> {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        // What is no number at all is refused like one that is too small.
        Self::try_from(text.parse().unwrap_or(i64::MIN))
    }
}

impl<const MIN: i64, const MAX: i64> fmt::Display for Whole<MIN, MAX> {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(formatter)
    }
}

/// Names that an argument chooses from.
pub trait Names: fmt::Debug + Clone + Send + Sync + 'static {
    /// All of them.
    fn names() -> Vec<&'static str>;
}

/// One of the names of `N`.
#[derive(Debug, Clone)]
pub struct OneOf<N>(String, PhantomData<N>);

impl<N: Names> OneOf<N> {
    /// A name that is one of them.
    pub fn known(name: String) -> Self {
        Self(name, PhantomData)
    }
}

impl<N> Deref for OneOf<N> {
    type Target = str;

    fn deref(&self) -> &str {
        &self.0
    }
}

impl<N: Names> FromStr for OneOf<N> {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        let names = N::names();
        if names.contains(&name) {
            Ok(Self::known(name.to_owned()))
        } else {
            Err(format!("expected one of {}", names.join(", ")))
        }
    }
}

impl<N: Names> ValueParserFactory for OneOf<N> {
    type Parser = MapValueParser<PossibleValuesParser, fn(String) -> Self>;

    fn value_parser() -> Self::Parser {
        PossibleValuesParser::new(N::names()).map(Self::known)
    }
}

/// Defines kinds of names.
macro_rules! names {
    ($($(#[$meta:meta])* $kind:ident: $names:expr;)*) => {
        $(
            $(#[$meta])*
            #[derive(Debug, Clone)]
            pub struct $kind;

            impl Names for $kind {
                fn names() -> Vec<&'static str> {
                    $names.to_vec()
                }
            }
        )*
    };
}

names! {
    /// Where to simulate.
    Devices: Device::NAMES;
    /// Physics backends on the CPU.
    Backends: BackendKind::NAMES;
    /// Precisions of the backend `lanes`.
    Precisions: Precision::NAMES;
    /// Integrators that a robot can be simulated with instead of its own.
    Integrators: ["rk4", "euler"];
    /// Where to compute the networks.
    Learners: LearnerDevice::NAMES;
    /// What policies are told.
    Encodings: Encoding::NAMES;
    /// What raises suspicion.
    Triggers: Trigger::NAMES;
    /// Ways to make pairs.
    Presets: Preset::NAMES;
    /// Whose actions a twin takes.
    TwinActions: ["own", "shared"];
    /// What a diagnoser sees.
    Methods: Method::NAMES;
    /// Outputs of a diagnoser.
    Heads: ["classes", "limbs"];
}
