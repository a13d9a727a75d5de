//! Terms of the reward.

use serde::Deserialize;

use super::Signals;
use crate::backend::Layout;

/// One weighted summand of a reward.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(tag = "term", rename_all = "snake_case", deny_unknown_fields)]
pub enum RewardTerm {
    /// Velocity of the main body along +x, m/s.
    ForwardVelocity {
        /// Factor of the term.
        weight: f64,
    },
    /// 1 for every step that does not end in failure.
    Survive {
        /// Factor of the term.
        weight: f64,
    },
    /// Number of limbs in contact: any body of the limb carries an external force.
    LimbContacts {
        /// Factor of the term.
        weight: f64,
    },
    /// ‖ctrl‖².
    CtrlSquared {
        /// Factor of the term.
        weight: f64,
    },
    /// ‖clip(`cfrc_ext`)‖² over all bodies.
    ContactForcesSquared {
        /// Factor of the term.
        weight: f64,
        /// Bound of each component.
        clip: f64,
    },
    /// ‖τ‖² with `τ_i` = Σ of the squared, clipped components of `cfrc_ext` of body i.
    LinkLoadsSquared {
        /// Factor of the term.
        weight: f64,
        /// Bound of each component.
        clip: f64,
    },
}

impl RewardTerm {
    /// Value of the term, its weight included.
    #[must_use]
    pub fn value(&self, signals: &Signals, layout: &Layout, terminated: bool) -> f64 {
        match self {
            Self::ForwardVelocity { weight } => weight * signals.forward_velocity,
            Self::Survive { weight } => {
                if terminated {
                    0.0
                } else {
                    *weight
                }
            }
            Self::LimbContacts { weight } => weight * limbs_in_contact(signals.cfrc_ext, layout) as f64,
            Self::CtrlSquared { weight } => weight * signals.ctrl.iter().map(|c| c * c).sum::<f64>(),
            Self::ContactForcesSquared { weight, clip } => weight * clipped_square(signals.cfrc_ext, *clip),
            Self::LinkLoadsSquared { weight, clip } => {
                weight
                    * signals
                        .cfrc_ext
                        .chunks_exact(6)
                        .map(|body| clipped_square(body, *clip).powi(2))
                        .sum::<f64>()
            }
        }
    }
}

fn clipped_square(forces: &[f64], clip: f64) -> f64 {
    forces.iter().map(|force| force.clamp(-clip, clip).powi(2)).sum()
}

fn limbs_in_contact(cfrc_ext: &[f64], layout: &Layout) -> usize {
    let touched = |body: usize| cfrc_ext[body * 6..body * 6 + 6].iter().any(|component| *component != 0.0);
    layout.limb_bodies.iter().filter(|bodies| bodies.iter().any(|&body| touched(body))).count()
}
