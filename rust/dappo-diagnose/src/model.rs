//! A trained diagnoser, and the folder that holds it.
//!
//! | file | holds |
//! |---|---|
//! | `diagnoser.toml` | robot, classes, method, sizes, standardiser, CRC-32 of the weights |
//! | `weights.bpk` | the weights, as a burnpack record |

use std::path::Path;

use burn::module::Module;
use burn::tensor::{Tensor, TensorData};
use dappo_learn::{
    error::{FileKind, LearnError, Result},
    files::{
        Files,
        sealed::{Checksum, Manifest, Seal, SealedFolder, UnsealedFolder},
        write_new,
    },
    records::{load_module, read_numbers, unreadable},
};
use dappo_nn::diagnoser::{DiagnoserNet, DiagnoserSizes};
use dappo_nn::records::module_bytes;
use dappo_nn::{Standardizer, cpu, read};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::head::{Head, best, probabilities};
use super::{Method, Subject, Twin, Window};

const WEIGHTS: &str = "weights.bpk";
/// The widest layer and the longest window: products of a few such numbers can be counted.
const MOST: usize = 1 << 24;
/// Windows that go through the network at once.
const BATCH: usize = 256;

/// Everything about a diagnoser but its weights.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Description {
    /// What the network sees at every time step.
    pub method: Method,
    /// Time steps of its input, T.
    pub timesteps: usize,
    /// Length of an observation, O.
    pub obs_dim: usize,
    /// Length of an action, A.
    pub action_dim: usize,
    /// What it outputs.
    pub head: Head,
    /// Width of the embedding.
    pub embedding: usize,
    /// Width of the LSTM's hidden state.
    pub lstm: usize,
    /// Widths of the dense layers.
    pub hidden: Vec<usize>,
    /// Damage classes that it was not trained on.
    pub held_out: Vec<usize>,
    /// Mode of the twins of its windows; nothing for a diagnoser of the observation alone.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub twin: Option<Twin>,
    /// The robot and its classes.
    pub subject: Subject,
    /// What its inputs are standardised with.
    pub standardizer: Standardizer,
}

/// The contents of `diagnoser.toml`.
#[derive(Debug, Serialize, Deserialize)]
struct DiagnoserManifest {
    format: String,
    /// Of the file of the weights.
    #[serde(with = "hexadecimal")]
    weights_crc32: u32,
    description: Description,
}

/// A CRC-32 as text: TOML's integers in hexadecimal cannot keep its leading zeros.
mod hexadecimal {
    use serde::de::Error;
    use serde::{Deserialize, Deserializer, Serializer};

    #[expect(clippy::trivially_copy_pass_by_ref, reason = "serde hands fields over by reference")]
    pub fn serialize<S: Serializer>(number: &u32, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(&format_args!("{number:08x}"))
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u32, D::Error> {
        let text = String::deserialize(deserializer)?;
        u32::from_str_radix(&text, 16)
            .map_err(|_| D::Error::custom(format!("a CRC-32 is `{text}`, expected 8 hexadecimal digits")))
    }
}

impl Manifest for DiagnoserManifest {
    const NAME: &'static str = "diagnoser.toml";
    const IS_TOML: bool = true;
    const FORMAT: &'static str = "dappo-batch diagnoser 2";
    const KIND: &'static str = "a diagnoser";
    const FILES: FileKind = FileKind::Checkpoint;
    const ADVICE: &'static str = "train the diagnoser again";
    const UNLISTED: &'static [&'static str] = &[WEIGHTS];

    fn seals(&self) -> Vec<(String, Seal)> {
        vec![(WEIGHTS.into(), Seal { bytes: None, checksum: Checksum::Crc32(self.weights_crc32) })]
    }
}

impl Description {
    /// Numbers of one time step of the input, F.
    #[must_use]
    pub fn input_dim(&self) -> usize {
        self.method.input_dim(self.obs_dim, self.action_dim)
    }

    /// Widths of the network.
    #[must_use]
    pub fn sizes(&self) -> DiagnoserSizes {
        DiagnoserSizes {
            inputs: self.input_dim(),
            embedding: self.embedding,
            lstm: self.lstm,
            hidden: self.hidden.clone(),
            outputs: self.head.outputs(&self.subject),
        }
    }

    pub(crate) fn check(&self) -> Result<()> {
        self.subject.check()?;
        let hidden = self.hidden.iter().map(|width| ("hidden", *width));
        for (key, width) in [
            ("timesteps", self.timesteps),
            ("obs_dim", self.obs_dim),
            ("action_dim", self.action_dim),
            ("embedding", self.embedding),
            ("lstm", self.lstm),
        ]
        .into_iter()
        .chain(hidden)
        {
            if !(1..=MOST).contains(&width) {
                return Err(LearnError::Config { key, got: width.to_string(), expected: "1 to 2^24" });
            }
        }
        Ok(self.standardizer.check(self.input_dim())?)
    }
}

