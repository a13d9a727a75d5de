//! How well a diagnoser does on windows that it may not have seen.

use std::path::Path;

use dappo_learn::csv_table::{number, table};
use dappo_learn::error::{LearnError, Result};
use dappo_learn::files::{own_folder, write_atomically};
use dappo_learn::statistics::standard_error;
use serde::Serialize;

use super::head::best;
use super::samples::{Reader, samples};
use super::{Diagnoser, PairSource};

/// Equally wide bins of confidence.
const BINS: usize = 10;
/// Windows diagnosed at once.
const BATCH: usize = 256;

/// The windows whose confidence, the probability of the diagnosed class, falls into one bin.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct CalibrationBin {
    /// Lower end of the bin; the upper end belongs to it only in the last one.
    pub from: f64,
    /// Upper end.
    pub to: f64,
    /// Windows in it.
    pub count: usize,
    /// Their mean confidence; NaN without any.
    pub confidence: f64,
    /// Share of them whose class was diagnosed correctly; NaN without any.
    pub accuracy: f64,
}

/// A diagnoser's results on some rollouts, every class of each.
#[derive(Debug, Clone, PartialEq)]
pub struct Report {
    /// Names of the classes, C of them.
    pub class_names: Vec<String>,
    /// Classes that the diagnoser was not trained on.
    pub held_out: Vec<usize>,
    /// Windows by true class (rows) and diagnosed class (columns), `[C, C]`.
    pub confusion: Vec<usize>,
    /// Share of every rollout's windows whose class was diagnosed correctly, 0 to 1, `[rollouts]`.
    pub rollout_accuracy: Vec<f64>,
    /// Confidence and accuracy.
    pub calibration: Vec<CalibrationBin>,
    /// Mean of −ln p(true class).
    pub log_loss: f64,
}

/// A report in a few numbers.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DiagnosisSummary {
    /// Rollouts diagnosed.
    pub rollouts: usize,
    /// Windows diagnosed.
    pub windows: usize,
    /// Share of them whose class was diagnosed correctly.
    pub accuracy: f64,
    /// Standard error of the accuracy over rollouts, whose windows are not independent of each other; NaN for a
    /// single rollout.
    pub standard_error: f64,
    /// Accuracy on classes that were not trained on, if there are any.
    pub held_out_accuracy: Option<f64>,
    /// Mean of −ln p(true class).
    pub log_loss: f64,
    /// Mean distance of confidence and accuracy over the bins, weighted by their windows (Naeini et al., 2015).
    pub calibration_error: f64,
}

impl Diagnoser {
    /// Diagnoses the windows of all classes in `rollouts` of a source, given by their numbers in it.
    pub fn evaluate(&self, source: &dyn PairSource, rollouts: &[usize]) -> Result<Report> {
        let description = self.description();
        let classes = description.subject.classes();
        self.check(source, rollouts)?;
        let reader = Reader { source, method: description.method, timesteps: description.timesteps };
        let mut tally = Tally::new(classes);
        for samples in samples(rollouts, classes, &[]).chunks(BATCH) {
            let probabilities = self.probabilities(&reader.read(samples, None)?)?;
            for (sample, probabilities) in samples.iter().zip(probabilities.chunks_exact(classes)) {
                tally.add(sample.class, probabilities);
            }
        }
        Ok(tally.report(description.subject.class_names.clone(), description.held_out.clone()))
    }

    fn check(&self, source: &dyn PairSource, rollouts: &[usize]) -> Result<()> {
        let description = self.description();
        for (what, got, expected) in [
            ("number of damage classes", source.classes(), description.subject.classes()),
            ("length of an observation", source.obs_dim(), description.obs_dim),
            ("length of an action", source.action_dim(), description.action_dim),
        ] {
            if got != expected {
                return Err(LearnError::Invalid(format!(
                    "the {what} of the data is {got}, the diagnoser expects {expected}"
                )));
            }
        }
        if source.timesteps() < description.timesteps {
            return Err(LearnError::Invalid(format!(
                "the windows of the data have {} time steps, the diagnoser expects at least {}",
                source.timesteps(),
                description.timesteps
            )));
        }
        if rollouts.is_empty() || rollouts.iter().any(|&rollout| rollout >= source.rollouts()) {
            return Err(LearnError::Invalid(format!(
                "rollouts to diagnose are {rollouts:?}, expected at least one, each below {}",
                source.rollouts()
            )));
        }
        Ok(())
    }
}

/// Counts of a report under way.
struct Tally {
    classes: usize,
    confusion: Vec<usize>,
    /// Whether each window so far was diagnosed correctly.
    correct: Vec<bool>,
    log_loss: f64,
    /// Of every bin: windows, those diagnosed correctly, sum of confidence.
    bins: [(usize, usize, f64); BINS],
}

impl Tally {
    fn new(classes: usize) -> Self {
        let confusion = vec![0; classes * classes];
        Self { classes, confusion, correct: Vec::new(), log_loss: 0.0, bins: [(0, 0, 0.0); BINS] }
    }

