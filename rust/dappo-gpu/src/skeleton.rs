//! What all damage classes of a robot have in common, and which thread has what of it.

use dappo_lanes::Model;
use dappo_lanes::model::{Cone, Link, Point, Surface, Vector};

use crate::error::Error;
use crate::shape::{JointShape, MAX_JOINTS, MAX_LANES, MAX_SLOTS, Shape, Slot, SurfaceShape};

const IDENTITY: [Vector; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
const UNLIMITED: [f64; 2] = [f64::NEG_INFINITY, f64::INFINITY];

/// The shared part of a robot.
pub struct Skeleton {
    pub shape: Shape,
    pub joints: Vec<Joint>,
    /// Index of the point in each slot, `[lanes][slots]`.
    pub points: Vec<Vec<Option<usize>>>,
    /// Body of each thread's accumulators, `[lanes][bodies]`; `None` where it has no point.
    pub bodies: Vec<Vec<Option<usize>>>,
    /// Touch sensor of each thread's accumulators, `[lanes][touches]`.
    pub touches: Vec<Vec<Option<usize>>>,
    /// Number of degrees of freedom.
    pub dofs: usize,
    /// Number of bodies, the world included.
    pub num_bodies: usize,
    pub num_touches: usize,
}

/// Where a joint is.
pub struct Joint {
    /// Place among the joints of a row of coordinates, `lane · joints + joint`.
    pub place: usize,
    /// Index in qvel.
    pub dof: usize,
    /// Index in ctrl.
    pub actuator: Option<usize>,
}

/// What the points of a slot have in common.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Kind {
    moved_by: usize,
    surface: SurfaceShape,
    follows: bool,
    power: u8,
}

impl Skeleton {
    /// The skeleton of a robot; all classes must agree about it.
    ///
    /// # Errors
    /// All that the kernels do not support.
    pub fn new(classes: &[Model]) -> Result<Self, Error> {
        let Some(model) = classes.first() else {
            return Err(Error::Unsupported(vec!["there is no damage class".into()]));
        };
        let joints = model.limbs.iter().map(Vec::len).max().unwrap_or(0);
        let lanes = model.limbs.len().next_power_of_two();
        let reasons = refusals(classes, lanes, joints);
        if !reasons.is_empty() {
            return Err(Error::Unsupported(reasons));
        }
        let (kinds, points) = assign(&model.points, lanes);
        if kinds.len() > MAX_SLOTS {
            let count = kinds.len();
            let why = format!("each limb has {count} contact points; a thread has room for {MAX_SLOTS}");
            return Err(Error::Unsupported(vec![why]));
        }
        let (body_of, bodies) = accumulators(&points, |index| model.points[index].body);
        let (touch_of, touches) = accumulators(&points, |index| model.points[index].touch);
        // Slots whose points have no touch sensor need no accumulator.
        let sensed = |of: usize| touches.iter().any(|lane| lane[of].flatten().is_some());
        let kept: Vec<usize> = (0..touches.first().map_or(0, Vec::len)).filter(|&of| sensed(of)).collect();
        let mut slot = [Slot::default(); MAX_SLOTS];
        for (at, kind) in kinds.iter().enumerate() {
            slot[at] = Slot {
                moved_by: kind.moved_by,
                surface: kind.surface,
                follows: kind.follows,
                power: kind.power,
                body: body_of[at],
                touch: kept.iter().position(|&of| of == touch_of[at]),
            };
        }
        let inertias = || {
            let links = classes.iter().flat_map(|class| class.limbs.iter().flatten());
            classes.iter().map(|class| &class.root).chain(links.map(|link| &link.inertia))
        };
        let shape = Shape {
            lanes,
            joints,
            joint: joint_shapes(classes),
            slots: kinds.len(),
            slot,
            bodies: bodies.first().map_or(0, Vec::len),
            touches: kept.len(),
            integrator: model.integrator,
            compensates: inertias().any(|inertia| inertia.compensated != 0.0),
            damps_root: classes.iter().any(|class| class.root_damping != 0.0),
        };
        Ok(Self {
            shape,
            joints: joints_of(model, joints),
            points,
            bodies,
            touches: touches.iter().map(|lane| kept.iter().map(|&of| lane[of].flatten()).collect()).collect(),
            dofs: model.dofs(),
            num_bodies: model.bodies,
            num_touches: model.touch_sensors,
        })
    }
}

/// All that the kernels do not support of a robot.
fn refusals(classes: &[Model], lanes: usize, joints: usize) -> Vec<String> {
    let mut reasons = Vec::new();
    let model = &classes[0];
    for (index, class) in classes.iter().enumerate() {
        if let Some(what) = dappo_lanes::difference(model, class) {
            reasons.push(format!(
                "damage class {index} changes {what}, which the GPU engine keeps equal for all classes"
            ));
        }
    }
    if model.limbs.is_empty() || lanes > MAX_LANES || joints > MAX_JOINTS {
        let limbs = model.limbs.len();
        reasons.push(format!(
            "it has {limbs} limbs of up to {joints} joints; the GPU engine simulates 1 to {MAX_LANES} limbs of up to \
             {MAX_JOINTS} joints"
        ));
    }
    if model.trunk_joints() > 0 {
        reasons.push("limbs hang on another limb, its trunk; on the GPU engine all hang on the root".into());
    }
    if model.cone == Cone::Elliptic {
        reasons.push("its friction cones are elliptic; the GPU engine has pyramidal ones".into());
    }
    let other: Vec<_> = model.points.iter().filter(|point| point.dimensions != 3).collect();
    if let Some(point) = other.first() {
        reasons.push(format!(
            "{} of its contact points have condim {} or another than 3; the GPU engine has sliding friction alone",
            other.len(),
            point.dimensions
        ));
    }
    let power = |joint: usize| {
        let links = model.limbs.iter().filter_map(move |limb| limb.get(joint));
        let mut powers = links.map(|link| link.limit.power);
        let first = powers.next();
        powers.all(|power| Some(power) == first)
    };
    if !(0..joints).all(power) {
        reasons.push(
            "joints equally far from the root have limits whose impedance has different powers (solimp), which the GPU \
             engine does not distinguish"
                .into(),
        );
    }
    reasons
}

