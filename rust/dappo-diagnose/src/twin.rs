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

/// How the twin is led.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Twin {
    /// Whose actions it takes.
    pub action: TwinAction,
    /// Steps after which it is put into the state that the robot observes, over and over; 0 = only when the window
    /// begins.
    pub resync: u32,
}

impl Twin {
    /// Whether it is put beside the robot again before step `step` of the window, the first being 0.
    #[must_use]
    pub(crate) fn resyncs_before(self, step: usize) -> bool {
        step > 0 && self.resync > 0 && step.is_multiple_of(self.resync as usize)
    }
}
