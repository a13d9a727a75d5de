//! Settings of the learner, with the paper's values as defaults.

use dappo_nn::{Gradients, LearnerDevice};
use serde::{Deserialize, Serialize};

use super::symmetry::Symmetry;
use crate::error::{LearnError, Result};
use crate::faults::Faults;

/// Passes and rows of a minibatch at most.
const MOST_COUNT: u64 = i32::MAX as u64;
/// Names of the presets.
const PRESETS: [&str; 2] = ["paper", "batch"];
/// Units of a layer at most; whether such a network fits the memory is another question.
pub const MOST_WIDTH: u64 = 1 << 24;

/// How the learning rates change while a run spends its budget of env steps.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Schedule {
    /// They do not.
    #[default]
    Constant,
    /// They fall in proportion to what is left of the budget, to 0 at its end.
    Linear,
}

impl Schedule {
    /// What the learning rates are multiplied by once a share `done` of the budget is spent.
    #[must_use]
    pub fn factor(self, done: f64) -> f64 {
        match self {
            Self::Constant => 1.0,
            Self::Linear => 1.0 - done.clamp(0.0, 1.0),
        }
    }
}

/// Settings of PPO. "Paper" marks values that Verma et al. (2019) state; the others are ours.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PpoConfig {
    /// `cpu` or `gpu`: where the networks are computed.
    pub device: LearnerDevice,
    /// `written` or `recorded`: whether gradients and Adam's steps are written out for these networks, or burn's; written
    /// on the CPU and recorded elsewhere when absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gradients: Option<Gradients>,
    /// Hidden layers of both networks (paper).
    pub hidden: Vec<usize>,
    /// Units of an LSTM over what the policy observes, whose hidden state both networks are given behind the
    /// observation; a policy without memory when absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lstm: Option<usize>,
    /// What a 1 of the damage code becomes in the input of the networks, whose other entries have variance 1
    /// (paper: 1).
    pub code_scale: f64,
    /// Discount γ (paper).
    pub gamma: f64,
    /// λ of generalised advantage estimation (paper).
    pub gae_lambda: f64,
    /// ε of the clipped surrogate (paper).
    pub clip_range: f64,
    /// d*, the KL divergence that an update aims at (paper).
    pub kl_target: f64,
    /// η, the weight of the squared excess of the KL divergence over 2 d*.
    pub kl_hinge: f64,
    /// An update stops after an epoch whose KL divergence exceeds this many d*.
    pub kl_stop: f64,
    /// The adaptive learning rate stays below this multiple of `learning_rate`.
    pub max_lr_factor: f64,
    /// Logarithm of the variance of a new policy.
    pub initial_log_variance: f64,
    /// At most this many passes over the batch for the policy.
    pub epochs: usize,
    /// Rows of a policy minibatch.
    pub minibatch_size: usize,
    /// Adam's learning rate for the policy, before the adaptive factor.
    pub learning_rate: f64,
    /// Passes over the current and the previous batch for the value net.
    pub value_epochs: usize,
    /// Rows of a value minibatch.
    pub value_minibatch_size: usize,
    /// Adam's learning rate for the value net.
    pub value_learning_rate: f64,
    /// `constant` or `linear`: how both learning rates change during a run.
    pub schedule: Schedule,
    /// `true`, `false` or `"auto"`: whether the networks are their own mirror images, left to right, so that what they
    /// learn on one side holds for both.
    pub symmetry: Symmetry,
}

impl Default for PpoConfig {
    /// The preset `paper`.
    fn default() -> Self {
        Self {
            device: LearnerDevice::Cpu,
            gradients: None,
            hidden: vec![100, 200, 100],
            lstm: None,
            code_scale: 1.0,
            gamma: 0.995,
            gae_lambda: 0.98,
            clip_range: 0.2,
            kl_target: 0.01,
            kl_hinge: 50.0,
            kl_stop: 4.0,
            max_lr_factor: 10.0,
            initial_log_variance: -1.0,
            epochs: 10,
            minibatch_size: 2048,
            learning_rate: 3e-4,
            value_epochs: 10,
            value_minibatch_size: 2048,
            value_learning_rate: 1e-3,
            schedule: Schedule::Constant,
            symmetry: Symmetry::Off,
        }
    }
}

impl PpoConfig {
    /// A named preset: `paper`, or `batch` for hundreds to thousands of environments.
    ///
    /// `batch` differs in optimisation, in the scale of the damage code, and in the networks, which are smaller and have
    /// the symmetry of the robot. Where simulation is cheap, fewer passes over more samples learn sooner; a batch from
    /// many environments is less correlated than one from a few and allows larger steps and a KL target three times the
    /// paper's. A larger damage code is heeded sooner: at 1, the policy walked almost as well with the code of no damage
    /// (`docs/results/presets.md`).
    pub fn preset(name: &str) -> Result<Self> {
        match name {
            "paper" => Ok(Self::default()),
            "batch" => Ok(Self {
                hidden: vec![128, 128],
                code_scale: 4.0,
                kl_target: 0.03,
                epochs: 4,
                learning_rate: 1e-3,
                // Already large: a run whose factor rose to 10 unlearned walking (docs/results/healthy_ant.md).
                max_lr_factor: 1.0,
                value_epochs: 1,
                symmetry: Symmetry::Auto,
                ..Self::default()
            }),
            _ => Err(LearnError::Config {
                key: "preset",
                got: format!("{name:?}"),
                expected: "\"paper\" or \"batch\"",
            }),
        }
    }

