//! Substeps: Runge–Kutta of order 4, semi-implicit Euler and implicitfast.
//! (Documentation: Computation, "Numerical integration".)

use crate::constants::Constants;
use crate::coords::Coords;
use crate::dynamics::Dynamics;
use crate::lane::{Lane, Mask};
use crate::math::{Vec3, cross, dot, polynomial, quat_mul, quat_normalize, scale, scale_add, sin_cos};
use crate::model::Integrator;
use crate::skeleton::Skeleton;
use crate::state::{Position, State};

/// Everything a substep reads, and its last evaluation.
pub struct Substep<'a, T: Lane, const L: usize, const J: usize, const W: usize> {
    pub skeleton: &'a Skeleton<T, L, J>,
    pub constants: &'a Constants<T, L, J>,
    pub ctrl: &'a [[T; J]; L],
    pub dynamics: &'a mut Dynamics<T, L, J, W>,
}

/// Observer of the evaluations of a substep.
pub trait Observer<T: Lane, const L: usize, const J: usize, const W: usize> {
    /// The first evaluation, in the state before the substep.
    fn first(&mut self, dynamics: &Dynamics<T, L, J, W>);

    /// The last evaluation, in `position`.
    fn last(&mut self, dynamics: &Dynamics<T, L, J, W>, position: &Position<T, L, J>);
}

impl<T: Lane, const L: usize, const J: usize, const W: usize> Substep<'_, T, L, J, W> {
    /// Advances the state by one timestep.
    #[inline(always)]
    pub fn advance(&mut self, state: &mut State<T, L, J>, observer: &mut impl Observer<T, L, J, W>) {
        match self.skeleton.integrator {
            Integrator::Rk4 { rotation_correction } => {
                self.runge_kutta(state, rotation_correction, observer);
            }
            Integrator::Euler { .. } | Integrator::ImplicitFast { .. } => self.euler(state, observer),
        }
    }

    /// One evaluation: a function of its own, since several stages call it.
    #[inline(always)]
    pub fn forward(&mut self, state: &State<T, L, J>) {
        let Self { skeleton, constants, ctrl, dynamics } = self;
        T::run(
            #[inline(always)]
            || dynamics.update(skeleton, constants, state, ctrl),
        );
    }

    #[inline(always)]
    fn euler(&mut self, state: &mut State<T, L, J>, observer: &mut impl Observer<T, L, J, W>) {
        let timestep = T::of(self.skeleton.timestep);
        self.forward(state);
        observer.first(self.dynamics);
        observer.last(self.dynamics, &state.position);
        state.warm_start = self.dynamics.qacc();
        let actuation = &self.dynamics.actuation;
        let acceleration = match self.skeleton.integrator {
            Integrator::Euler { implicit_damping: false } => state.warm_start,
            Integrator::ImplicitFast { .. } => {
                let drag = actuation.drag;
                self.dynamics.implicit_qacc(self.constants.root_damping, &drag, timestep)
            }
            _ => {
                let damping = actuation.damping;
                self.dynamics.implicit_qacc(self.constants.root_damping, &damping, timestep)
            }
        };
        state.velocity.add_scaled(timestep, &acceleration);
        state.position = moved(&state.position, &state.velocity, timestep);
    }

    /// The classical tableau: stages at 0, ½, ½ and 1, weighted 1 : 2 : 2 : 1.
    #[inline(always)]
    fn runge_kutta(
        &mut self,
        state: &mut State<T, L, J>,
        rotation_correction: bool,
        observer: &mut impl Observer<T, L, J, W>,
    ) {
        let timestep = self.skeleton.timestep;
        let begin = *state;
        let mut mean_velocity = Coords::zero();
        let mut mean_acceleration = Coords::zero();
        // Velocity of the previous stage as the rate of a rotation vector, and its acceleration.
        let mut rate: Coords<T, L, J> = begin.velocity;
        let mut acceleration: Coords<T, L, J> = Coords::zero();
        let stages = [(0.0, 1.0 / 6.0), (0.5, 1.0 / 3.0), (0.5, 1.0 / 3.0), (1.0, 1.0 / 6.0)];
        for (index, (at, weight)) in stages.into_iter().enumerate() {
            if index > 0 {
                let part = T::of(timestep * at);
                state.position = moved(&begin.position, &rate, part);
                state.velocity = begin.velocity;
                state.velocity.add_scaled(part, &acceleration);
                let turn = scale(rate.angular(), part);
                rate = state.velocity;
                if rotation_correction {
                    rate = rate.with_angular(rotation_vector_rate(turn, rate.angular()));
                }
            }
            self.forward(state);
            acceleration = self.dynamics.qacc();
            state.warm_start = acceleration;
            mean_velocity.add_scaled(T::of(weight), &rate);
            mean_acceleration.add_scaled(T::of(weight), &acceleration);
            if index == 0 {
                observer.first(self.dynamics);
            } else if index == 3 {
                observer.last(self.dynamics, &state.position);
            }
        }
        state.position = moved(&begin.position, &mean_velocity, T::of(timestep));
        state.velocity = begin.velocity;
        state.velocity.add_scaled(T::of(timestep), &mean_acceleration);
    }
}

