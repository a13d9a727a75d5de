//! Settings of a diagnoser's training, with the paper's values as defaults.

use std::slice;

use dappo_learn::config::{Assignment, Layers};
use dappo_learn::error::{LearnError, Result};
use dappo_learn::faults::Faults;
use dappo_learn::ppo::config::MOST_WIDTH;
use serde::{Deserialize, Serialize};

use super::{Head, Method, PairSource, Subject};
use crate::memory::check_diagnosers;

/// How the learning rate changes over a training.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Schedule {
    /// It stays.
    Constant,
    /// It falls to 0 along half a cosine over all epochs (Loshchilov and Hutter, 2017, without restarts).
    Cosine,
}

impl Schedule {
    /// Factor of the learning rate after `done` of 0 to 1 of all training steps.
    #[must_use]
    pub fn factor(self, done: f64) -> f64 {
        match self {
            Self::Constant => 1.0,
            Self::Cosine => f64::midpoint(1.0, (std::f64::consts::PI * done).cos()),
        }
    }
}

/// Settings of a diagnoser and its training. "Paper" marks values that Verma et al. (2019) state; the others
/// are ours.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DiagnoserConfig {
    /// Seed of weights, split, order of samples and dropout.
    pub seed: u64,
    /// What the network sees at every time step (paper: A and B).
    pub method: Method,
    /// Time steps it sees, the first of a window (paper: 10, 30 and 50).
    pub timesteps: usize,
    /// Rollouts used, of which some are for validation; all that there are when absent (paper: 1000, 2000
    /// and 7000).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rollouts: Option<usize>,
    /// Share of the rollouts that is only validated on.
    pub validation_fraction: f64,
    /// Damage classes never trained on.
    pub held_out: Vec<usize>,
    /// What the network outputs (paper: `classes`).
    pub head: Head,
    /// Width of the embedding of a time step (paper).
    pub embedding: usize,
    /// Width of the LSTM's hidden state (paper).
    pub lstm: usize,
    /// Widths of the dense layers (paper).
    pub hidden: Vec<usize>,
    /// Share of the dense layers' units that a training step leaves out.
    pub dropout: f64,
    /// Adam's learning rate at the start.
    pub learning_rate: f64,
    /// How it changes.
    pub schedule: Schedule,
    /// Samples of a minibatch.
    pub minibatch_size: usize,
    /// At most this many passes over the training samples.
    pub epochs: usize,
    /// Training ends after this many epochs without a lower validation loss.
    pub patience: usize,
}

impl Default for DiagnoserConfig {
    fn default() -> Self {
        Self {
            seed: 0,
            method: Method::B,
            timesteps: 50,
            rollouts: None,
            validation_fraction: 0.2,
            held_out: Vec::new(),
            head: Head::Classes,
            embedding: 512,
            lstm: 32,
            hidden: vec![256, 128, 64],
            dropout: 0.1,
            learning_rate: 1e-3,
            schedule: Schedule::Constant,
            minibatch_size: 64,
            epochs: 50,
            patience: 10,
        }
    }
}

impl DiagnoserConfig {
    /// The defaults with these settings laid over them, later ones over earlier ones.
    pub fn with(settings: &[Assignment]) -> Result<Self> {
        let config: Self = Layers::of(settings)?.typed()?;
        config.check()?;
        Ok(config)
    }

    /// Fails with all settings outside their range.
    pub fn check(&self) -> Result<()> {
        let mut faults = Faults::default();
        let most = i32::MAX as u64;
        faults.count("timesteps", self.timesteps as u64, most);
        if let Some(rollouts) = self.rollouts {
            faults.rule("rollouts", rollouts, "at least 2, one of them to validate on", rollouts > 1);
        }
        let (share, dropout) = (self.validation_fraction, self.dropout);
        faults.rule("validation_fraction", share, "a number in (0, 1)", share > 0.0 && share < 1.0);
        faults.rule("dropout", dropout, "a number in [0, 1)", (0.0..1.0).contains(&dropout));
        faults.count("embedding", self.embedding as u64, MOST_WIDTH);
        faults.count("lstm", self.lstm as u64, MOST_WIDTH);
        for (layer, &width) in self.hidden.iter().enumerate() {
            faults.count(&format!("hidden[{layer}]"), width as u64, MOST_WIDTH);
        }
        faults.positive("learning_rate", self.learning_rate, 1.0);
        for (key, value) in
            [("minibatch_size", self.minibatch_size), ("epochs", self.epochs), ("patience", self.patience)]
        {
            faults.count(key, value as u64, most);
        }
        Ok(faults.end()?)
    }

    /// Fails if the data cannot serve these settings, or a training on them does not fit the memory.
    pub fn check_source(&self, source: &dyn PairSource, subject: &Subject) -> Result<()> {
        self.check_data(source)?;
        Ok(check_diagnosers(slice::from_ref(self), 1, source, subject)?)
    }

