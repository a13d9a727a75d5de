//! The robot file: everything about a robot that is not in its MJCF.

mod earlier;
mod entries;
mod event_faults;
mod faults;
mod limits;
mod nesting;
mod simplify;
mod task_faults;
mod tasks;

use std::collections::BTreeMap;

use regex_lite::Regex;
use serde::Deserialize;

use crate::error::SimError;
use crate::task::{
    Actions, Commands, Curriculum, Events, ObservationTerm, Quantity, RewardTerm, Terminations,
};

pub use tasks::with_task;

/// A robot file and its task, parsed. Python reads the same text to compile the MJCF.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Robot {
    /// Name of the robot.
    pub name: String,
    /// MJCF file, relative to the robot file.
    pub mjcf: String,
    /// Body whose x position gives the forward velocity.
    pub main_body: String,
    /// Limbs in ring order.
    pub limbs: Vec<Limb>,
    /// Damage types and their parameters.
    pub damage: DamageSection,
    /// Simplifications of the MJCF, which Python applies before it compiles.
    #[serde(default)]
    pub simplify: Option<toml::Table>,
    /// Changes of joints, actuators and geoms, which Python applies after them.
    #[serde(default, rename = "override")]
    pub overrides: Vec<toml::Table>,
    /// Hints for rendering, read by Python alone.
    #[serde(default)]
    pub pictures: Option<toml::Table>,
    /// The robot's default task, which Python reads.
    #[serde(default)]
    pub task: Option<String>,
    /// Entries of tasks that are the robot's, by the name of the task.
    #[serde(default)]
    pub tasks: BTreeMap<String, toml::Table>,
    /// Physics substeps an env step.
    pub frame_skip: usize,
    /// Steps after which an episode is truncated.
    pub max_episode_steps: usize,
    /// What an episode asks the robot to do.
    #[serde(default)]
    pub commands: Commands,
    /// What becomes harder in training.
    #[serde(default)]
    pub curriculum: Curriculum,
    /// How controls follow from actions.
    pub actions: Actions,
    /// The initial state.
    pub reset: InitialState,
    /// When an episode fails.
    #[serde(default)]
    pub terminations: Terminations,
    /// What is random besides damage.
    #[serde(default)]
    pub events: Events,
    /// What networks see.
    pub observation: Observation,
    /// Reward functions by name, and the default one.
    pub reward: RewardSection,
}

/// A limb: a body of the MJCF and everything below it.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Limb {
    /// Name in texts.
    pub name: String,
    /// Root body of the limb.
    pub body: String,
    /// Joints from the torso outwards.
    pub joints: Vec<String>,
    /// Lowest segment, which `missing_toe` shortens.
    #[serde(default)]
    pub toe_geom: Option<String>,
    /// Touch sensor of the limb.
    #[serde(default)]
    pub touch: Option<String>,
    /// Site of the touch sensor.
    #[serde(default)]
    pub touch_site: Option<String>,
    /// Geom or site whose centre is the foot.
    #[serde(default)]
    pub foot: Option<String>,
}

/// The section `[damage]`: parameters of the types belong to Python, which edits the MJCF.
#[derive(Debug, Clone, Deserialize)]
pub struct DamageSection {
    /// Names of the damage types.
    pub types: Vec<String>,
    /// Largest number of damaged limbs.
    pub max_damaged_limbs: usize,
    /// Largest number of damages of a limb.
    #[serde(default = "one_damage")]
    pub max_damages_per_limb: usize,
    /// Parameters of each type.
    #[serde(flatten)]
    pub parameters: BTreeMap<String, toml::Value>,
}

fn one_damage() -> usize {
    1
}

/// The section `[reset]`: the initial state.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct InitialState {
    /// Keyframe of the MJCF whose positions are the default pose; the MJCF's reference pose when absent.
    #[serde(default)]
    pub keyframe: Option<String>,
    /// Half-width of the uniform noise on every entry of qpos.
    pub qpos_noise: f64,
    /// Standard deviation of the normal noise on every entry of qvel.
    pub qvel_noise: f64,
}

