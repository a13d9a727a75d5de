//! Terms of the reward.

use serde::Deserialize;

use super::memory::FootRow;
use super::{Scene, Signals};

/// A named, weighted summand of a reward.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct RewardTerm {
    /// Name in logs; that of the term unless a file gives it another.
    #[serde(default)]
    pub name: String,
    /// Factor of the term.
    pub weight: f64,
    /// What is summed.
    #[serde(flatten)]
    pub measure: Measure,
}

/// Something that a reward measures, without its weight. A std is that of a Gaussian exp(−(error / std)²), as in Isaac
/// Lab and mjlab.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(tag = "term", rename_all = "snake_case")]
pub enum Measure {
    /// Velocity of the main body along +x, m/s.
    ForwardVelocity,
    /// 1 for every step that does not end in failure.
    Survive,
    /// 1 for a step that ends in failure.
    Termination,
    /// Number of limbs in contact: any body of the limb carries an external force.
    LimbContacts,
    /// ‖ctrl‖².
    CtrlSquared,
    /// ‖clip(`cfrc_ext`)‖² over all bodies.
    ContactForcesSquared {
        /// Bound of each component.
        clip: f64,
    },
    /// ‖τ‖² with `τ_i` = Σ of the squared, clipped components of `cfrc_ext` of body i.
    LinkLoadsSquared {
        /// Bound of each component.
        clip: f64,
    },
    /// exp(−‖v − v*‖² / std²) of the root's velocity along its own x and y and the commanded one.
    TrackLinVel {
        /// m/s.
        std: f64,
    },
    /// exp(−(ω − ω*)² / std²) of the root's rate of turn about its own z and the commanded one.
    TrackAngVel {
        /// rad/s.
        std: f64,
    },
    /// exp(−‖g‖² / std²) with g the x and y of the projected gravity.
    Upright {
        /// Sine of a tilt.
        std: f64,
    },
    /// ‖g‖² with g the x and y of the projected gravity: the squared sine of the tilt.
    TiltSquared,
    /// Square of the root's velocity along its own z, m²/s².
    LinVelZSquared,
    /// Square of the root's rates of roll and pitch, rad²/s².
    AngVelXySquared,
    /// (z − target)² of the root, m².
    BaseHeightSquared {
        /// Height, m.
        target: f64,
    },
    /// ‖a − a′‖² of the last two actions, clipped to ±1.
    ActionRateSquared,
    /// Σ of the squared forces of the actuators, N²·m².
    TorqueSquared,
    /// Σ |force · joint velocity| of the actuators, W.
    Power,
    /// Σ of how far actuated joints are beyond the inner part of their range, rad.
    JointLimits {
        /// Share of the range around its middle that is allowed.
        soft: f64,
    },
    /// ‖q − q₀‖² of the actuated joints and the default pose, rad².
    PoseSquared,
    /// exp(−mean((q − q₀)²) / std²) of the actuated joints and the default pose.
    Pose {
        /// rad.
        std: f64,
    },
    /// Σ |q − q₀| of the actuated joints while the command is to stand still, rad.
    StandStill,
    /// Σ (time in the air − threshold) of the feet that land in this step, unless the command is to stand still, s.
    FeetAirTime {
        /// s.
        threshold: f64,
    },
    /// Σ ‖v‖² of the feet in contact, along the floor, m²/s².
    FeetSlip,
    /// Σ |z − target| · ‖v‖ of the feet, v along the floor, m²/s.
    FeetClearance {
        /// Height of the feet, m.
        target: f64,
    },
    /// Σ contact force of the feet that land in this step, N.
    Landing,
    /// What a Python function returns, which whoever runs Python adds.
    Python {
        /// `module:function`.
        function: String,
    },
}

/// Commands up to here, m/s and rad/s, are to stand still.
const STANDING: f64 = 0.1;

impl Measure {
    /// Whether it follows from the motion of the feet.
    pub(super) fn needs_feet(&self) -> bool {
        matches!(self, Self::FeetAirTime { .. } | Self::FeetSlip | Self::FeetClearance { .. } | Self::Landing)
    }

    /// Whether it follows from the command.
    pub(super) fn needs_command(&self) -> bool {
        matches!(
            self,
            Self::TrackLinVel { .. } | Self::TrackAngVel { .. } | Self::StandStill | Self::FeetAirTime { .. }
        )
    }

    /// Whether it follows from the hinges of the actuators.
    pub(super) fn needs_joints(&self) -> bool {
        matches!(
            self,
            Self::Power | Self::JointLimits { .. } | Self::PoseSquared | Self::Pose { .. } | Self::StandStill
        )
    }

