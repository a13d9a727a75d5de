//! The constraint solver: Newton's method on MuJoCo's convex problem, all lanes at once.
//! (Documentation: Computation, "Constraint solver": minimise ½ (a − a₀)ᵀ M (a − a₀) + s(J a − reference).)
//!
//! Every edge of a friction pyramid and every joint limit costs ½ D r² while its residual r is negative. As
//! long as the set of such rows does not change, the problem is quadratic and a Newton step solves it. So it is
//! with dry friction while the same joints stick, and with elliptic cones while no contact slips.

use crate::arrow::Arrow;
use crate::contact::Contacts;
use crate::coords::Coords;
use crate::dry_friction::DryFriction;
use crate::hessian::{add_contact, add_turn};
use crate::kinematics::Kinematics;
use crate::lane::{Lane, Mask};
use crate::limit::Limits;

/// Whole steps before the line searches. Hardly any state needs more than four.
const MAX_WHOLE_STEPS: usize = 8;
/// More than any state needs: MuJoCo's own default is 100.
const MAX_ITERATIONS: usize = 100;
const MAX_LINE_SEARCH: usize = 50;
/// Above every length of a step.
const UNBOUNDED: f64 = 1e10;

/// The problem; contacts, limits and dry friction contain the solver's present point.
pub struct Problem<'a, T: Lane, const L: usize, const J: usize, const W: usize> {
    pub mass: &'a Arrow<T, L, J, W>,
    /// M a₀: all forces but those of the constraints.
    pub force: &'a Coords<T, L, J>,
    pub kinematics: &'a Kinematics<T, L, J>,
    pub contacts: &'a mut Contacts<T, J, W>,
    pub limits: &'a mut Limits<T, L, J>,
    pub dry_friction: &'a mut DryFriction<T>,
    /// Room for the Hessian and its factorisation.
    pub hessian: &'a mut Arrow<T, L, J, W>,
    /// Scale of the stopping rule.
    pub scale: T,
}

/// A point of the search: the acceleration and M times its distance from the smooth one.
struct Point<T, const L: usize, const J: usize> {
    acceleration: Coords<T, L, J>,
    momentum: Coords<T, L, J>,
}

