//! Contacts other than those of pyramids with sliding friction alone: elliptic cones, contacts without friction,
//! and torsional and rolling friction. (Documentation: Computation, "Constraint solver", primal problem, and
//! "Contact", friction cones.)

use crate::constants::PointConstants;
use crate::contact::Contact;
use crate::coords::Coords;
use crate::kinematics::Kinematics;
use crate::lane::Lane;
use crate::math::{Axes, Vec3, dot, rotate, scale, scale_add, sub, unrotate, zero3};
use crate::model::Cone;
use crate::pyramid::{self, Push, pushing};
use crate::skeleton::Carrier;

/// A contact with the solver's numbers about it.
///
/// Its constraints follow from six numbers: one along each of the floor's normal n, μ t₁ and μ t₂, and one
/// about each of n, t₁ and t₂, scaled by the coefficients of torsional and rolling friction. Those about the
/// axes matter only with such friction.
#[derive(Clone, Copy)]
pub struct ConeContact<T: Lane, const J: usize, const W: usize> {
    pub contact: Contact<T, J, W>,
    /// Coefficient of torsional friction, and that of rolling friction over μ.
    turning: [T; 2],
    cone: Cone,
    /// Number of friction dimensions: 0, 2, 3 or 5.
    frictions: usize,
    /// Square of the friction of the regularised elliptic cone.
    cone_friction: T,
    /// Reference acceleration about n, t₁ and t₂.
    angular_reference: Vec3<T>,
    /// J a − reference at the solver's present point.
    residual: Residual<T>,
    /// Change of the residual along the solver's search direction.
    slope: Residual<T>,
}

/// The numbers of a contact's constraints.
#[derive(Clone, Copy)]
struct Residual<T> {
    /// Along n, μ t₁ and μ t₂.
    linear: Vec3<T>,
    /// About n, t₁ and t₂, scaled by the coefficients of friction.
    angular: Vec3<T>,
}

/// Derivatives of a contact's cost that have to do with its angular residuals.
pub struct Turn<T> {
    /// Gradient by the angular residuals.
    pub gradient: Vec3<T>,
    /// Hessian by a linear residual (row) and an angular one (column).
    pub mixed: [Vec3<T>; 3],
    /// Hessian by two angular residuals.
    pub stiffness: [Vec3<T>; 3],
}

/// Where a residual lies with respect to an elliptic cone; elsewhere the contact opens and costs nothing.
struct Zone<T: Lane> {
    /// Length of the residual in the friction dimensions.
    friction: T,
    /// Lanes in which the contact sticks: its force lies inside the cone.
    sticks: T::Mask,
    /// Lanes in which it slips: its force lies on the cone.
    slips: T::Mask,
}

/// Derivatives at a residual with the entries tⱼ in the friction dimensions, û = t / |t|:
/// the gradient is (normal, pull · t), the Hessian [stiffness, tilt · ûᵀ; ·, pull · 1 + spread · û ûᵀ].
struct Ellipse<T> {
    normal: T,
    pull: T,
    stiffness: T,
    tilt: T,
    spread: T,
    /// 1 / |t| where the contact slips, 0 elsewhere.
    unit: T,
}

impl<T: Lane, const J: usize, const W: usize> ConeContact<T, J, W> {
    /// A contact of a point.
    #[inline(always)]
    pub fn new<const L: usize>(
        contact: Contact<T, J, W>,
        carrier: &Carrier<T>,
        point: &PointConstants<T>,
        kinematics: &Kinematics<T, L, J>,
        velocity: &Coords<T, L, J>,
    ) -> Self {
        let zero = Residual { linear: zero3(), angular: zero3() };
        let mut own = Self {
            contact,
            turning: [point.torsional, point.rolling],
            cone: carrier.cone,
            frictions: carrier.frictions,
            cone_friction: point.cone_friction,
            angular_reference: zero3(),
            residual: zero,
            slope: zero,
        };
        if own.turns() {
            let damping = T::splat(carrier.softness.damping);
            own.angular_reference = scale(own.around(kinematics, velocity), -damping);
        }
        own
    }

    /// Whether it has angular residuals.
    #[inline(always)]
    pub fn turns(&self) -> bool {
        self.frictions > 2
    }

    /// J x: velocity (or acceleration) along and about the axes.
    #[inline(always)]
    fn product<const L: usize>(&self, kinematics: &Kinematics<T, L, J>, x: &Coords<T, L, J>) -> Residual<T> {
        let angular = if self.turns() { self.around(kinematics, x) } else { zero3() };
        Residual { linear: self.contact.along(x), angular }
    }

    /// J x about n, t₁ and t₂.
    #[inline(always)]
    fn around<const L: usize>(&self, kinematics: &Kinematics<T, L, J>, x: &Coords<T, L, J>) -> Vec3<T> {
        let mut angular = x.angular();
        if let Some((limb, joints)) = self.contact.limb {
            for joint in 0..joints {
                angular = scale_add(kinematics.links[limb][joint].hinge(), x.limbs[limb][joint], angular);
            }
            for joint in 0..self.contact.trunk_joints() {
                angular = scale_add(kinematics.links[0][joint].hinge(), x.limbs[0][joint], angular);
            }
        }
        unrotate(&self.turning_axes(), angular)
    }

