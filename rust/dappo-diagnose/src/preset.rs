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
}

/// A way to make pairs: onset of the damage and mode of the twin.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Protocol {
    /// When the damage strikes, and when the window begins.
    pub timing: Timing,
    /// Mode of the twin.
    pub twin: Twin,
}

impl Preset {
    /// The protocol of this preset.
    #[must_use]
    pub fn protocol(self) -> Protocol {
        let mid_episode =
            Timing { onset: Span { first: 20, last: 150 }, delay: Span { first: 20, last: 80 } };
        match self {
            Self::Paper => Protocol { timing: Timing::default(), twin: Twin::default() },
            Self::Runtime => Protocol { timing: mid_episode, twin: Twin::default() },
            Self::Residual => {
                Protocol { timing: mid_episode, twin: Twin { action: TwinAction::Shared, resync: 1 } }
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
        !self.timing.starts_at_reset() || self.twin != Twin::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn protocols_are_known_by_what_they_do() {
        assert_eq!(Preset::VARIANTS, ["paper", "runtime", "residual"]);
        for name in Preset::VARIANTS {
            assert_eq!(name.parse::<Preset>().unwrap().protocol().name(), *name);
        }
        let [paper, runtime, residual] =
            [Preset::Paper, Preset::Runtime, Preset::Residual].map(Preset::protocol);
        assert!(!paper.needs_twins() && runtime.needs_twins() && residual.needs_twins());
        assert_eq!(Protocol { timing: paper.timing, ..residual }.name(), "custom");
    }
}
