//! `export.json`: what an export folder is, for programs in any language.

use std::collections::BTreeMap;
use std::path::Path;

use dappo_learn::RunPolicy;
use dappo_learn::error::{FileKind, LearnError, Result};
use dappo_learn::files::sealed::{Checksum, Manifest, Seal};
use dappo_learn::run_folder::RunFolder;
use dappo_nn::Standardizer;
use dappo_sim::task::{ActuatorParts, Anatomy, Entry, ObservationTerm};
use serde::{Deserialize, Serialize};

use crate::controller::ControllerConfig;
use crate::{Description, Head, Method, Subject, Twin, TwinAction};

/// The contents of `export.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ExportHeader {
    /// Name and version of the format.
    pub format: String,
    /// Version of the program that wrote it.
    pub version: String,
    /// Name of the robot.
    pub robot: String,
    /// Time from one action to the next, s.
    pub control_period: f64,
    /// Length of an observation, without damage code, O.
    pub obs_dim: usize,
    /// Length of an action, A.
    pub action_dim: usize,
    /// What each entry of an observation is, `[O]`; absent from exports of earlier versions.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub observation: Vec<Entry>,
    /// The joints that the actions move, `[A]`; absent if actuators move something else, and from exports of earlier
    /// versions.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub joints: Vec<JointHeader>,
    /// The damage classes; the index is the class, 0 is the healthy robot.
    pub classes: Vec<ClassHeader>,
    /// When damage is suspected and which diagnoses are accepted; nothing for a policy alone.
    pub controller: Option<ControllerConfig>,
    /// The policy.
    pub policy: PolicyHeader,
    /// The policy that acts during a diagnosis window; the policy itself with the code of no damage, for none.
    pub expert: Option<PolicyHeader>,
    /// The diagnoser; nothing for a policy alone.
    pub diagnoser: Option<DiagnoserHeader>,
    /// How to simulate the robot, and how to run its twin.
    pub twin: TwinHeader,
    /// What the parts were made from.
    pub sources: Sources,
    /// Every other file of the folder.
    pub files: BTreeMap<String, FileHeader>,
}

/// A damage class.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ClassHeader {
    /// Its name.
    pub name: String,
    /// Its damage code, zeros and ones.
    pub code: Vec<u8>,
    /// Forward velocity of the policy with the true code, m/s; a policy alone may not have been evaluated.
    pub baseline: Option<f64>,
}

/// A policy: an observation, followed by a damage code, in; actions out.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PolicyHeader {
    /// Its file in ONNX.
    pub onnx: String,
    /// Its file of tensors.
    pub tensors: String,
    /// Units of the LSTM of a recurrent policy, whose hidden state is behind the input of the layers.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lstm: Option<usize>,
    /// Widths, inputs to outputs; tanh between the layers.
    pub layers: Vec<usize>,
    /// Length of the damage code at the end of its input; 0 if it observes no damage.
    pub code_length: usize,
    /// What the entries of the damage code are multiplied by.
    pub code_scale: f32,
    /// Bound of the standardised entries before the code.
    pub clip: f32,
}

/// A diagnoser: a window of raw inputs in, the probability of every damage class out.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DiagnoserHeader {
    /// Its file in ONNX.
    pub onnx: String,
    /// Its file of tensors.
    pub tensors: String,
    /// What it sees, as a letter.
    pub method: Method,
    /// The same block by block, in the order of the inputs of a step: `damaged`, `twin - damaged`, `action`.
    pub inputs: Vec<String>,
    /// Steps of a window, T.
    pub timesteps: usize,
    /// What the network outputs.
    pub head: Head,
    /// Width of the embedding.
    pub embedding: usize,
    /// Width of the LSTM's hidden state.
    pub lstm: usize,
    /// Widths of the dense layers.
    pub hidden: Vec<usize>,
    /// Damage classes that it was not trained on.
    pub held_out: Vec<usize>,
    /// Bound of the standardised inputs.
    pub clip: f32,
}

