//! What each entry of an observation is, for programs that have to fill one in: a robot, or another simulator.

use serde::{Deserialize, Serialize};

use super::anatomy::JointParts;
use super::observation::{ObservationTerm, Quantity};
use crate::backend::Layout;

/// One entry of an observation.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Entry {
    /// The term, the part of the robot and the axis, such as `joint_pos FR_hip_joint` or `base_ang_vel z`.
    pub name: String,
    /// Unit of the quantity, before the term's scale; empty for a number without a unit.
    pub unit: String,
}

/// Names of what a robot's entries refer to, apart from its layout.
#[derive(Debug, Clone, Copy)]
pub(super) struct Parts<'a> {
    pub layout: &'a Layout,
    /// Names of the limbs.
    pub limbs: &'a [String],
    /// What the events draw.
    pub events: &'a [String],
}

const AXES: [&str; 3] = ["x", "y", "z"];
/// A contact force on a body in the order of `cfrc_ext`, with its units.
const WRENCH: [(&str, &str); 6] = [
    ("torque x", "N·m"),
    ("torque y", "N·m"),
    ("torque z", "N·m"),
    ("force x", "N"),
    ("force y", "N"),
    ("force z", "N"),
];
const ROOT_POSITION: [(&str, &str); 7] =
    [("x", "m"), ("y", "m"), ("z", "m"), ("quat w", ""), ("quat x", ""), ("quat y", ""), ("quat z", "")];
const ROOT_VELOCITY: [(&str, &str); 6] = [
    ("lin x", "m/s"),
    ("lin y", "m/s"),
    ("lin z", "m/s"),
    ("ang x", "rad/s"),
    ("ang y", "rad/s"),
    ("ang z", "rad/s"),
];

impl ObservationTerm {
    /// The entries of the block, the oldest step of its history first.
    pub(super) fn entries(&self, parts: Parts<'_>) -> Vec<Entry> {
        let term = self.quantity.name();
        let entry = |(what, unit): (String, &str), suffix: &str| Entry {
            name: [term, &what, suffix]
                .into_iter()
                .filter(|part| !part.is_empty())
                .collect::<Vec<_>>()
                .join(" "),
            unit: unit.to_owned(),
        };
        let ages = (0..self.history).rev();
        ages.flat_map(|age| {
            let suffix = if self.history > 1 { format!("t-{}", age + self.delay) } else { String::new() };
            let entries = self.quantity.entries(parts).into_iter();
            entries.map(|part| entry(part, &suffix)).collect::<Vec<_>>()
        })
        .collect()
    }
}

impl Quantity {
    /// What each entry is besides the name of the term, and its unit.
    fn entries(&self, parts: Parts<'_>) -> Vec<(String, &'static str)> {
        let Parts { layout, limbs, events } = parts;
        let axes = |unit| AXES.map(|axis| (axis.to_owned(), unit)).to_vec();
        let feet = |unit| limbs.iter().map(|limb| (limb.clone(), unit)).collect();
        let joints = |unit| {
            let name = |joint: &Option<JointParts>| {
                joint.as_ref().map_or_else(String::new, |joint| joint.name.clone())
            };
            layout.anatomy.actuators.iter().map(|actuator| (name(&actuator.joint), unit)).collect()
        };
        match self {
            Self::Qpos { skip } => coordinates(layout, layout.nq, &ROOT_POSITION, "rad", |joint| joint.qpos)
                .skip(*skip)
                .collect(),
            Self::Qvel => {
                coordinates(layout, layout.nv, &ROOT_VELOCITY, "rad/s", |joint| joint.dof).collect()
            }
            Self::CfrcExt => {
                let bodies = layout.anatomy.bodies.iter();
                bodies.flat_map(|body| WRENCH.map(|(part, unit)| (format!("{body} {part}"), unit))).collect()
            }
            Self::Touch | Self::FootContact => feet(""),
            Self::BaseHeight => vec![(String::new(), "m")],
            Self::BaseLinVel => axes("m/s"),
            Self::BaseAngVel => axes("rad/s"),
            Self::ProjectedGravity => axes(""),
            Self::Command => {
                [("lin_vel_x", "m/s"), ("lin_vel_y", "m/s"), ("ang_vel_z", "rad/s")].map(owned).to_vec()
            }
            Self::JointPos => joints("rad"),
            Self::JointVel => joints("rad/s"),
            Self::LastAction => {
                layout.anatomy.actuators.iter().map(|actuator| (actuator.name.clone(), "")).collect()
            }
            Self::Clock { .. } => [("sin", ""), ("cos", "")].map(owned).to_vec(),
            Self::FootVel => {
                let of = |limb: &String| AXES.map(|axis| (format!("{limb} {axis}"), "m/s"));
                limbs.iter().flat_map(of).collect()
            }
            Self::FootHeight => feet("m"),
            Self::FootAirTime => feet("s"),
            Self::Events => events.iter().map(|event| (event.clone(), "")).collect(),
            Self::Python { function, size } => {
                (0..*size).map(|index| (format!("{function} {index}"), "")).collect()
            }
        }
    }
}

fn owned((name, unit): (&str, &'static str)) -> (String, &'static str) {
    (name.to_owned(), unit)
}

/// The entries of qpos or qvel: those of the root, then hinges, which have a number where no actuator moves them.
fn coordinates<'a>(
    layout: &'a Layout,
    count: usize,
    root: &'a [(&'a str, &'static str)],
    unit: &'static str,
    index: fn(&JointParts) -> usize,
) -> impl Iterator<Item = (String, &'static str)> + 'a {
    let of_hinge = move |at: usize| {
        let joints = layout.anatomy.actuators.iter().filter_map(|actuator| actuator.joint.as_ref());
        joints.filter(|joint| index(joint) == at).map(|joint| joint.name.clone()).next()
    };
    (0..count).map(move |at| match root.get(at) {
        Some(&(name, unit)) => (format!("root {name}"), unit),
        None => (of_hinge(at).unwrap_or_else(|| at.to_string()), unit),
    })
}