    /// n, t₁ and t₂, scaled by the coefficients of torsional and rolling friction.
    #[inline(always)]
    pub fn turning_axes(&self) -> Axes<T> {
        let zero = T::zero();
        let [torsional, rolling] = self.turning;
        let [x, y] = [rolling * self.contact.tangent[0], rolling * self.contact.tangent[1]];
        [[zero, zero, torsional], [x, y, zero], [-y, x, zero]]
    }

    /// n, μ t₁ and μ t₂.
    #[inline(always)]
    pub fn axes(&self) -> Axes<T> {
        let (zero, one) = (T::zero(), T::of(1.0));
        let [x, y] = self.contact.tangent;
        [[zero, zero, one], [x, y, zero], [-y, x, zero]]
    }

    /// Sets the residual to that of an acceleration.
    #[inline(always)]
    pub fn set_acceleration<const L: usize>(
        &mut self,
        kinematics: &Kinematics<T, L, J>,
        x: &Coords<T, L, J>,
    ) {
        let Residual { linear, angular } = self.product(kinematics, x);
        self.residual.linear = sub(linear, self.contact.reference);
        self.residual.angular = sub(angular, self.angular_reference);
    }

    /// Begins a line search along a step.
    #[inline(always)]
    pub fn set_step<const L: usize>(&mut self, kinematics: &Kinematics<T, L, J>, step: &Coords<T, L, J>) {
        self.slope = self.product(kinematics, step);
    }

    /// Moves the residual by a length of the step.
    #[inline(always)]
    pub fn advance(&mut self, length: T) {
        self.residual = self.moved(length);
    }

    /// Force and torque about `center` at the solver's present point.
    #[inline(always)]
    pub fn wrench(&self, center: Vec3<T>) -> (Vec3<T>, Vec3<T>) {
        let (force, mut torque) = self.contact.wrench(self.push().gradient, center);
        if self.turns() {
            torque = sub(torque, rotate(&self.turning_axes(), self.turn().gradient));
        }
        (force, torque)
    }

    /// Derivatives of the cost at the present residual by its linear part.
    #[inline(always)]
    pub fn push(&self) -> Push<T> {
        let weight = self.contact.weight;
        match self.cone {
            Cone::Pyramidal => {
                let linear = self.residual.linear;
                let mut push = pyramid::push(weight, &pushing(linear), linear);
                for friction in 2..self.frictions {
                    for edge in turning_edges(&self.residual, friction) {
                        let weight = weight.keep(edge.lt(T::zero()));
                        push.gradient[0] = weight.mul_add(edge, push.gradient[0]);
                        push.stiffness[0] += weight;
                    }
                }
                push
            }
            Cone::Elliptic => {
                let ellipse = self.ellipse();
                let [_, first, second] = self.residual.linear;
                let (x, y) = (ellipse.unit * first, ellipse.unit * second);
                Push {
                    gradient: [ellipse.normal, ellipse.pull * first, ellipse.pull * second],
                    stiffness: [
                        ellipse.stiffness,
                        (ellipse.spread * x).mul_add(x, ellipse.pull),
                        (ellipse.spread * y).mul_add(y, ellipse.pull),
                        ellipse.tilt * x,
                        ellipse.tilt * y,
                    ],
                    skew: Some(ellipse.spread * x * y),
                }
            }
        }
    }

    /// Derivatives of the cost at the present residual that have to do with its angular part.
    #[inline(always)]
    pub fn turn(&self) -> Turn<T> {
        let zero = T::zero();
        let mut turn = Turn { gradient: zero3(), mixed: [zero3(); 3], stiffness: [zero3(); 3] };
        match self.cone {
            Cone::Pyramidal => {
                for friction in 2..self.frictions {
                    let axis = friction - 2;
                    let [plus, minus] = turning_edges(&self.residual, friction);
                    let push = self.contact.weight.keep(plus.lt(zero));
                    let pull = self.contact.weight.keep(minus.lt(zero));
                    turn.gradient[axis] = push * plus - pull * minus;
                    turn.mixed[0][axis] = push - pull;
                    turn.stiffness[axis][axis] = push + pull;
                }
            }
            Cone::Elliptic => {
                let ellipse = self.ellipse();
                let Residual { linear, angular } = &self.residual;
                for axis in 0..self.frictions - 2 {
                    let along = ellipse.unit * angular[axis];
                    turn.gradient[axis] = ellipse.pull * angular[axis];
                    turn.mixed[0][axis] = ellipse.tilt * along;
                    for row in 1..3 {
                        turn.mixed[row][axis] = ellipse.spread * (ellipse.unit * linear[row]) * along;
                    }
                    for other in 0..self.frictions - 2 {
                        turn.stiffness[axis][other] =
                            ellipse.spread * (ellipse.unit * angular[other]) * along;
                    }
                    turn.stiffness[axis][axis] += ellipse.pull;
                }
            }
        }
        turn
    }