    /// Value of the term, without its weight.
    pub(super) fn value(&self, scene: &Scene<'_>, terminated: bool) -> f64 {
        let Scene { signals, layout, .. } = scene;
        let Signals { qpos, qvel, actuator_force, .. } = signals;
        let actuated = || layout.anatomy.actuators.iter().filter_map(|actuator| actuator.joint.as_ref());
        let deviations = || actuated().map(|joint| qpos[joint.qpos] - layout.anatomy.start[joint.qpos]);
        let feet = |value: fn(&FootRow<'_>) -> f64| scene.feet().map(|foot| value(&foot)).sum::<f64>();
        let gaussian = |square: f64, std: f64| (-square / (std * std)).exp();
        match self {
            Self::ForwardVelocity => signals.forward_velocity,
            Self::Survive => f64::from(u8::from(!terminated)),
            Self::Termination => f64::from(u8::from(terminated)),
            Self::LimbContacts => limbs_in_contact(signals.cfrc_ext, &layout.limb_bodies) as f64,
            Self::CtrlSquared => squared(signals.ctrl),
            Self::ContactForcesSquared { clip } => clipped_square(signals.cfrc_ext, *clip),
            Self::LinkLoadsSquared { clip } => {
                signals.cfrc_ext.chunks_exact(6).map(|body| clipped_square(body, *clip).powi(2)).sum()
            }
            Self::TrackLinVel { std } => {
                let [x, y, _] = scene.lin_vel;
                let command = scene.command();
                gaussian((x - command[0]).powi(2) + (y - command[1]).powi(2), *std)
            }
            Self::TrackAngVel { std } => gaussian((qvel[5] - scene.command()[2]).powi(2), *std),
            Self::Upright { std } => gaussian(squared(&scene.gravity[..2]), *std),
            Self::TiltSquared => squared(&scene.gravity[..2]),
            Self::LinVelZSquared => scene.lin_vel[2].powi(2),
            Self::AngVelXySquared => squared(&qvel[3..5]),
            Self::BaseHeightSquared { target } => (qpos[2] - target).powi(2),
            Self::ActionRateSquared => {
                let pairs = scene.action().iter().zip(scene.previous_action());
                pairs.map(|(now, before)| (now - before).powi(2)).sum()
            }
            Self::TorqueSquared => squared(actuator_force),
            Self::Power => {
                let pairs = actuated().zip(*actuator_force);
                pairs.map(|(joint, force)| (force * qvel[joint.dof]).abs()).sum()
            }
            Self::JointLimits { soft } => actuated()
                .map(|joint| {
                    let [low, high] = joint.range;
                    let (middle, half) = (f64::midpoint(low, high), 0.5 * soft * (high - low));
                    // Without limits the middle is not a number, and nothing is beyond it.
                    ((qpos[joint.qpos] - middle).abs() - half).max(0.0)
                })
                .sum(),
            Self::PoseSquared => deviations().map(|deviation| deviation * deviation).sum(),
            Self::Pose { std } => {
                let square: f64 = deviations().map(|deviation| deviation * deviation).sum();
                gaussian(square / layout.nu as f64, *std)
            }
            Self::StandStill if scene.is_standing_commanded() => deviations().map(f64::abs).sum(),
            Self::StandStill | Self::Python { .. } => 0.0,
            Self::FeetAirTime { .. } if scene.is_standing_commanded() => 0.0,
            Self::FeetAirTime { threshold } => scene
                .feet()
                .filter(|foot| foot.landed_after() > 0.0)
                .map(|foot| foot.landed_after() - threshold)
                .sum(),
            Self::FeetSlip => feet(|foot| if foot.is_in_contact() { foot.speed().powi(2) } else { 0.0 }),
            Self::FeetClearance { target } => {
                scene.feet().map(|foot| (foot.height() - target).abs() * foot.speed()).sum()
            }
            Self::Landing => feet(|foot| if foot.landed_after() > 0.0 { foot.force() } else { 0.0 }),
        }
    }
}

impl Scene<'_> {
    fn is_standing_commanded(&self) -> bool {
        squared(self.command()) <= STANDING * STANDING
    }
}

fn squared(values: &[f64]) -> f64 {
    values.iter().map(|value| value * value).sum()
}

fn clipped_square(forces: &[f64], clip: f64) -> f64 {
    let square = |force: &f64| force.abs().min(clip).powi(2);
    // Two sums at a time, which do not wait for each other.
    let (pairs, last) = forces.as_chunks();
    let [even, odd] = pairs.iter().fold([0.0; 2], |[even, odd], [a, b]| [even + square(a), odd + square(b)]);
    even + odd + last.iter().map(square).sum::<f64>()
}

fn limbs_in_contact(cfrc_ext: &[f64], limb_bodies: &[Vec<usize>]) -> usize {
    let touched = |body: usize| cfrc_ext[body * 6..body * 6 + 6].iter().any(|component| *component != 0.0);
    limb_bodies.iter().filter(|bodies| bodies.iter().any(|&body| touched(body))).count()
}
