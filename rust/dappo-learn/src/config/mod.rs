//! The configuration of a run: typed, with the paper's defaults; unknown keys are errors.
//!
//! Sources, later ones win: defaults → the robot's own file in `configs/` or `--config` → command-line
//! flags → `--set key=value`. The resolved configuration is written into the run folder.

mod assignment;
mod changes;
mod damage;
mod layers;
mod nearest;
mod sift;

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use dappo_sim::curriculum::{ClassMix, Stage};
use dappo_sim::{BackendKind, Device, Precision};

use crate::error::LearnError;
use crate::faults::Faults;
use crate::ppo::PpoConfig;

pub use assignment::Assignment;
pub use changes::{Change, change, changes};
pub use damage::DamageSection;
pub use layers::Layers;

/// Envs at most: more do not fit the memory of any machine.
const MOST_ENVS: usize = 1 << 24;
/// Transitions of an iteration at most: their indices, and those of two batches together, are of 31 bits.
const MOST_ROWS: usize = 1 << 30;
/// Steps of an episode at most, which devices count with 31 bits.
const MOST_STEPS: usize = i32::MAX as usize;
/// Env steps at most that a policy observes, as in task files.
const MOST_HISTORY: usize = 1000;
/// Worker threads at most: more than any machine has cores for.
pub const MOST_THREADS: usize = 4096;

/// Everything that determines a training run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// Built-in robot or path of a robot file.
    pub robot: String,
    /// The robot file to compile, where it is another than `robot` names: the copy that a run or an export keeps.
    #[serde(skip)]
    pub robot_file: Option<PathBuf>,
    /// Seed of all random streams of the run.
    pub seed: u64,
    /// Env steps of the whole run, over all envs.
    pub total_steps: u64,
    /// Env steps each env does in one iteration.
    pub horizon: usize,
    /// The envs.
    pub env: EnvSection,
    /// The damage classes.
    pub damage: DamageSection,
    /// Saving.
    pub checkpoint: CheckpointSection,
    /// The evaluation at the end of the run.
    pub evaluation: EvaluationSection,
    /// The learner.
    pub ppo: PpoConfig,
    /// Stages of the damage distribution, in order.
    pub curriculum: Vec<Stage>,
}

/// The section `[env]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct EnvSection {
    /// Number of envs simulated at once.
    pub num_envs: usize,
    /// Worker threads; all cores when absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub threads: Option<usize>,
    /// `auto`, `cpu`, `gpu`, `cuda` or `warp-cpu`: where the training simulates; `auto` is a CUDA GPU where one can
    /// be used, unless `backend` or `precision` need the CPU.
    pub device: Device,
    /// The backend on the CPU: `auto`, `lanes` or `mujoco`; `auto` is the lane engine wherever it supports
    /// the robot.
    pub backend: BackendKind,
    /// `f32` or `f64`, for the backend `lanes`; `mujoco` always computes in `f64`, `warp` in `f32`.
    pub precision: Precision,
    /// Name of the reward function; the robot's default when absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reward: Option<String>,
    /// `rk4` or `euler`; the MJCF's own integrator when absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub physics: Option<String>,
    /// Whether the policy sees the damage code (true = DA-PPO, false = PPO-Unaware).
    pub observe_damage: bool,
    /// Env steps whose values of every term the policy observes; as the robot's task has it when absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub history: Option<usize>,
    /// Steps after which an episode is truncated; the robot's when absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_episode_steps: Option<usize>,
    /// Room for the constraints of an env on the device `cuda`; what the robot can need at most when absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub njmax: Option<usize>,
    /// Room for contacts there, an env on average; as above.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub nconmax: Option<usize>,
}

impl Default for EnvSection {
    fn default() -> Self {
        Self {
            num_envs: 32,
            threads: None,
            device: Device::Auto,
            backend: BackendKind::Auto,
            precision: Precision::F32,
            reward: None,
            physics: None,
            observe_damage: true,
            history: None,
            max_episode_steps: None,
            njmax: None,
            nconmax: None,
        }
    }
}

/// The section `[checkpoint]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CheckpointSection {
    /// Iterations between checkpoints.
    pub every: u64,
    /// Checkpoints kept, the newest first.
    pub keep: usize,
}

impl Default for CheckpointSection {
    fn default() -> Self {
        Self { every: 20, keep: 2 }
    }
}

/// The section `[evaluation]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct EvaluationSection {
    /// Episodes a damage class.
    pub episodes: usize,
    /// Seed of the evaluation's initial states; the same for every policy that is compared.
    pub seed: u64,
    /// Iterations of a training from one evaluation to the next; without it, the only one is at the end.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub every: Option<u64>,
    /// As `env.device`. The CPU unless set otherwise, so that results of all devices can be compared.
    pub device: Device,
    /// As `env.precision`, for the evaluation.
    pub precision: Precision,
}

