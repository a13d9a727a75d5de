//! Named ways to make pairs.

use dappo_learn::error::{LearnError, Result};

use super::{Span, Timing, Twin, TwinAction};

/// When the damage strikes and how the twin is led.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Preset {
    /// When the damage strikes, and when the window begins.
    pub timing: Timing,
    /// How the twin is led.
    pub twin: Twin,
}

impl Preset {
    /// The names of the presets.
    pub const NAMES: [&'static str; 3] = ["paper", "runtime", "residual"];

    /// - `paper`: damaged from the start and diagnosed at once (Verma et al., 2019, Algorithm 1).
    /// - `runtime`: the damage strikes in mid-gait and is noticed later, as when a walking robot breaks.
    /// - `residual`: the same, but before every step the twin is put beside the robot and takes its action, so that
    ///   what it does differently is the damage of this one step. A free twin soon walks another way for reasons of
    ///   its own: small differences grow from step to step.
    pub fn named(name: &str) -> Result<Self> {
        let mid_gait = Timing { onset: Span { first: 20, last: 150 }, delay: Span { first: 20, last: 80 } };
        match name {
            "paper" => Ok(Self { timing: Timing::default(), twin: Twin::default() }),
            "runtime" => Ok(Self { timing: mid_gait, twin: Twin::default() }),
            "residual" => Ok(Self { timing: mid_gait, twin: Twin { action: TwinAction::Shared, resync: 1 } }),
            _ => Err(LearnError::Config {
                key: "preset",
                got: format!("`{name}`"),
                expected: "`paper`, `runtime` or `residual`",
            }),
        }
    }

    /// The name of this way, or `custom`.
    #[must_use]
    pub fn name(&self) -> &'static str {
        let is_this = |name: &&&str| Self::named(name).is_ok_and(|preset| preset == *self);
        Self::NAMES.iter().find(is_this).copied().unwrap_or("custom")
    }

    /// Whether each damage class needs a twin of its own. Otherwise the run of the healthy class is the twin of all.
    #[must_use]
    pub fn needs_twins(&self) -> bool {
        !self.timing.starts_at_reset() || self.twin != Twin::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn presets_are_known_by_what_they_do() {
        for name in Preset::NAMES {
            assert_eq!(Preset::named(name).unwrap().name(), name);
        }
        let [paper, runtime, residual] = Preset::NAMES.map(|name| Preset::named(name).unwrap());
        assert!(!paper.needs_twins() && runtime.needs_twins() && residual.needs_twins());
        assert_eq!(Preset { timing: paper.timing, ..residual }.name(), "custom");
        assert!(Preset::named("gait").unwrap_err().to_string().contains("`gait`"));
    }
}
