//! Friction cones: cost, gradient and Hessian of a contact as functions of its residual.
//! (Documentation: Computation, "Constraint solver", primal problem, and "Contact", friction cones.)

use crate::contact::{Contact, Residual};
use crate::lane::{Lane, Mask};
use crate::math::{Vec3, dot, scale_add, zero3};
use crate::model::Cone;

/// Derivatives of a contact's cost by its linear residuals.
pub struct Push<T: Lane> {
    /// Gradient along n, μ t₁, μ t₂.
    pub gradient: Vec3<T>,
    /// Hessian: nn, 11, 22, n1, n2.
    pub stiffness: [T; 5],
    /// Entry 12 of the Hessian; a pyramid has none.
    pub skew: Option<T>,
    /// Lanes in which each edge of a pyramid pushes.
    pub active: [T::Mask; 4],
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

impl<T: Lane, const J: usize> Contact<T, J> {
    /// Whether it has angular residuals.
    #[inline(always)]
    pub fn turns(&self) -> bool {
        self.frictions > 2
    }

    /// Whether its cone is a pyramid with sliding friction alone. Most robots have no other contacts, so that
    /// what others need is kept out of the loops in functions of its own.
    #[inline(always)]
    fn is_plain(&self) -> bool {
        self.cone == Cone::Pyramidal && self.frictions == 2
    }

    /// Adds the cost at a residual to a sum.
    #[inline(always)]
    pub fn add_cost(&self, residual: &Residual<T>, sum: T) -> T {
        if self.is_plain() {
            self.add_pyramid_cost(residual.linear, sum)
        } else {
            T::run(
                #[inline(always)]
                move || self.add_any_cost(residual, sum),
            )
        }
    }

    #[inline(always)]
    fn add_any_cost(&self, residual: &Residual<T>, sum: T) -> T {
        let half_weight = T::of(0.5) * self.weight;
        match self.cone {
            Cone::Pyramidal => {
                let mut sum = self.add_pyramid_cost(residual.linear, sum);
                for friction in 2..self.frictions {
                    for edge in turning_edges(residual, friction) {
                        sum = half_weight.mul_add(negative_square(edge), sum);
                    }
                }
                sum
            }
            Cone::Elliptic => {
                let zone = self.zone(residual);
                let normal = residual.linear[0];
                let gap = normal - zone.friction;
                let sticking = normal * normal + zone.friction * zone.friction / self.cone_friction;
                let slipping = gap * gap / (T::of(1.0) + self.cone_friction);
                half_weight.mul_add(sticking.keep(zone.sticks) + slipping.keep(zone.slips), sum)
            }
        }
    }

    /// Adds the cost of the edges for sliding friction.
    #[inline(always)]
    fn add_pyramid_cost(&self, linear: Vec3<T>, mut sum: T) -> T {
        let half_weight = T::of(0.5) * self.weight;
        for edge in edges(linear) {
            sum = half_weight.mul_add(negative_square(edge), sum);
        }
        sum
    }

    /// Derivatives of the cost at the present residual by its linear part.
    #[inline(always)]
    pub fn push(&self) -> Push<T> {
        if self.is_plain() {
            self.pyramid_push()
        } else {
            T::run(
                #[inline(always)]
                || self.any_push(),
            )
        }
    }