/// A trained diagnoser.
#[derive(Debug, Clone)]
pub struct Diagnoser {
    description: Description,
    net: DiagnoserNet,
    /// The head's targets of all classes, `[C, W]`.
    targets: Vec<f32>,
}

impl Diagnoser {
    pub(crate) fn new(description: Description, net: DiagnoserNet) -> Self {
        let targets = description.head.targets(&description.subject);
        Self { description, net, targets }
    }

    /// Everything but the weights.
    #[must_use]
    pub fn description(&self) -> &Description {
        &self.description
    }

    pub(crate) fn net(&self) -> &DiagnoserNet {
        &self.net
    }

    /// How probable every class is, given raw inputs as [`Method::write`] lays them out.
    ///
    /// # Shapes
    /// inputs `[N, T, F]`; returns `[N, C]`, rows sum to 1
    pub fn probabilities(&self, inputs: &[f32]) -> Result<Vec<f32>> {
        let window = self.description.timesteps * self.description.input_dim();
        if !inputs.len().is_multiple_of(window) {
            let (got, steps) = (inputs.len(), self.description.timesteps);
            return Err(LearnError::Invalid(format!(
                "inputs [N, T, F] have {got} elements, expected a multiple of {window} for {steps} time steps"
            )));
        }
        let mut all = Vec::with_capacity(inputs.len() / window * self.description.subject.classes());
        for raw in inputs.chunks(BATCH * window) {
            let mut inputs = raw.to_vec();
            inputs.par_chunks_mut(window).for_each(|rows| self.description.standardizer.apply(rows));
            all.extend(probabilities(&self.scores(inputs)?, self.description.subject.classes()));
        }
        Ok(all)
    }

    /// How probable every class is, `[C]`.
    pub fn probabilities_of(&self, window: &Window) -> Result<Vec<f32>> {
        let Description { method, timesteps, obs_dim, action_dim, .. } = self.description;
        let mut inputs = vec![0.0; timesteps * self.description.input_dim()];
        method.write(window, obs_dim, action_dim, &mut inputs)?;
        self.probabilities(&inputs)
    }

    /// The most probable class of a window, and its probability.
    pub fn diagnose(&self, window: &Window) -> Result<(usize, f32)> {
        let probabilities = self.probabilities_of(window)?;
        let class = best(&probabilities);
        Ok((class, probabilities[class]))
    }

    /// The logarithm of every class's probability, given standardised inputs.
    ///
    /// # Shapes
    /// inputs `[N, T, F]`; returns `[N, C]`
    pub(super) fn scores(&self, inputs: Vec<f32>) -> Result<Vec<f64>> {
        let Description { timesteps, head, ref subject, .. } = self.description;
        let input_dim = self.description.input_dim();
        let windows = inputs.len() / (timesteps * input_dim);
        let data = TensorData::new(inputs, [windows, timesteps, input_dim]);
        let outputs = read(self.net.forward(Tensor::from_data(data, &cpu()), &[]))?;
        Ok(head.scores(&outputs, &self.targets, subject))
    }

    /// Writes the diagnoser as a folder, in place of an earlier one.
    pub fn save(&self, folder: &Path) -> Result<()> {
        let new = UnsealedFolder::create(folder)?;
        let path = new.path().join(WEIGHTS);
        let bytes = module_bytes(&self.net)?;
        write_new(&path, &bytes)?;
        new.seal(&DiagnoserManifest {
            format: DiagnoserManifest::FORMAT.into(),
            weights_crc32: crc32fast::hash(&bytes),
            description: self.description.clone(),
        })?;
        new.commit()
    }

    /// CRC-32 of the description in a folder, which holds the CRC-32 of the weights: equal for equal diagnosers.
    pub fn fingerprint(folder: &Path) -> Result<String> {
        SealedFolder::<DiagnoserManifest>::open(folder).map(|sealed| sealed.fingerprint())
    }

    /// Reads a diagnoser from a folder that [`Diagnoser::save`] wrote.
    pub fn load(folder: &Path) -> Result<Self> {
        let sealed = SealedFolder::<DiagnoserManifest>::open(folder)?;
        let description = sealed.manifest().description.clone();
        description.check().map_err(|error| unreadable(&sealed.manifest_path(), error))?;
        let bytes = read_numbers(&sealed, WEIGHTS, description.sizes().parameter_count())?;
        // Any weights do, as the record replaces them.
        let net = DiagnoserNet::new(&description.sizes(), 0, &cpu());
        Ok(Self::new(description, load_module(net, &sealed.path(WEIGHTS), bytes)?.valid()))
    }
}
