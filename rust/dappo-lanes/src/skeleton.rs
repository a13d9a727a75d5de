//! What all damage classes of a robot have in common, in the form the dynamics uses it.

use crate::error::Unsupported;
use crate::lane::Lane;
use crate::model::{Cone, Integrator, Link, Model, Point, RimPlace, Softness, Surface, Vector};

const IDENTITY: [Vector; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

/// What all damage classes share.
#[expect(clippy::struct_excessive_bools, reason = "each is a feature that costs nothing where it is absent")]
pub struct Skeleton<T: Lane, const L: usize, const J: usize> {
    pub timestep: f64,
    pub integrator: Integrator,
    pub floor: T::Scalar,
    /// Whether the weight of some body is compensated.
    pub compensates: bool,
    pub cone: Cone,
    /// Whether the free joint has damping.
    pub damps_root: bool,
    /// Whether some point has another contact than a pyramid with sliding friction.
    pub has_cones: bool,
    /// Whether some joint has dry friction.
    pub has_dry_friction: bool,
    /// Joints of each limb; a limb with fewer joints than `J` ends in joints that are always at rest.
    pub joints: [[Joint<T>; J]; L],
    /// Link of limb 0 that each limb hangs on; `None` for the root.
    pub parents: [Option<usize>; L],
    pub points: Vec<Carrier<T>>,
    /// Number of degrees of freedom.
    pub dofs: usize,
    pub bodies: usize,
    pub touch_sensors: usize,
}

/// The shared part of a [`Link`].
#[expect(clippy::struct_excessive_bools, reason = "each is a feature that costs nothing where it is absent")]
pub struct Joint<T: Lane> {
    pub axes: [[T::Scalar; 3]; 3],
    /// Whether `axes` are those of the parent.
    pub is_aligned: bool,
    pub zero: T::Scalar,
    pub margin: T::Scalar,
    pub limit: Impedance<T>,
    /// Damping of the reference acceleration of dry friction; `None` without dry friction.
    pub dry_friction: Option<T::Scalar>,
    /// Whether it has a spring.
    pub spring: bool,
    /// Index in qvel; `None` for a joint that only completes the shape of the robot.
    pub dof: Option<usize>,
    pub actuator: Option<usize>,
    /// Whether the actuator's force depends on position or velocity.
    pub servo: bool,
    /// Whether the torque of the actuator is limited at the joint.
    pub limited_torque: bool,
}

/// The shared part of a [`Point`].
pub struct Carrier<T: Lane> {
    pub link: Option<(usize, usize)>,
    pub shape: Shape<T>,
    pub tangent: Option<[T::Scalar; 3]>,
    pub margin: T::Scalar,
    pub softness: Impedance<T>,
    pub cone: Cone,
    /// Number of friction dimensions: 0, 2, 3 or 5.
    pub frictions: usize,
    pub body: usize,
    pub touch: Option<usize>,
}

impl<T: Lane> Carrier<T> {
    /// Whether its contact is a pyramid with sliding friction alone.
    pub fn is_plain(&self) -> bool {
        self.cone == Cone::Pyramidal && self.frictions == 2
    }
}

/// A [`Surface`].
pub enum Shape<T: Lane> {
    Ball,
    Corner,
    Rim([[T::Scalar; 3]; 3], RimPlace),
    Ellipsoid([[T::Scalar; 3]; 3]),
}

/// A [`Softness`], ready for use.
pub struct Impedance<T: Lane> {
    pub stiffness: T::Scalar,
    pub damping: T::Scalar,
    pub lowest: T::Scalar,
    pub span: T::Scalar,
    pub inverse_width: T::Scalar,
    pub midpoint: T::Scalar,
    pub power: u8,
}

impl<T: Lane> Impedance<T> {
    fn new(softness: &Softness) -> Self {
        let [lowest, highest] = softness.impedance;
        Self {
            stiffness: T::scalar(softness.stiffness),
            damping: T::scalar(softness.damping),
            lowest: T::scalar(lowest),
            span: T::scalar(highest - lowest),
            inverse_width: T::scalar(1.0 / softness.width),
            midpoint: T::scalar(softness.midpoint),
            power: softness.power,
        }
    }

    /// Impedance d(r) at a violation r ≥ 0 (documentation: Modeling, "Solver parameters", solimp).
    #[inline(always)]
    pub fn at(&self, violation: T) -> T {
        let one = T::of(1.0);
        let x = (violation * T::splat(self.inverse_width)).min(one);
        let y = if self.power == 1 {
            x
        } else {
            let midpoint = T::splat(self.midpoint);
            let rest = one - x;
            let power = self.power - 1;
            let below = x * raised(x, power) / raised(midpoint, power);
            let above = one - rest * raised(rest, power) / raised(one - midpoint, power);
            T::select(x.lt(midpoint), below, above)
        };
        y.mul_add(T::splat(self.span), T::splat(self.lowest))
    }
}

/// x to the power of a positive integer.
#[inline(always)]
fn raised<T: Lane>(x: T, power: u8) -> T {
    let mut product = x;
    for _ in 1..power {
        product = product * x;
    }
    product
}

impl<T: Lane, const L: usize, const J: usize> Skeleton<T, L, J> {
    /// The skeleton of a robot; all classes must agree about it.
    pub fn new(classes: &[Model]) -> Result<Self, Unsupported> {
        let model = classes.first().ok_or_else(|| Unsupported("there is no damage class".into()))?;
        for (index, class) in classes.iter().enumerate() {
            if let Some(what) = difference(model, class) {
                return Err(Unsupported(format!(
                    "damage class {index} changes {what}, which the lane engine keeps equal for all classes"
                )));
            }
        }
        let links = || classes.iter().flat_map(|class| class.limbs.iter().flatten());
        let points: Vec<_> = model.points.iter().map(|point| shared_point(point, model.cone)).collect();
        let inertias = || classes.iter().map(|class| &class.root).chain(links().map(|link| &link.inertia));
        Ok(Self {
            timestep: model.timestep,
            integrator: model.integrator,
            floor: T::scalar(model.floor),
            compensates: inertias().any(|inertia| inertia.compensated != 0.0),
            cone: model.cone,
            damps_root: classes.iter().any(|class| class.root_damping != 0.0),
            has_cones: !points.iter().all(Carrier::is_plain),
            has_dry_friction: links().any(|link| link.friction_loss > 0.0),
            joints: std::array::from_fn(|limb| {
                std::array::from_fn(|joint| {
                    let of_classes: Vec<&Link> =
                        classes.iter().filter_map(|class| class.limbs.get(limb)?.get(joint)).collect();
                    of_classes.first().map_or_else(completing_joint, |link| shared_joint(link, &of_classes))
                })
            }),
            parents: std::array::from_fn(|limb| model.parents.get(limb).copied().flatten()),
            points,
            dofs: model.dofs(),
            bodies: model.bodies,
            touch_sensors: model.touch_sensors,
        })
    }
}

/// A constant that differs between two classes of a robot although all of them must share it.
#[must_use]
pub fn difference(a: &Model, b: &Model) -> Option<&'static str> {
    let links = || a.limbs.iter().flatten().zip(b.limbs.iter().flatten());
    let points = || a.points.iter().zip(&b.points);
    let lengths = |model: &Model| model.limbs.iter().map(Vec::len).collect::<Vec<_>>();
    let index = |link: &Link| link.actuator.map(|actuator| actuator.index);
    let same_point =
        |(a, b): (&Point, &Point)| (a.link, a.body, a.touch, a.margin) == (b.link, b.body, b.touch, b.margin);
    [
        ("the integrator or its timestep", (a.timestep, a.integrator) == (b.timestep, b.integrator)),
        ("the floor", a.floor == b.floor),
        ("the friction cones", (a.cone, a.impedance_ratio) == (b.cone, b.impedance_ratio)),
        ("the number of joints", lengths(a) == lengths(b)),
        ("what a limb hangs on", a.parents == b.parents),
        ("the softness of joint limits", links().all(|(a, b)| a.limit == b.limit)),
        ("the softness of dry friction", links().all(|(a, b)| a.friction_softness == b.friction_softness)),
        ("the axis of a joint", links().all(|(a, b)| a.axes == b.axes && a.zero == b.zero)),
        ("the margin of a joint limit", links().all(|(a, b)| a.margin == b.margin)),
        ("which joints have actuators", links().all(|(a, b)| index(a) == index(b))),
        ("the number of contact points", a.points.len() == b.points.len()),
        ("where a contact point is fixed", points().all(same_point)),
        ("the softness of a contact", points().all(|(a, b)| a.softness == b.softness)),
        ("the dimensions of a contact", points().all(|(a, b)| a.dimensions == b.dimensions)),
        ("the direction of a geom", points().all(|(a, b)| a.tangent == b.tangent)),
        ("the shape of a geom", points().all(|(a, b)| a.surface == b.surface)),
    ]
    .into_iter()
    .find(|(_, same)| !same)
    .map(|(what, _)| what)
}

