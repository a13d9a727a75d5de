//! The configuration of a run: typed, with the paper's defaults; unknown keys are errors.
//!
//! Sources, later ones win: defaults → the robot's own file in `configs/` or `--config` → command-line
//! flags → `--set key=value`. The resolved configuration is written into the run folder.

mod layers;

use serde::{Deserialize, Serialize};

use dappo_sim::curriculum::{ClassMix, Stage};
use dappo_sim::vector_env::Onset;
use dappo_sim::{BackendKind, Device, Precision};

use crate::error::LearnError;
use crate::ppo::PpoConfig;
use crate::simulator::Compute;

pub use layers::Layers;

/// Everything that determines a training run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// Built-in robot or path of a robot file.
    pub robot: String,
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
    /// `auto`, `cpu`, `cuda` or `warp-cpu`: where the training simulates; `auto` is a CUDA GPU where one can be used,
    /// unless `backend` or `precision` ask for what only the CPU has.
    pub device: Device,
    /// The backend on the CPU: `auto`, `lanes` or `mujoco`; `auto` is the lane engine wherever it knows everything about the robot.
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

impl EnvSection {
    /// Where and how precisely the training simulates.
    #[must_use]
    pub fn compute(&self) -> Compute {
        Compute { device: self.device, precision: self.precision }
    }
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
            max_episode_steps: None,
            njmax: None,
            nconmax: None,
        }
    }
}

/// The section `[damage]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DamageSection {
    /// Damage types; the robot's when absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub types: Option<Vec<String>>,
    /// Largest number of damaged limbs; the robot's when absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_damaged_limbs: Option<usize>,
    /// 1 is the paper's damage, values towards 0 are milder.
    pub severity: f64,
    /// When the damage strikes; (0, 0) is from the start of the episode.
    pub onset: Onset,
    /// Parameters of the damage types, for example `options.jammed_joint.range_deg`.
    #[serde(skip_serializing_if = "toml::Table::is_empty")]
    pub options: toml::Table,
}

impl Default for DamageSection {
    fn default() -> Self {
        Self {
            types: None,
            max_damaged_limbs: None,
            severity: 1.0,
            onset: Onset::default(),
            options: toml::Table::new(),
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
    /// As `env.device`. The CPU unless something else is asked for, so that results of all devices can be compared.
    pub device: Device,
    /// As `env.precision`, for the evaluation.
    pub precision: Precision,
}

impl EvaluationSection {
    /// Where and how precisely the evaluation simulates.
    #[must_use]
    pub fn compute(&self) -> Compute {
        Compute { device: self.device, precision: self.precision }
    }
}

impl Default for EvaluationSection {
    fn default() -> Self {
        Self { episodes: 4, seed: 1_000_000, device: Device::Cpu, precision: Precision::F64 }
    }
}

impl Default for Config {
    fn default() -> Self {
        Self {
            robot: String::new(),
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
    /// The configuration as TOML; reading it back gives the same configuration.
    pub fn to_toml(&self) -> Result<String, LearnError> {
        toml::to_string(self)
            .map_err(|error| LearnError::Invalid(format!("cannot write the configuration: {error}")))
    }

    /// Checks what types cannot express.
    pub fn check(&self) -> Result<(), LearnError> {
        let bad = |why: String| Err(LearnError::Invalid(why));
        if self.robot.is_empty() {
            return bad("`robot` is missing; name a built-in robot or a robot file".into());
        }
        for (name, value) in [
            ("env.num_envs", self.env.num_envs),
            ("total_steps", self.total_steps as usize),
            ("horizon", self.horizon),
            ("checkpoint.keep", self.checkpoint.keep),
            ("checkpoint.every", self.checkpoint.every as usize),
            ("evaluation.episodes", self.evaluation.episodes),
            ("env.threads", self.env.threads.unwrap_or(1)),
            ("env.njmax", self.env.njmax.unwrap_or(1)),
            ("env.nconmax", self.env.nconmax.unwrap_or(1)),
        ] {
            if value == 0 {
                return bad(format!("`{name}` is 0, expected at least 1"));
            }
        }
        if !(self.damage.severity > 0.0 && self.damage.severity <= 1.0) {
            return bad(format!(
                "`damage.severity` is {}, expected a number above 0 and at most 1",
                self.damage.severity
            ));
        }
        if self.curriculum.is_empty() {
            return bad(
                "`curriculum` has no stage; leave it out for one stage over all damage classes".into()
            );
        }
        if let Some(stage) =
            self.curriculum.iter().find(|stage| !(stage.budget.is_finite() && stage.budget > 0.0))
        {
            return bad(format!(
                "stage `{}` has budget {}, expected a positive number",
                stage.name, stage.budget
            ));
        }
        self.ppo.check()
    }
}