fn joint_shapes(classes: &[Model]) -> [JointShape; MAX_JOINTS] {
    let mut shapes = [JointShape::default(); MAX_JOINTS];
    for (joint, shape) in shapes.iter_mut().enumerate() {
        let links: Vec<&Link> =
            classes.iter().flat_map(|class| class.limbs.iter().filter_map(|limb| limb.get(joint))).collect();
        let some = |has: fn(&Link) -> bool| links.iter().any(|link| has(link));
        *shape = JointShape {
            aligned: links.iter().all(|link| link.axes == IDENTITY),
            actuated: some(|link| link.actuator.is_some()),
            servo: some(|link| link.actuator.is_some_and(|actuator| actuator.bias != [0.0; 3])),
            limited_torque: some(|link| link.actuator_range != UNLIMITED),
            spring: some(|link| link.stiffness != 0.0),
            dry_friction: some(|link| link.friction_loss > 0.0),
            limit_power: links.first().map_or(1, |link| link.limit.power),
        };
    }
    shapes
}

fn joints_of(model: &Model, joints: usize) -> Vec<Joint> {
    let limbs = model.limbs.iter().enumerate();
    limbs
        .flat_map(|(lane, limb)| {
            limb.iter().enumerate().map(move |(joint, link)| Joint {
                place: lane * joints + joint,
                dof: link.dof,
                actuator: link.actuator.map(|actuator| actuator.index),
            })
        })
        .collect()
}

/// The kinds of the slots, and the point in each of them, `[lanes][slots]`. Points of the root go to the threads that
/// have fewest of their kind.
fn assign(points: &[Point], lanes: usize) -> (Vec<Kind>, Vec<Vec<Option<usize>>>) {
    let mut of_lane: Vec<Vec<(Kind, usize)>> = vec![Vec::new(); lanes];
    for (index, point) in points.iter().enumerate() {
        let kind = kind(point);
        let count = |lane: usize| of_lane[lane].iter().filter(|(other, _)| *other == kind).count();
        let lane = match point.link {
            Some((limb, _)) => limb,
            None => (0..lanes).min_by_key(|&lane| count(lane)).unwrap_or(0),
        };
        of_lane[lane].push((kind, index));
    }
    let mut kinds: Vec<Kind> = Vec::new();
    for lane in &mut of_lane {
        lane.sort_unstable();
        for (kind, _) in lane.iter() {
            let missing = |kinds: &[Kind]| {
                let count = |of: &mut dyn Iterator<Item = &Kind>| of.filter(|other| *other == kind).count();
                count(&mut lane.iter().map(|(kind, _)| kind)).saturating_sub(count(&mut kinds.iter()))
            };
            kinds.extend(std::iter::repeat_n(*kind, missing(&kinds)));
        }
    }
    kinds.sort_unstable();
    let slots = of_lane
        .iter()
        .map(|lane| {
            let mut rest = lane.as_slice();
            kinds
                .iter()
                .map(|kind| match rest {
                    [(first, index), others @ ..] if first == kind => {
                        rest = others;
                        Some(*index)
                    }
                    _ => None,
                })
                .collect()
        })
        .collect();
    (kinds, slots)
}

fn kind(point: &Point) -> Kind {
    Kind {
        moved_by: point.link.map_or(0, |(_, joint)| joint + 1),
        surface: match point.surface {
            Surface::Ball => SurfaceShape::Ball,
            Surface::Corner => SurfaceShape::Corner,
            Surface::Rim { place, .. } => SurfaceShape::Rim(place),
            Surface::Ellipsoid { .. } => SurfaceShape::Ellipsoid,
        },
        follows: point.tangent.is_some(),
        power: point.softness.power,
    }
}

/// Assigns slots to as few accumulators as suffice if in no thread two values share one: the accumulator of each slot,
/// and the values of each thread's accumulators.
fn accumulators<V: Copy + PartialEq>(
    points: &[Vec<Option<usize>>],
    value: impl Fn(usize) -> V,
) -> (Vec<usize>, Vec<Vec<Option<V>>>) {
    let slots = points.first().map_or(0, Vec::len);
    let mut values: Vec<Vec<Option<V>>> = vec![Vec::new(); points.len()];
    let mut of_slot = Vec::with_capacity(slots);
    for slot in 0..slots {
        let wanted: Vec<Option<V>> = points.iter().map(|lane| lane[slot].map(&value)).collect();
        let count = values.first().map_or(0, Vec::len);
        let fits = |of: &usize| {
            values
                .iter()
                .zip(&wanted)
                .all(|(lane, wanted)| lane[*of].is_none() || wanted.is_none() || lane[*of] == *wanted)
        };
        let of = (0..count).find(fits).unwrap_or(count);
        for (lane, wanted) in values.iter_mut().zip(wanted) {
            if of == count {
                lane.push(wanted);
            } else {
                lane[of] = lane[of].or(wanted);
            }
        }
        of_slot.push(of);
    }
    (of_slot, values)
}
