//! The numbers of [`Model`] in the form the dynamics uses them.
//!
//! What damage may change is a lane number, so that worlds of different classes share a register:
//! [`Constants`]. What all classes of a robot have in common is kept once: [`Skeleton`].

use crate::error::Unsupported;
use crate::lane::Lane;
use crate::math::{Sym3, Vec3, zero3};
use crate::model::{Cone, Inertia, Integrator, Link, Model, Point, RimPlace, Softness, Surface, Vector};

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

/// What a damage class may change, lane by lane.
pub struct Constants<T, const L: usize, const J: usize> {
    /// Acceleration upwards that has the effect of gravity.
    pub lift: Vec3<T>,
    pub root: Body<T>,
    pub root_armature: T,
    pub root_damping: T,
    pub links: [[LinkConstants<T>; J]; L],
    pub points: Vec<PointConstants<T>>,
    /// 1 / (mean inertia · nv): makes the solver's stopping rule independent of the robot's size.
    pub solver_scale: T,
}

/// A mass distribution.
#[derive(Clone, Copy)]
pub struct Body<T> {
    pub mass: T,
    pub com: Vec3<T>,
    pub tensor: Sym3<T>,
    pub compensated: T,
    pub compensated_com: Vec3<T>,
}

/// The part of a [`Link`] that damage may change.
#[derive(Clone, Copy)]
pub struct LinkConstants<T> {
    pub offset: Vec3<T>,
    pub body: Body<T>,
    pub armature: T,
    pub damping: T,
    pub stiffness: T,
    pub spring_reference: T,
    pub friction_loss: T,
    /// 1/R of the constraint of dry friction.
    pub friction_weight: T,
    pub range: [T; 2],
    pub inverse_weight: T,
    pub motor: Motor<T>,
    pub actuator_range: [T; 2],
}

/// The part of an [`Actuator`](crate::model::Actuator) that damage may change.
#[derive(Clone, Copy)]
pub struct Motor<T> {
    pub gear: T,
    pub gain: T,
    pub bias: Vec3<T>,
    pub ctrl_range: [T; 2],
    pub force_range: [T; 2],
}

/// The part of a [`Point`] that damage may change.
#[derive(Clone, Copy)]
pub struct PointConstants<T> {
    pub position: Vec3<T>,
    pub size: Vec3<T>,
    /// Coefficient of sliding friction; 0 without friction.
    pub friction: T,
    /// Coefficient of torsional friction, m.
    pub torsional: T,
    /// Coefficient of rolling friction over that of sliding friction, m; 0 without rolling friction.
    pub rolling: T,
    /// Square of the friction of the regularised cone (`mu` of `mjContact`).
    pub cone_friction: T,
    /// Regularisation R of the normal, or of an edge of a pyramid, at impedance d is this · (1 − d) / d.
    pub softness: T,
}

impl<T: Lane, const L: usize, const J: usize> Constants<T, L, J> {
    /// Room for `points` contact points, all numbers zero.
    pub fn new(points: usize) -> Self {
        let zero = T::zero();
        let body =
            Body { mass: zero, com: zero3(), tensor: [zero; 6], compensated: zero, compensated_com: zero3() };
        let motor =
            Motor { gear: zero, gain: zero, bias: zero3(), ctrl_range: [zero; 2], force_range: [zero; 2] };
        let link = LinkConstants {
            offset: zero3(),
            body,
            // What joints keep that only complete a limb: positive inertia and no limits.
            armature: T::of(1.0),
            damping: zero,
            stiffness: zero,
            spring_reference: zero,
            friction_loss: zero,
            friction_weight: zero,
            range: [T::of(f64::NEG_INFINITY), T::of(f64::INFINITY)],
            inverse_weight: T::of(1.0),
            motor,
            actuator_range: [zero; 2],
        };
        let point = PointConstants {
            position: zero3(),
            size: zero3(),
            friction: zero,
            torsional: zero,
            rolling: zero,
            cone_friction: zero,
            softness: zero,
        };
        Self {
            lift: zero3(),
            root: body,
            root_armature: zero,
            root_damping: zero,
            links: [[link; J]; L],
            points: vec![point; points],
            solver_scale: zero,
        }
    }