impl<T: Lane, const L: usize, const J: usize, const W: usize> Problem<'_, T, L, J, W> {
    /// The acceleration under constraints that are quadratic but for the rows that push.
    ///
    /// Beginning with the rows that pushed in the evaluation before, whole Newton steps mostly arrive in one to
    /// three, and the first needs no acceleration to begin with. Where they do not, line searches make sure.
    #[inline(always)]
    pub fn solve(&mut self) -> Coords<T, L, J> {
        let (mut right, mut acceleration) = (*self.force, Coords::zero());
        self.newton(&mut right, &mut acceleration, true);
        let mut live = self.set_acceleration(&acceleration);
        for _ in 1..MAX_WHOLE_STEPS {
            if !live.any() {
                return acceleration;
            }
            // From here on small differences are solved for, which loses fewer digits.
            let mut gradient = self.momentum(&acceleration);
            let mut step = Coords::zero();
            self.newton(&mut gradient, &mut step, false);
            step.negate(live);
            acceleration.add_scaled(T::of(1.0), &step);
            live = live & self.set_acceleration(&acceleration);
        }
        T::run(
            #[inline(always)]
            || self.descend(&acceleration, live, false),
        )
    }

    /// M (a − a₀).
    #[inline(always)]
    fn momentum(&self, acceleration: &Coords<T, L, J>) -> Coords<T, L, J> {
        let mut momentum = self.mass.mul(acceleration);
        momentum.subtract(self.force);
        momentum
    }

    /// The acceleration under any constraints, from a guess.
    ///
    /// `slips`: whether contacts may slip on elliptic cones. Close to the solution each Newton step then doubles
    /// the number of correct digits, so that one more than the stopping rule asks for is worth its cost.
    #[inline(always)]
    pub fn solve_from(&mut self, guess: &Coords<T, L, J>, slips: bool) -> Coords<T, L, J> {
        self.set_acceleration(guess);
        self.descend(guess, !T::Mask::none(), slips)
    }

    /// Newton's method with line searches, in the lanes of a mask.
    #[inline(always)]
    fn descend(&mut self, from: &Coords<T, L, J>, mut live: T::Mask, slips: bool) -> Coords<T, L, J> {
        let mut point = Point { acceleration: *from, momentum: self.momentum(from) };
        for friction in &mut self.dry_friction.rows {
            friction.settle();
        }
        let tolerance = T::of(if T::DOUBLE { 1e-14 } else { 1e-9 });
        for _ in 0..MAX_ITERATIONS {
            if !live.any() {
                break;
            }
            let (mut gradient, mut step) = (point.momentum, Coords::zero());
            self.newton(&mut gradient, &mut step, false);
            let decrement = step.dot(&gradient);
            let arrived = (T::of(0.5) * self.scale * decrement).lt(tolerance);
            if !slips {
                live = live & !arrived;
            }
            if !live.any() {
                break;
            }
            step.negate(live);
            let mass_step = self.mass.mul(&step);
            self.set_step(&step);
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

    /// Solves H x = right + Jᵀ d, with H = M + Jᵀ D J over the rows that push.
    ///
    /// With `whole`, `right` is the force and d what the references demand: x is then the acceleration after a
    /// whole Newton step. Without, d is the gradient of the cost, and x minus the step; `right` becomes the
    /// whole right side.
    #[inline(always)]
    fn newton(&mut self, right: &mut Coords<T, L, J>, x: &mut Coords<T, L, J>, whole: bool) {
        // A function of its own, since it is called in several places.
        T::run(
            #[inline(always)]
            || self.solve_newton(right, x, whole),
        );
    }

    #[inline(always)]
    fn solve_newton(&mut self, right: &mut Coords<T, L, J>, x: &mut Coords<T, L, J>, whole: bool) {
        let Self { mass, kinematics, contacts, limits, dry_friction, hessian, .. } = self;
        hessian.set_root(mass);
        x.root = [T::zero(); 6];
        // The limbs change the trunk, limb 0, which is the last.
        if W > 0 {
            hessian.set_limb(0, mass);
            x.limbs[0] = [T::zero(); J];
        }
        for limb in (0..L).rev() {
            if W == 0 || limb > 0 {
                hessian.set_limb(limb, mass);
                x.limbs[limb] = [T::zero(); J];
            }
            for pyramid in &mut contacts.pyramids {
                if pyramid.contact.is_added_with(limb) {
                    let push = pyramid.push(whole);
                    add_contact(&pyramid.contact, &push, right, hessian);
                }
            }
            if !contacts.cones.is_empty() {
                T::run(
                    #[inline(always)]
                    || {
                        for cone in &contacts.cones {
                            if cone.contact.is_added_with(limb) {
                                let push = cone.push();
                                add_contact(&cone.contact, &push, right, hessian);
                                if cone.turns() {
                                    add_turn(cone, kinematics, right, hessian);
                                }
                            }
                        }
                    },
                );
            }
            for friction in &dry_friction.rows {
                let (own, joint) = friction.joint;
                if own == limb {
                    right.limbs[limb][joint] += if whole { friction.demand() } else { friction.gradient() };
                    hessian.limbs[limb][joint][joint] += friction.curvature();
                }
            }
            for joint in 0..J {
                let limit = &mut limits.rows[limb][joint];
                if limit.somewhere {
                    limit.active = limit.residual.lt(T::zero());
                    let weight = limit.weight.keep(limit.active);
                    let entry = &mut right.limbs[limb][joint];
                    let along = if whole { limit.reference } else { limit.residual };
                    *entry = (weight * along).mul_add(limit.sign, *entry);
                    hessian.limbs[limb][joint][joint] += weight;
                }
            }
            for joint in 0..J {
                x.limbs[limb][joint] += right.limbs[limb][joint];
            }
            hessian.eliminate(limb, x);
        }
        for i in 0..6 {
            x.root[i] += right.root[i];
        }
        hessian.substitute(x);
    }

    /// Computes all residuals; returns the lanes in which other rows push than when the derivatives were last
    /// computed.
    #[inline(always)]
    fn set_acceleration(&mut self, acceleration: &Coords<T, L, J>) -> T::Mask {
        let mut changed = T::Mask::none();
        for pyramid in &mut self.contacts.pyramids {
            changed = changed | pyramid.set_acceleration(acceleration);
        }
        if !self.contacts.cones.is_empty() {
            let (cones, kinematics) = (&mut self.contacts.cones, self.kinematics);
            T::run(
                #[inline(always)]
                || {
                    for cone in cones {
                        cone.set_acceleration(kinematics, acceleration);
                    }
                },
            );
        }
        for friction in &mut self.dry_friction.rows {
            let (limb, joint) = friction.joint;
            changed = changed | friction.set_residual(acceleration.limbs[limb][joint] - friction.reference);
        }
        for limb in 0..L {
            for joint in 0..J {
                let limit = &mut self.limits.rows[limb][joint];
                if limit.somewhere {
                    limit.residual = limit.sign * acceleration.limbs[limb][joint] - limit.reference;
                    changed = changed | limit.changes(limit.residual);
                }
            }
        }
        changed
    }

    /// Slopes of all residuals along the step.
    #[inline(always)]
    fn set_step(&mut self, step: &Coords<T, L, J>) {
        for pyramid in &mut self.contacts.pyramids {
            pyramid.set_step(step);
        }
        for cone in &mut self.contacts.cones {
            cone.set_step(self.kinematics, step);
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

    /// Line search: Newton's method on the derivative, kept inside a bracket, first tried at 1, until the slope is a
    /// tenth of that at the beginning. A more exact one saves no Newton step, but takes several times as long.
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
        let tolerance = decrement * T::of(0.1);
        let mut length = T::of(1.0).keep(live);
        let (mut low, mut high) = (zero, T::of(UNBOUNDED));
        let (mut slope, mut curvature, changed) = self.along(length, smooth);
        let exact = live & !changed;
        let mut open = live & changed & tolerance.lt(slope.abs());
        for _ in 0..MAX_LINE_SEARCH {
            if !open.any() {
                break;
            }
            let short = slope.lt(zero) & open;
            let long = open & !short;
            let before = high - low;
            low = T::select(short, length, low);
            high = T::select(long, length, high);
            let newton = (length - slope / curvature).min(length * T::of(8.0));
            // Between the kinks of the slope Newton's method may creep, or step out of the bracket.
            let is_unbounded = !high.lt(T::of(UNBOUNDED));
            let creeps = !((high - low).lt(before * half) | is_unbounded);
            let inside = low.lt(newton) & newton.lt(high) & !creeps;
            let middle = T::select(is_unbounded, length * T::of(2.0), (low + high) * half);
            length = T::select(open, T::select(inside, newton, middle), length);
            (slope, curvature, _) = self.along(length, smooth);
            open = open & tolerance.lt(slope.abs());
        }
        (length, exact)
    }

    /// First and second derivative of the cost at a length of the step, and the lanes in which the cost is
    /// not the same quadratic function there as at its beginning.
    #[inline(always)]
    fn along(&self, length: T, smooth: (T, T)) -> (T, T, T::Mask) {
        let mut slope = smooth.1.mul_add(length, smooth.0);
        let mut curvature = smooth.1;
        let mut changed = T::Mask::none();
        for pyramid in &self.contacts.pyramids {
            let pyramid_changed;
            (slope, curvature, pyramid_changed) = pyramid.add_along(length, (slope, curvature));
            changed = changed | pyramid_changed;
        }
        for cone in &self.contacts.cones {
            let cone_changed;
            (slope, curvature, cone_changed) = cone.add_along(length, (slope, curvature));
            changed = changed | cone_changed;
        }
        for friction in &self.dry_friction.rows {
            let friction_changed;
            (slope, curvature, friction_changed) = friction.add_along(length, (slope, curvature));
            changed = changed | friction_changed;
        }
        for limit in self.limits.rows.as_flattened() {
            if limit.somewhere {
                let residual = limit.slope.mul_add(length, limit.residual);
                changed = changed | limit.changes(residual);
                let weighted = (limit.weight * limit.slope).keep(residual.lt(T::zero()));
                slope = weighted.mul_add(residual, slope);
                curvature = weighted.mul_add(limit.slope, curvature);
            }
        }
        (slope, curvature, changed)
    }

    #[inline(always)]
    fn advance(&mut self, length: T) {
        for pyramid in &mut self.contacts.pyramids {
            pyramid.advance(length);
        }
        for cone in &mut self.contacts.cones {
            cone.advance(length);
        }
        for friction in &mut self.dry_friction.rows {
            friction.advance(length);
        }
        for limit in self.limits.rows.as_flattened_mut() {
            if limit.somewhere {
                limit.residual = limit.slope.mul_add(length, limit.residual);
            }
        }
    }
}