    #[inline(always)]
    fn any_push(&self) -> Push<T> {
        match self.cone {
            Cone::Pyramidal => {
                let mut push = self.pyramid_push();
                for friction in 2..self.frictions {
                    for edge in turning_edges(&self.residual, friction) {
                        let weight = self.weight.keep(edge.lt(T::zero()));
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
                    active: [T::Mask::none(); 4],
                }
            }
        }
    }

    /// What the edges for sliding friction contribute to [`push`](Self::push).
    #[inline(always)]
    fn pyramid_push(&self) -> Push<T> {
        let zero = T::zero();
        let residuals = edges(self.residual.linear);
        let (mut weights, mut f) = ([zero; 4], [zero; 4]);
        let mut active = [T::Mask::none(); 4];
        for edge in 0..4 {
            active[edge] = residuals[edge].lt(zero);
            weights[edge] = self.weight.keep(active[edge]);
            f[edge] = weights[edge] * residuals[edge];
        }
        let (first, second) = (weights[0] + weights[1], weights[2] + weights[3]);
        Push {
            gradient: [(f[0] + f[1]) + (f[2] + f[3]), f[0] - f[1], f[2] - f[3]],
            stiffness: [first + second, first, second, weights[0] - weights[1], weights[2] - weights[3]],
            skew: None,
            active,
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
                    let push = self.weight.keep(plus.lt(zero));
                    let pull = self.weight.keep(minus.lt(zero));
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
        if self.is_plain() {
            self.add_along_pyramid(length, sums)
        } else {
            T::run(
                #[inline(always)]
                move || self.add_along_any(length, sums),
            )
        }
    }

    #[inline(always)]
    fn add_along_any(&self, length: T, sums: (T, T)) -> (T, T, T::Mask) {
        match self.cone {
            Cone::Pyramidal => {
                let (mut first, mut second, mut changed) = self.add_along_pyramid(length, sums);
                let there = self.moved(length);
                for friction in 2..self.frictions {
                    let before = turning_edges(&self.residual, friction);
                    let residuals = turning_edges(&there, friction);
                    let slopes = turning_edges(&self.slope, friction);
                    for edge in 0..2 {
                        let active = residuals[edge].lt(T::zero());
                        let switched = active ^ before[edge].lt(T::zero());
                        changed = changed | (switched & T::zero().lt(self.weight));
                        let weighted = (self.weight * slopes[edge]).keep(active);
                        first = weighted.mul_add(residuals[edge], first);
                        second = weighted.mul_add(slopes[edge], second);
                    }
                }
                (first, second, changed)
            }
            Cone::Elliptic => self.add_along_ellipse(length, sums),
        }
    }

    /// What the edges for sliding friction contribute to [`add_along`](Self::add_along).
    #[inline(always)]
    fn add_along_pyramid(&self, length: T, (mut first, mut second): (T, T)) -> (T, T, T::Mask) {
        let zero = T::zero();
        let residuals = edges(scale_add(self.slope.linear, length, self.residual.linear));
        let slopes = edges(self.slope.linear);
        let mut changed = T::Mask::none();
        for edge in 0..4 {
            let active = residuals[edge].lt(zero);
            changed = changed | (active ^ self.active[edge]);
            let weighted = (self.weight * slopes[edge]).keep(active);
            first = weighted.mul_add(residuals[edge], first);
            second = weighted.mul_add(slopes[edge], second);
        }
        (first, second, changed & zero.lt(self.weight))
    }

    #[inline(always)]
    fn add_along_ellipse(&self, length: T, (first, second): (T, T)) -> (T, T, T::Mask) {
        let there = &self.moved(length);
        let (before, zone) = (self.zone(&self.residual), self.zone(there));
        let (normal, rise) = (there.linear[0], self.slope.linear[0]);
        let across = self.slope.dot_friction(there);
        let square = self.slope.dot_friction(&self.slope);
        let inverse = T::of(1.0) / self.cone_friction;
        let stick = self.weight.keep(zone.sticks);
        let first = stick.mul_add(normal.mul_add(rise, across * inverse), first);
        let second = stick.mul_add(rise.mul_add(rise, square * inverse), second);

        let unit = zone.unit();
        let slip = self.weight.keep(zone.slips) / (T::of(1.0) + self.cone_friction);
        let along = across * unit;
        let (gap, closing) = (normal - zone.friction, rise - along);
        let bend = gap * unit * along.neg_mul_add(along, square);
        let first = (slip * gap).mul_add(closing, first);
        let second = slip.mul_add(closing.mul_add(closing, -bend), second);
        // Where a contact slips, its cost is not quadratic.
        let changed = (zone.sticks ^ before.sticks) | zone.slips | before.slips;
        (first, second, changed & T::zero().lt(self.weight))
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
        let stick = self.weight.keep(zone.sticks);
        let slip = self.weight.keep(zone.slips) / (T::of(1.0) + self.cone_friction);
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

/// The residuals of a pyramid's edges n ± μ t₁ and n ± μ t₂, from those along n, μ t₁ and μ t₂.
#[inline(always)]
fn edges<T: Lane>([normal, first, second]: Vec3<T>) -> [T; 4] {
    [normal + first, normal - first, normal + second, normal - second]
}

/// The residuals of the two edges of a friction dimension from the third on.
#[inline(always)]
fn turning_edges<T: Lane>(residual: &Residual<T>, friction: usize) -> [T; 2] {
    let (normal, angular) = (residual.linear[0], residual.angular[friction - 2]);
    [normal + angular, normal - angular]
}

/// r² of an edge that pushes, 0 otherwise.
#[inline(always)]
fn negative_square<T: Lane>(residual: T) -> T {
    let negative = residual.min(T::zero());
    negative * negative
}