/// How to simulate the twin of the robot.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TwinHeader {
    /// File of the healthy robot, as MJCF.
    pub mjcf: String,
    /// Version of MuJoCo that the robot was trained in.
    pub mujoco: String,
    /// Integrator, as MuJoCo calls it; it overrides that of the MJCF.
    pub integrator: String,
    /// Physics steps a control step.
    pub frame_skip: usize,
    /// ctrl = `action_scale` · clip(action, ±1), where this holds for all actuators alike.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub action_scale: Option<f64>,
    /// Controls of the actuators, in the order of the actions, where there is no `action_scale`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub actuators: Vec<ActuatorHeader>,
    /// Blocks of an observation, in order.
    pub observation: Vec<ObservationTerm>,
    /// Touch sensor of every limb in the MJCF, for the block `touch`; empty without such sensors.
    pub touch_sensors: Vec<String>,
    /// Body whose way along x in a control step, divided by the control period, is the forward velocity.
    pub forward_velocity: String,
    /// Whose actions the twin takes during a diagnosis window; nothing for a policy alone and for a diagnoser without a
    /// twin, as in the following entries.
    pub action: Option<TwinAction>,
    /// Steps of a diagnosis window after which the twin is re-synchronised; 0 = only at the start.
    pub resync: Option<u32>,
    /// What the difference between two observations is multiplied by to form the residual, 0 for entries that do not
    /// take part, `[O]`.
    pub residual_scale: Option<Vec<f32>>,
}

/// A joint that an action moves.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct JointHeader {
    /// Name of the joint.
    pub name: String,
    /// Name of its actuator.
    pub actuator: String,
    /// Position in the default pose, rad, which the term `joint_pos` is relative to.
    pub default: f64,
}

impl JointHeader {
    /// The joints of a robot in the order of the actions; none if an actuator moves something else.
    pub(super) fn of(anatomy: &Anatomy) -> Vec<Self> {
        let joint = |ActuatorParts { name: actuator, joint, .. }: &ActuatorParts| {
            let joint = joint.as_ref()?;
            let default = *anatomy.start.get(joint.qpos)?;
            Some(Self { name: joint.name.clone(), actuator: actuator.clone(), default })
        };
        anatomy.actuators.iter().map(joint).collect::<Option<_>>().unwrap_or_default()
    }
}

/// ctrl = `offset` + `scale` · clip(action, ±1).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ActuatorHeader {
    /// Name of the actuator.
    pub name: String,
    /// Control at an action of 0.
    pub offset: f64,
    /// Change of the control by an action of 1.
    pub scale: f64,
}

impl From<(&str, f64, f64)> for ActuatorHeader {
    fn from((name, offset, scale): (&str, f64, f64)) -> Self {
        Self { name: name.to_owned(), offset, scale }
    }
}

/// Where the parts come from.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sources {
    /// Of the policy.
    pub policy: RunSource,
    /// Of the expert, if it has a run of its own.
    pub expert: Option<RunSource>,
    /// Of the diagnoser, if there is one.
    pub diagnoser: Option<DiagnoserSource>,
}

/// A training run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RunSource {
    /// Name of the run folder.
    pub run: String,
    /// Version of the program that began it.
    pub version: String,
    /// Env steps that the policy was trained for.
    pub env_steps: u64,
    /// CRC-32 of the checkpoint's manifest, which lists the CRC-32 of every file.
    pub fingerprint: String,
}

impl RunSource {
    /// The source of the policy of a run.
    pub fn of(folder: &RunFolder, policy: &RunPolicy) -> Result<Self> {
        let RunPolicy { env_steps, fingerprint, .. } = policy;
        Ok(Self {
            run: last_name(folder.root()),
            version: folder.version()?,
            env_steps: *env_steps,
            fingerprint: fingerprint.clone(),
        })
    }
}

/// The training of a diagnoser.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DiagnoserSource {
    /// Name of its folder.
    pub folder: String,
    /// CRC-32 of its header, which holds the CRC-32 of the weights.
    pub fingerprint: String,
}

/// A file of the folder.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FileHeader {
    /// Its length.
    pub bytes: u64,
    /// Its SHA-256 in hexadecimal.
    pub sha256: String,
}

impl Manifest for ExportHeader {
    const NAME: &'static str = "export.json";
    const FORMAT: &'static str = "dappo-batch export 1";
    const KIND: &'static str = "an export";
    const FILES: FileKind = FileKind::Export;
    const ADVICE: &'static str = "export again";

    fn seals(&self) -> Vec<(String, Seal)> {
        let seal = |file: &FileHeader| Seal {
            bytes: Some(file.bytes),
            checksum: Checksum::Sha256(file.sha256.clone()),
        };
        self.files.iter().map(|(name, file)| (name.clone(), seal(file))).collect()
    }
}

impl ExportHeader {
    /// Names of the damage classes.
    #[must_use]
    pub fn class_names(&self) -> Vec<String> {
        self.classes.iter().map(|class| class.name.clone()).collect()
    }

