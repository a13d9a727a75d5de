//! Everything that a training carries from one epoch to the next.
//!
//! | file of a checkpoint | holds |
//! |---|---|
//! | `session.toml` | configuration, description of the diagnoser with its standardiser, best epoch |
//! | `net.bpk`, `adam.bpk` | weights and Adam's moments |
//! | `best.bpk` | weights of the best epoch |

use std::path::Path;

use burn::module::Module;
use dappo_learn::checkpoint::{Checkpoint, Position};
use dappo_learn::error::{LearnError, Result};
use dappo_learn::files::{Files, TEXT_BYTES, write_new};
use dappo_nn::diagnoser::dropout_masks;
use dappo_nn::{DiagnoserNet, Standardizer, cpu};
use serde::{Deserialize, Serialize};

use super::BestEpoch;
use super::learner::{Learner, Minibatch, optimizer};
use crate::model::Description;
use crate::samples::{Reader, samples};
use crate::{Diagnoser, DiagnoserConfig, PairSource, Sample, Split, Subject, TrainingFolder};
use dappo_learn::records::{
    load_module, load_optimizer, read_numbers, save_module, save_optimizer, unreadable,
};

const SESSION: &str = "session.toml";
const NET: &str = "net.bpk";
const ADAM: &str = "adam.bpk";
const BEST: &str = "best.bpk";
/// Checkpoints kept, the newest first.
const KEEP: usize = 2;

/// Progress of a training.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrainingPosition {
    /// Epochs done.
    pub epoch: u64,
    /// Training steps done.
    pub steps: u64,
    /// Samples trained on.
    pub samples: u64,
}

impl Position for TrainingPosition {
    fn number(&self) -> u64 {
        self.epoch
    }
}

/// The contents of `session.toml`.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct SavedSession {
    best: Option<BestEpoch>,
    config: DiagnoserConfig,
    description: Description,
}

/// What minibatches are made from.
pub struct Data<'a> {
    config: &'a DiagnoserConfig,
    reader: Reader<'a>,
    pub description: Description,
    /// The head's targets of all classes, `[C, W]`.
    targets: Vec<f32>,
}

impl Data<'_> {
    /// Standardised inputs of samples, `[samples, T, F]`.
    pub fn inputs(&self, samples: &[Sample]) -> Result<Vec<f32>> {
        self.reader.read(samples, Some(&self.description.standardizer))
    }

    /// What one training step learns from samples; `step` is its number in the whole training.
    pub fn minibatch(&self, samples: &[Sample], step: u64) -> Result<Minibatch> {
        let width = self.description.head.outputs(&self.description.subject);
        let target = |sample: &Sample| &self.targets[sample.class * width..][..width];
        let targets = samples.iter().flat_map(target).copied().collect();
        let DiagnoserConfig { dropout, seed, ref hidden, .. } = *self.config;
        let dropout = dropout_masks(dropout, samples.len(), hidden, seed, step);
        Ok(Minibatch { inputs: self.inputs(samples)?, targets, dropout })
    }
}

/// A training between two epochs.
pub struct Session<'a> {
    pub config: &'a DiagnoserConfig,
    pub data: Data<'a>,
    pub learner: Learner,
    pub training: Vec<Sample>,
    pub validation: Vec<Sample>,
    pub position: TrainingPosition,
    /// The best epoch so far and its network.
    pub best: Option<(BestEpoch, Diagnoser)>,
}

impl<'a> Session<'a> {
    /// A training before its first epoch.
    pub fn new(config: &'a DiagnoserConfig, subject: &Subject, source: &'a dyn PairSource) -> Result<Self> {
        Self::with_standardizer(config, subject, source, None)
    }

    /// A new training with a known standardiser, or with one of the training samples.
    fn with_standardizer(
        config: &'a DiagnoserConfig,
        subject: &Subject,
        source: &'a dyn PairSource,
        standardizer: Option<Standardizer>,
    ) -> Result<Self> {
        check(config, subject, source)?;
        let split = Split::of(config, source);
        let choose = |rollouts: &[usize]| samples(rollouts, source.classes(), &config.held_out);
        let (training, validation) = (choose(&split.train), choose(&split.validation));
        let reader = Reader { source, method: config.method, timesteps: config.timesteps };
        let standardizer = standardizer.map_or_else(|| reader.standardizer(&training), Ok)?;
        let description = describe(config, subject, source, standardizer);
        description.check()?;
        Ok(Self {
            config,
            learner: Learner::new(config, description.sizes(), &cpu()),
            data: Data { config, reader, targets: config.head.targets(subject), description },
            training,
            validation,
            position: TrainingPosition::default(),
            best: None,
        })
    }

