//! The numbers of [`Model`] in the form the dynamics uses them.
//!
//! What damage may change is a lane number, so that worlds of different classes share a register:
//! [`Constants`]. What all classes of a robot have in common is kept once: [`Skeleton`].

use crate::error::Unsupported;
use crate::lane::Lane;
use crate::math::{Sym3, Vec3, zero3};
use crate::model::{Inertia, Integrator, Link, Model, Point, Softness, Vector};

/// What all damage classes share.
pub struct Skeleton<T: Lane, const L: usize, const J: usize> {
    pub timestep: f64,
    pub integrator: Integrator,
    pub gravity: T::Scalar,
    pub floor: T::Scalar,
    pub contact: Impedance<T>,
    pub limit: Impedance<T>,
    pub joints: [[Joint<T>; J]; L],
    pub points: Vec<Carrier<T>>,
    pub bodies: usize,
    pub touch_sensors: usize,
}

/// The shared part of a [`Link`].
pub struct Joint<T: Lane> {
    pub axes: [[T::Scalar; 3]; 3],
    pub zero: T::Scalar,
    pub margin: T::Scalar,
    pub dof: usize,
    pub actuator: Option<usize>,
    /// Whether the actuator's force depends on position or velocity.
    pub servo: bool,
}

/// The shared part of a [`Point`].
pub struct Carrier<T: Lane> {
    pub link: Option<(usize, usize)>,
    pub tangent: Option<[T::Scalar; 3]>,
    pub corner: Option<[T::Scalar; 3]>,
    pub margin: T::Scalar,
    pub body: usize,
    pub touch: Option<usize>,
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
            let below = x * x / midpoint;
            let above = one - rest * rest / (one - midpoint);
            T::select(x.lt(midpoint), below, above)
        };
        y.mul_add(T::splat(self.span), T::splat(self.lowest))
    }
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
        Ok(Self {
            timestep: model.timestep,
            integrator: model.integrator,
            gravity: T::scalar(model.gravity),
            floor: T::scalar(model.floor),
            contact: Impedance::new(&model.contact),
            limit: Impedance::new(&model.limit),
            joints: std::array::from_fn(|limb| {
                std::array::from_fn(|joint| {
                    let servo = |class: &Model| {
                        class.limbs[limb][joint].actuator.is_some_and(|actuator| actuator.bias != [0.0; 3])
                    };
                    shared_joint(&model.limbs[limb][joint], classes.iter().any(servo))
                })
            }),
            points: model.points.iter().map(shared_point).collect(),
            bodies: model.bodies,
            touch_sensors: model.touch_sensors,
        })
    }
}

/// A constant that differs between two classes of a robot although it must not.
fn difference(a: &Model, b: &Model) -> Option<&'static str> {
    let links = || a.limbs.iter().flatten().zip(b.limbs.iter().flatten());
    let points = || a.points.iter().zip(&b.points);
    let index = |link: &Link| link.actuator.map(|actuator| actuator.index);
    let same_point =
        |(a, b): (&Point, &Point)| (a.link, a.body, a.touch, a.margin) == (b.link, b.body, b.touch, b.margin);
    [
        ("the integrator or its timestep", (a.timestep, a.integrator) == (b.timestep, b.integrator)),
        ("gravity", a.gravity == b.gravity),
        ("the floor", a.floor == b.floor),
        ("the softness of contacts", a.contact == b.contact),
        ("the softness of joint limits", a.limit == b.limit),
        ("the axis of a joint", links().all(|(a, b)| a.axes == b.axes && a.zero == b.zero)),
        ("the margin of a joint limit", links().all(|(a, b)| a.margin == b.margin)),
        ("which joints have actuators", links().all(|(a, b)| index(a) == index(b))),
        ("the number of contact points", a.points.len() == b.points.len()),
        ("where a contact point is fixed", points().all(same_point)),
        ("the direction of a geom", points().all(|(a, b)| a.tangent == b.tangent)),
        ("the shape of a box", points().all(|(a, b)| a.corner == b.corner)),
    ]
    .into_iter()
    .find(|(_, same)| !same)
    .map(|(what, _)| what)
}

