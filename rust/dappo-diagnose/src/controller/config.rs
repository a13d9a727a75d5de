//! Settings of the run-time loop.

use dappo_learn::config::{Assignment, Layers};
use dappo_learn::error::{LearnError, Result};
use dappo_learn::faults::Faults;
use serde::{Deserialize, Serialize};
use strum::{EnumString, IntoStaticStr, VariantNames};

use crate::{Description, Method};

/// Steps of a window at most, which is kept for every robot.
const MOST_WINDOW: u64 = 1_000_000;
/// Steps at most that something waits for; the time to the next diagnosis window doubles.
const MOST_WAIT: u64 = 1 << 31;

/// What makes a controller suspect damage.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[derive(EnumString, IntoStaticStr, VariantNames)]
#[strum(serialize_all = "lowercase")]
pub enum Trigger {
    /// The robot moves differently from a twin with the assumed class. Needs an accurate simulation, and then
    /// also detects damage without loss of speed, wrong diagnoses, and repairs.
    Residual,
    /// The robot walks too slowly for the assumed class.
    Speed,
    /// The diagnoser sees another class than the assumed one in the last observations, again and again. Needs neither a
    /// twin nor a diagnosis window, but a diagnoser of the observation alone (method A).
    Observation,
}

/// Which damage code the policy is given.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum CodeSource {
    /// That of the assumed class.
    #[default]
    Assumed,
    /// The mean of the codes of all classes, weighted by the probabilities of the last diagnosis, with the trigger
    /// `observation`. The policy reacts to evidence before it suffices for a diagnosis, as with an estimate of the
    /// extrinsics by an adaptation module (Kumar et al., 2021, "RMA: Rapid motor adaptation for legged robots").
    Expected,
}

impl CodeSource {
    /// Whether it is the one of controllers that do not say so.
    #[expect(clippy::trivially_copy_pass_by_ref, reason = "serde passes references")]
    fn is_assumed(&self) -> bool {
        *self == Self::Assumed
    }
}

/// When a controller suspects damage and which diagnoses it accepts. Times are in control steps.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ControllerConfig {
    /// What makes it suspect damage; by default `residual`, or `observation` with a diagnoser that has no twin.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub trigger: Option<Trigger>,
    /// Steps over which the forward velocity is averaged.
    pub speed_window: usize,
    /// Share of the expected forward velocity below which a robot is too slow.
    pub speed_fraction: f64,
    /// Steps over which the median of the residual is taken.
    pub residual_window: usize,
    /// Residual above which a robot differs from its twin: root mean square over the entries of an observation, in
    /// standard deviations of the training.
    pub residual_threshold: f64,
    /// Steps after a start or a diagnosis in which nothing is suspected. Each diagnosis window that does not
    /// remove the suspicion doubles the time to the next one.
    pub cooldown: usize,
    /// Least probability of a diagnosis that is accepted; by default 0.5, or 0.99 with the trigger `observation`, which
    /// has many diagnoses to choose from.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub confidence: Option<f64>,
    /// Steps with a residual after which a diagnosis is withdrawn, if the twin with the diagnosed damage is
    /// no closer to the robot than the healthy one was; 0 for never. Needs the trigger `residual` and a
    /// diagnoser whose twins are re-synchronised before every step.
    pub probation: usize,
    /// Steps from one diagnosis to the next, with the trigger `observation`.
    pub diagnose_every: usize,
    /// Consecutive diagnoses of one class after which it is assumed, with the trigger `observation`.
    pub agreement: usize,
    /// Which damage code the policy is given.
    #[serde(skip_serializing_if = "CodeSource::is_assumed")]
    pub code: CodeSource,
}

impl Default for ControllerConfig {
    fn default() -> Self {
        Self {
            trigger: None,
            speed_window: 50,
            speed_fraction: 0.5,
            residual_window: 10,
            residual_threshold: 0.05,
            cooldown: 50,
            confidence: None,
            probation: 10,
            diagnose_every: 1,
            agreement: 4,
            code: CodeSource::Assumed,
        }
    }
}

impl ControllerConfig {
    /// The defaults with these settings laid over them.
    pub fn with(settings: &[Assignment]) -> Result<Self> {
        let config: Self = Layers::of(settings)?.typed()?;
        config.check()?;
        Ok(config)
    }

    /// Whether the probability of a diagnosis is high enough, for [resolved](Self::resolved) settings.
    pub(super) fn accepts(&self, probability: f32) -> bool {
        self.confidence.is_none_or(|least| f64::from(probability) >= least)
    }

    /// These settings with the defaults of the trigger that this diagnoser is used with; fails if it cannot be used with
    /// theirs.
    pub fn resolved(self, diagnoser: &Description) -> Result<Self> {
        let trigger = self.trigger_with(diagnoser)?;
        if self.code == CodeSource::Expected && trigger != Trigger::Observation {
            return Err(LearnError::Invalid(format!(
                "`code` is `expected`, which needs a diagnosis in every step, but the trigger is `{}`; expected the trigger \
                 `observation`, or `code = \"assumed\"`",
                <&str>::from(trigger)
            )));
        }
        let confidence = self.confidence.unwrap_or(if trigger == Trigger::Observation { 0.99 } else { 0.5 });
        Ok(Self { trigger: Some(trigger), confidence: Some(confidence), ..self })
    }