    /// Fails if the data cannot serve these settings.
    pub(super) fn check_data(&self, source: &dyn PairSource) -> Result<()> {
        let available = source.timesteps();
        if self.timesteps > available {
            return Err(LearnError::Invalid(format!(
                "`timesteps` is {}, but the windows of the data have {available}",
                self.timesteps
            )));
        }
        let (used, available) = (self.rollouts.unwrap_or(source.rollouts()), source.rollouts());
        if used > available || used < 2 {
            return Err(LearnError::Invalid(format!(
                "`rollouts` is {used}, expected 2 to {available}, as many as the data has"
            )));
        }
        if self.method != Method::A && source.twin().is_none() {
            return Err(LearnError::Invalid(format!(
                "`method` is {}, which compares robots with their twins, but the data were recorded without twins; \
                 expected A",
                self.method.name()
            )));
        }
        let classes = source.classes();
        if let Some(class) = self.held_out.iter().find(|&&class| class >= classes) {
            return Err(LearnError::Invalid(format!(
                "`held_out` contains damage class {class}; the classes are 0 to {}",
                classes.saturating_sub(1)
            )));
        }
        if (0..classes).all(|class| self.held_out.contains(&class)) {
            return Err(LearnError::Invalid(format!(
                "`held_out` contains all {classes} damage classes; one must remain"
            )));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::str::FromStr;

    use strum::VariantNames;

    use super::*;
    use crate::TwinAction;
    use crate::controller::Trigger;

    /// Checks the names of an enum: on the command line, in files, and of its values.
    fn check_names<T>(names: &[&str])
    where
        T: FromStr + VariantNames + Serialize + Into<&'static str>,
    {
        assert_eq!(T::VARIANTS, names);
        for name in names {
            let value: T = name.parse().ok().unwrap();
            assert_eq!(serde_json::to_value(&value).unwrap(), *name);
            assert_eq!(value.into(), *name);
        }
    }

    #[test]
    fn values_have_the_same_name_on_the_command_line_and_in_files() {
        check_names::<Method>(&["A", "B", "C", "D"]);
        check_names::<Head>(&["classes", "limbs"]);
        check_names::<TwinAction>(&["own", "shared"]);
        check_names::<Trigger>(&["residual", "speed", "observation"]);
    }

    #[test]
    fn the_defaults_are_the_papers_network_and_pass_their_own_check() {
        let config = DiagnoserConfig::default();
        config.check().unwrap();
        assert_eq!((config.embedding, config.lstm), (512, 32));
        assert_eq!(config.hidden, [256, 128, 64]);
        assert_eq!((config.method, config.head), (Method::B, Head::Classes));
    }

    #[test]
    fn a_configuration_reads_back_from_toml_and_unknown_keys_are_rejected() {
        let config = DiagnoserConfig {
            rollouts: Some(1000),
            schedule: Schedule::Cosine,
            held_out: vec![3, 5],
            ..DiagnoserConfig::default()
        };
        let text = toml::to_string(&config).unwrap();
        assert_eq!(toml::from_str::<DiagnoserConfig>(&text).unwrap(), config);
        let config: DiagnoserConfig = toml::from_str("method = \"A\"\nhead = \"limbs\"").unwrap();
        assert_eq!((config.method, config.head), (Method::A, Head::Limbs));
        let message = toml::from_str::<DiagnoserConfig>("lstms = 3").unwrap_err().to_string();
        assert!(message.contains("lstms"), "{message}");
    }

    #[test]
    fn settings_outside_their_range_are_rejected_by_name() {
        let refuse = |config: DiagnoserConfig| config.check().unwrap_err().to_string();
        let paper = DiagnoserConfig::default;
        let message = refuse(DiagnoserConfig { dropout: 1.0, ..paper() });
        assert_eq!(message, "`dropout` is 1, expected a number in [0, 1)");
        let message = refuse(DiagnoserConfig { learning_rate: f64::NAN, ..paper() });
        assert_eq!(message, "`learning_rate` is NaN, expected a number above 0 and at most 1");
        let message = refuse(DiagnoserConfig { validation_fraction: 0.0, ..paper() });
        assert_eq!(message, "`validation_fraction` is 0, expected a number in (0, 1)");
        assert!(refuse(DiagnoserConfig { rollouts: Some(1), ..paper() }).starts_with("`rollouts` is 1"));
        assert!(refuse(DiagnoserConfig { hidden: vec![4, 0], ..paper() }).starts_with("`hidden[1]` is 0"));
    }

    #[test]
    fn the_cosine_falls_from_1_over_a_half_to_0() {
        for (done, expected) in [(0.0, 1.0), (0.25, 0.853_553_390_593_273_8), (0.5, 0.5), (1.0, 0.0)] {
            assert!((Schedule::Cosine.factor(done) - expected).abs() < 1e-12);
            assert_eq!(Schedule::Constant.factor(done), 1.0);
        }
    }
}
