//! Which backend simulates, and how precisely.

use serde::{Deserialize, Serialize};

use super::lanes::LaneTable;
use crate::error::SimError;

/// The backend that a user asks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum BackendKind {
    /// The lane engine where it knows everything about the robot, libmujoco otherwise.
    #[default]
    Auto,
    /// The lane engine, or an error that says why it cannot.
    Lanes,
    /// libmujoco.
    Mujoco,
}

/// Floating-point format of the lane engine; libmujoco always computes in double precision.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Precision {
    /// Single precision: twice the envs in a register.
    #[default]
    F32,
    /// Double precision: equal to MuJoCo up to rounding.
    F64,
}

impl BackendKind {
    /// Reads a name.
    pub fn parse(text: &str) -> Result<Self, SimError> {
        let choices = [("auto", Self::Auto), ("lanes", Self::Lanes), ("mujoco", Self::Mujoco)];
        choose("backend", text, &choices)
    }

    /// Its name.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::Lanes => "lanes",
            Self::Mujoco => "mujoco",
        }
    }

    /// The backend that it means for a robot; `compile` hands the robot to the lane engine.
    pub fn choose(self, compile: impl FnOnce() -> Result<LaneTable, SimError>) -> Result<Choice, SimError> {
        if self == Self::Mujoco {
            return Ok(Choice::Mujoco { note: String::new() });
        }
        match compile() {
            Ok(table) => Ok(Choice::Lanes(table)),
            Err(error @ SimError::Unsupported(_)) if self == Self::Auto => {
                Ok(Choice::Mujoco { note: error.to_string() })
            }
            Err(error) => Err(error),
        }
    }
}

impl Precision {
    /// Reads a name.
    pub fn parse(text: &str) -> Result<Self, SimError> {
        choose("precision", text, &[("f32", Self::F32), ("f64", Self::F64)])
    }

    /// Its name.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::F32 => "f32",
            Self::F64 => "f64",
        }
    }
}

impl From<Precision> for dappo_lanes::Precision {
    fn from(precision: Precision) -> Self {
        match precision {
            Precision::F32 => Self::F32,
            Precision::F64 => Self::F64,
        }
    }
}

/// The backend of a robot.
pub enum Choice {
    /// The lane engine, with the damage classes as it knows them.
    Lanes(LaneTable),
    /// libmujoco.
    Mujoco {
        /// Why not the lane engine; empty if it was not asked for.
        note: String,
    },
}

impl Choice {
    /// The kind of the backend, never `Auto`.
    #[must_use]
    pub fn kind(&self) -> BackendKind {
        match self {
            Self::Lanes(_) => BackendKind::Lanes,
            Self::Mujoco { .. } => BackendKind::Mujoco,
        }
    }

    /// Why it is this backend, for people; empty where there is nothing to say.
    #[must_use]
    pub fn note(&self) -> &str {
        match self {
            Self::Lanes(_) => "",
            Self::Mujoco { note } => note,
        }
    }

    /// The precision in which the backend computes when `wanted` is asked for.
    #[must_use]
    pub fn precision(&self, wanted: Precision) -> &'static str {
        match self {
            Self::Lanes(_) => wanted.name(),
            Self::Mujoco { .. } => "f64",
        }
    }
}

pub(super) fn choose<T: Copy>(what: &str, text: &str, choices: &[(&str, T)]) -> Result<T, SimError> {
    let found = choices.iter().find(|(name, _)| *name == text);
    found.map(|(_, choice)| *choice).ok_or_else(|| {
        let names: Vec<String> = choices.iter().map(|(name, _)| format!("`{name}`")).collect();
        SimError::Config(format!("{what} is `{text}`, expected one of {}", names.join(", ")))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn unsupported() -> Result<LaneTable, SimError> {
        Err(SimError::Unsupported("it has wheels".into()))
    }

    #[test]
    fn auto_falls_back_with_the_reason_and_a_wish_for_lanes_is_refused_with_it() {
        let choice = BackendKind::Auto.choose(unsupported).unwrap();
        assert_eq!((choice.kind(), choice.precision(Precision::F32)), (BackendKind::Mujoco, "f64"));
        assert!(choice.note().contains("it has wheels"), "{}", choice.note());
        let refusal = BackendKind::Lanes.choose(unsupported).err().unwrap();
        assert!(refusal.to_string().contains("it has wheels"), "{refusal}");
    }

    #[test]
    fn who_asks_for_mujoco_gets_it_unasked_questions_included() {
        let choice = BackendKind::Mujoco.choose(|| unreachable!("the lane engine was not asked for"));
        assert_eq!(choice.unwrap().note(), "");
    }

    #[test]
    fn errors_other_than_an_unknown_robot_are_no_reason_to_fall_back() {
        let broken = || Err(SimError::Config("DAPPO_SIMD is `mmx`".into()));
        assert!(BackendKind::Auto.choose(broken).is_err());
    }

    #[test]
    fn unknown_names_are_refused_with_the_known_ones() {
        let message = BackendKind::parse("brax").unwrap_err().to_string();
        assert_eq!(message, "backend is `brax`, expected one of `auto`, `lanes`, `mujoco`");
        let message = Precision::parse("f16").unwrap_err().to_string();
        assert_eq!(message, "precision is `f16`, expected one of `f32`, `f64`");
    }
}