fn scalars<T: Lane>(vector: Vector) -> [T::Scalar; 3] {
    vector.map(T::scalar)
}

fn shared_joint<T: Lane>(link: &Link, servo: bool) -> Joint<T> {
    Joint {
        axes: link.axes.map(scalars::<T>),
        zero: T::scalar(link.zero),
        margin: T::scalar(link.margin),
        dof: link.dof,
        actuator: link.actuator.map(|actuator| actuator.index),
        servo,
    }
}

fn shared_point<T: Lane>(point: &Point) -> Carrier<T> {
    Carrier {
        link: point.link,
        tangent: point.tangent.map(scalars::<T>),
        corner: point.corner.map(scalars::<T>),
        margin: T::scalar(point.margin),
        body: point.body,
        touch: point.touch,
    }
}

/// What a damage class may change, lane by lane.
pub struct Constants<T, const L: usize, const J: usize> {
    pub root: Body<T>,
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
}

/// The part of a [`Link`] that damage may change.
#[derive(Clone, Copy)]
pub struct LinkConstants<T> {
    pub offset: Vec3<T>,
    pub body: Body<T>,
    pub armature: T,
    pub damping: T,
    pub range: [T; 2],
    pub inverse_weight: T,
    pub motor: Motor<T>,
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
    pub radius: T,
    pub friction: T,
    /// Regularisation R of a friction pyramid's edge at impedance d is this · (1 − d) / d.
    pub softness: T,
}

impl<T: Lane, const L: usize, const J: usize> Constants<T, L, J> {
    /// Room for `points` contact points, all numbers zero.
    pub fn new(points: usize) -> Self {
        let zero = T::zero();
        let body = Body { mass: zero, com: zero3(), tensor: [zero; 6] };
        let motor =
            Motor { gear: zero, gain: zero, bias: zero3(), ctrl_range: [zero; 2], force_range: [zero; 2] };
        let link = LinkConstants {
            offset: zero3(),
            body,
            armature: zero,
            damping: zero,
            range: [zero; 2],
            inverse_weight: zero,
            motor,
        };
        let point = PointConstants { position: zero3(), radius: zero, friction: zero, softness: zero };
        Self { root: body, links: [[link; J]; L], points: vec![point; points], solver_scale: zero }
    }

    /// Gives a lane the numbers of a damage class.
    pub fn set(&mut self, lane: usize, model: &Model) {
        self.root.set(lane, &model.root);
        for (link, given) in self.links.as_flattened_mut().iter_mut().zip(model.limbs.iter().flatten()) {
            link.set(lane, given);
        }
        for (point, given) in self.points.iter_mut().zip(&model.points) {
            set_all(&mut point.position, lane, &given.position);
            point.radius.set(lane, given.radius);
            point.friction.set(lane, given.friction);
            // Documentation: Computation, "Constraint model", diagonal approximation; for a pyramid
            // MuJoCo takes 2 μ² (1 + μ²) times the inverse weight for each of its edges.
            let square = given.friction * given.friction;
            point.softness.set(lane, 2.0 * square * (1.0 + square) * given.inverse_weight);
        }
        self.solver_scale.set(lane, 1.0 / (model.mean_inertia * (6 + L * J) as f64));
    }
}

impl<T: Lane> Body<T> {
    fn set(&mut self, lane: usize, inertia: &Inertia) {
        self.mass.set(lane, inertia.mass);
        set_all(&mut self.com, lane, &inertia.com);
        set_all(&mut self.tensor, lane, &inertia.tensor);
    }
}

impl<T: Lane> LinkConstants<T> {
    fn set(&mut self, lane: usize, link: &Link) {
        set_all(&mut self.offset, lane, &link.offset);
        self.body.set(lane, &link.inertia);
        self.armature.set(lane, link.armature);
        self.damping.set(lane, link.damping);
        set_all(&mut self.range, lane, &link.range);
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
