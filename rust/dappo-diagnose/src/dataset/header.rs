//! `dataset.json`: what the records of a folder are.

use dappo_sim::Severity;
use std::path::Path;

use dappo_learn::RunPolicy;
use dappo_learn::error::{FileKind, LearnError, Result};
use dappo_learn::files::{read_text, write_first};
use serde::{Deserialize, Serialize};

use super::npy::Field;
use crate::{Protocol, Subject, Timing, Twin};

const FORMAT: &str = "dappo-batch pairs 1";
const FILE: &str = "dataset.json";
/// The largest record, bytes: far above those of any robot.
const LARGEST_RECORD: u64 = 1 << 32;

/// Which policy it was.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PolicyId {
    /// Its run folder, or the name of a policy of another learner.
    pub run: String,
    /// CRC-32 of its checkpoint's manifest, which lists the CRC-32 of every file, or that name again.
    pub fingerprint: String,
    /// Env steps that it was trained for; 0 if they are unknown.
    pub env_steps: u64,
}

impl PolicyId {
    /// That of the policy of a run.
    #[must_use]
    pub fn of(policy: &RunPolicy) -> Self {
        let RunPolicy { run, fingerprint, env_steps, .. } = policy;
        Self { run: run.clone(), fingerprint: fingerprint.clone(), env_steps: *env_steps }
    }
}

/// Everything that determines the records, except for how many there are.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DatasetHeader {
    /// Name and version of the format.
    pub format: String,
    /// The robot and its damage classes.
    pub subject: Subject,
    /// Severity of the damage.
    pub severity: Severity,
    /// Seed of the rollouts.
    pub seed: u64,
    /// Steps in a window, T.
    pub timesteps: usize,
    /// Length of an observation, O.
    pub obs_dim: usize,
    /// Length of an action, A.
    pub action_dim: usize,
    /// When the damage strikes, and when the window begins.
    pub timing: Timing,
    /// Mode of the twin; nothing for records without one.
    pub twin: Option<Twin>,
    /// The policy of both robots in the window.
    pub expert: PolicyId,
    /// The policy of the robot before the window.
    #[serde(alias = "walker")]
    pub policy: PolicyId,
    /// Backend of the physics.
    pub backend: String,
    /// Its floating-point format.
    pub precision: String,
}

impl DatasetHeader {
    /// The name and version that this program writes.
    #[must_use]
    pub fn format() -> String {
        FORMAT.into()
    }

    /// Onset of the damage and mode of the twin.
    #[must_use]
    pub fn protocol(&self) -> Protocol {
        Protocol { timing: self.timing, twin: self.twin }
    }

    /// Whether a folder has a header.
    #[must_use]
    pub fn exists(folder: &Path) -> bool {
        folder.join(FILE).exists()
    }

    /// Reads the header of a folder.
    pub fn read(folder: &Path) -> Result<Self> {
        let path = folder.join(FILE);
        let bad = |message: String| FileKind::Dataset.unusable(&path, message);
        let text = read_text(&path).map_err(|error| {
            bad(format!("it cannot be read ({error}); `dappo-batch diagnose collect` makes such a folder"))
        })?;
        let header: Self = serde_json::from_str(&text)
            .map_err(|error| bad(format!("it is truncated or foreign ({error})")))?;
        if header.format != FORMAT {
            return Err(bad(format!("its format is `{}`, expected `{FORMAT}`", header.format)));
        }
        header.check().map_err(bad)?;
        Ok(header)
    }

    /// Fails unless there can be records of these sizes.
    fn check(&self) -> std::result::Result<(), String> {
        self.subject.check().map_err(|error| error.to_string())?;
        self.timing.check().map_err(|error| error.to_string())?;
        let sizes =
            [("timesteps", self.timesteps), ("obs_dim", self.obs_dim), ("action_dim", self.action_dim)];
        if let Some((name, _)) = sizes.iter().find(|(_, size)| *size == 0) {
            return Err(format!("{name} is 0, expected at least 1"));
        }
        // At most two observations and an action a step of 4 bytes each, and some bytes for the rest.
        let [steps, obs, action] = sizes.map(|(_, size)| size as u64);
        let numbers = obs.checked_mul(2).and_then(|numbers| numbers.checked_add(action));
        let bytes = numbers.and_then(|numbers| numbers.checked_mul(steps)?.checked_add(16)?.checked_mul(4));
        let record = bytes.and_then(|bytes| bytes.checked_mul(self.subject.classes() as u64));
        if record.is_some_and(|bytes| bytes <= LARGEST_RECORD) {
            return Ok(());
        }
        Err(format!(
            "a record of {} classes, {steps} steps, observations of {obs} and actions of {action} numbers has more \
             than {LARGEST_RECORD} bytes; record fewer steps",
            self.subject.classes()
        ))
    }

    /// Writes the header into a folder that has none; fails if the folder holds records of another kind.
    pub(crate) fn write_or_match(&self, folder: &Path) -> Result<()> {
        let path = folder.join(FILE);
        self.check().map_err(|message| FileKind::Dataset.unusable(&path, message))?;
        if !path.exists() {
            write_first(&path, self.to_json()?.as_bytes())?;
        }
        // Another piece that began at the same moment may have been faster.
        let there = Self::read(folder)?;
        let (one, other) = (self.entries()?, there.entries()?);
        match one.iter().find(|(key, value)| other.get(*key) != Some(value)) {
            None => Ok(()),
            Some((key, wanted)) => Err(FileKind::Dataset.unusable(
                path,
                format!(
                    "the folder holds records with `{key}` = {}, this command needs {wanted}; choose another folder",
                    other.get(key).unwrap_or(&serde_json::Value::Null),
                ),
            )),
        }
    }

    fn to_json(&self) -> Result<String> {
        serde_json::to_string_pretty(self).map_err(|error| LearnError::Invalid(error.to_string()))
    }

    /// All that determines the records: a policy is the same wherever its run folder is.
    fn entries(&self) -> Result<serde_json::Map<String, serde_json::Value>> {
        let mut header = self.clone();
        header.expert.run.clear();
        header.policy.run.clear();
        match serde_json::to_value(&header) {
            Ok(serde_json::Value::Object(entries)) => Ok(entries),
            other => Err(LearnError::Invalid(format!("cannot write the header: {other:?}"))),
        }
    }

    /// The fields of a record, in order.
    pub(super) fn fields(&self) -> Vec<Field> {
        let (classes, steps) = (self.subject.classes(), self.timesteps);
        let mut fields = vec![
            Field::f32("damaged", &[classes, steps, self.obs_dim]),
            Field::f32("actions", &[classes, steps, self.action_dim]),
        ];
        if self.protocol().needs_twins() {
            fields.push(Field::f32("twin", &[classes, steps, self.obs_dim]));
        }
        fields.extend([Field::u32("onset", &[]), Field::u32("delay", &[]), Field::u32("fallen", &[classes])]);
        fields
    }

    /// Bytes of a record.
    #[must_use]
    pub(crate) fn record_bytes(&self) -> u64 {
        self.fields().iter().map(|field| field.bytes() as u64).sum()
    }
}