    /// The training of the newest checkpoint in `folder`.
    pub fn load(
        config: &'a DiagnoserConfig,
        subject: &Subject,
        source: &'a dyn PairSource,
        folder: &TrainingFolder,
    ) -> Result<Self> {
        let checkpoint: Checkpoint<TrainingPosition> =
            Checkpoint::newest(&folder.checkpoints(), &subject.robot)?;
        let path = checkpoint.path(SESSION);
        let SavedSession { best, config: earlier, description } = read_session(&checkpoint)?;
        check_same(&path, &earlier, config)?;
        let standardizer = description.standardizer.clone();
        let mut session = Self::with_standardizer(config, subject, source, Some(standardizer))?;
        if session.data.description != description {
            let message = "it was trained on data of another robot, other damage classes or other lengths";
            return Err(unreadable(&path, message));
        }
        session.position = checkpoint.progress;
        let numbers = Some(session.learner.net.num_params());
        let load = |net: DiagnoserNet, name: &str| {
            load_module(net, &checkpoint.path(name), read_numbers(&checkpoint, name, numbers)?)
        };
        session.learner.net = load(session.learner.net, NET)?;
        session.learner.optimizer = load_optimizer(optimizer(), &session.learner.net, &checkpoint, ADAM)?;
        if let Some(best) = best {
            check_best(&best, session.position).map_err(|message| unreadable(&path, message))?;
            let net = load(DiagnoserNet::new(&description.sizes(), 0, &cpu()), BEST)?.valid();
            session.best = Some((best, Diagnoser::new(description, net)));
        }
        folder.metrics().rewind("epoch", session.position.epoch)?;
        Ok(session)
    }

    /// Writes a checkpoint.
    pub fn save(&self, folder: &TrainingFolder) -> Result<()> {
        let robot = &self.data.description.subject.robot;
        Checkpoint::write(&folder.checkpoints(), robot, self.position, KEEP, |at| {
            let saved = SavedSession {
                best: self.best.as_ref().map(|(best, _)| *best),
                config: self.config.clone(),
                description: self.data.description.clone(),
            };
            let path = at.join(SESSION);
            let text = toml::to_string(&saved).map_err(|error| unreadable(&path, error))?;
            write_new(&path, text.as_bytes())?;
            save_module(&self.learner.net, &at.join(NET))?;
            save_optimizer(&self.learner.optimizer, &at.join(ADAM))?;
            self.best.as_ref().map_or(Ok(()), |(_, best)| save_module(best.net(), &at.join(BEST)))
        })
    }

    /// The diagnoser of the weights as they are now.
    pub fn diagnoser(&self) -> Diagnoser {
        Diagnoser::new(self.data.description.clone(), self.learner.net.valid())
    }

    /// Whether the epochs are spent or the patience is lost.
    pub fn is_finished(&self) -> bool {
        let best = self.best.as_ref().map_or(0, |(best, _)| best.epoch);
        let waited = self.position.epoch - best;
        self.position.epoch >= self.config.epochs as u64 || waited >= self.config.patience as u64
    }
}

fn check(config: &DiagnoserConfig, subject: &Subject, source: &dyn PairSource) -> Result<()> {
    config.check()?;
    subject.check()?;
    if subject.classes() != source.classes() {
        return Err(LearnError::Invalid(format!(
            "the data has {} damage classes, robot `{}` has {}",
            source.classes(),
            subject.robot,
            subject.classes()
        )));
    }
    config.check_source(source, subject)
}

fn describe(
    config: &DiagnoserConfig,
    subject: &Subject,
    source: &dyn PairSource,
    standardizer: Standardizer,
) -> Description {
    Description {
        method: config.method,
        timesteps: config.timesteps,
        obs_dim: source.obs_dim(),
        action_dim: source.action_dim(),
        head: config.head,
        embedding: config.embedding,
        lstm: config.lstm,
        hidden: config.hidden.clone(),
        held_out: config.held_out.clone(),
        twin: source.twin(),
        subject: subject.clone(),
        standardizer,
    }
}

/// Fails unless the best epoch is one of those that were done.
fn check_best(best: &BestEpoch, position: TrainingPosition) -> std::result::Result<(), String> {
    let BestEpoch { epoch, validation_loss, validation_accuracy } = *best;
    if epoch > position.epoch {
        return Err(format!("the best epoch is {epoch}, expected at most {}", position.epoch));
    }
    if !validation_loss.is_finite() || !(0.0..=1.0).contains(&validation_accuracy) {
        return Err(format!(
            "the best epoch has validation loss {validation_loss} and accuracy {validation_accuracy}, expected a \
             finite number and a share"
        ));
    }
    Ok(())
}

fn read_session<F: Files>(files: &F) -> Result<SavedSession> {
    let path = files.path(SESSION);
    let text =
        String::from_utf8(files.read(SESSION, TEXT_BYTES)?).map_err(|error| unreadable(&path, error))?;
    toml::from_str(&text).map_err(|error| unreadable(&path, error))
}

/// A training may be resumed for more epochs or with more patience, but not as another training.
fn check_same(path: &Path, earlier: &DiagnoserConfig, config: &DiagnoserConfig) -> Result<()> {
    let earlier = DiagnoserConfig { epochs: config.epochs, patience: config.patience, ..earlier.clone() };
    let table = |config: &DiagnoserConfig| {
        toml::Table::try_from(config).map_err(|error| LearnError::Invalid(error.to_string()))
    };
    let (earlier, config) = (table(&earlier)?, table(config)?);
    let show = |value: Option<&toml::Value>| value.map_or("absent".to_owned(), ToString::to_string);
    for key in earlier.keys().chain(config.keys()) {
        let (got, expected) = (earlier.get(key), config.get(key));
        if got != expected {
            let message = format!("{key} is {}, expected {}", show(got), show(expected));
            return Err(unreadable(path, message));
        }
    }
    Ok(())
}
