//! The constraint solver: Newton's method on MuJoCo's convex problem, all lanes at once.
//! (Documentation: Computation, "Constraint solver": minimise ½ (a − a₀)ᵀ M (a − a₀) + s(J a − reference).)
//!
//! Every edge of a friction pyramid and every joint limit costs ½ D r² while its residual r is negative. As
//! long as the set of such rows does not change, the problem is quadratic and a Newton step solves it. So it is
//! with dry friction while the same joints stick, and with elliptic cones while no contact slips.

use crate::arrow::Arrow;
use crate::cone::{Push, Turn};
use crate::contact::Contact;
use crate::coords::Coords;
use crate::dry_friction::DryFriction;
use crate::kinematics::Kinematics;
use crate::lane::{Lane, Mask};
use crate::limit::Limits;
use crate::math::{Axes, Vec3, add, cross, dot, rotate, scale_add, sub, zero3};

/// More than any state needs: MuJoCo's own default is 100, and four suffice for most.
const MAX_ITERATIONS: usize = 100;
const MAX_LINE_SEARCH: usize = 50;

/// The problem and the solver's present point.
pub struct Problem<'a, T: Lane, const L: usize, const J: usize> {
    pub mass: &'a Arrow<T, L, J>,
    pub kinematics: &'a Kinematics<T, L, J>,
    pub contacts: &'a mut [Contact<T, J>],
    pub limits: &'a mut Limits<T, L, J>,
    pub dry_friction: &'a mut DryFriction<T>,
    /// Room for the Hessian.
    pub hessian: &'a mut Arrow<T, L, J>,
    /// Room for its factorisation.
    pub factor: &'a mut Arrow<T, L, J>,
    /// Lanes with at least one constraint; the others keep the smooth acceleration.
    pub present: T::Mask,
    /// Whether contacts may slip on elliptic cones. Close to the solution each Newton step then doubles the
    /// number of correct digits, so that one more than the stopping rule asks for is worth its cost.
    pub slips: bool,
}

/// A point of the search: the acceleration and M times its distance from the smooth one.
struct Point<T, const L: usize, const J: usize> {
    acceleration: Coords<T, L, J>,
    momentum: Coords<T, L, J>,
}