    /// First and second derivative of the cost along the slope, at a length of it from the present residual,
    /// each added to a sum, and the lanes in which the cost is not the same quadratic function there.
    #[inline(always)]
    pub fn add_along(&self, length: T, sums: (T, T)) -> (T, T, T::Mask) {
        match self.cone {
            Cone::Pyramidal => {
                let weight = self.contact.weight;
                let linear = (self.residual.linear, self.slope.linear);
                let (mut first, mut second, mut changed) =
                    pyramid::add_along(weight, &pushing(linear.0), linear, length, sums);
                let there = self.moved(length);
                for friction in 2..self.frictions {
                    let before = turning_edges(&self.residual, friction);
                    let residuals = turning_edges(&there, friction);
                    let slopes = turning_edges(&self.slope, friction);
                    for edge in 0..2 {
                        let active = residuals[edge].lt(T::zero());
                        let switched = active ^ before[edge].lt(T::zero());
                        changed = changed | (switched & T::zero().lt(weight));
                        let weighted = (weight * slopes[edge]).keep(active);
                        first = weighted.mul_add(residuals[edge], first);
                        second = weighted.mul_add(slopes[edge], second);
                    }
                }
                (first, second, changed)
            }
            Cone::Elliptic => self.add_along_ellipse(length, sums),
        }
    }

    #[inline(always)]
    fn add_along_ellipse(&self, length: T, (first, second): (T, T)) -> (T, T, T::Mask) {
        let there = &self.moved(length);
        let (before, zone) = (self.zone(&self.residual), self.zone(there));
        let (normal, rise) = (there.linear[0], self.slope.linear[0]);
        let across = self.slope.dot_friction(there);
        let square = self.slope.dot_friction(&self.slope);
        let inverse = T::of(1.0) / self.cone_friction;
        let stick = self.contact.weight.keep(zone.sticks);
        let first = stick.mul_add(normal.mul_add(rise, across * inverse), first);
        let second = stick.mul_add(rise.mul_add(rise, square * inverse), second);

        let unit = zone.unit();
        let slip = self.contact.weight.keep(zone.slips) / (T::of(1.0) + self.cone_friction);
        let along = across * unit;
        let (gap, closing) = (normal - zone.friction, rise - along);
        let bend = gap * unit * along.neg_mul_add(along, square);
        let first = (slip * gap).mul_add(closing, first);
        let second = slip.mul_add(closing.mul_add(closing, -bend), second);
        // Where a contact slips, its cost is not quadratic.
        let changed = (zone.sticks ^ before.sticks) | zone.slips | before.slips;
        (first, second, changed & T::zero().lt(self.contact.weight))
    }

    /// The residual at a length of the slope from the present one.
    #[inline(always)]
    fn moved(&self, length: T) -> Residual<T> {
        Residual {
            linear: scale_add(self.slope.linear, length, self.residual.linear),
            angular: scale_add(self.slope.angular, length, self.residual.angular),
        }
    }

    #[inline(always)]
    fn zone(&self, residual: &Residual<T>) -> Zone<T> {
        let friction = residual.dot_friction(residual).sqrt();
        let normal = residual.linear[0];
        let closed = normal.lt(friction) | normal.lt(T::zero());
        let sticks = !T::zero().lt(self.cone_friction.mul_add(normal, friction)) & closed;
        Zone { friction, sticks, slips: closed & !sticks }
    }

    #[inline(always)]
    fn ellipse(&self) -> Ellipse<T> {
        let zone = self.zone(&self.residual);
        let normal = self.residual.linear[0];
        let unit = zone.unit();
        let stick = self.contact.weight.keep(zone.sticks);
        let slip = self.contact.weight.keep(zone.slips) / (T::of(1.0) + self.cone_friction);
        let gap = normal - zone.friction;
        Ellipse {
            normal: stick.mul_add(normal, slip * gap),
            pull: stick / self.cone_friction - slip * gap * unit,
            stiffness: stick + slip,
            tilt: -slip,
            spread: slip * normal * unit,
            unit,
        }
    }
}

impl<T: Lane> Zone<T> {
    /// 1 / |t| where the contact slips, 0 elsewhere.
    #[inline(always)]
    fn unit(&self) -> T {
        (T::of(1.0) / T::select(self.slips, self.friction, T::of(1.0))).keep(self.slips)
    }
}

impl<T: Lane> Residual<T> {
    /// Product of the parts in the friction dimensions.
    #[inline(always)]
    fn dot_friction(&self, other: &Self) -> T {
        let linear = self.linear[1].mul_add(other.linear[1], self.linear[2] * other.linear[2]);
        linear + dot(self.angular, other.angular)
    }
}

/// The residuals of the two edges of a friction dimension from the third on.
#[inline(always)]
fn turning_edges<T: Lane>(residual: &Residual<T>, friction: usize) -> [T; 2] {
    let (normal, angular) = (residual.linear[0], residual.angular[friction - 2]);
    [normal + angular, normal - angular]
}