    fn add(&mut self, class: usize, probabilities: &[f32]) {
        let diagnosed = best(probabilities);
        let is_correct = diagnosed == class;
        self.confusion[class * self.classes + diagnosed] += 1;
        self.correct.push(is_correct);
        // A probability of 0 in f32 is not quite 0.
        self.log_loss -= f64::from(probabilities[class].max(f32::MIN_POSITIVE)).ln();
        let confidence = f64::from(probabilities[diagnosed]);
        let bin = &mut self.bins[((confidence * BINS as f64) as usize).min(BINS - 1)];
        *bin = (bin.0 + 1, bin.1 + usize::from(is_correct), bin.2 + confidence);
    }

    /// The report, once every class of every rollout has been added, rollout by rollout.
    fn report(self, class_names: Vec<String>, held_out: Vec<usize>) -> Report {
        Report {
            class_names,
            held_out,
            rollout_accuracy: self.correct.chunks_exact(self.classes).map(share).collect(),
            log_loss: self.log_loss / self.correct.len() as f64,
            calibration: self.bins(),
            confusion: self.confusion,
        }
    }

    fn bins(&self) -> Vec<CalibrationBin> {
        let bin = |(index, &(count, correct, confidence)): (usize, &(usize, usize, f64))| CalibrationBin {
            from: index as f64 / BINS as f64,
            to: (index + 1) as f64 / BINS as f64,
            count,
            confidence: confidence / count as f64,
            accuracy: correct as f64 / count as f64,
        };
        self.bins.iter().enumerate().map(bin).collect()
    }
}

fn share(flags: &[bool]) -> f64 {
    flags.iter().filter(|flag| **flag).count() as f64 / flags.len() as f64
}

impl Report {
    fn row(&self, class: usize) -> &[usize] {
        let classes = self.class_names.len();
        &self.confusion[class * classes..][..classes]
    }

    /// Share of the windows of some classes that were diagnosed correctly; NaN without any.
    fn accuracy_of(&self, mut classes: impl Iterator<Item = usize> + Clone) -> f64 {
        let windows: usize = classes.clone().map(|class| self.row(class).iter().sum::<usize>()).sum();
        let correct: usize = classes.by_ref().map(|class| self.row(class)[class]).sum();
        correct as f64 / windows as f64
    }

    /// Share of the windows of `class` that were diagnosed as `diagnosed`.
    #[must_use]
    pub fn share(&self, class: usize, diagnosed: usize) -> f64 {
        let row = self.row(class);
        row[diagnosed] as f64 / row.iter().sum::<usize>() as f64
    }

    /// Writes all tables and the summary into a folder: `STEM.classes.csv`, `STEM.confusion.csv`,
    /// `STEM.calibration.csv` and `STEM.json`.
    pub fn write(&self, folder: &Path, stem: &str) -> Result<()> {
        let summary = serde_json::to_string_pretty(&self.summary())
            .map_err(|error| LearnError::Invalid(error.to_string()))?;
        own_folder(folder)?;
        for (name, text) in [
            ("classes.csv", self.class_table()),
            ("confusion.csv", self.confusion_table()),
            ("calibration.csv", self.calibration_table()),
            ("json", summary),
        ] {
            write_atomically(&folder.join(format!("{stem}.{name}")), text.as_bytes())?;
        }
        Ok(())
    }

    /// Share of every class's windows that were diagnosed correctly, `[C]`.
    #[must_use]
    pub fn class_accuracy(&self) -> Vec<f64> {
        (0..self.class_names.len()).map(|class| self.accuracy_of(std::iter::once(class))).collect()
    }

    /// The report in a few numbers.
    #[must_use]
    pub fn summary(&self) -> DiagnosisSummary {
        let windows: usize = self.confusion.iter().sum();
        let gap = |bin: &CalibrationBin| bin.count as f64 * (bin.confidence - bin.accuracy).abs();
        let filled = self.calibration.iter().filter(|bin| bin.count > 0);
        DiagnosisSummary {
            rollouts: self.rollout_accuracy.len(),
            windows,
            accuracy: self.accuracy_of(0..self.class_names.len()),
            standard_error: standard_error(&self.rollout_accuracy),
            held_out_accuracy: (!self.held_out.is_empty())
                .then(|| self.accuracy_of(self.held_out.iter().copied())),
            log_loss: self.log_loss,
            calibration_error: filled.map(gap).sum::<f64>() / windows as f64,
        }
    }

    /// The confusion matrix as CSV: a row a true class, a column a diagnosed class.
    #[must_use]
    pub fn confusion_table(&self) -> String {
        let columns: Vec<&str> =
            std::iter::once("true\\diagnosed").chain(self.class_names.iter().map(String::as_str)).collect();
        let row = |(class, name): (usize, &String)| {
            std::iter::once(name.clone()).chain(self.row(class).iter().map(ToString::to_string)).collect()
        };
        table(&columns, self.class_names.iter().enumerate().map(row))
    }

