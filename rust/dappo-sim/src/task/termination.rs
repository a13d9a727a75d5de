//! Terminations: when an episode has failed.

use serde::Deserialize;

use super::memory::CONTACT_FORCE;
use super::{Scene, Signals};
use crate::backend::Layout;

/// The section `[terminations]`; an episode also fails when the physics diverges.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
pub struct Terminations {
    /// Range of heights (z) of the root, m.
    #[serde(default)]
    pub height: Option<[f64; 2]>,
    /// Largest angle between the root's z axis and the vertical.
    #[serde(default)]
    pub tilt: Option<TiltLimit>,
    /// Bodies that must not touch anything.
    #[serde(default)]
    pub contact: Option<ContactLimit>,
    /// Python functions that return failures.
    #[serde(default)]
    pub python: Option<PythonFailures>,
}

/// The table `[terminations.python]`.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
pub struct PythonFailures {
    /// `module:function`.
    pub functions: Vec<String>,
}

/// The table `[terminations.tilt]`.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
pub struct TiltLimit {
    /// Largest angle, rad.
    pub angle: f64,
}

/// The table `[terminations.contact]`.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct ContactLimit {
    /// Names of the bodies.
    pub bodies: Vec<String>,
    /// Contact force that ends the episode, N.
    #[serde(default = "touching")]
    pub force: f64,
}

fn touching() -> f64 {
    CONTACT_FORCE
}

/// Terminations of a compiled robot.
#[derive(Debug, Clone)]
pub(super) struct Limits {
    pub height: [f64; 2],
    /// Cosine of the largest tilt.
    pub cosine: f64,
    bodies: Vec<usize>,
    pub force: f64,
}

impl Limits {
    pub fn new(terminations: &Terminations, layout: &Layout) -> Result<Self, String> {
        let index = |name: &String| {
            let bodies = &layout.anatomy.bodies;
            bodies.iter().position(|body| body == name).ok_or_else(|| {
                format!(
                    "[terminations.contact]: the MJCF has no body `{name}`; they are {}",
                    bodies.join(", ")
                )
            })
        };
        let contact = terminations.contact.as_ref();
        let bodies = contact.map_or(&[][..], |contact| &contact.bodies);
        Ok(Self {
            height: terminations.height.unwrap_or([f64::NEG_INFINITY, f64::INFINITY]),
            cosine: terminations.tilt.map_or(-2.0, |tilt| tilt.angle.cos()),
            bodies: bodies.iter().map(index).collect::<Result<_, _>>()?,
            force: contact.map_or(CONTACT_FORCE, |contact| contact.force),
        })
    }

    /// Indices of the bodies that must not touch anything.
    pub fn bodies(&self) -> &[usize] {
        &self.bodies
    }

    /// Whether the episode has failed.
    pub fn are_exceeded(&self, scene: &Scene<'_>) -> bool {
        let Signals { qpos, .. } = scene.signals;
        let [low, high] = self.height;
        let touches = |&body: &usize| {
            scene.signals.contact_force(body).iter().map(|f| f * f).sum::<f64>() > self.force * self.force
        };
        !(low..=high).contains(&qpos[2]) || -scene.gravity[2] < self.cosine || self.bodies.iter().any(touches)
    }
}
