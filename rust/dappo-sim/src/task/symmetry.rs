//! Left-right symmetry: what observations, actions and damage codes become when a robot is reflected at the plane y = 0.
//!
//! Under this reflection vectors such as forces and velocities keep x and z and change the sign of y; axial vectors,
//! angular velocities and torques among them, keep y and change the signs of x and z. Parts of the robot take the place
//! of their mirror images.

use std::ops::Range;

use super::anatomy::JointParts;
use super::observation::{ObservationGroup, Quantity};
use super::{Measure, RewardTerm, Task};
use crate::backend::Layout;
use crate::damage::DamageSpace;
use crate::error::SimError;

/// A part of a robot that is the mirror image of another one, and the sign that its coordinate then has.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Image {
    /// Index of the part whose mirror image it is.
    pub of: usize,
    /// 1 or −1.
    pub sign: f32,
}

/// Which parts of a robot are mirror images of each other.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct MirroredParts {
    /// Of each limb, the limb whose mirror image it is.
    pub limbs: Vec<usize>,
    /// Of each body, the world included, the body whose mirror image it is.
    pub bodies: Vec<usize>,
    /// Of each joint after the free one, in the order of qpos.
    pub joints: Vec<Image>,
    /// Of each actuator.
    pub actuators: Vec<Image>,
}

/// The reflection of a vector: each entry of the result is an entry of the vector or its negative.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Reflection {
    entries: Vec<Image>,
}

/// The reflections of what a learner sees and does.
#[derive(Debug, Clone, PartialEq)]
pub struct Reflections {
    /// Of a row of observations: those of the policy, privileged ones, and the damage code where it is observed.
    pub obs: Reflection,
    /// Of an action.
    pub action: Reflection,
}

/// Entries of vectors and axial vectors, and of a quaternion (w, x, y, z).
const VECTOR: [f32; 3] = [1.0, -1.0, 1.0];
const AXIAL: [f32; 3] = [-1.0, 1.0, -1.0];
const QUATERNION: [f32; 4] = [1.0, -1.0, 1.0, -1.0];
/// Forward and lateral velocity, and rate of turn.
const COMMAND: [f32; 3] = [1.0, -1.0, -1.0];
/// Positions of the free joint.
const ROOT: usize = VECTOR.len() + QUATERNION.len();

impl Reflection {
    /// A reflection with these entries.
    #[must_use]
    pub fn new(entries: Vec<Image>) -> Self {
        Self { entries }
    }

    /// The reflection that changes nothing.
    #[must_use]
    pub fn identity(length: usize) -> Self {
        Self::of_signs(&vec![1.0; length])
    }

    /// Entries that keep their place and take these signs.
    fn of_signs(signs: &[f32]) -> Self {
        Self { entries: signs.iter().enumerate().map(|(of, &sign)| Image { of, sign }).collect() }
    }

    /// Blocks that take each other's place, and the signs of the entries of a block.
    fn of_blocks(images: &[usize], signs: &[f32]) -> Self {
        let block = |of: &usize| {
            let start = of * signs.len();
            signs.iter().enumerate().map(move |(entry, &sign)| Image { of: start + entry, sign })
        };
        Self { entries: images.iter().flat_map(block).collect() }
    }

    /// The reflection of a vector whose blocks are reflected so.
    fn concat(blocks: impl IntoIterator<Item = Self>) -> Self {
        let mut entries = Vec::new();
        for block in blocks {
            let start = entries.len();
            entries.extend(block.entries.iter().map(|image| Image { of: start + image.of, ..*image }));
        }
        Self { entries }
    }

    /// The reflection of vectors without some entries; `None` if those are mirror images of others.
    #[must_use]
    pub fn without(&self, left_out: Range<usize>) -> Option<Self> {
        let kept = self.entries.iter().enumerate().filter(|(index, _)| !left_out.contains(index));
        let entries = kept.map(|(_, image)| match image.of {
            of if left_out.contains(&of) => None,
            of if of < left_out.start => Some(*image),
            of => Some(Image { of: of - left_out.len(), ..*image }),
        });
        Some(Self { entries: entries.collect::<Option<_>>()? })
    }

