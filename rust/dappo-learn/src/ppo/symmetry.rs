//! The setting `ppo.symmetry`.

use std::fmt::{Formatter, Result as FormatResult};

use serde::de::{Error, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// Whether the networks are their own mirror images, left to right: `true`, `false` or `"auto"`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Symmetry {
    /// They are not.
    #[default]
    Off,
    /// They are; a robot or task that is not its own mirror image is an error.
    On,
    /// They are if robot and task are. A run keeps what it has found.
    Auto,
}

impl Serialize for Symmetry {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Off => serializer.serialize_bool(false),
            Self::On => serializer.serialize_bool(true),
            Self::Auto => serializer.serialize_str("auto"),
        }
    }
}

impl<'de> Deserialize<'de> for Symmetry {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Choice;

        impl Visitor<'_> for Choice {
            type Value = Symmetry;

            fn expecting(&self, formatter: &mut Formatter<'_>) -> FormatResult {
                formatter.write_str("true, false or \"auto\"")
            }

            fn visit_bool<E: Error>(self, value: bool) -> Result<Symmetry, E> {
                Ok(if value { Symmetry::On } else { Symmetry::Off })
            }

            fn visit_str<E: Error>(self, value: &str) -> Result<Symmetry, E> {
                match value {
                    "auto" => Ok(Symmetry::Auto),
                    other => Err(E::invalid_value(serde::de::Unexpected::Str(other), &self)),
                }
            }
        }

        deserializer.deserialize_any(Choice)
    }
}