    /// Gives a lane the numbers of a damage class.
    pub fn set(&mut self, lane: usize, model: &Model) {
        // Not −g, which would be −0 along x and y.
        set_all(&mut self.lift, lane, &model.gravity.map(|g| 0.0 - g));
        self.root.set(lane, &model.root);
        self.root_armature.set(lane, model.root_armature);
        self.root_damping.set(lane, model.root_damping);
        for (links, limb) in self.links.iter_mut().zip(&model.limbs) {
            for (link, given) in links.iter_mut().zip(limb) {
                link.set(lane, given);
            }
        }
        for (point, given) in self.points.iter_mut().zip(&model.points) {
            point.set(lane, given, model);
        }
        self.solver_scale.set(lane, 1.0 / (model.mean_inertia * model.dofs() as f64));
    }
}

impl<T: Lane> PointConstants<T> {
    fn set(&mut self, lane: usize, point: &Point, model: &Model) {
        set_all(&mut self.position, lane, &point.position);
        set_all(&mut self.size, lane, &point.size);
        let [sliding, torsional, rolling] = point.friction;
        let square = sliding * sliding;
        // Documentation: Computation, "Constraint model", diagonal approximation; for a pyramid
        // MuJoCo takes 2 μ² (1 + μ²) times the inverse weight for each of its edges.
        let pyramid = 2.0 * square / model.impedance_ratio * (1.0 + square);
        let (friction, cone_friction, scale) = match (point.dimensions, model.cone) {
            (1, _) => (0.0, 1.0, 1.0),
            (_, Cone::Pyramidal) => (sliding, 1.0, pyramid),
            (_, Cone::Elliptic) => (sliding, square / model.impedance_ratio, 1.0),
        };
        self.friction.set(lane, friction);
        self.torsional.set(lane, torsional);
        self.rolling.set(lane, if point.dimensions == 6 { rolling / sliding } else { 0.0 });
        self.cone_friction.set(lane, cone_friction);
        self.softness.set(lane, scale * point.inverse_weight);
    }
}

impl<T: Lane> Body<T> {
    fn set(&mut self, lane: usize, inertia: &Inertia) {
        self.mass.set(lane, inertia.mass);
        set_all(&mut self.com, lane, &inertia.com);
        set_all(&mut self.tensor, lane, &inertia.tensor);
        self.compensated.set(lane, inertia.compensated);
        set_all(&mut self.compensated_com, lane, &inertia.compensated_com);
    }
}

impl<T: Lane> LinkConstants<T> {
    fn set(&mut self, lane: usize, link: &Link) {
        set_all(&mut self.offset, lane, &link.offset);
        self.body.set(lane, &link.inertia);
        self.armature.set(lane, link.armature);
        self.damping.set(lane, link.damping);
        self.stiffness.set(lane, link.stiffness);
        self.spring_reference.set(lane, link.spring_reference);
        self.friction_loss.set(lane, link.friction_loss);
        // Dry friction has no violation, so its impedance is that at 0.
        let impedance = link.friction_softness.impedance[0];
        self.friction_weight.set(lane, impedance / ((1.0 - impedance) * link.inverse_weight));
        set_all(&mut self.range, lane, &link.range);
        set_all(&mut self.actuator_range, lane, &link.actuator_range);
        self.inverse_weight.set(lane, link.inverse_weight);
        if let Some(actuator) = link.actuator {
            self.motor.gear.set(lane, actuator.gear);
            self.motor.gain.set(lane, actuator.gain);
            set_all(&mut self.motor.bias, lane, &actuator.bias);
            set_all(&mut self.motor.ctrl_range, lane, &actuator.ctrl_range);
            set_all(&mut self.motor.force_range, lane, &actuator.force_range);
        }
    }
}

fn set_all<T: Lane>(numbers: &mut [T], lane: usize, values: &[f64]) {
    for (number, &value) in numbers.iter_mut().zip(values) {
        number.set(lane, value);
    }
}
