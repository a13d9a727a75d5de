//! Actions: how the controls of the actuators follow from what a policy decides.

use serde::Deserialize;
use std::collections::BTreeMap;

use super::anatomy::{ActuatorParts, Anatomy};
use crate::robot::pattern;

/// The section `[actions]`.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct Actions {
    /// What an action is.
    #[serde(rename = "type")]
    pub kind: ActionKind,
    /// What an action of 1 stands for: a number, or one for each actuator whose name a pattern matches as a whole.
    pub scale: Scale,
}

/// What an action is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ActionKind {
    /// ctrl = scale · clip(action, ±1).
    Control,
    /// ctrl = target of the default pose + scale · clip(action, ±1), for actuators that are position servos.
    JointPosition,
}

/// One number for all actuators, or one by pattern.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(untagged)]
pub enum Scale {
    /// For all actuators.
    All(f64),
    /// By pattern of the actuator's name.
    Patterns(BTreeMap<String, f64>),
}

/// The controls of one actuator: offset + scale · clip(action, ±1).
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ActuatorAction {
    pub offset: f64,
    pub scale: f64,
}

impl Actions {
    /// The actions of every actuator, or what is wrong with them.
    pub(super) fn of_actuators(&self, nu: usize, anatomy: &Anatomy) -> Result<Vec<ActuatorAction>, String> {
        if let (ActionKind::Control, Scale::All(scale)) = (self.kind, &self.scale) {
            return Ok(vec![ActuatorAction { offset: 0.0, scale: *scale }; nu]);
        }
        let names = || anatomy.actuators.iter().map(|actuator| actuator.name.as_str());
        let scales = self.scale.of_names(&names().collect::<Vec<_>>())?;
        let action = |((actuator, offset), scale): ((&ActuatorParts, f64), f64)| match self.kind {
            ActionKind::Control => Ok(ActuatorAction { offset: 0.0, scale }),
            ActionKind::JointPosition if actuator.is_position => Ok(ActuatorAction { offset, scale }),
            ActionKind::JointPosition => Err(format!(
                "[actions]: `type` is \"joint_position\", but the actuator `{}` is not a position servo on a hinge; \
                 [[override]] with control = \"position\", kp and kd makes it one",
                actuator.name
            )),
        };
        let offsets = anatomy.start_ctrl.iter().copied();
        anatomy.actuators.iter().zip(offsets).zip(scales).map(action).collect()
    }
}

impl Scale {
    fn of_names(&self, names: &[&str]) -> Result<Vec<f64>, String> {
        let patterns = match self {
            Self::All(scale) => return Ok(vec![*scale; names.len()]),
            Self::Patterns(patterns) => patterns,
        };
        let mut scales = vec![None; names.len()];
        for (text, value) in patterns {
            let pattern = pattern(text).map_err(|why| format!("[actions] scale: {why}"))?;
            let mut matches = 0;
            for (scale, name) in scales.iter_mut().zip(names).filter(|(_, name)| pattern.is_match(name)) {
                if scale.replace(*value).is_some() {
                    return Err(format!(
                        "[actions] scale: more than one pattern matches the actuator `{name}`"
                    ));
                }
                matches += 1;
            }
            if matches == 0 {
                return Err(format!(
                    "[actions] scale: the pattern {text:?} matches no actuator; they are {}",
                    names.join(", ")
                ));
            }
        }
        let missing = |name: &str| format!("[actions] scale: no pattern matches the actuator `{name}`");
        scales.into_iter().zip(names).map(|(scale, name)| scale.ok_or_else(|| missing(name))).collect()
    }
}