    fn trigger_with(&self, diagnoser: &Description) -> Result<Trigger> {
        let fault = match (self.trigger, diagnoser.twin, diagnoser.method) {
            (None, Some(_), _) => return Ok(Trigger::Residual),
            (None, None, _) | (Some(Trigger::Observation), _, Method::A) => return Ok(Trigger::Observation),
            (Some(Trigger::Observation), _, method) => format!(
                "the trigger `observation` diagnoses observations alone, but the diagnoser compares robots with twins \
                 (method {}); train one with the method A",
                method.name()
            ),
            (Some(trigger), Some(_), _) => return Ok(trigger),
            (Some(trigger), None, _) => format!(
                "the diagnoser was trained on records without twins (preset `observation`), and the trigger `{}` \
                 needs one with twins; leave out the trigger, or choose `observation`",
                <&str>::from(trigger)
            ),
        };
        Err(LearnError::Invalid(fault))
    }

    /// Fails with all settings outside their range.
    pub fn check(&self) -> Result<()> {
        let mut faults = Faults::default();
        for (key, window) in [
            ("speed_window", self.speed_window),
            ("residual_window", self.residual_window),
            ("diagnose_every", self.diagnose_every),
            ("agreement", self.agreement),
        ] {
            faults.count(key, window as u64, MOST_WINDOW);
        }
        for (key, steps) in [("cooldown", self.cooldown), ("probation", self.probation)] {
            let expected = format!("a whole number from 0 to {MOST_WAIT}");
            faults.rule(key, steps, &expected, steps as u64 <= MOST_WAIT);
        }
        faults.positive("speed_fraction", self.speed_fraction, 1e9);
        faults.positive("residual_threshold", self.residual_threshold, 1e9);
        let confidence = self.confidence.unwrap_or(0.5);
        faults.rule("confidence", confidence, "a number in [0, 1]", (0.0..=1.0).contains(&confidence));
        Ok(faults.end()?)
    }
}

#[cfg(test)]
mod tests {
    use dappo_nn::Standardizer;

    use super::*;
    use crate::{Head, Subject, Twin};

    fn diagnoser(method: Method, twin: Option<Twin>) -> Description {
        Description {
            method,
            timesteps: 1,
            obs_dim: 1,
            action_dim: 1,
            head: Head::Classes,
            embedding: 1,
            lstm: 1,
            hidden: Vec::new(),
            held_out: Vec::new(),
            twin,
            subject: Subject { robot: "toy".into(), class_names: Vec::new(), codes: Vec::new() },
            standardizer: Standardizer::of(vec![0.0], vec![1.0]).unwrap(),
        }
    }

    #[test]
    fn an_observed_robot_needs_surer_diagnoses_unless_set_otherwise() {
        let confidence = |twin, confidence| {
            let config = ControllerConfig { confidence, ..ControllerConfig::default() };
            config.resolved(&diagnoser(Method::A, twin)).unwrap()
        };
        let observed = confidence(None, None);
        assert!(observed.accepts(0.991) && !observed.accepts(0.989));
        let compared = confidence(Some(Twin::default()), None);
        assert!(compared.accepts(0.5) && !compared.accepts(0.49));
        assert_eq!(confidence(None, Some(0.25)).confidence, Some(0.25));
    }

    #[test]
    fn the_trigger_is_that_of_the_diagnoser_unless_another_one_can_be_used() {
        let twin = Some(Twin::default());
        let resolve = |trigger, method, twin| {
            let config = ControllerConfig { trigger, ..ControllerConfig::default() };
            config.resolved(&diagnoser(method, twin)).map(|config| config.trigger)
        };
        let becomes = |trigger, method, twin| resolve(trigger, method, twin).unwrap().unwrap();
        assert_eq!(becomes(None, Method::B, twin), Trigger::Residual);
        assert_eq!(becomes(None, Method::A, twin), Trigger::Residual);
        assert_eq!(becomes(None, Method::A, None), Trigger::Observation);
        assert_eq!(becomes(Some(Trigger::Speed), Method::C, twin), Trigger::Speed);
        assert_eq!(becomes(Some(Trigger::Observation), Method::A, twin), Trigger::Observation);
        for (trigger, method, twin, why) in [
            (Trigger::Observation, Method::C, twin, "(method C); train one with the method A"),
            (Trigger::Residual, Method::A, None, "the trigger `residual` needs one with twins"),
            (Trigger::Speed, Method::A, None, "the trigger `speed` needs one with twins"),
        ] {
            let message = resolve(Some(trigger), method, twin).unwrap_err().to_string();
            assert!(message.contains(why), "{message}");
        }
    }
}
