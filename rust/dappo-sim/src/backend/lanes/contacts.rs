//! Contacts with the floor: explicit pairs of one plane with spheres, capsules and boxes.

use dappo_lanes::Unsupported;
use dappo_lanes::model::{Point, Softness, Vector};

use super::arrays::ModelArrays;
use super::features::Owner;
use super::geometry::{Pose, add, dot, scale, sub};
use super::refuse::refuse;
use super::softness::softness;
use super::tree::{Carrier, Tree};

/// `mjtGeom`.
const PLANE: i32 = 0;
pub(super) const SPHERE: i32 = 2;
pub(super) const CAPSULE: i32 = 3;
const BOX: i32 = 6;
/// `mjMINMU`, the least friction of a contact.
const LEAST_FRICTION: f64 = 1e-5;
/// How far from +z the floor's normal may point.
const LEVEL: f64 = 1e-12;
/// Rounding that a sensor's zone of the very size of its geom is allowed, m.
const ROUNDING: f64 = 1e-9;

/// The floor, and everything that can touch it.
pub(super) struct Contacts {
    pub floor: f64,
    pub points: Vec<Point>,
    pub softness: Softness,
}

impl Contacts {
    /// Reads the contact pairs; any contact but one with the floor is refused.
    pub fn new(model: &ModelArrays, tree: &Tree) -> Result<Self, Unsupported> {
        check_masks(model)?;
        let mut floor = None;
        let mut points = Vec::new();
        for pair in 0..model.npair {
            let (plane, geom) = split(model, pair)?;
            if *floor.get_or_insert(plane) != plane {
                let (one, two) = (floor.unwrap_or(plane), plane);
                let (one, two) = (model.called(Owner::Geom, one), model.called(Owner::Geom, two));
                return refuse(format!("{one} and {two} are two floors; it supports one"));
            }
            check_pair(model, pair)?;
            points.extend(touching(model, tree, pair, geom)?);
        }
        let Some(plane) = floor else {
            return refuse("no geom can touch a floor (there is no contact pair)");
        };
        Ok(Self { floor: height(model, plane)?, points, softness: contact_softness(model)? })
    }
}

/// Contacts that MuJoCo would find by masks are none of the pairs.
fn check_masks(model: &ModelArrays) -> Result<(), Unsupported> {
    let masks = || model.geom_contype.iter().zip(&model.geom_conaffinity);
    for (a, (contype, _)) in masks().enumerate() {
        if let Some((b, _)) =
            masks().enumerate().find(|&(b, (_, conaffinity))| a != b && contype & conaffinity != 0)
        {
            let (one, two) = (model.called(Owner::Geom, a), model.called(Owner::Geom, b));
            return refuse(format!(
                "{one} and {two} touch each other by contype and conaffinity; it supports explicit contact pairs \
                 with the floor alone, which a class table generates for a robot that can touch nothing else"
            ));
        }
    }
    Ok(())
}

/// The plane and the other geom of a pair.
fn split(model: &ModelArrays, pair: usize) -> Result<(usize, usize), Unsupported> {
    let [one, two] = [model.pair_geom1[pair] as usize, model.pair_geom2[pair] as usize];
    let is_floor = |geom: usize| model.geom_type[geom] == PLANE && model.geom_bodyid[geom] == 0;
    match (is_floor(one), is_floor(two)) {
        (true, false) => Ok((one, two)),
        (false, true) => Ok((two, one)),
        _ => {
            let (one, two) = (model.called(Owner::Geom, one), model.called(Owner::Geom, two));
            refuse(format!("the contact of {one} and {two} is not with a plane of the world body"))
        }
    }
}

fn check_pair(model: &ModelArrays, pair: usize) -> Result<(), Unsupported> {
    let called = || model.called(Owner::Pair, pair);
    let dimensions = model.pair_dim[pair];
    if dimensions != 3 {
        return refuse(format!("{} has condim {dimensions}; it supports 3, sliding friction", called()));
    }
    let friction: [f64; 5] = ModelArrays::row(&model.pair_friction, pair);
    if friction[0] != friction[1] {
        return refuse(format!("{} has friction {friction:?}, not the same in both directions", called()));
    }
    Ok(())
}

/// Height of the floor, which must be level.
fn height(model: &ModelArrays, plane: usize) -> Result<f64, Unsupported> {
    let pose = geom_pose(model, plane);
    if pose.axes[2][2] < 1.0 - LEVEL {
        return refuse(format!("{} is not level", model.called(Owner::Geom, plane)));
    }
    Ok(pose.origin[2])
}

/// A geom in its body's frame.
fn geom_pose(model: &ModelArrays, geom: usize) -> Pose {
    Pose::new(ModelArrays::vector(&model.geom_pos, geom), ModelArrays::row(&model.geom_quat, geom))
}