impl InitialState {
    /// The noise.
    #[must_use]
    pub fn noise(&self) -> ResetNoise {
        ResetNoise { qpos_noise: self.qpos_noise, qvel_noise: self.qvel_noise }
    }
}

/// Noise of the initial state around the default pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ResetNoise {
    /// Half-width of the uniform noise on every entry of qpos.
    pub qpos_noise: f64,
    /// Standard deviation of the normal noise on every entry of qvel.
    pub qvel_noise: f64,
}

/// The section `[observation]`.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Observation {
    /// What the policy sees.
    pub policy: ObservationTerms,
    /// What the value net sees besides, while it is trained.
    #[serde(default)]
    pub critic: Option<ObservationTerms>,
}

/// A group of observations.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ObservationTerms {
    /// Terms in the order of the observation vector.
    pub terms: Vec<ObservationTerm>,
}

/// The section `[reward]`.
#[derive(Debug, Clone, Deserialize)]
pub struct RewardSection {
    /// Name of the reward used when none is chosen.
    pub default: String,
    /// Reward functions by name.
    #[serde(flatten)]
    pub functions: BTreeMap<String, RewardFunction>,
}

/// A reward: a sum of weighted terms.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RewardFunction {
    /// Terms of the sum.
    pub terms: Vec<RewardTerm>,
}

impl RewardFunction {
    /// The term that rewards tracking of commanded linear velocities, and its index; `None` without one.
    #[must_use]
    pub fn tracking(&self) -> Option<(usize, &RewardTerm)> {
        crate::task::tracking(&self.terms)
    }
}

/// Largest robot file, bytes.
const LARGEST_FILE: usize = 1 << 20;
/// Tables and lists inside each other, at most; a robot needs four.
const DEEPEST: usize = 32;

impl Robot {
    /// Parses and checks a robot file. The error lists all faults, a line each.
    pub fn from_toml(text: &str) -> Result<Self, SimError> {
        let faults = Self::faults(text);
        if !faults.is_empty() {
            return Err(SimError::Config(format!("cannot use the robot file: {}", faults.join("\n"))));
        }
        let unreadable = |error| SimError::Config(format!("cannot read the robot file: {error}"));
        let file: toml::Table = toml::from_str(text).map_err(unreadable)?;
        earlier::brought_up_to_date(file).try_into().map_err(unreadable)
    }

    /// What is wrong with a robot file, a sentence a fault; empty for one that can be used.
    #[must_use]
    pub fn faults(text: &str) -> Vec<String> {
        if text.len() > LARGEST_FILE {
            return vec![format!("it has {} bytes, a robot file at most {LARGEST_FILE}", text.len())];
        }
        if nesting::is_deeper_than(text, DEEPEST) {
            return vec![format!("its tables, lists or dotted keys are nested more than {DEEPEST} deep")];
        }
        match text.parse::<toml::Table>() {
            Ok(file) => faults::faults(&file),
            Err(error) => vec![format!("it is not valid TOML: {error}")],
        }
    }

    /// The task that a robot file names; `None` if it names none, or cannot be read.
    #[must_use]
    pub fn task_name(text: &str) -> Option<String> {
        if text.len() > LARGEST_FILE || nesting::is_deeper_than(text, DEEPEST) {
            return None;
        }
        text.parse::<toml::Table>().ok()?.get("task")?.as_str().map(ToOwned::to_owned)
    }

    /// The robot with a policy that observes so many steps of every term, as a group's `history_length` in Isaac Lab; with
    /// the numbers of its task for `None`. The value net's own terms stay as they are.
    ///
    /// # Errors
    /// If a term is computed in Python, where earlier values are not kept.
    pub fn with_history(mut self, steps: Option<usize>) -> Result<Self, SimError> {
        let Some(steps) = steps else { return Ok(self) };
        for term in &mut self.observation.policy.terms {
            if let Quantity::Python { function, .. } = &term.quantity {
                return Err(SimError::Config(format!(
                    "robot `{}`: a history of {steps} steps cannot be observed, as the term `{function}` is computed in \
                     Python, which keeps no earlier values",
                    self.name
                )));
            }
            term.history = steps;
        }
        Ok(self)
    }