    /// The preset with the fewest other values, wherever they are computed, and the settings that differ from it, each
    /// as `ppo.KEY = VALUE`.
    pub fn closest_preset(&self) -> Result<(&'static str, Vec<String>)> {
        let (device, gradients) = (self.device, self.gradients);
        let own = self.to_table()?;
        let differences = PRESETS.into_iter().map(|name| {
            let preset = Self { device, gradients, ..Self::preset(name)? };
            // A run with a robot that has it.
            let found = preset.symmetry == Symmetry::Auto && self.symmetry == Symmetry::On;
            let symmetry = if found { Symmetry::On } else { preset.symmetry };
            let preset = Self { symmetry, ..preset }.to_table()?;
            let changed = own.iter().filter(|(key, value)| preset.get(*key) != Some(*value));
            Ok((name, changed.map(|(key, value)| format!("ppo.{key} = {value}")).collect::<Vec<_>>()))
        });
        let differences = differences.collect::<Result<Vec<_>>>()?;
        let closest = differences.into_iter().min_by_key(|(_, changed)| changed.len());
        closest.ok_or_else(|| LearnError::Invalid("there are no presets".into()))
    }

    /// Its settings as TOML.
    pub(crate) fn to_table(&self) -> Result<toml::Table> {
        toml::Table::try_from(self)
            .map_err(|error| LearnError::Invalid(format!("cannot write the settings of PPO: {error}")))
    }

    /// Where gradients and Adam's steps come from.
    #[must_use]
    pub fn gradients(&self) -> Gradients {
        self.gradients.unwrap_or(match self.device {
            LearnerDevice::Cpu => Gradients::Written,
            LearnerDevice::Gpu => Gradients::Recorded,
        })
    }

    /// Width of the hidden state of the policy's memory; 0 for a policy without one.
    #[must_use]
    pub fn memory(&self) -> usize {
        self.lstm.unwrap_or(0)
    }

    /// Logarithm of the standard deviation of a new policy.
    #[must_use]
    pub fn initial_log_std(&self) -> f64 {
        self.initial_log_variance / 2.0
    }

    /// Fails with all settings outside their range.
    pub fn check(&self) -> Result<()> {
        let mut faults = Faults::default();
        self.review(&mut faults);
        Ok(faults.end()?)
    }

