//! Terms of the observation vector.

use serde::{Deserialize, Serialize};

use super::Signals;
use crate::backend::Layout;

/// One block of the observation vector.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "term", rename_all = "snake_case", deny_unknown_fields)]
pub enum ObservationTerm {
    /// Positions but for the first `skip` entries (2 leaves out the root's x and y).
    Qpos {
        /// Entries left out.
        #[serde(default)]
        skip: usize,
    },
    /// Velocities.
    Qvel,
    /// External contact forces of all bodies, the world's zero row included, clipped to ±`clip`.
    CfrcExt {
        /// Bound of each component, N or N·m.
        clip: f64,
    },
    /// One 0/1 entry a limb: its touch sensor reads a positive force.
    Touch,
}

impl ObservationTerm {
    /// Number of entries.
    #[must_use]
    pub fn len(&self, layout: &Layout) -> usize {
        match self {
            Self::Qpos { skip } => layout.nq.saturating_sub(*skip),
            Self::Qvel => layout.nv,
            Self::CfrcExt { .. } => layout.nbody * 6,
            Self::Touch => layout.touch_addresses.len(),
        }
    }

    /// Writes the term into `out`, which has the term's length.
    pub fn write(&self, signals: &Signals, layout: &Layout, out: &mut [f32]) {
        let copy = |out: &mut [f32], source: &[f64]| {
            for (entry, value) in out.iter_mut().zip(source) {
                *entry = *value as f32;
            }
        };
        match self {
            Self::Qpos { skip } => copy(out, &signals.qpos[*skip..]),
            Self::Qvel => copy(out, signals.qvel),
            Self::CfrcExt { clip } => {
                for (entry, value) in out.iter_mut().zip(signals.cfrc_ext) {
                    *entry = value.clamp(-clip, *clip) as f32;
                }
            }
            Self::Touch => {
                for ((entry, &address), &disabled) in
                    out.iter_mut().zip(&layout.touch_addresses).zip(signals.disabled_touch)
                {
                    *entry = if !disabled && signals.sensordata[address] > 0.0 { 1.0 } else { 0.0 };
                }
            }
        }
    }
}