    /// The reward function of this name; the robot's default for `None`.
    pub fn reward(&self, name: Option<&str>) -> Result<&RewardFunction, SimError> {
        let name = name.unwrap_or(&self.reward.default);
        self.reward.functions.get(name).ok_or_else(|| {
            let known: Vec<&str> = self.reward.functions.keys().map(String::as_str).collect();
            SimError::Config(format!(
                "robot `{}` has no reward `{name}`; it has {}",
                self.name,
                known.join(", ")
            ))
        })
    }
}

/// A regular expression that has to match a name as a whole, or what is wrong with it.
pub(crate) fn pattern(text: &str) -> Result<Regex, String> {
    Regex::new(&format!("^(?:{text})$"))
        .map_err(|error| format!("{text:?} is not a regular expression: {error}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    pub(super) const GOOD: &str = r#"
name = "toy"
mjcf = "toy.xml"
main_body = "root"
frame_skip = 4
max_episode_steps = 100
action_scale = 1.0
[[limbs]]
name = "a"
body = "a"
joints = ["a1", "a2"]
touch = "ta"
[[limbs]]
name = "b"
body = "b"
joints = ["b1"]
toe_geom = "toe"
touch = "tb"
[damage]
types = ["jammed_joint"]
max_damaged_limbs = 1
[damage.jammed_joint]
joint = 0
[reset]
qpos_noise = 0
qvel_noise = 0.1
[termination]
height = [0.2, inf]
[observation]
terms = [{ term = "qpos", skip = 2 }, { term = "cfrc_ext", clip = 1.0 }, { term = "touch" }]
[reward]
default = "walk"
[reward.walk]
terms = [{ term = "survive", weight = 1 }, { term = "link_loads_squared", weight = -1.0, clip = 10.0 }]
"#;

    #[test]
    fn a_file_without_faults_becomes_a_robot() {
        assert_eq!(Robot::faults(GOOD), Vec::<String>::new());
        let robot = Robot::from_toml(GOOD).unwrap();
        assert_eq!((robot.limbs.len(), robot.limbs[0].toe_geom.as_deref()), (2, None));
        assert_eq!(robot.terminations.height, Some([0.2, f64::INFINITY]));
    }

    #[test]
    fn every_fault_is_named_with_what_is_expected() {
        for (old, new, fault) in [
            ("name = \"toy\"", "name = \"../toy\"", "`name` is \"../toy\", expected letters"),
            ("mjcf = \"toy.xml\"", "", "the entry `mjcf` is missing"),
            ("main_body = \"root\"", "main_body = 1", "`main_body` is 1, expected a text"),
            (
                "frame_skip = 4",
                "frame_skip = 4999",
                "`frame_skip` is 4999, expected a whole number from 1 to 1000",
            ),
            ("frame_skip = 4", "frame_skip = 4.0", "`frame_skip` is 4.0, expected a whole number"),
            ("max_episode_steps = 100", "", "the entry `max_episode_steps` is missing"),
            ("action_scale = 1.0", "action_scale = 1e308", "`action_scale` is 1e308"),
            ("action_scale = 1.0", "action_scale = nan", "expected a number above 0"),
            ("joints = [\"b1\"]", "joints = []", "limb 1: `joints` is empty"),
            (
                "joints = [\"b1\"]",
                "joints = [\"a2\"]",
                "limb 1: the joint \"a2\" is listed by limb 0 already",
            ),
            ("body = \"b\"", "body = \"a\"", "limb 1: `body` is \"a\", which limb 0 has already"),
            ("touch = \"tb\"", "", "1 of 2 limbs have a `touch` sensor"),
            ("touch = \"tb\"", "colour = \"red\"", "limb 1: unknown entries colour"),
            (
                "max_damaged_limbs = 1",
                "max_damaged_limbs = -1",
                "[damage]: `max_damaged_limbs` is -1, expected a whole",
            ),
            ("max_damaged_limbs = 1", "max_damaged_limbs = 3", "a whole number from 0 to 2"),
            ("max_damaged_limbs = 1", "max_damaged_limbs = true", "`max_damaged_limbs` is true"),
            ("types = [\"jammed_joint\"]", "types = []", "`types` is empty"),
            ("types = [\"jammed_joint\"]", "types = [\"x\", \"x\"]", "lists \"x\" twice"),
            (
                "[damage.jammed_joint]\njoint = 0",
                "jammed_joint = 3",
                "[damage]: `jammed_joint` is 3; expected",
            ),
            (
                "qpos_noise = 0",
                "qpos_noise = inf",
                "[reset]: `qpos_noise` is inf, expected a number from 0 to 10",
            ),
            ("qvel_noise = 0.1", "qvel_noise = 4e9", "`qvel_noise` is 4000000000.0"),
            ("[0.2, inf]", "[0.2]", "[termination]: `height` is [0.2], expected [low, high]"),
            ("[0.2, inf]", "[nan, 1.0]", "expected [low, high]"),
            ("[0.2, inf]", "[1.0, 0.2]", "expected [low, high]"),
            ("skip = 2", "skip = -2", "[observation] term 0: `skip` is -2"),
            ("\"cfrc_ext\", clip = 1.0", "\"cfrc_ext\", clip = -1.0", "[observation] term 1: `clip` is -1.0"),
            (
                "\"cfrc_ext\", clip = 1.0",
                "\"cfrc_ext\", clip = nan",
                "`clip` is nan, expected a number above 0",
            ),
            ("{ term = \"touch\" }", "{ term = \"smell\" }", "`term` is \"smell\", expected one of qpos"),
            ("{ term = \"touch\" }", "7", "[observation]: term 2 is 7, expected a table"),
            ("weight = 1 }", "weight = 1e308 }", "[reward.walk] term 0: `weight` is 1e308"),
            (
                "default = \"walk\"",
                "default = \"run\"",
                "`default` is \"run\", which is not one of the rewards (walk)",
            ),
            ("[reward.walk]", "[reward.run]", "`default` is \"walk\""),
            ("[reset]", "[rset]", "unknown entries rset"),
            ("[reset]\nqpos_noise = 0\nqvel_noise = 0.1", "[other]\na = 1", "the entry `reset` is missing"),
            ("[damage]", "[damage", "it is not valid TOML"),
            (
                "[reset]",
                "[pictures]\ncamera = 5\n[reset]",
                "[pictures]: `camera` is 5, expected a text in quotes",
            ),
            ("[reset]", "[pictures]\nlight = \"dim\"\n[reset]", "[pictures]: unknown entries light"),
        ] {
            assert_eq!(GOOD.matches(old).count(), 1, "{old}");
            let faults = Robot::faults(&GOOD.replace(old, new));
            assert!(faults.iter().any(|found| found.contains(fault)), "{new} gave {faults:?}");
            assert!(Robot::from_toml(&GOOD.replace(old, new)).unwrap_err().to_string().contains(fault));
        }
    }

    #[test]
    fn all_faults_come_at_once() {
        let text = GOOD.replace("frame_skip = 4", "frame_skip = 0").replace("skip = 2", "skip = -1");
        let faults = Robot::faults(&text.replace("weight = 1 }", "weight = inf }"));
        assert_eq!(faults.len(), 3, "{faults:?}");
    }

    #[test]
    fn a_number_in_the_place_of_a_table_is_a_fault() {
        for table in ["damage", "reset", "termination", "observation", "reward", "limbs"] {
            let faults = Robot::faults(&format!("{table} = 5"));
            assert!(faults.iter().any(|fault| fault.contains(&format!("`{table}` is 5"))), "{faults:?}");
        }
    }

    #[test]
    fn deep_nesting_is_rejected_before_the_stack_overflows() {
        let deep = [
            format!("a = {}{}", "[".repeat(100_000), "]".repeat(100_000)),
            format!("a = {}", "{a=".repeat(100_000)),
            format!("{}a = 1", "a.".repeat(100_000)),
            format!("[{}a]", "a.".repeat(100_000)),
            format!("a = {{ b = 1, {}a = 1 }}", "a . ".repeat(100_000)),
        ];
        for text in deep {
            assert!(Robot::faults(&text)[0].contains("nested more than 32 deep"));
        }
        assert!(Robot::faults(&"# ".repeat(1 << 20))[0].contains("a robot file at most"));
    }
}
