//! The healthy twin: a simulated robot that does what the real one would do if it were not damaged.

use serde::{Deserialize, Serialize};
use strum::{EnumString, IntoStaticStr, VariantNames};

/// Whose actions the twin takes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[derive(EnumString, IntoStaticStr, VariantNames)]
#[strum(serialize_all = "snake_case")]
pub enum TwinAction {
    /// The expert's, on the twin's own observation.
    #[default]
    Own,
    /// The damaged robot's.
    Shared,
}

/// The mode of a twin.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Twin {
    /// Whose actions it takes.
    pub action: TwinAction,
    /// Steps after which it is re-synchronised with the observed state of the robot; 0 = only when the window
    /// begins.
    pub resync: u32,
}

impl Twin {
    /// Whether it is re-synchronised before step `step` of the window, the first being 0.
    #[must_use]
    pub(crate) fn resyncs_before(self, step: usize) -> bool {
        step > 0 && self.resync > 0 && step.is_multiple_of(self.resync as usize)
    }
}
