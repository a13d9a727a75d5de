//! Contacts with the floor: explicit pairs of one plane with spheres, capsules, cylinders, ellipsoids and boxes.

use dappo_lanes::Unsupported;
use dappo_lanes::model::{Point, RimPlace, Surface, Vector};

use super::arrays::ModelArrays;
use super::features::Owner;
use super::geometry::{Pose, add, dot, scale, sub};
use super::refuse::{Reasons, refuse};
use super::softness::softness;
use super::tree::{Carrier, Tree};

/// `mjtGeom`.
const PLANE: i32 = 0;
pub(super) const SPHERE: i32 = 2;
pub(super) const CAPSULE: i32 = 3;
const ELLIPSOID: i32 = 4;
const CYLINDER: i32 = 5;
const BOX: i32 = 6;
/// Shapes whose contacts with a plane the engine knows.
const SHAPES: [i32; 5] = [SPHERE, CAPSULE, ELLIPSOID, CYLINDER, BOX];
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
}

impl Contacts {
    /// Reads the contact pairs; any contact but one with the floor is refused.
    pub fn new(model: &ModelArrays, tree: &Tree, reasons: &mut Reasons) -> Option<Self> {
        let mut floor = None;
        let mut points = Vec::new();
        for pair in 0..model.npair {
            let Some((plane, geom)) = reasons.keep(split(model, pair)) else { continue };
            let first = *floor.get_or_insert(plane);
            if first != plane {
                let (one, two) = (model.called(Owner::Geom, first), model.called(Owner::Geom, plane));
                reasons.add(format!("{one} and {two} are two floors; it supports one"));
            } else if let Some(touching) = reasons.keep(touching(model, tree, pair, geom)) {
                points.extend(touching);
            }
        }
        let Some(plane) = floor else {
            if !masks_match(model).any(|_| true) {
                reasons.add("no geom can touch a floor (there is no contact pair)");
            }
            return None;
        };
        Some(Self { floor: reasons.keep(height(model, plane))?, points })
    }
}

/// Finds what of the geoms is refused, whatever carries them: contacts by masks instead of pairs, and shapes.
pub(super) fn check_geoms(model: &ModelArrays, reasons: &mut Reasons) {
    let moves = |geom: usize| model.geom_bodyid[geom] != 0;
    let within = masks_match(model).find(|&(a, b)| moves(a) && moves(b));
    if let Some((a, b)) = within.or_else(|| masks_match(model).next()) {
        let (one, two) = (model.called(Owner::Geom, a), model.called(Owner::Geom, b));
        reasons.add(format!(
            "{one} and {two} touch each other by contype and conaffinity; it supports explicit contact pairs \
             with the floor alone, which a class table generates for a robot that can touch nothing else"
        ));
    }
    let pairs =
        (0..model.npair).map(|pair| (model.pair_geom1[pair] as usize, model.pair_geom2[pair] as usize));
    let mut shapeless: Vec<usize> = masks_match(model)
        .chain(pairs)
        .flat_map(|(a, b)| [(a, b), (b, a)])
        .filter(|&(plane, geom)| is_floor(model, plane) && !SHAPES.contains(&model.geom_type[geom]))
        .map(|(_, geom)| geom)
        .collect();
    shapeless.sort_unstable();
    shapeless.dedup();
    if let Some(&geom) = shapeless.first() {
        let (called, verb) = model.called_with_others(Owner::Geom, geom, shapeless.len() - 1, ("is", "are"));
        reasons.add(format!(
            "{called} can touch the floor but {verb} not a sphere, capsule, cylinder, ellipsoid or box \
             (geom_type = {})",
            model.geom_type[geom]
        ));
    }
}

/// Pairs of geoms that MuJoCo lets touch each other by their masks.
fn masks_match(model: &ModelArrays) -> impl Iterator<Item = (usize, usize)> {
    let geoms = 0..model.geom_type.len();
    geoms
        .clone()
        .flat_map(move |a| geoms.clone().map(move |b| (a, b)))
        .filter(|&(a, b)| a != b && model.geom_contype[a] & model.geom_conaffinity[b] != 0)
}

fn is_floor(model: &ModelArrays, geom: usize) -> bool {
    model.geom_type[geom] == PLANE && model.geom_bodyid[geom] == 0
}

/// The plane and the other geom of a pair.
fn split(model: &ModelArrays, pair: usize) -> Result<(usize, usize), Unsupported> {
    let [one, two] = [model.pair_geom1[pair] as usize, model.pair_geom2[pair] as usize];
    match (is_floor(model, one), is_floor(model, two)) {
        (true, false) => Ok((one, two)),
        (false, true) => Ok((two, one)),
        _ => {
            let (one, two) = (model.called(Owner::Geom, one), model.called(Owner::Geom, two));
            refuse(format!("the contact of {one} and {two} is not with a plane of the world body"))
        }
    }
}

