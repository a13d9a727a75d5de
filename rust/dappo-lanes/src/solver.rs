//! The constraint solver: Newton's method on MuJoCo's convex problem, all lanes at once.
//! (Documentation: Computation, "Constraint solver": minimise ½ (a − a₀)ᵀ M (a − a₀) + s(J a − reference).)
//!
//! Every edge of a friction pyramid and every joint limit costs ½ D r² while its residual r is negative. As
//! long as the set of such rows does not change, the problem is quadratic and a Newton step solves it.

use crate::arrow::Arrow;
use crate::contact::Contact;
use crate::coords::Coords;
use crate::lane::{Lane, Mask};
use crate::limit::Limits;
use crate::math::{Vec3, cross, dot, scale_add, sub};

/// More than any state needs: MuJoCo's own default is 100, and four suffice for most.
const MAX_ITERATIONS: usize = 30;
const MAX_LINE_SEARCH: usize = 30;

/// The problem and the solver's present point.
pub struct Problem<'a, T: Lane, const L: usize, const J: usize> {
    pub mass: &'a Arrow<T, L, J>,
    pub contacts: &'a mut [Contact<T, J>],
    pub limits: &'a mut Limits<T, L, J>,
    /// Room for the Hessian.
    pub hessian: &'a mut Arrow<T, L, J>,
    /// Lanes with at least one constraint; the others keep the smooth acceleration.
    pub present: T::Mask,
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
            self.hessian.solve(&mut step);
            let decrement = step.dot(&gradient);
            live = live & !(T::of(0.5) * scale * decrement).lt(tolerance);
            if !live.any() {
                break;
            }
            step.negate(live);
            let mass_step = self.mass.mul(&step);
            self.prepare_search(&step);
            let (length, exact) = self.search(&point.momentum, &step, &mass_step, decrement, live);
            point.acceleration.add_scaled(length, &step);
            point.momentum.add_scaled(length, &mass_step);
            self.advance(length);
            live = live & !exact;
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
            contact.residual = sub(contact.along(guess), contact.reference);
            contact.slope = sub(contact.along(smooth), contact.reference);
            let half_weight = half * contact.weight;
            for residual in Contact::<T, J>::edges(contact.residual) {
                guess_cost = half_weight.mul_add(negative_square(residual), guess_cost);
            }
            for residual in Contact::<T, J>::edges(contact.slope) {
                smooth_cost = half_weight.mul_add(negative_square(residual), smooth_cost);
            }
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

        let use_guess = guess_cost.lt(smooth_cost) & self.present;
        for contact in self.contacts.iter_mut() {
            for (residual, &other) in contact.residual.iter_mut().zip(&contact.slope) {
                *residual = T::select(use_guess, *residual, other);
            }
        }
        for limit in self.limits.rows.as_flattened_mut() {
            if limit.somewhere {
                limit.residual = T::select(use_guess, limit.residual, limit.slope);
            }
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
            add_contact(contact, &mut gradient, self.hessian);
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
            contact.slope = contact.along(step);
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
    /// Returns the length and the lanes in which a whole step left the set of pushing rows unchanged, which
    /// have arrived at the solution.
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

    /// First and second derivative of the cost at a length of the step, and the lanes in which the set of
    /// pushing rows differs from that at its beginning.
    #[inline(always)]
    fn along(&self, length: T, smooth: (T, T)) -> (T, T, T::Mask) {
        let zero = T::zero();
        let mut slope = smooth.1.mul_add(length, smooth.0);
        let mut curvature = smooth.1;
        let mut changed = T::Mask::none();
        for contact in self.contacts.iter() {
            let residuals = Contact::<T, J>::edges(scale_add(contact.slope, length, contact.residual));
            let slopes = Contact::<T, J>::edges(contact.slope);
            let mut contact_changed = T::Mask::none();
            for edge in 0..4 {
                let active = residuals[edge].lt(zero);
                contact_changed = contact_changed | (active ^ contact.active[edge]);
                let weighted = (contact.weight * slopes[edge]).keep(active);
                slope = weighted.mul_add(residuals[edge], slope);
                curvature = weighted.mul_add(slopes[edge], curvature);
            }
            changed = changed | (contact_changed & zero.lt(contact.weight));
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
            contact.residual = scale_add(contact.slope, length, contact.residual);
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

/// Adds a contact's force to the gradient and its stiffness to the Hessian.
///
/// The four edges make a symmetric 3 × 3 matrix in the contact's frame; the Jacobian carries it over.
#[inline(always)]
fn add_contact<T: Lane, const L: usize, const J: usize>(
    contact: &mut Contact<T, J>,
    gradient: &mut Coords<T, L, J>,
    hessian: &mut Arrow<T, L, J>,
) {
    let zero = T::zero();
    let residuals = Contact::<T, J>::edges(contact.residual);
    let (mut weights, mut f) = ([zero; 4], [zero; 4]);
    for edge in 0..4 {
        contact.active[edge] = residuals[edge].lt(zero);
        weights[edge] = contact.weight.keep(contact.active[edge]);
        f[edge] = weights[edge] * residuals[edge];
    }
    let force = contact.world([(f[0] + f[1]) + (f[2] + f[3]), f[0] - f[1], f[2] - f[3]]);
    let torque = cross(contact.at, force);
    for i in 0..3 {
        gradient.root[i] += force[i];
        gradient.root[3 + i] += torque[i];
    }

    let stiffness = world_stiffness(contact.tangent, weights);
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
    let Some((limb, joints)) = contact.limb else {
        return;
    };
    for joint in 0..joints {
        let column = contact.columns[joint];
        let pushed = [dot(stiffness[0], column), dot(stiffness[1], column), dot(stiffness[2], column)];
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

/// Rows of the stiffness of a contact in the world's frame: Σ over the edges e of weight · e eᵀ.
#[inline(always)]
fn world_stiffness<T: Lane>([x, y]: [T; 2], weights: [T; 4]) -> [Vec3<T>; 3] {
    let (first, second) = (weights[0] + weights[1], weights[2] + weights[3]);
    let (tilt_first, tilt_second) = (weights[0] - weights[1], weights[2] - weights[3]);
    let (x2, y2) = (x * x, y * y);
    let xx = first.mul_add(x2, second * y2);
    let yy = first.mul_add(y2, second * x2);
    let xy = (first - second) * (x * y);
    let xz = tilt_first * x - tilt_second * y;
    let yz = tilt_first.mul_add(y, tilt_second * x);
    [[xx, xy, xz], [xy, yy, yz], [xz, yz, first + second]]
}