    /// That of vectors with those of `other` behind them.
    #[must_use]
    pub fn followed_by(&self, other: &Self) -> Self {
        Self::concat([self.clone(), other.clone()])
    }

    /// Length of the vectors that it is for.
    #[must_use]
    pub fn len(&self) -> usize {
        self.entries.len()
    }

    /// Whether the vectors have no entries.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }

    /// Of each entry of a reflected vector, what it is of the vector.
    #[must_use]
    pub fn entries(&self) -> &[Image] {
        &self.entries
    }

    /// Writes the reflection of `vector` into `out`.
    ///
    /// # Shapes
    /// vector, out `[len]`
    pub fn apply(&self, vector: &[f32], out: &mut [f32]) {
        for (entry, image) in out.iter_mut().zip(&self.entries) {
            *entry = image.sign * vector[image.of];
        }
    }
}

impl Task {
    /// The reflections of observations and actions; `codes` are the damage classes if observations end with the code.
    ///
    /// # Errors
    /// If something that is observed, done or rewarded has no mirror image.
    pub fn reflections(
        &self,
        symmetry: &MirroredParts,
        codes: Option<&DamageSpace>,
    ) -> Result<Reflections, SimError> {
        let refuse = |why: String| SimError::Config(format!("the task has no mirror image: {why}"));
        self.check_symmetry(symmetry).map_err(refuse)?;
        let events = self.event_names();
        let parts = Parts { symmetry, layout: &self.layout, events: &events };
        let groups = [&self.policy].into_iter().chain(&self.critic);
        let mut blocks = Vec::new();
        for (term, _) in groups.flat_map(ObservationGroup::blocks) {
            let block = parts.reflection(&term.quantity).map_err(refuse)?;
            blocks.extend(std::iter::repeat_n(block, term.history));
        }
        blocks.extend(
            codes.map(|space| Reflection::of_blocks(&symmetry.limbs, &vec![1.0; space.types().len()])),
        );
        Ok(Reflections {
            obs: Reflection::concat(blocks),
            action: Reflection::new(symmetry.actuators.clone()),
        })
    }

    /// Refuses actions, commands and rewards that differ between left and right.
    fn check_symmetry(&self, symmetry: &MirroredParts) -> Result<(), String> {
        let actuators = &self.layout.anatomy.actuators;
        for ((action, image), actuator) in self.actions.iter().zip(&symmetry.actuators).zip(actuators) {
            let other = &self.actions[image.of];
            let offset = f64::from(image.sign) * other.offset;
            if action.scale != other.scale || (action.offset - offset).abs() > ANGLE_TOLERANCE {
                return Err(format!(
                    "the actions of `{}` have another scale or another default than those of `{}`, its mirror image",
                    actuator.name, actuators[image.of].name
                ));
            }
        }
        let command = self.command.iter();
        let ranges = command.flat_map(|it| [("lin_vel_y", it.lin_vel_y), ("ang_vel_z", it.ang_vel_z)]);
        for (name, [low, high]) in ranges {
            if low != -high {
                return Err(format!(
                    "[commands.velocity] {name} is [{low}, {high}], expected a range from -x to x"
                ));
            }
        }
        let bodies = self.limits.bodies();
        if let Some(body) = bodies.iter().find(|body| !bodies.contains(&symmetry.bodies[**body])) {
            return Err(format!(
                "[terminations.contact] lists the body `{}`, but not its mirror image",
                self.layout.anatomy.bodies[*body]
            ));
        }
        let python = |term: &&RewardTerm| matches!(term.measure, Measure::Python { .. });
        let reward = self.rewards.iter().find(python).map(|term| format!("reward term `{}`", term.name));
        let failure = self.python_failures.first().map(|function| format!("termination `{function}`"));
        match reward.or(failure) {
            None => Ok(()),
            Some(what) => {
                Err(format!("the {what} is a Python function, which may differ between left and right"))
            }
        }
    }
}

/// By how much the angles of mirror images may differ, rad.
const ANGLE_TOLERANCE: f64 = 1e-3;

/// What entries of an observation refer to.
struct Parts<'a> {
    symmetry: &'a MirroredParts,
    layout: &'a Layout,
    /// Names of what the events draw.
    events: &'a [String],
}