impl<T: Lane, const L: usize, const J: usize> Problem<'_, T, L, J> {
    /// The acceleration under constraints; contacts and limits keep its residuals.
    #[inline(always)]
    pub fn solve(&mut self, smooth: &Coords<T, L, J>, guess: &Coords<T, L, J>, scale: T) -> Coords<T, L, J> {
        let mut point = self.start(smooth, guess);
        let tolerance = T::of(if T::DOUBLE { 1e-14 } else { 1e-9 });
        let mut live = self.present;
        for _ in 0..MAX_ITERATIONS {
            if !live.any() {
                break;
            }
            let gradient = self.derivatives(&point.momentum);
            let mut step = gradient;
            self.hessian.solve(self.factor, &mut step);
            let decrement = step.dot(&gradient);
            let arrived = (T::of(0.5) * scale * decrement).lt(tolerance);
            if !self.slips {
                live = live & !arrived;
            }
            if !live.any() {
                break;
            }
            step.negate(live);
            let mass_step = self.mass.mul(&step);
            self.prepare_search(&step);
            let searched = live & !arrived;
            let (mut length, exact) = self.search(&point.momentum, &step, &mass_step, decrement, searched);
            length = T::select(live & arrived, T::of(1.0), length);
            point.acceleration.add_scaled(length, &step);
            point.momentum.add_scaled(length, &mass_step);
            self.advance(length);
            live = searched & !exact;
        }
        point.acceleration
    }

    /// Begins at the cheaper of the smooth acceleration and the guess.
    #[inline(always)]
    fn start(&mut self, smooth: &Coords<T, L, J>, guess: &Coords<T, L, J>) -> Point<T, L, J> {
        let half = T::of(0.5);
        let mut distance = *guess;
        distance.subtract(smooth);
        let mut momentum = self.mass.mul(&distance);
        let mut guess_cost = half * momentum.dot(&distance);
        let mut smooth_cost = T::zero();
        for contact in self.contacts.iter_mut() {
            contact.residual.linear = sub(contact.along(guess), contact.reference.linear);
            contact.slope.linear = sub(contact.along(smooth), contact.reference.linear);
            if contact.turns() {
                let reference = contact.reference.angular;
                contact.residual.angular = sub(contact.around(self.kinematics, guess), reference);
                contact.slope.angular = sub(contact.around(self.kinematics, smooth), reference);
            }
            guess_cost = contact.add_cost(&contact.residual, guess_cost);
            smooth_cost = contact.add_cost(&contact.slope, smooth_cost);
        }
        for limb in 0..L {
            for joint in 0..J {
                let limit = &mut self.limits.rows[limb][joint];
                if !limit.somewhere {
                    continue;
                }
                limit.residual = limit.sign * guess.limbs[limb][joint] - limit.reference;
                limit.slope = limit.sign * smooth.limbs[limb][joint] - limit.reference;
                let half_weight = half * limit.weight;
                guess_cost = half_weight.mul_add(negative_square(limit.residual), guess_cost);
                smooth_cost = half_weight.mul_add(negative_square(limit.slope), smooth_cost);
            }
        }
        for friction in &mut self.dry_friction.rows {
            let (limb, joint) = friction.joint;
            friction.residual = guess.limbs[limb][joint] - friction.reference;
            friction.slope = smooth.limbs[limb][joint] - friction.reference;
            guess_cost = friction.add_cost(friction.residual, guess_cost);
            smooth_cost = friction.add_cost(friction.slope, smooth_cost);
        }

        let use_guess = guess_cost.lt(smooth_cost) & self.present;
        for contact in self.contacts.iter_mut() {
            contact.residual.linear = select(use_guess, contact.residual.linear, contact.slope.linear);
            if contact.turns() {
                contact.residual.angular = select(use_guess, contact.residual.angular, contact.slope.angular);
            }
        }
        for limit in self.limits.rows.as_flattened_mut() {
            if limit.somewhere {
                limit.residual = T::select(use_guess, limit.residual, limit.slope);
            }
        }
        for friction in &mut self.dry_friction.rows {
            friction.residual = T::select(use_guess, friction.residual, friction.slope);
        }
        momentum.keep(use_guess);
        let mut acceleration = *smooth;
        acceleration.replace(use_guess, guess);
        Point { acceleration, momentum }
    }

    /// Gradient M (a − a₀) + Jᵀ D r; fills the Hessian M + Jᵀ D J, both over the rows that push.
    #[inline(always)]
    fn derivatives(&mut self, momentum: &Coords<T, L, J>) -> Coords<T, L, J> {
        let mut gradient = *momentum;
        *self.hessian = *self.mass;
        for contact in self.contacts.iter_mut() {
            add_contact(contact, self.kinematics, &mut gradient, self.hessian);
        }
        for friction in &mut self.dry_friction.rows {
            let (limb, joint) = friction.joint;
            gradient.limbs[limb][joint] += friction.gradient(friction.residual);
            self.hessian.limbs[limb][joint][joint] +=
                friction.weight.keep(friction.sticks(friction.residual));
        }
        for limb in 0..L {
            for joint in 0..J {
                let limit = &mut self.limits.rows[limb][joint];
                if limit.somewhere {
                    limit.active = limit.residual.lt(T::zero());
                    let weight = limit.weight.keep(limit.active);
                    let entry = &mut gradient.limbs[limb][joint];
                    *entry = (weight * limit.residual).mul_add(limit.sign, *entry);
                    self.hessian.limbs[limb][joint][joint] += weight;
                }
            }
        }
        gradient
    }

    /// Slopes of all residuals along the step.
    #[inline(always)]
    fn prepare_search(&mut self, step: &Coords<T, L, J>) {
        for contact in self.contacts.iter_mut() {
            contact.slope.linear = contact.along(step);
            if contact.turns() {
                contact.slope.angular = contact.around(self.kinematics, step);
            }
        }
        for friction in &mut self.dry_friction.rows {
            let (limb, joint) = friction.joint;
            friction.slope = step.limbs[limb][joint];
        }
        for limb in 0..L {
            for joint in 0..J {
                let limit = &mut self.limits.rows[limb][joint];
                if limit.somewhere {
                    limit.slope = limit.sign * step.limbs[limb][joint];
                }
            }
        }
    }

    /// Exact line search: Newton's method on the derivative, kept inside a bracket, first tried at 1.
    ///
    /// Returns the length and the lanes in which the cost is quadratic along a whole step, which have
    /// arrived at the solution.
    #[inline(always)]
    fn search(
        &self,
        momentum: &Coords<T, L, J>,
        step: &Coords<T, L, J>,
        mass_step: &Coords<T, L, J>,
        decrement: T,
        live: T::Mask,
    ) -> (T, T::Mask) {
        let (zero, half) = (T::zero(), T::of(0.5));
        let smooth = (momentum.dot(step), mass_step.dot(step));
        let tolerance = decrement * T::of(if T::DOUBLE { 1e-11 } else { 1e-4 });
        let mut length = T::of(1.0).keep(live);
        let (mut low, mut high) = (zero, T::of(1e10));
        let (mut slope, mut curvature, changed) = self.along(length, smooth);
        let exact = live & !changed;
        let mut open = live & changed & tolerance.lt(slope.abs());
        for _ in 0..MAX_LINE_SEARCH {
            if !open.any() {
                break;
            }
            let short = slope.lt(zero) & open;
            let long = open & !short;
            low = T::select(short, length, low);
            high = T::select(long, length, high);
            let newton = length - slope / curvature;
            let inside = low.lt(newton) & newton.lt(high);
            let next = T::select(inside, newton, (low + high) * half);
            length = T::select(open, next, length);
            (slope, curvature, _) = self.along(length, smooth);
            open = open & tolerance.lt(slope.abs());
        }
        (length, exact)
    }

    /// First and second derivative of the cost at a length of the step, and the lanes in which the cost is
    /// not the same quadratic function there as at its beginning.
    #[inline(always)]
    fn along(&self, length: T, smooth: (T, T)) -> (T, T, T::Mask) {
        let zero = T::zero();
        let mut slope = smooth.1.mul_add(length, smooth.0);
        let mut curvature = smooth.1;
        let mut changed = T::Mask::none();
        for contact in self.contacts.iter() {
            let contact_changed;
            (slope, curvature, contact_changed) = contact.add_along(length, (slope, curvature));
            changed = changed | contact_changed;
        }
        for friction in &self.dry_friction.rows {
            let residual = friction.slope.mul_add(length, friction.residual);
            changed = changed | friction.changes(friction.residual, residual);
            slope = friction.gradient(residual).mul_add(friction.slope, slope);
            let weighted = (friction.weight * friction.slope).keep(friction.sticks(residual));
            curvature = weighted.mul_add(friction.slope, curvature);
        }
        for limit in self.limits.rows.as_flattened() {
            if limit.somewhere {
                let residual = limit.slope.mul_add(length, limit.residual);
                let active = residual.lt(zero);
                changed = changed | ((active ^ limit.active) & zero.lt(limit.weight));
                let weighted = (limit.weight * limit.slope).keep(active);
                slope = weighted.mul_add(residual, slope);
                curvature = weighted.mul_add(limit.slope, curvature);
            }
        }
        (slope, curvature, changed)
    }

    #[inline(always)]
    fn advance(&mut self, length: T) {
        for contact in self.contacts.iter_mut() {
            contact.residual.linear = scale_add(contact.slope.linear, length, contact.residual.linear);
            if contact.turns() {
                contact.residual.angular = scale_add(contact.slope.angular, length, contact.residual.angular);
            }
        }
        for friction in &mut self.dry_friction.rows {
            friction.residual = friction.slope.mul_add(length, friction.residual);
        }
        for limit in self.limits.rows.as_flattened_mut() {
            if limit.somewhere {
                limit.residual = limit.slope.mul_add(length, limit.residual);
            }
        }
    }
}