/// The points of a geom that can touch the floor.
fn touching(model: &ModelArrays, tree: &Tree, pair: usize, geom: usize) -> Result<Vec<Point>, Unsupported> {
    let body = model.geom_bodyid[geom] as usize;
    let (carrier, pose) = tree.bodies[body];
    let link = match carrier {
        Carrier::Root => None,
        Carrier::Link(limb, link) => Some((limb, link)),
        Carrier::World => return refuse(format!("{} cannot move", model.called(Owner::Geom, geom))),
    };
    let pose = pose.then(&geom_pose(model, geom));
    let point = |position: Vector, radius: f64, tangent: Option<Vector>, corner: Option<Vector>| Point {
        link,
        position,
        radius,
        tangent,
        corner,
        margin: model.pair_margin[pair],
        friction: model.pair_friction[5 * pair].max(LEAST_FRICTION),
        inverse_weight: model.body_invweight0[2 * body],
        body,
        touch: None,
    };
    let size = ModelArrays::vector(&model.geom_size, geom);
    match model.geom_type[geom] {
        SPHERE => Ok(vec![point(pose.origin, size[0], None, None)]),
        CAPSULE => {
            let axis = pose.axes[2];
            let end =
                |side: f64| point(add(pose.origin, scale(axis, side * size[1])), size[0], Some(axis), None);
            Ok(vec![end(1.0), end(-1.0)])
        }
        BOX => {
            let corner = |index: usize| {
                let side = |axis: usize| if index >> axis & 1 == 1 { size[axis] } else { -size[axis] };
                let way = pose.direction(std::array::from_fn(side));
                point(add(pose.origin, way), 0.0, None, Some(way))
            };
            Ok((0..8).map(corner).collect())
        }
        kind => {
            let called = model.called(Owner::Geom, geom);
            refuse(format!(
                "{called} can touch the floor but is not a sphere, capsule or box (geom_type = {kind})"
            ))
        }
    }
}

/// The one softness of all contacts.
fn contact_softness(model: &ModelArrays) -> Result<Softness, Unsupported> {
    let parameters = |pair: usize| -> ([f64; 2], [f64; 5]) {
        (ModelArrays::row(&model.pair_solref, pair), ModelArrays::row(&model.pair_solimp, pair))
    };
    let (solref, solimp) = parameters(0);
    if let Some(other) = (1..model.npair).find(|&pair| parameters(pair) != (solref, solimp)) {
        let (one, two) = (model.called(Owner::Pair, 0), model.called(Owner::Pair, other));
        return refuse(format!(
            "{one} and {two} differ in solref or solimp; it supports one softness for all"
        ));
    }
    softness(solref, solimp, model.timestep)
        .or_else(|why| refuse(format!("{}: {why}", model.called(Owner::Pair, 0))))
}

/// Assigns the points to the touch sensors that measure them.
///
/// MuJoCo adds up the normal forces of the contacts of the sensor's body that lie in the zone of its site. The
/// engine takes all contacts of the body, so the zone must hold every one of them.
pub(super) fn attach_sensors(
    model: &ModelArrays,
    tree: &Tree,
    points: &mut [Point],
) -> Result<(), Unsupported> {
    for sensor in 0..model.nsensor {
        let called = || model.called(Owner::Sensor, sensor);
        if model.sensor_adr[sensor] as usize != sensor {
            return refuse(format!("{} does not read a single number", called()));
        }
        let site = model.sensor_objid[sensor] as usize;
        let body = model.site_bodyid[site] as usize;
        let own =
            Pose::new(ModelArrays::vector(&model.site_pos, site), ModelArrays::row(&model.site_quat, site));
        let zone = Zone::new(model, site, &tree.bodies[body].1.then(&own));
        for point in points.iter_mut().filter(|point| point.body == body) {
            if point.touch.is_some() {
                return refuse(format!(
                    "{} is the second touch sensor of its body; it supports one",
                    called()
                ));
            }
            if !zone.as_ref().is_some_and(|zone| zone.holds(point)) {
                return refuse(format!(
                    "the site of {} does not enclose all contacts of its body; a sphere or a capsule somewhat \
                     thicker than the geoms would",
                    called()
                ));
            }
            point.touch = Some(sensor);
        }
    }
    Ok(())
}

/// A sphere or capsule around the segment from `start` along `way`.
struct Zone {
    start: Vector,
    way: Vector,
    radius: f64,
}

impl Zone {
    /// `None` for sites of another shape.
    fn new(model: &ModelArrays, site: usize, pose: &Pose) -> Option<Self> {
        let [radius, half, _] = ModelArrays::vector(&model.site_size, site);
        let half = match model.site_type[site] {
            SPHERE => 0.0,
            CAPSULE => half,
            _ => return None,
        };
        let way = scale(pose.axes[2], 2.0 * half);
        Some(Self { start: sub(pose.origin, scale(way, 0.5)), way, radius })
    }

    /// Whether every contact of the point lies inside: half a margin below its surface at most.
    fn holds(&self, point: &Point) -> bool {
        let from = sub(point.position, self.start);
        let length = dot(self.way, self.way);
        let along = if length > 0.0 { (dot(from, self.way) / length).clamp(0.0, 1.0) } else { 0.0 };
        let across = sub(from, scale(self.way, along));
        dot(across, across).sqrt() + point.radius + 0.5 * point.margin <= self.radius + ROUNDING
    }
}