    /// Notes the settings outside their range.
    pub(crate) fn review(&self, faults: &mut Faults) {
        let (gamma, lambda, clip) = (self.gamma, self.gae_lambda, self.clip_range);
        faults.rule("gamma", gamma, "a number in [0, 1)", (0.0..1.0).contains(&gamma));
        faults.rule("gae_lambda", lambda, "a number in [0, 1]", (0.0..=1.0).contains(&lambda));
        faults.rule("clip_range", clip, "a number in (0, 1)", clip > 0.0 && clip < 1.0);
        let (hinge, log_variance) = (self.kl_hinge, self.initial_log_variance);
        faults.rule("kl_hinge", hinge, "a number in [0, 1e9]", (0.0..=1e9).contains(&hinge));
        let expected = "a number in [-40, 40]";
        faults.rule("initial_log_variance", log_variance, expected, (-40.0..=40.0).contains(&log_variance));
        faults.positive("code_scale", self.code_scale, 1e6);
        faults.positive("kl_target", self.kl_target, 1e6);
        faults.positive("kl_stop", self.kl_stop, 1e9);
        faults.positive("learning_rate", self.learning_rate, 1.0);
        faults.positive("value_learning_rate", self.value_learning_rate, 1.0);
        let factor = self.max_lr_factor;
        faults.rule("max_lr_factor", factor, "a number in [1, 1e6]", (1.0..=1e6).contains(&factor));
        let is_possible = self.device == LearnerDevice::Cpu || self.gradients() == Gradients::Recorded;
        let expected = "\"recorded\", as written gradients are for the device `cpu`";
        faults.rule("gradients", "\"written\"", expected, is_possible);
        for (key, value) in [
            ("epochs", self.epochs),
            ("minibatch_size", self.minibatch_size),
            ("value_epochs", self.value_epochs),
            ("value_minibatch_size", self.value_minibatch_size),
        ] {
            faults.count(key, value as u64, MOST_COUNT);
        }
        if let Some(units) = self.lstm {
            faults.count("lstm", units as u64, MOST_WIDTH);
        }
        for (layer, &width) in self.hidden.iter().enumerate() {
            faults.count(&format!("hidden[{layer}]"), width as u64, MOST_WIDTH);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_is_the_paper_preset_with_the_papers_numbers() {
        let config = PpoConfig::preset("paper").unwrap();
        assert_eq!(config, PpoConfig::default());
        assert_eq!(config.hidden, [100, 200, 100]);
        let numbers = [config.gamma, config.gae_lambda, config.clip_range, config.kl_target];
        assert_eq!(numbers, [0.995, 0.98, 0.2, 0.01]);
    }

    #[test]
    fn every_preset_passes_its_own_check_and_unknown_presets_are_named() {
        for name in PRESETS {
            let preset = PpoConfig::preset(name).unwrap();
            preset.check().unwrap();
            assert_eq!(preset.closest_preset().unwrap(), (name, Vec::new()));
            let elsewhere = PpoConfig { device: LearnerDevice::Gpu, ..preset.clone() };
            assert_eq!(elsewhere.closest_preset().unwrap(), (name, Vec::new()));
            let changed = PpoConfig { gamma: 0.9, hidden: vec![64], ..preset };
            let settings = ["ppo.gamma = 0.9", "ppo.hidden = [64]"].map(ToOwned::to_owned).to_vec();
            assert_eq!(changed.closest_preset().unwrap(), (name, settings));
        }
        let message = PpoConfig::preset("fast").unwrap_err().to_string();
        assert_eq!(message, "preset is \"fast\", expected \"paper\" or \"batch\"");
    }

    #[test]
    fn symmetry_is_true_false_or_auto_and_on_is_what_the_preset_finds() {
        let read = |text: &str| toml::from_str::<PpoConfig>(text);
        for (text, symmetry) in [("true", Symmetry::On), ("false", Symmetry::Off), ("'auto'", Symmetry::Auto)]
        {
            let config = read(&format!("symmetry = {text}")).unwrap();
            assert_eq!(config.symmetry, symmetry);
            assert_eq!(read(&toml::to_string(&config).unwrap()).unwrap(), config);
        }
        let message = read("symmetry = 'maybe'").unwrap_err().to_string();
        assert!(message.contains("expected true, false or \"auto\""), "{message}");
        let batch = PpoConfig::preset("batch").unwrap();
        let on = PpoConfig { symmetry: Symmetry::On, ..batch.clone() };
        assert_eq!(on.closest_preset().unwrap(), ("batch", Vec::new()));
        let off = PpoConfig { symmetry: Symmetry::Off, gamma: 0.9, ..batch };
        let (preset, changed) = off.closest_preset().unwrap();
        assert_eq!((preset, changed.len()), ("batch", 2), "{changed:?}");
    }

    #[test]
    fn a_linear_schedule_is_what_is_left_of_the_budget() {
        assert_eq!([0.0, 0.25, 1.0, 1.5].map(|done| Schedule::Linear.factor(done)), [1.0, 0.75, 0.0, 0.0]);
        assert_eq!([0.0, 0.25, 1.0].map(|done| Schedule::Constant.factor(done)), [1.0; 3]);
    }

    #[test]
    fn missing_keys_take_defaults_and_unknown_keys_are_rejected() {
        let config: PpoConfig = toml::from_str("gamma = 0.9").unwrap();
        assert_eq!(config, PpoConfig { gamma: 0.9, ..PpoConfig::default() });
        assert!(toml::from_str::<PpoConfig>("gama = 0.9").unwrap_err().to_string().contains("gama"));
    }

    #[test]
    fn settings_outside_their_range_are_rejected_by_name() {
        let bad = PpoConfig { gamma: 1.0, ..PpoConfig::default() };
        assert_eq!(bad.check().unwrap_err().to_string(), "`gamma` is 1, expected a number in [0, 1)");
        let bad = PpoConfig { learning_rate: f64::NAN, ..PpoConfig::default() };
        assert!(bad.check().unwrap_err().to_string().starts_with("`learning_rate` is NaN"));
        let bad = PpoConfig { hidden: vec![100, 0], ..PpoConfig::default() };
        assert!(bad.check().is_err());
    }

    #[test]
    fn gradients_follow_the_device_and_written_ones_are_for_the_cpu() {
        let on = |device, gradients| PpoConfig { device, gradients, ..PpoConfig::default() };
        assert_eq!(on(LearnerDevice::Cpu, None).gradients(), Gradients::Written);
        assert_eq!(on(LearnerDevice::Gpu, None).gradients(), Gradients::Recorded);
        on(LearnerDevice::Cpu, Some(Gradients::Recorded)).check().unwrap();
        let message = on(LearnerDevice::Gpu, Some(Gradients::Written)).check().unwrap_err().to_string();
        assert!(message.starts_with("`gradients` is \"written\", expected \"recorded\""), "{message}");
    }
}
