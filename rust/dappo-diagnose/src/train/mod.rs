//! Training a diagnoser: epochs over shuffled samples, validation, early stopping — and what surrounds them.

mod epoch;
mod learner;
mod session;

use dappo_learn::checkpoint::Checkpoint;
use dappo_learn::error::Result;
use serde::{Deserialize, Serialize};

use super::{Diagnoser, DiagnoserConfig, LockedTraining, PairSource, Subject};
use session::Session;

/// The metrics of one epoch, one JSON object a line in `metrics.jsonl`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct EpochMetrics {
    /// Number of the epoch, from 1.
    pub epoch: u64,
    /// Mean loss of the training samples, each before the step that it took part in, with dropout.
    pub train_loss: f64,
    /// Mean loss of the validation samples after the epoch.
    pub validation_loss: f64,
    /// Share of the validation samples whose class was diagnosed correctly.
    pub validation_accuracy: f64,
    /// Learning rate of the epoch's last step.
    pub learning_rate: f64,
    /// Samples trained on so far.
    pub samples: u64,
    /// Time spent on the epoch's training steps, s.
    pub seconds: f64,
    /// Samples trained on in this epoch, per second.
    pub samples_per_second: f64,
}

/// How far an epoch is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EpochProgress {
    /// Number of the epoch, from 1.
    pub epoch: u64,
    /// Epochs at most.
    pub epochs: u64,
    /// Samples of this epoch trained on so far.
    pub samples: u64,
    /// Samples of an epoch.
    pub samples_per_epoch: u64,
    /// Samples trained on per second, since the epoch began.
    pub samples_per_second: f64,
    /// Mean loss since the epoch began.
    pub train_loss: f64,
}

/// Observer of a training.
pub trait Observer {
    /// Called several times an epoch.
    fn progress(&mut self, progress: &EpochProgress);

    /// Called after every epoch.
    fn epoch(&mut self, metrics: &EpochMetrics);

    /// Whether to stop now. What was learned since the last epoch ended is dropped.
    fn should_stop(&self) -> bool;
}

/// The epoch whose weights are kept.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BestEpoch {
    /// Its number.
    pub epoch: u64,
    /// Its validation loss.
    pub validation_loss: f64,
    /// Its validation accuracy.
    pub validation_accuracy: f64,
}

/// How a training ended.
#[derive(Debug, Clone)]
pub struct DiagnoserOutcome {
    /// The diagnoser of the best epoch, if one was finished; it is also in the folder.
    pub best: Option<(BestEpoch, Diagnoser)>,
    /// Epochs done.
    pub epochs: u64,
    /// Whether the observer stopped it before its end.
    pub interrupted: bool,
}

/// Trains until the epochs are spent or the patience is lost, from the newest checkpoint when `resume` is
/// set. A training that was stopped before its first checkpoint starts again.
pub fn train(
    config: &DiagnoserConfig,
    subject: &Subject,
    source: &dyn PairSource,
    folder: &LockedTraining,
    resume: bool,
    observer: &mut dyn Observer,
) -> Result<DiagnoserOutcome> {
    let mut session = if resume && Checkpoint::any(&folder.checkpoints())? {
        Session::load(config, subject, source, folder)?
    } else {
        folder.metrics().rewind("epoch", 0)?;
        Session::new(config, subject, source)?
    };
    let mut interrupted = false;
    while !session.is_finished() {
        let Some(metrics) = session.run_epoch(observer)? else {
            interrupted = true;
            break;
        };
        folder.metrics().append(&metrics)?;
        session.save(folder)?;
        observer.epoch(&metrics);
    }
    if let Some((_, diagnoser)) = &session.best {
        diagnoser.save(&folder.model())?;
    }
    Ok(DiagnoserOutcome { epochs: session.position.epoch, best: session.best, interrupted })
}
