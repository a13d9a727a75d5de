//! A trained diagnoser, and the folder that holds it.
//!
//! | file | holds |
//! |---|---|
//! | `diagnoser.toml` | robot, classes, method, sizes, standardiser, CRC-32 of the weights |
//! | `weights.bpk` | the weights, as a burnpack record |

use std::path::Path;

use burn::module::Module;
use burn::tensor::{Tensor, TensorData};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::head::{Head, best, probabilities};
use super::{Method, Standardizer, Subject, Twin, Window};
use crate::cpu;
use crate::error::{LearnError, Result};
use crate::files::{
    TEXT_BYTES, TemporaryFolder, check_names, io, own_folder, read_regular, read_text, replace_folder,
    write_new,
};
use crate::nn::diagnoser::{DiagnoserNet, DiagnoserSizes};
use crate::nn::read;
use crate::records::{load_module, module_bytes, read_numbers, unreadable};

const FORMAT: &str = "dappo-batch diagnoser 2";
const HEADER: &str = "diagnoser.toml";
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
    /// What it puts out.
    pub head: Head,
    /// Width of the embedding.
    pub embedding: usize,
    /// Width of the LSTM's hidden state.
    pub lstm: usize,
    /// Widths of the dense layers.
    pub hidden: Vec<usize>,
    /// Damage classes that it was not trained on.
    pub held_out: Vec<usize>,
    /// How the twins of its windows were led.
    pub twin: Twin,
    /// The robot and its classes.
    pub subject: Subject,
    /// What its inputs are standardised with.
    pub standardizer: Standardizer,
}

/// The contents of `diagnoser.toml`.
#[derive(Debug, Serialize, Deserialize)]
struct Header {
    format: String,
    /// Of the file of the weights, in hexadecimal.
    weights_crc32: String,
    description: Description,
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
        self.standardizer.check(self.input_dim())
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
        own_folder(folder)?;
        if let Err(foreign) = check_names(folder, |name| [HEADER, WEIGHTS].contains(&name)) {
            let message =
                "it is none of a diagnoser's files, and would go with the earlier one; move it away";
            return Err(unreadable(&foreign, message));
        }
        let new = TemporaryFolder::create(folder)?;
        let bytes = module_bytes(&self.net, &folder.join(WEIGHTS))?;
        let header = Header {
            format: FORMAT.into(),
            weights_crc32: checksum(&bytes),
            description: self.description.clone(),
        };
        let text = toml::to_string(&header).map_err(|error| unreadable(&folder.join(HEADER), error))?;
        write_new(&new.path().join(WEIGHTS), &bytes)?;
        write_new(&new.path().join(HEADER), text.as_bytes())?;
        replace_folder(new, folder)
    }

    /// CRC-32 of the header in a folder, which holds the CRC-32 of the weights: equal for equal diagnosers.
    pub fn fingerprint(folder: &Path) -> Result<String> {
        let path = folder.join(HEADER);
        read_regular(&path, TEXT_BYTES).map(|bytes| checksum(&bytes)).map_err(io(&path))
    }

    /// Reads a diagnoser from a folder that [`Diagnoser::save`] wrote.
    pub fn load(folder: &Path) -> Result<Self> {
        let path = folder.join(HEADER);
        let text = read_text(&path).map_err(|error| {
            unreadable(&path, format!("it cannot be read ({error}); this is no folder of a diagnoser"))
        })?;
        let foreign =
            |error: toml::de::Error| unreadable(&path, format!("it is broken or foreign ({error})"));
        let table: toml::Table = toml::from_str(&text).map_err(foreign)?;
        let format = table.get("format").and_then(toml::Value::as_str).unwrap_or("missing");
        if format != FORMAT {
            return Err(unreadable(&path, format!("its format is `{format}`, expected `{FORMAT}`")));
        }
        let Header { weights_crc32, description, .. } = toml::from_str(&text).map_err(foreign)?;
        description.check().map_err(|error| unreadable(&path, error))?;
        check_names(folder, |name| [HEADER, WEIGHTS].contains(&name))
            .map_err(|path| unreadable(&path, "it is no file of a diagnoser; remove it"))?;
        let path = folder.join(WEIGHTS);
        let bytes = read_numbers(folder, WEIGHTS, description.sizes().numbers())?;
        let found = checksum(&bytes);
        if found != weights_crc32 {
            let message = format!(
                "its CRC-32 is {found}, expected {weights_crc32}; the file is broken or of another diagnoser"
            );
            return Err(unreadable(&path, message));
        }
        // Any weights do, as the record replaces them.
        let net = DiagnoserNet::new(&description.sizes(), 0, &cpu());
        Ok(Self::new(description, load_module(net, &path, bytes)?.valid()))
    }
}

fn checksum(bytes: &[u8]) -> String {
    format!("{:08x}", crc32fast::hash(bytes))
}