impl Parts<'_> {
    /// The reflection of the entries of a quantity.
    fn reflection(&self, quantity: &Quantity) -> Result<Reflection, String> {
        let MirroredParts { limbs, bodies, joints, actuators } = self.symmetry;
        let (signs, limbs) = (Reflection::of_signs, |signs: &[f32]| Reflection::of_blocks(limbs, signs));
        let joints = || Reflection::new(joints.clone());
        Ok(match quantity {
            Quantity::Qpos { skip } => Reflection::concat([signs(&VECTOR), signs(&QUATERNION), joints()])
                .without(0..*skip)
                .ok_or_else(|| format!("the term `qpos` skips {skip} positions, expected at most 7"))?,
            Quantity::Qvel => Reflection::concat([signs(&VECTOR), signs(&AXIAL), joints()]),
            Quantity::CfrcExt => Reflection::of_blocks(bodies, &[AXIAL, VECTOR].concat()),
            Quantity::BaseHeight => signs(&[1.0]),
            Quantity::BaseLinVel | Quantity::ProjectedGravity => signs(&VECTOR),
            Quantity::BaseAngVel => signs(&AXIAL),
            Quantity::Command => signs(&COMMAND),
            Quantity::JointPos | Quantity::JointVel => self.actuated()?,
            Quantity::LastAction => Reflection::new(actuators.clone()),
            Quantity::Clock { .. } => signs(&[1.0; 2]),
            Quantity::Touch | Quantity::FootContact | Quantity::FootHeight | Quantity::FootAirTime => {
                limbs(&[1.0])
            }
            Quantity::FootVel => limbs(&VECTOR),
            Quantity::Events => {
                Reflection::new(self.events.iter().map(|name| self.event(name)).collect::<Result<_, _>>()?)
            }
            Quantity::Python { function, .. } => {
                return Err(format!("the term `python` is what {function} returns"));
            }
        })
    }

    /// Of the joints behind the actuators.
    fn actuated(&self) -> Result<Reflection, String> {
        let image = |(index, image): (usize, &Image)| {
            let joint = self.layout.anatomy.actuators[index].joint.as_ref();
            let sign = joint.and_then(|joint| self.sign(joint)).ok_or("an actuator turns no joint")?;
            Ok(Image { of: image.of, sign })
        };
        let images = self.symmetry.actuators.iter().enumerate().map(image).collect::<Result<_, String>>()?;
        Ok(Reflection::new(images))
    }

    fn sign(&self, joint: &JointParts) -> Option<f32> {
        Some(self.symmetry.joints.get(joint.qpos.checked_sub(ROOT)?)?.sign)
    }

    /// Of a number that the events draw: its name has that of a part, of which there is a mirror image, and may end with
    /// an axis.
    fn event(&self, name: &str) -> Result<Image, String> {
        let Layout { anatomy, .. } = self.layout;
        let mut sign = 1.0;
        let mut image = Vec::new();
        for word in name.split(' ') {
            let joint = anatomy
                .actuators
                .iter()
                .position(|actuator| actuator.joint.as_ref().is_some_and(|joint| joint.name == word));
            if let Some(index) = joint {
                let other = &anatomy.actuators[self.symmetry.actuators[index].of];
                image.push(other.joint.as_ref().map_or(word, |joint| joint.name.as_str()));
                if name.starts_with("encoder_bias") {
                    sign *= anatomy.actuators[index]
                        .joint
                        .as_ref()
                        .and_then(|joint| self.sign(joint))
                        .unwrap_or(1.0);
                }
            } else if let Some(body) = anatomy.bodies.iter().position(|body| body == word) {
                image.push(&anatomy.bodies[self.symmetry.bodies[body]]);
            } else {
                image.push(word);
            }
        }
        let signs = if name.contains("base_ang_vel") { AXIAL } else { VECTOR };
        if let Some(axis) = ["x", "y", "z"].iter().position(|axis| name.ends_with(&format!(" {axis}"))) {
            sign *= signs[axis];
        }
        let image = image.join(" ");
        let of = self.events.iter().position(|event| *event == image);
        match of {
            Some(of) if name != "encoder_fault offset" => Ok(Image { of, sign }),
            _ => Err(format!("the events draw `{name}`, of which there is no mirror image")),
        }
    }
}