    /// The classes as CSV: windows, accuracy with its standard error, and the class most often diagnosed
    /// instead.
    #[must_use]
    pub fn class_table(&self) -> String {
        let columns =
            ["class", "name", "held_out", "windows", "accuracy", "standard_error", "most_often_mistaken_for"];
        let row = |(class, (name, accuracy)): (usize, (&String, f64))| {
            let mut mistakes = self.row(class).to_vec();
            let windows: usize = mistakes.iter().sum();
            mistakes[class] = 0;
            let worst = best(&mistakes);
            let mistaken = if mistakes[worst] > 0 { self.class_names[worst].clone() } else { String::new() };
            let held_out = self.held_out.contains(&class).to_string();
            // A class has one window a rollout, so its windows are independent.
            let error = (accuracy * (1.0 - accuracy) / (windows as f64 - 1.0)).sqrt();
            let (accuracy, error) = (number(accuracy, 4), number(error, 4));
            vec![class.to_string(), name.clone(), held_out, windows.to_string(), accuracy, error, mistaken]
        };
        table(&columns, self.class_names.iter().zip(self.class_accuracy()).enumerate().map(row))
    }

    /// The calibration as CSV, a row a bin.
    #[must_use]
    fn calibration_table(&self) -> String {
        let row = |bin: &CalibrationBin| {
            let (from, to) = (format!("{:.1}", bin.from), format!("{:.1}", bin.to));
            vec![from, to, bin.count.to_string(), number(bin.confidence, 4), number(bin.accuracy, 4)]
        };
        table(&["from", "to", "count", "confidence", "accuracy"], self.calibration.iter().map(row))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two rollouts of three classes; of six windows, four are diagnosed correctly.
    fn report() -> Report {
        let mut tally = Tally::new(3);
        for (class, probabilities) in [
            (0, [0.8, 0.1, 0.1]),
            (1, [0.6, 0.4, 0.0]),
            (2, [0.04, 0.04, 0.92]),
            (0, [0.35, 0.34, 0.31]),
            (1, [0.0, 1.0, 0.0]),
            (2, [0.36, 0.33, 0.31]),
        ] {
            tally.add(class, &probabilities);
        }
        tally.report(vec!["healthy".into(), "a".into(), "b".into()], vec![2])
    }

    #[test]
    fn accuracy_and_its_error_over_rollouts_equal_hand_calculation() {
        let report = report();
        assert_eq!(report.confusion, [2, 0, 0, 1, 1, 0, 1, 0, 1]);
        assert_eq!(report.class_accuracy(), [1.0, 0.5, 0.5]);
        let summary = report.summary();
        assert_eq!((summary.rollouts, summary.windows), (2, 6));
        assert_eq!(summary.accuracy, 4.0 / 6.0);
        // Two of three windows of both rollouts are correct.
        assert_eq!(summary.standard_error, 0.0);
        assert_eq!(summary.held_out_accuracy, Some(0.5));
        // -np.log([.8, .4, .92, .35, 1, .31]).mean()
        assert!((summary.log_loss - 0.573_970_2).abs() < 1e-6, "{}", summary.log_loss);
    }

    #[test]
    fn the_error_is_that_of_the_mean_over_rollouts() {
        let report = Report { rollout_accuracy: vec![0.5, 1.0, 0.75], ..report() };
        // np.std([.5, 1, .75], ddof=1) / 3 ** .5
        assert!((report.summary().standard_error - 0.144_337_567_3).abs() < 1e-9);
        let single = Report { rollout_accuracy: vec![0.5], ..report };
        assert!(single.summary().standard_error.is_nan());
    }

    #[test]
    fn windows_fall_into_bins_by_the_confidence_of_what_was_named() {
        let report = report();
        let filled: Vec<(usize, usize)> = report
            .calibration
            .iter()
            .enumerate()
            .filter(|(_, bin)| bin.count > 0)
            .map(|(index, bin)| (index, bin.count))
            .collect();
        assert_eq!(filled, [(3, 2), (6, 1), (8, 1), (9, 2)]);
        // (2 |.355 - .5| + |.6 - 0| + |.8 - 1| + 2 |.96 - 1|) / 6
        let error = report.summary().calibration_error;
        assert!((error - 0.195).abs() < 1e-6, "{error}");
    }

    #[test]
    fn the_tables_are_csv_with_a_header() {
        let report = report();
        assert_eq!(
            report.confusion_table(),
            "true\\diagnosed,healthy,a,b\nhealthy,2,0,0\na,1,1,0\nb,1,0,1\n"
        );
        let table = report.class_table();
        assert_eq!(table.lines().nth(3).unwrap(), "2,b,true,2,0.5000,0.5000,healthy");
        assert_eq!(table.lines().nth(1).unwrap(), "0,healthy,false,2,1.0000,0.0000,");
        let table = report.calibration_table();
        assert_eq!(table.lines().count(), 11);
        assert_eq!(table.lines().nth(1).unwrap(), "0.0,0.1,0,,");
        assert_eq!(table.lines().nth(4).unwrap(), "0.3,0.4,2,0.3550,0.5000");
    }
}