/// Coefficients of sliding, torsional and rolling friction of a pair.
fn friction(model: &ModelArrays, pair: usize) -> Result<Vector, Unsupported> {
    let friction: [f64; 5] = ModelArrays::row(&model.pair_friction, pair);
    let dimensions = model.pair_dim[pair];
    if (dimensions > 1 && friction[0] != friction[1]) || (dimensions > 4 && friction[3] != friction[4]) {
        let called = model.called(Owner::Pair, pair);
        return refuse(format!("{called} has friction {friction:?}, not the same in both directions"));
    }
    Ok([friction[0], friction[2], friction[3]].map(|coefficient| coefficient.max(LEAST_FRICTION)))
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
    let size = ModelArrays::vector(&model.geom_size, geom);
    let softness = softness(
        ModelArrays::row(&model.pair_solref, pair),
        ModelArrays::row(&model.pair_solimp, pair),
        model.timestep,
    )
    .or_else(|why| refuse(format!("{}: {why}", model.called(Owner::Pair, pair))))?;
    let point = Point {
        link,
        surface: Surface::Ball,
        position: pose.origin,
        size,
        tangent: None,
        margin: model.pair_margin[pair],
        softness,
        dimensions: model.pair_dim[pair] as usize,
        friction: friction(model, pair)?,
        inverse_weight: model.body_invweight0[2 * body],
        body,
        touch: None,
    };
    Ok(match model.geom_type[geom] {
        CAPSULE => {
            let axis = pose.axes[2];
            let end = |side: f64| {
                let position = add(pose.origin, scale(axis, side * size[1]));
                Point { position, size: [size[0], 0.0, 0.0], tangent: Some(axis), ..point }
            };
            vec![end(1.0), end(-1.0)]
        }
        ELLIPSOID => vec![Point { surface: Surface::Ellipsoid { axes: pose.axes }, ..point }],
        CYLINDER => [RimPlace::Lowest, RimPlace::OtherEnd, RimPlace::Left, RimPlace::Right]
            .map(|place| Point { surface: Surface::Rim { axes: pose.axes, place }, ..point })
            .to_vec(),
        BOX => {
            let corner = |index: usize| {
                let side = |axis: usize| if index >> axis & 1 == 1 { size[axis] } else { -size[axis] };
                let way = pose.direction(std::array::from_fn(side));
                let position = add(pose.origin, way);
                Point { surface: Surface::Corner, position, size: way, ..point }
            };
            (0..8).map(corner).collect()
        }
        // A sphere: every other shape has been refused.
        _ => vec![point],
    })
}

/// Assigns the points to the touch sensors that measure them.
///
/// MuJoCo adds up the normal forces of the contacts of the sensor's body that lie in the zone of its site. The
/// engine takes all contacts of the body, so the zone must hold every one of them.
///
/// `read` are the addresses of the sensors that are read.
pub(super) fn attach_sensors(
    model: &ModelArrays,
    tree: &Tree,
    read: &[usize],
    points: &mut [Point],
    reasons: &mut Reasons,
) {
    for sensor in 0..model.nsensor {
        let address = model.sensor_adr[sensor] as usize;
        if read.contains(&address) {
            reasons.keep(attach(model, tree, sensor, address, points));
        }
    }
}

fn attach(
    model: &ModelArrays,
    tree: &Tree,
    sensor: usize,
    address: usize,
    points: &mut [Point],
) -> Result<(), Unsupported> {
    let called = || model.called(Owner::Sensor, sensor);
    let site = model.sensor_objid[sensor] as usize;
    let Some(&body) = model.site_bodyid.get(site) else {
        return refuse(format!("{} is not on a site", called()));
    };
    let body = body as usize;
    let own = Pose::new(ModelArrays::vector(&model.site_pos, site), ModelArrays::row(&model.site_quat, site));
    let zone = Zone::new(model, site, &tree.bodies[body].1.then(&own));
    for point in points.iter_mut().filter(|point| point.body == body) {
        if point.touch.is_some() {
            return refuse(format!("{} is the second touch sensor of its body; it supports one", called()));
        }
        if !zone.as_ref().is_some_and(|zone| zone.holds(point)) {
            return refuse(format!(
                "the site of {} does not enclose all contacts of its body; a sphere or a capsule somewhat \
                 thicker than the geoms would",
                called()
            ));
        }
        point.touch = Some(address);
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
        dot(across, across).sqrt() + reach(point) + 0.5 * point.margin <= self.radius + ROUNDING
    }
}

/// Largest distance of a contact from the position of its point.
fn reach(point: &Point) -> f64 {
    let [first, second, third] = point.size;
    match point.surface {
        Surface::Ball => first,
        Surface::Corner => 0.0,
        Surface::Rim { .. } => first.hypot(second),
        Surface::Ellipsoid { .. } => first.max(second).max(third),
    }
}
