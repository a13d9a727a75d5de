//! Ways to make pairs, and those that have names.

use strum::{EnumIter, EnumString, IntoEnumIterator, IntoStaticStr, VariantNames};

use super::{Span, Timing, Twin, TwinAction};

/// A way to make pairs that has a name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, EnumIter, EnumString, IntoStaticStr, VariantNames)]
#[strum(serialize_all = "lowercase")]
pub enum Preset {
    /// Damaged from the start and diagnosed at once (Verma et al., 2019, Algorithm 1).
    Paper,
    /// The damage strikes mid-episode and is diagnosed later, as when a walking robot breaks.
    Runtime,
    /// The same with a twin that is re-synchronised before every step and takes the action of the robot, so
    /// that the difference is the effect of the damage in this one step. A free-running twin soon walks
    /// differently even without damage: small differences grow from step to step.
    Residual,
    /// No twin: the damage strikes mid-episode, while the policy has the code of no damage, of this one, or of
    /// another. For robots that do not observe their whole state, as with an IMU and joint encoders alone.
    Observation,
}

/// A way to make records: onset of the damage and mode of the twin.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Protocol {
    /// When the damage strikes, and when the window begins or ends.
    pub timing: Timing,
    /// Mode of the twin; the robot is recorded alone for `None`.
    pub twin: Option<Twin>,
}

impl Preset {
    /// The protocol of this preset.
    #[must_use]
    pub fn protocol(self) -> Protocol {
        let mid_episode =
            Timing { onset: Span { first: 20, last: 150 }, delay: Span { first: 20, last: 80 } };
        match self {
            Self::Paper => Protocol { timing: Timing::default(), twin: Some(Twin::default()) },
            Self::Runtime => Protocol { timing: mid_episode, twin: Some(Twin::default()) },
            Self::Residual => {
                Protocol { timing: mid_episode, twin: Some(Twin { action: TwinAction::Shared, resync: 1 }) }
            }
            Self::Observation => {
                let (onset, delay) = (Span { first: 50, last: 200 }, Span { first: 5, last: 150 });
                Protocol { timing: Timing { onset, delay }, twin: None }
            }
        }
    }
}

impl Protocol {
    /// The name of the preset that it is, or `custom`.
    #[must_use]
    pub fn name(&self) -> &'static str {
        Preset::iter().find(|preset| preset.protocol() == *self).map_or("custom", Into::into)
    }

    /// Whether each damage class needs a twin of its own. Otherwise the run of the healthy class is the twin of all.
    #[must_use]
    pub(crate) fn needs_twins(&self) -> bool {
        self.twin.is_some_and(|twin| !self.timing.starts_at_reset() || twin != Twin::default())
    }

    /// Whether a twin is set to the observed state of its robot.
    #[must_use]
    pub(crate) fn synchronises_twins(&self) -> bool {
        self.twin.is_some_and(|twin| !self.timing.starts_at_reset() || twin.resync > 0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn protocols_are_known_by_what_they_do() {
        assert_eq!(Preset::VARIANTS, ["paper", "runtime", "residual", "observation"]);
        for name in Preset::VARIANTS {
            assert_eq!(name.parse::<Preset>().unwrap().protocol().name(), *name);
        }
        let [paper, runtime, residual, observation] =
            [Preset::Paper, Preset::Runtime, Preset::Residual, Preset::Observation].map(Preset::protocol);
        assert!(!paper.needs_twins() && runtime.needs_twins() && residual.needs_twins());
        assert!(!observation.needs_twins() && !observation.synchronises_twins());
        assert!(!paper.synchronises_twins() && runtime.synchronises_twins());
        assert_eq!(Protocol { timing: paper.timing, ..residual }.name(), "custom");
    }
}