/// r² of a row that pushes, 0 otherwise.
#[inline(always)]
fn negative_square<T: Lane>(residual: T) -> T {
    let negative = residual.min(T::zero());
    negative * negative
}

#[inline(always)]
fn select<T: Lane>(mask: T::Mask, yes: Vec3<T>, no: Vec3<T>) -> Vec3<T> {
    [T::select(mask, yes[0], no[0]), T::select(mask, yes[1], no[1]), T::select(mask, yes[2], no[2])]
}

/// Adds a contact's force to the gradient and its stiffness to the Hessian.
///
/// The stiffness is a symmetric 3 × 3 matrix in the contact's frame; the Jacobian carries it over.
#[inline(always)]
fn add_contact<T: Lane, const L: usize, const J: usize>(
    contact: &mut Contact<T, J>,
    kinematics: &Kinematics<T, L, J>,
    gradient: &mut Coords<T, L, J>,
    hessian: &mut Arrow<T, L, J>,
) {
    let push = contact.push();
    contact.active = push.active;
    let force = contact.world(push.gradient);
    let torque = cross(contact.at, force);
    for i in 0..3 {
        gradient.root[i] += force[i];
        gradient.root[3 + i] += torque[i];
    }

    let stiffness = world_stiffness(contact.tangent, &push);
    // [1; r×] W [1, −r×]: lower triangle of the root's block.
    let lower =
        [cross(contact.at, stiffness[0]), cross(contact.at, stiffness[1]), cross(contact.at, stiffness[2])];
    for i in 0..3 {
        for j in 0..i + 1 {
            hessian.root[i][j] += stiffness[i][j];
        }
        for j in 0..3 {
            hessian.root[3 + i][j] += lower[j][i];
        }
        let turned = cross(contact.at, [lower[0][i], lower[1][i], lower[2][i]]);
        for j in 0..i + 1 {
            hessian.root[3 + i][3 + j] += turned[j];
        }
    }
    if contact.turns() {
        T::run(
            #[inline(always)]
            || add_turn(contact, kinematics, gradient, hessian),
        );
    }
    let Some((limb, joints)) = contact.limb else {
        return;
    };
    for joint in 0..joints {
        let column = contact.columns[joint];
        let pushed = mul(&stiffness, column);
        let turned = cross(contact.at, pushed);
        gradient.limbs[limb][joint] += dot(column, force);
        let coupling = &mut hessian.coupling[limb][joint];
        for i in 0..3 {
            coupling[i] += pushed[i];
            coupling[3 + i] += turned[i];
        }
        for inner in 0..joint + 1 {
            hessian.limbs[limb][joint][inner] += dot(contact.columns[inner], pushed);
        }
    }
}