impl Default for EvaluationSection {
    fn default() -> Self {
        Self { episodes: 4, seed: 1_000_000, every: None, device: Device::Cpu, precision: Precision::F64 }
    }
}

impl Default for Config {
    fn default() -> Self {
        Self {
            robot: String::new(),
            robot_file: None,
            seed: 0,
            total_steps: 2_000_000,
            horizon: 128,
            env: EnvSection::default(),
            damage: DamageSection::default(),
            checkpoint: CheckpointSection::default(),
            evaluation: EvaluationSection::default(),
            ppo: PpoConfig::default(),
            curriculum: vec![Stage {
                name: "all".into(),
                budget: 1.0,
                mix: ClassMix::Named("uniform".into()),
            }],
        }
    }
}

impl Config {
    /// The configuration with some settings of a user's laid over it.
    pub fn with(self, assignments: &[Assignment]) -> Result<Self, LearnError> {
        if assignments.is_empty() {
            return Ok(self);
        }
        let mut layers = Layers::default();
        layers.add_toml(&self.to_toml()?, "the run's config.toml")?;
        layers.assign(assignments)?;
        let mut config = layers.resolve()?;
        if config.robot == self.robot {
            config.robot_file = self.robot_file;
        }
        Ok(config)
    }

    /// Name of the learner that it trains: policies with or without damage code.
    #[must_use]
    pub fn learner(&self) -> &'static str {
        if self.env.observe_damage { "DA-PPO" } else { "PPO-Unaware" }
    }

    /// The configuration as TOML; reading it back gives the same configuration.
    pub fn to_toml(&self) -> Result<String, LearnError> {
        toml::to_string(self)
            .map_err(|error| LearnError::Invalid(format!("cannot write the configuration: {error}")))
    }

    /// What types cannot express: all that is out of range.
    #[must_use]
    pub fn faults(&self) -> Faults {
        let mut faults = Faults::default();
        if self.robot.is_empty() {
            faults.add("robot", "is missing; name a built-in robot or a robot file");
        }
        for (key, value, most) in [
            ("env.num_envs", self.env.num_envs, MOST_ENVS),
            ("horizon", self.horizon, MOST_ROWS),
            ("checkpoint.keep", self.checkpoint.keep, usize::MAX >> 1),
            ("evaluation.episodes", self.evaluation.episodes, MOST_ENVS),
            ("env.threads", self.env.threads.unwrap_or(1), MOST_THREADS),
            ("env.max_episode_steps", self.env.max_episode_steps.unwrap_or(1), MOST_STEPS),
            ("env.history", self.env.history.unwrap_or(1), MOST_HISTORY),
            ("env.njmax", self.env.njmax.unwrap_or(1), MOST_STEPS),
            ("env.nconmax", self.env.nconmax.unwrap_or(1), MOST_STEPS),
        ] {
            faults.count(key, value as u64, most as u64);
        }
        faults.count("total_steps", self.total_steps, u64::MAX >> 1);
        faults.count("checkpoint.every", self.checkpoint.every, u64::MAX >> 1);
        faults.count("evaluation.every", self.evaluation.every.unwrap_or(1), u64::MAX >> 1);
        let rows = self.env.num_envs.saturating_mul(self.horizon);
        if rows > MOST_ROWS && !faults.concern("env.num_envs") && !faults.concern("horizon") {
            faults.add("horizon", format!(
                "is {} and `env.num_envs` is {}; their product, the transitions of an iteration, must be at most {MOST_ROWS}",
                self.horizon, self.env.num_envs
            ));
        }
        self.damage.review(&mut faults);
        self.review_curriculum(&mut faults);
        faults.section("ppo", |faults| self.ppo.review(faults));
        if self.ppo.lstm.is_some() && !matches!(self.env.device, Device::Auto | Device::Cpu) {
            let device = self.env.device.name();
            let reason = format!(
                "is for the device `cpu`, where recurrent policies act, but `env.device` is `{device}`"
            );
            faults.add("ppo.lstm", reason);
        }
        faults
    }

    fn review_curriculum(&self, faults: &mut Faults) {
        if self.curriculum.is_empty() {
            faults.add("curriculum", "has no stage; leave it out for one stage over all damage classes");
        }
        for (index, stage) in self.curriculum.iter().enumerate() {
            // Shares of the whole are formed, which must be numbers.
            faults.positive(&format!("curriculum[{index}].budget"), stage.budget, 1e9);
            if let ClassMix::Strata(strata) = &stage.mix
                && let Err(error) = strata.check()
            {
                faults.add(&format!("curriculum[{index}].mix"), format!("cannot be used: {error}"));
            }
        }
    }

    /// Fails with all that is out of range.
    pub fn check(&self) -> Result<(), LearnError> {
        Ok(self.faults().end()?)
    }
}
