//! What a controller did and why.

use serde::Serialize;

/// Something that happened to one robot.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Event {
    /// Index of the robot.
    pub robot: usize,
    /// Control steps since the robot's start.
    pub step: u64,
    /// What happened.
    #[serde(flatten)]
    pub kind: EventKind,
}

/// What can happen. Classes are damage classes.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum EventKind {
    /// The robot does not move as expected: a diagnosis window begins.
    Suspected {
        /// Mean forward velocity over the last steps, m/s.
        forward_velocity: f64,
        /// Forward velocity of the assumed class, m/s.
        expected: f64,
        /// Median residual over the last steps; none without a twin.
        residual: Option<f64>,
    },
    /// A diagnosis window has ended.
    Diagnosed {
        /// The most probable class.
        class: usize,
        /// Its probability.
        confidence: f32,
        /// Whether that was enough to accept it.
        accepted: bool,
    },
    /// The assumed class changes.
    Adapted {
        /// The class.
        class: usize,
    },
    /// A diagnosis explains the robot no better than no damage does: it is broken in a way that has no class,
    /// and the assumed class is healthy again.
    Withdrawn {
        /// The diagnosed class.
        class: usize,
        /// Median residual of the twin with its damage.
        residual: f64,
        /// Median residual of the healthy twin.
        healthy: f64,
    },
    /// Some entries of the observation are not finite; their last finite values are used, and nothing is compared.
    ObservationInvalid {
        /// How many entries.
        entries: usize,
    },
    /// All entries of the observation are finite again.
    ObservationValid,
}