/// Adds what torsional and rolling friction contribute: with B the Hessian by force and torque and C that by
/// the torque, each joint's velocity v and axis h at the contact gain B h in force and Bᵀ v + C h in torque.
#[inline(always)]
fn add_turn<T: Lane, const L: usize, const J: usize>(
    contact: &Contact<T, J>,
    kinematics: &Kinematics<T, L, J>,
    gradient: &mut Coords<T, L, J>,
    hessian: &mut Arrow<T, L, J>,
) {
    let turn: Turn<T> = contact.turn();
    let (axes, turning_axes) = (contact.axes(), contact.turning_axes());
    let torque = rotate(&turning_axes, turn.gradient);
    let mixed = carried(&axes, &turn.mixed, &turning_axes);
    let transposed = transpose(&mixed);
    let stiffness = carried(&turning_axes, &turn.stiffness, &turning_axes);
    // r × each column of B.
    let lever = [
        cross(contact.at, transposed[0]),
        cross(contact.at, transposed[1]),
        cross(contact.at, transposed[2]),
    ];
    for i in 0..3 {
        gradient.root[3 + i] += torque[i];
        for j in 0..3 {
            hessian.root[3 + i][j] += mixed[j][i];
        }
        for j in 0..i + 1 {
            hessian.root[3 + i][3 + j] += stiffness[i][j] + (lever[i][j] + lever[j][i]);
        }
    }
    let Some((limb, joints)) = contact.limb else {
        return;
    };
    let links = &kinematics.links[limb];
    for joint in 0..joints {
        let hinge = links[joint].hinge();
        let force = mul(&mixed, hinge);
        let turned = add(mul(&transposed, contact.columns[joint]), mul(&stiffness, hinge));
        let whole = add(cross(contact.at, force), turned);
        gradient.limbs[limb][joint] += dot(hinge, torque);
        let coupling = &mut hessian.coupling[limb][joint];
        for i in 0..3 {
            coupling[i] += force[i];
            coupling[3 + i] += whole[i];
        }
        for inner in 0..joint + 1 {
            hessian.limbs[limb][joint][inner] +=
                dot(contact.columns[inner], force) + dot(links[inner].hinge(), turned);
        }
    }
}

/// A matrix, given as rows, times a vector.
#[inline(always)]
fn mul<T: Lane>(rows: &[Vec3<T>; 3], v: Vec3<T>) -> Vec3<T> {
    [dot(rows[0], v), dot(rows[1], v), dot(rows[2], v)]
}

#[inline(always)]
fn transpose<T: Lane>(rows: &[Vec3<T>; 3]) -> [Vec3<T>; 3] {
    let [a, b, c] = rows;
    [[a[0], b[0], c[0]], [a[1], b[1], c[1]], [a[2], b[2], c[2]]]
}

/// Σᵢⱼ inner[i][j] · leftᵢ rightⱼᵀ: a matrix given along two sets of axes, in the world's coordinates.
#[inline(always)]
fn carried<T: Lane>(left: &Axes<T>, inner: &[Vec3<T>; 3], right: &Axes<T>) -> [Vec3<T>; 3] {
    let mut rows = [zero3(); 3];
    for i in 0..3 {
        let along = rotate(right, inner[i]);
        for row in 0..3 {
            for column in 0..3 {
                rows[row][column] = left[i][row].mul_add(along[column], rows[row][column]);
            }
        }
    }
    rows
}

/// Rows of the stiffness of a contact in the world's frame.
#[inline(always)]
fn world_stiffness<T: Lane>([x, y]: [T; 2], push: &Push<T>) -> [Vec3<T>; 3] {
    let [normal, first, second, tilt_first, tilt_second] = push.stiffness;
    let (x2, y2) = (x * x, y * y);
    let mut xx = first.mul_add(x2, second * y2);
    let mut yy = first.mul_add(y2, second * x2);
    let mut xy = (first - second) * (x * y);
    if let Some(skew) = push.skew {
        let twice = T::of(2.0) * skew * (x * y);
        xx -= twice;
        yy += twice;
        xy = skew.mul_add(x2 - y2, xy);
    }
    let xz = tilt_first * x - tilt_second * y;
    let yz = tilt_first.mul_add(y, tilt_second * x);
    [[xx, xy, xz], [xy, yy, yz], [xz, yz, normal]]
}
