//! The state of one robot in the run-time loop.

use super::ControllerConfig;
use super::probation::Probation;
use super::suspicion::Suspicion;
use crate::Window;

/// What a controller stores of one robot.
pub(super) struct Robot {
    /// Control steps since its start.
    pub step: u64,
    /// The assumed class.
    pub class: usize,
    /// Damage class of its twin.
    pub twin_class: usize,
    /// Whether the twin has taken the step whose observation comes next.
    pub has_prediction: bool,
    /// Whether some of its last readings were not finite.
    pub is_blind: bool,
    /// Evidence of damage while it walks.
    pub suspicion: Suspicion,
    /// The diagnosis window so far, if one is being recorded.
    pub window: Option<Window>,
    /// Evidence for the last diagnosis, until the probation ends.
    pub probation: Option<Probation>,
}

impl Robot {
    /// A robot that is assumed healthy.
    pub fn new(config: &ControllerConfig) -> Self {
        Self {
            step: 0,
            class: 0,
            twin_class: usize::MAX,
            has_prediction: false,
            is_blind: false,
            suspicion: Suspicion::new(config),
            window: None,
            probation: None,
        }
    }
}
