//! The robot file: everything about a robot that is not in its MJCF.

use serde::Deserialize;
use std::collections::BTreeMap;

use crate::error::SimError;
use crate::terms::{ObservationTerm, RewardTerm};

/// A robot file, parsed. Python reads the same file to compile the MJCF.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Robot {
    /// Name of the robot.
    pub name: String,
    /// MJCF file, relative to the robot file.
    pub mjcf: String,
    /// Body whose x position gives the forward velocity.
    pub main_body: String,
    /// Physics substeps an env step.
    pub frame_skip: usize,
    /// Steps after which an episode is truncated.
    pub max_episode_steps: usize,
    /// ctrl = `action_scale` · clip(action, ±1).
    pub action_scale: f64,
    /// Limbs in ring order.
    pub limbs: Vec<Limb>,
    /// Damage types and their parameters.
    pub damage: DamageSection,
    /// Noise of the initial state.
    pub reset: ResetNoise,
    /// When an episode fails.
    pub termination: Termination,
    /// What the policy sees.
    pub observation: Observation,
    /// Reward functions by name, and the default one.
    pub reward: RewardSection,
    /// Hints for rendering, read by Python alone.
    #[serde(default)]
    pub pictures: Option<toml::Table>,
}

/// A limb: a body of the MJCF and everything below it.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Limb {
    /// Name for people.
    pub name: String,
    /// Root body of the limb.
    pub body: String,
    /// Joints from the torso outwards.
    pub joints: Vec<String>,
    /// Lowest segment.
    pub toe_geom: String,
    /// Touch sensor of the limb.
    #[serde(default)]
    pub touch: Option<String>,
    /// Site of the touch sensor.
    #[serde(default)]
    pub touch_site: Option<String>,
}

/// The section `[damage]`: parameters of the types belong to Python, which edits the MJCF.
#[derive(Debug, Clone, Deserialize)]
pub struct DamageSection {
    /// Names of the damage types.
    pub types: Vec<String>,
    /// Largest number of damaged limbs.
    pub max_damaged_limbs: usize,
    /// Parameters of each type.
    #[serde(flatten)]
    pub parameters: BTreeMap<String, toml::Value>,
}

/// Noise of the initial state around the MJCF's reference pose.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ResetNoise {
    /// Half-width of the uniform noise on every entry of qpos.
    pub qpos_noise: f64,
    /// Standard deviation of the normal noise on every entry of qvel.
    pub qvel_noise: f64,
}

/// An episode ends when the root leaves this range of heights, or when the physics diverges.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Termination {
    /// Lowest and highest z of the root, m.
    pub height: [f64; 2],
}

/// The section `[observation]`.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Observation {
    /// Terms in the order of the observation vector.
    pub terms: Vec<ObservationTerm>,
}

/// The section `[reward]`.
#[derive(Debug, Clone, Deserialize)]
pub struct RewardSection {
    /// Name of the reward used when none is asked for.
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

impl Robot {
    /// Parses and checks a robot file.
    pub fn from_toml(text: &str) -> Result<Self, SimError> {
        let robot: Self = toml::from_str(text)
            .map_err(|error| SimError::Config(format!("cannot read the robot file: {error}")))?;
        robot.check()?;
        Ok(robot)
    }

    fn check(&self) -> Result<(), SimError> {
        let bad = |why: String| Err(SimError::Config(format!("robot `{}`: {why}", self.name)));
        if self.limbs.is_empty() {
            return bad("it needs at least one entry in `limbs`".into());
        }
        if self.frame_skip == 0 || self.max_episode_steps == 0 {
            return bad("`frame_skip` and `max_episode_steps` must be at least 1".into());
        }
        if !(self.action_scale.is_finite() && self.action_scale > 0.0) {
            return bad(format!("`action_scale` is {}, expected a positive number", self.action_scale));
        }
        if !(self.reset.qpos_noise >= 0.0 && self.reset.qvel_noise >= 0.0) {
            return bad("the noises in `[reset]` must not be negative".into());
        }
        let [low, high] = self.termination.height;
        if low.is_nan() || high.is_nan() || low >= high {
            return bad(format!("`termination.height` is [{low}, {high}], expected [low, high]"));
        }
        if self.observation.terms.is_empty() {
            return bad("`observation.terms` is empty".into());
        }
        let touch = self.limbs.iter().filter(|limb| limb.touch.is_some()).count();
        if touch != 0 && touch != self.limbs.len() {
            return bad(format!(
                "{touch} of {} limbs have a `touch` sensor; give it to all or none",
                self.limbs.len()
            ));
        }
        if touch == 0 && self.observation.terms.contains(&ObservationTerm::Touch) {
            return bad("the observation term `touch` needs a `touch` sensor on every limb".into());
        }
        self.reward(None).map(|_| ())
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