    /// In words: what is exported, and its files.
    #[must_use]
    pub fn text(&self) -> String {
        let what = match &self.diagnoser {
            Some(diagnoser) if self.twin.action.is_none() => {
                format!("the last {} observations without a twin", diagnoser.timesteps)
            }
            Some(diagnoser) => format!("a window of {} steps", diagnoser.timesteps),
            None => "a policy without a diagnoser".to_owned(),
        };
        let (robot, classes, period) = (&self.robot, self.classes.len(), self.control_period);
        let files = self.files.iter().map(|(name, file)| format!("  {name:<24} {:>10} bytes\n", file.bytes));
        format!("{robot}: {classes} damage classes, {what}, control period {period} s\n")
            + &files.collect::<String>()
    }

    /// A diagnoser without its weights.
    pub(super) fn description(
        &self,
        diagnoser: &DiagnoserHeader,
        standardizer: Standardizer,
    ) -> Result<Description> {
        let missing = |what: &str| {
            LearnError::Invalid(format!("the header does not contain the mode of the twin: `{what}`"))
        };
        let twin = match (self.twin.action, self.twin.resync) {
            (Some(action), Some(resync)) => Some(Twin { action, resync }),
            (None, None) if diagnoser.method == Method::A => None,
            (None, _) => return Err(missing("action")),
            (_, None) => return Err(missing("resync")),
        };
        Ok(Description {
            method: diagnoser.method,
            timesteps: diagnoser.timesteps,
            obs_dim: self.obs_dim,
            action_dim: self.action_dim,
            head: diagnoser.head,
            embedding: diagnoser.embedding,
            lstm: diagnoser.lstm,
            hidden: diagnoser.hidden.clone(),
            held_out: diagnoser.held_out.clone(),
            twin,
            subject: Subject {
                robot: self.robot.clone(),
                class_names: self.class_names(),
                codes: self.classes.iter().map(|class| class.code.clone()).collect(),
            },
            standardizer,
        })
    }
}

/// The name of a folder without those above it, which mean nothing on another machine.
pub(crate) fn last_name(folder: &Path) -> String {
    folder.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// The blocks of a diagnoser's input, in order.
pub(super) fn input_blocks(method: Method) -> Vec<String> {
    let blocks: &[&str] = match method {
        Method::A => &["damaged"],
        Method::B => &["twin - damaged"],
        Method::C => &["damaged", "twin - damaged"],
        Method::D => &["damaged", "twin - damaged", "action"],
    };
    blocks.iter().map(|block| (*block).to_owned()).collect()
}

#[cfg(test)]
mod tests {
    use serde_json::{Value, json};

    use super::*;

    fn header(diagnoser: &Value, action: &Value) -> ExportHeader {
        let file = |bytes: u64| json!({"bytes": bytes, "sha256": "0"});
        let class = |name: &str| json!({"name": name, "code": [0], "baseline": null});
        let header = json!({
            "format": ExportHeader::FORMAT,
            "version": "1.0",
            "robot": "ant",
            "control_period": 0.05,
            "obs_dim": 2,
            "action_dim": 1,
            "classes": [class("healthy"), class("jammed@0")],
            "controller": null,
            "policy": {
                "onnx": "policy.onnx", "tensors": "policy.safetensors", "layers": [3, 1], "code_length": 1,
                "code_scale": 1.0, "clip": 5.0,
            },
            "expert": null,
            "diagnoser": diagnoser,
            "twin": {
                "mjcf": "robot.xml", "mujoco": "3.0", "integrator": "RK4", "frame_skip": 5, "action_scale": 1.0,
                "observation": [], "touch_sensors": [], "forward_velocity": "torso", "action": action, "resync": 0,
                "residual_scale": null,
            },
            "sources": {
                "policy": {"run": "run", "version": "1.0", "env_steps": 1, "fingerprint": "0"},
                "expert": null,
                "diagnoser": null,
            },
            "files": {"robot.xml": file(12345), "policy.safetensors": file(7)},
        });
        serde_json::from_value(header).unwrap()
    }

    #[test]
    fn a_header_shows_what_it_exports_and_the_sizes_of_its_files() {
        let diagnoser = json!({
            "onnx": "diagnoser.onnx", "tensors": "diagnoser.safetensors", "method": "B",
            "inputs": ["twin - damaged"], "timesteps": 50, "head": "classes", "embedding": 1, "lstm": 1,
            "hidden": [], "held_out": [], "clip": 5.0,
        });
        let files =
            "  policy.safetensors                7 bytes\n  robot.xml                     12345 bytes\n";
        for (diagnoser, action, what) in [
            (&diagnoser, json!("own"), "a window of 50 steps"),
            (&diagnoser, Value::Null, "the last 50 observations without a twin"),
            (&Value::Null, Value::Null, "a policy without a diagnoser"),
        ] {
            let expected = format!("ant: 2 damage classes, {what}, control period 0.05 s\n{files}");
            assert_eq!(header(diagnoser, &action).text(), expected);
        }
    }
}
