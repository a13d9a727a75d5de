//! The numbers of [`Model`] that damage may change, in the form the dynamics uses them.
//!
//! Each is a lane number, so that worlds of different classes share a register. What all classes of a robot have in
//! common is kept once, in the [`Skeleton`](crate::skeleton::Skeleton).

use crate::lane::Lane;
use crate::math::{Sym3, Vec3, zero3};
use crate::model::{Cone, Inertia, Link, Model, Point};

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
