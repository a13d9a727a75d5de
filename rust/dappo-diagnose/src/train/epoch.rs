//! One pass over the training samples, and one over the validation samples.

use std::time::Instant;

use dappo_learn::error::{Result, check_converging};
use dappo_nn::minibatch::ranges;
use dappo_sim::rng::{Purpose, Stream};

use super::session::Session;
use super::{BestEpoch, EpochMetrics, EpochProgress, Observer};
use crate::head::best;
use crate::{Diagnoser, Sample};

/// Minibatches from one report of progress to the next.
const REPORT_EVERY: usize = 50;
/// Windows validated at once.
const VALIDATION_BATCH: usize = 256;

/// What to do where a training has diverged.
const ADVICE: &str = "train again with a lower learning rate, for example --set learning_rate=0.0001";

impl Session<'_> {
    /// One epoch; `None` if the observer stopped it, after which the session must not be used any more.
    pub fn run_epoch(&mut self, observer: &mut dyn Observer) -> Result<Option<EpochMetrics>> {
        let start = Instant::now();
        let Some((train_loss, learning_rate)) = self.train_pass(observer)? else { return Ok(None) };
        let seconds = start.elapsed().as_secs_f64();
        let diagnoser = self.diagnoser();
        let (validation_loss, validation_accuracy) = self.validate(&diagnoser)?;
        let trained = self.training.len() as u64;
        self.position.epoch += 1;
        self.position.samples += trained;
        let epoch = self.position.epoch;
        if self.best.as_ref().is_none_or(|(best, _)| validation_loss < best.validation_loss) {
            self.best = Some((BestEpoch { epoch, validation_loss, validation_accuracy }, diagnoser));
        }
        Ok(Some(EpochMetrics {
            epoch,
            train_loss,
            validation_loss,
            validation_accuracy,
            learning_rate,
            samples: self.position.samples,
            seconds,
            samples_per_second: trained as f64 / seconds,
        }))
    }

    /// Trains on every sample once; returns the mean loss and the last learning rate.
    fn train_pass(&mut self, observer: &mut dyn Observer) -> Result<Option<(f64, f64)>> {
        let start = Instant::now();
        let epoch = self.position.epoch + 1;
        let mut order = self.training.clone();
        Stream::new(self.config.seed, epoch, Purpose::DiagnoserShuffle).shuffle(&mut order);
        let minibatches: Vec<&[Sample]> =
            ranges(order.len(), self.config.minibatch_size).map(|range| &order[range]).collect();
        let all_steps = (minibatches.len() * self.config.epochs) as f64;
        let (mut sum, mut done, mut learning_rate) = (0.0, 0, self.config.learning_rate);
        let mut next = Some(self.data.minibatch(minibatches[0], self.position.steps)?);
        for (index, samples) in minibatches.iter().enumerate() {
            if observer.should_stop() {
                return Ok(None);
            }
            let Some(batch) = next.take() else { break };
            let share = self.position.steps as f64 / all_steps;
            learning_rate = self.config.learning_rate * self.config.schedule.factor(share);
            self.position.steps += 1;
            let (step, following) = (self.position.steps, minibatches.get(index + 1));
            // The next minibatch is read while this one trains.
            let (learner, data) = (&mut self.learner, &self.data);
            let (loss, read) = rayon::join(
                || learner.step(batch, learning_rate),
                || following.map(|samples| data.minibatch(samples, step)).transpose(),
            );
            next = read?;
            sum += loss? * samples.len() as f64;
            done += samples.len();
            let train_loss = check_converging(
                format!("train loss of epoch {epoch}, minibatch {}", index + 1),
                sum / done as f64,
                ADVICE,
            )?;
            if (index + 1) % REPORT_EVERY == 0 || index + 1 == minibatches.len() {
                observer.progress(&EpochProgress {
                    epoch,
                    epochs: self.config.epochs as u64,
                    samples: done as u64,
                    samples_per_epoch: order.len() as u64,
                    samples_per_second: done as f64 / start.elapsed().as_secs_f64(),
                    train_loss,
                });
            }
        }
        Ok(Some((sum / done as f64, learning_rate)))
    }

    /// Mean loss and accuracy over the validation samples.
    fn validate(&self, diagnoser: &Diagnoser) -> Result<(f64, f64)> {
        let classes = self.data.description.subject.classes();
        let (mut loss, mut correct) = (0.0, 0);
        for samples in self.validation.chunks(VALIDATION_BATCH) {
            let scores = diagnoser.scores(self.data.inputs(samples)?)?;
            for (sample, scores) in samples.iter().zip(scores.chunks_exact(classes)) {
                loss -= scores[sample.class];
                correct += usize::from(best(scores) == sample.class);
            }
        }
        let count = self.validation.len() as f64;
        let what = format!("validation loss of epoch {}", self.position.epoch + 1);
        let loss = check_converging(what, loss / count, ADVICE)?;
        Ok((loss, correct as f64 / count))
    }
}