fn scalars<T: Lane>(vector: Vector) -> [T::Scalar; 3] {
    vector.map(T::scalar)
}

/// What the classes have in common of one joint, `link` in the first of them.
fn shared_joint<T: Lane>(link: &Link, of_classes: &[&Link]) -> Joint<T> {
    let some = |has: fn(&Link) -> bool| of_classes.iter().any(|link| has(link));
    Joint {
        axes: link.axes.map(scalars::<T>),
        is_aligned: link.axes == IDENTITY,
        zero: T::scalar(link.zero),
        margin: T::scalar(link.margin),
        limit: Impedance::new(&link.limit),
        dry_friction: some(|link| link.friction_loss > 0.0)
            .then(|| T::scalar(link.friction_softness.damping)),
        spring: some(|link| link.stiffness != 0.0),
        dof: Some(link.dof),
        actuator: link.actuator.map(|actuator| actuator.index),
        servo: some(|link| link.actuator.is_some_and(|actuator| actuator.bias != [0.0; 3])),
        limited_torque: some(|link| link.actuator_range != [f64::NEG_INFINITY, f64::INFINITY]),
    }
}

/// A joint beyond the end of a limb: nothing hangs on it and nothing moves it.
fn completing_joint<T: Lane>() -> Joint<T> {
    let rigid =
        Softness { stiffness: 1.0, damping: 1.0, impedance: [0.5; 2], width: 1.0, midpoint: 0.5, power: 1 };
    Joint {
        axes: IDENTITY.map(scalars::<T>),
        is_aligned: true,
        zero: T::scalar(0.0),
        margin: T::scalar(0.0),
        limit: Impedance::new(&rigid),
        dry_friction: None,
        spring: false,
        dof: None,
        actuator: None,
        servo: false,
        limited_torque: false,
    }
}

fn shared_point<T: Lane>(point: &Point, cone: Cone) -> Carrier<T> {
    Carrier {
        link: point.link,
        shape: match point.surface {
            Surface::Ball => Shape::Ball,
            Surface::Corner => Shape::Corner,
            Surface::Rim { axes, place } => Shape::Rim(axes.map(scalars::<T>), place),
            Surface::Ellipsoid { axes } => Shape::Ellipsoid(axes.map(scalars::<T>)),
        },
        tangent: point.tangent.map(scalars::<T>),
        margin: T::scalar(point.margin),
        softness: Impedance::new(&point.softness),
        // Without friction dimensions a pyramid has no edges; the elliptic cone is then the normal alone.
        cone: if point.dimensions == 1 { Cone::Elliptic } else { cone },
        frictions: point.dimensions - 1,
        body: point.body,
        touch: point.touch,
    }
}