/// Positions after moving for `time` with constant velocity; the root turns about its own axes.
#[inline(always)]
fn moved<T: Lane, const L: usize, const J: usize>(
    position: &Position<T, L, J>,
    velocity: &Coords<T, L, J>,
    time: T,
) -> Position<T, L, J> {
    let linear = [velocity.root[0], velocity.root[1], velocity.root[2]];
    let mut joints = position.joints;
    for limb in 0..L {
        for joint in 0..J {
            joints[limb][joint] = velocity.limbs[limb][joint].mul_add(time, joints[limb][joint]);
        }
    }
    Position {
        root: scale_add(linear, time, position.root),
        rotation: turned(position.rotation, velocity.angular(), time),
        joints,
    }
}

/// A rotation followed by one with constant angular velocity (`mju_quatIntegrate`).
#[inline(always)]
fn turned<T: Lane>(rotation: [T; 4], velocity: Vec3<T>, time: T) -> [T; 4] {
    let speed = dot(velocity, velocity).sqrt();
    let (sin, cos) = sin_cos(speed * time * T::of(0.5));
    let still = speed.lt(T::of(1e-15));
    let factor = (sin / T::select(still, T::of(1.0), speed)).keep(!still);
    let axis = scale(velocity, factor);
    quat_normalize(quat_mul(rotation, [cos, axis[0], axis[1], axis[2]]))
}

/// Rate of the rotation vector r of a frame that turns with ω, both along its own axes (Bortz' equation):
/// ω + ½ r × ω + c r × (r × ω) with c = (1 − (x/2) cot(x/2)) / x², x = |r|.
#[inline(always)]
fn rotation_vector_rate<T: Lane>(vector: Vec3<T>, omega: Vec3<T>) -> Vec3<T> {
    let mut r = vector;
    let mut square = dot(r, r);
    let far = T::of(SERIES_LIMIT).lt(square);
    let series = if T::DOUBLE { &BORTZ[..] } else { &BORTZ[5..] };
    let mut coefficient = polynomial(square, series);
    if far.any() {
        // The vector of the same rotation whose angle is at most π, and the closed form.
        let angle = square.sqrt();
        let whole = (angle * T::of(0.5 / std::f64::consts::PI)).round();
        let rest = whole.neg_mul_add(T::of(2.0 * std::f64::consts::PI), angle);
        r = scale(r, T::select(far, rest / angle, T::of(1.0)));
        square = dot(r, r);
        let half = T::of(0.5) * square.sqrt();
        let (sin, cos) = sin_cos(half);
        let closed = (T::of(1.0) - half * cos / sin) / square;
        coefficient = T::select(T::of(SERIES_LIMIT).lt(square), closed, polynomial(square, series));
    }
    let turn = cross(r, omega);
    scale_add(cross(r, turn), coefficient, scale_add(turn, T::of(0.5), omega))
}

/// x² up to which the series is used.
const SERIES_LIMIT: f64 = 3.0;

/// Series of (1 − (x/2) cot(x/2)) / x² in x², |B₂ₙ| / (2n)! with Bernoulli's numbers, the highest power first.
const BORTZ: [f64; 13] = [
    3.534_707_039_629_467e-21,
    1.395_446_468_581_252_2e-19,
    5.509_002_828_360_23e-18,
    2.174_868_698_558_062e-16,
    8.586_062_056_277_845e-15,
    3.389_680_296_322_582_7e-13,
    1.338_253_653_068_467_9e-11,
    691.0 / 1_307_674_368_000.0,
    1.0 / 47_900_160.0,
    1.0 / 1_209_600.0,
    1.0 / 30_240.0,
    1.0 / 720.0,
    1.0 / 12.0,
];
