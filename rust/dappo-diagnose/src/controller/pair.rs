//! A robot and its twin in the run-time loop.

use super::ControllerConfig;
use super::probation::Probation;
use super::suspicion::Suspicion;
use crate::Window;

/// What a controller with twins stores of one robot.
pub(super) struct Pair {
    /// Damage class of the twin.
    pub twin_class: usize,
    /// Whether the twin has taken the step whose observation comes next.
    pub has_prediction: bool,
    /// Evidence of damage while the robot walks.
    pub suspicion: Suspicion,
    /// The diagnosis window so far, if one is being recorded.
    pub window: Option<Window>,
    /// Evidence for the last diagnosis, until the probation ends.
    pub probation: Option<Probation>,
}

impl Pair {
    /// A robot that is assumed healthy.
    pub fn new(config: &ControllerConfig) -> Self {
        Self {
            twin_class: usize::MAX,
            has_prediction: false,
            suspicion: Suspicion::new(config),
            window: None,
            probation: None,
        }
    }
}
