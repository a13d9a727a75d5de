//! The section `[damage]`.

use serde::{Deserialize, Serialize};

use dappo_sim::Severity;
use dappo_sim::vector_env::{DamageCourse, StepRange};

use super::MOST_STEPS;
use crate::faults::Faults;

/// Number of severities that are compiled for a range, unless set otherwise.
const SEVERITY_LEVELS: usize = 4;

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde passes references")]
fn are_usual(levels: &usize) -> bool {
    *levels == SEVERITY_LEVELS
}

fn is_nothing(steps: &StepRange) -> bool {
    *steps == StepRange::default()
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde passes references")]
fn is_zero(steps: &usize) -> bool {
    *steps == 0
}

/// The section `[damage]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DamageSection {
    /// Damage types; the robot's when absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub types: Option<Vec<String>>,
    /// Python modules that register damage types of a user, besides those of the robot.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub modules: Vec<String>,
    /// Largest number of damaged limbs; the robot's when absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_damaged_limbs: Option<usize>,
    /// Largest number of damages of a limb; the robot's when absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_damages_per_limb: Option<usize>,
    /// 1 is the paper's damage, values towards 0 are milder; with a range, episodes differ.
    pub severity: Severity,
    /// Number of severities that are compiled for a range.
    #[serde(skip_serializing_if = "are_usual")]
    pub severity_levels: usize,
    /// Env steps for which an env has its damage class at least, in training; with 0 each episode draws its class.
    #[serde(skip_serializing_if = "is_zero")]
    pub min_class_steps: usize,
    /// When the damage strikes; (0, 0) is from the start of the episode.
    pub onset: StepRange,
    /// Steps for which it lasts; for good when absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub duration: Option<StepRange>,
    /// Steps from its end until it returns; it does not when absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pause: Option<StepRange>,
    /// Steps by which the damage code is late while training, as after a diagnosis; (0, 0) is not at all.
    #[serde(skip_serializing_if = "is_nothing")]
    pub code_delay: StepRange,
    /// Parameters of the damage types, for example `options.jammed_joint.range_deg`.
    #[serde(skip_serializing_if = "toml::Table::is_empty")]
    pub options: toml::Table,
}

impl Default for DamageSection {
    fn default() -> Self {
        Self {
            types: None,
            modules: Vec::new(),
            max_damaged_limbs: None,
            max_damages_per_limb: None,
            severity: Severity::Same(1.0),
            severity_levels: SEVERITY_LEVELS,
            min_class_steps: 0,
            onset: StepRange::default(),
            duration: None,
            pause: None,
            code_delay: StepRange::default(),
            options: toml::Table::new(),
        }
    }
}

impl DamageSection {
    /// When the damage of an episode is active.
    #[must_use]
    pub fn course(&self) -> DamageCourse {
        DamageCourse {
            onset: self.onset,
            duration: self.duration,
            pause: self.pause,
            code_delay: self.code_delay,
        }
    }

    pub(super) fn review(&self, faults: &mut Faults) {
        match self.severity {
            Severity::Same(severity) => faults.positive("damage.severity", severity, 1.0),
            drawn @ Severity::Drawn(_) => {
                let expected = "a number, or a range [low, high] with 0 < low < high <= 1";
                faults.rule("damage.severity", drawn.to_string(), expected, drawn.is_valid());
            }
        }
        let levels = self.severity_levels;
        let expected = "a whole number from 2 to 1000";
        faults.rule("damage.severity_levels", levels.to_string(), expected, (2..=1000).contains(&levels));
        let (steps, expected) = (self.min_class_steps, format!("a whole number up to {MOST_STEPS}"));
        faults.rule("damage.min_class_steps", steps.to_string(), &expected, steps <= MOST_STEPS);
        let ranges = [
            ("damage.onset", Some(self.onset), 0),
            ("damage.duration", self.duration, 1),
            ("damage.pause", self.pause, 1),
            ("damage.code_delay", Some(self.code_delay), 0),
        ];
        for (key, range, least) in ranges {
            let Some(StepRange { first, last }) = range else { continue };
            let expected = format!("a range in ascending order, within {least} to {MOST_STEPS}");
            let fits = least <= first && first <= last && last <= MOST_STEPS;
            faults.rule(key, format!("{first} to {last}"), &expected, fits);
        }
        if self.pause.is_some() && self.duration.is_none() {
            faults.add(
                "damage.pause",
                "is set, but `damage.duration` is not: damage that stays does not return",
            );
        }
    }
}
