//! Substeps: Runge–Kutta of order 4, semi-implicit Euler and implicitfast.
//! (Documentation: Computation, "Numerical integration".)

use cubecl::prelude::*;
use dappo_lanes::model::Integrator;

use crate::constants::root;
use crate::coords::Coords;
use crate::dynamics::{Shown, forward, is_implicit};
use crate::math::{V3, is_double, lit, polynomial, sin_cos};
use crate::shape::Shape;
use crate::state::{Place, Position};

/// The state of a world.
#[derive(CubeType)]
pub struct State<F: Float> {
    pub position: Position<F>,
    /// qvel: the root's angular velocity is along its own axes.
    pub velocity: Coords<F>,
    /// qacc of the last evaluation, the solver's first guess (`qacc_warmstart`).
    pub acceleration: Coords<F>,
}

#[cube]
impl<F: Float> State<F> {
    /// Reads the state of a world.
    pub fn read(state: &[F], place: Place, #[comptime] shape: Shape) -> State<F> {
        let row = place.world * comptime!(shape.state());
        let mut own = State::<F> {
            position: Position::<F>::room(shape),
            velocity: Coords::<F>::room(shape),
            acceleration: Coords::<F>::room(shape),
        };
        own.position.read(state, row, place.lane, shape);
        own.velocity.read(state, row + comptime!(shape.velocity()), place.lane, shape);
        own.acceleration.read(state, row + comptime!(shape.guess()), place.lane, shape);
        own
    }

    pub fn write(&self, state: &mut [F], place: Place, #[comptime] shape: Shape) {
        let row = place.world * comptime!(shape.state());
        self.position.write(state, row, place.lane, shape);
        self.velocity.write(state, row + comptime!(shape.velocity()), place.lane, shape);
        self.acceleration.write(state, row + comptime!(shape.guess()), place.lane, shape);
    }

    /// Advances by substeps with Euler or implicitfast, and shows the last evaluation.
    pub fn euler(
        &mut self,
        numbers: &[F],
        place: Place,
        ctrl: &Array<F>,
        readings: &mut [F],
        substeps: u32,
        #[comptime] shape: Shape,
    ) {
        let timestep = numbers[place.model + root::TIMESTEP];
        let mut begin = Position::<F>::room(shape);
        let mut implicit = Coords::<F>::room(shape);
        for substep in 0..substeps {
            let last = substep + 1u32 == substeps;
            forward::<F>(
                numbers,
                place,
                &self.position,
                &self.velocity,
                ctrl,
                Shown { touch: last, forces: last },
                readings,
                &mut self.acceleration,
                &mut implicit,
                shape,
            );
            if comptime!(is_implicit(shape.integrator)) {
                self.velocity.add_scaled(timestep, &implicit, shape);
            } else {
                self.velocity.add_scaled(timestep, &self.acceleration, shape);
            }
            begin.copy_from(&self.position, shape);
            self.position.set_moved(&begin, &self.velocity, timestep, shape);
        }
    }

    /// Advances by substeps with Runge–Kutta: stages at 0, ½, ½ and 1, weighted 1 : 2 : 2 : 1. The last substep shows
    /// touch sensors of the first stage and forces of the last: MuJoCo evaluates sensors before the integrator's
    /// further stages.
    pub fn runge_kutta(
        &mut self,
        numbers: &[F],
        place: Place,
        ctrl: &Array<F>,
        readings: &mut [F],
        substeps: u32,
        #[comptime] shape: Shape,
    ) {
        let timestep = numbers[place.model + root::TIMESTEP];
        let mut begin = Position::<F>::room(shape);
        let mut first = Coords::<F>::room(shape);
        // Velocity of the previous stage as the rate of a rotation vector.
        let mut rate = Coords::<F>::room(shape);
        let mut mean_velocity = Coords::<F>::room(shape);
        let mut mean_acceleration = Coords::<F>::room(shape);
        let mut unused = Coords::<F>::room(shape);
        for substep in 0..substeps {
            begin.copy_from(&self.position, shape);
            first.copy_from(&self.velocity, shape);
            rate.copy_from(&self.velocity, shape);
            mean_velocity.clear(shape);
            mean_acceleration.clear(shape);
            // Not unrolled: the code of an evaluation is large.
            for stage in 0..4u32 {
                if stage > 0u32 {
                    let part = timestep * select(stage == 3u32, lit::<F>(1.0), lit::<F>(0.5));
                    self.position.set_moved(&begin, &rate, part, shape);
                    self.velocity.set_sum(&first, part, &self.acceleration, shape);
                    let turn = rate.angular() * part;
                    rate.copy_from(&self.velocity, shape);
                    if comptime!(shape.integrator == Integrator::Rk4 { rotation_correction: true }) {
                        rate.set_angular(rotation_vector_rate::<F>(turn, self.velocity.angular()));
                    }
                }
                let last = substep + 1u32 == substeps;
                forward::<F>(
                    numbers,
                    place,
                    &self.position,
                    &self.velocity,
                    ctrl,
                    Shown { touch: last && stage == 0u32, forces: last && stage == 3u32 },
                    readings,
                    &mut self.acceleration,
                    &mut unused,
                    shape,
                );
                let outer = stage == 0u32 || stage == 3u32;
                let weight = select(outer, lit::<F>(1.0 / 6.0), lit::<F>(1.0 / 3.0));
                mean_velocity.add_scaled(weight, &rate, shape);
                mean_acceleration.add_scaled(weight, &self.acceleration, shape);
            }
            self.position.set_moved(&begin, &mean_velocity, timestep, shape);
            self.velocity.set_sum(&first, timestep, &mean_acceleration, shape);
        }
    }
}

/// Rate of the rotation vector r of a frame that turns with ω, both along its own axes (Bortz' equation):
/// ω + ½ r × ω + c r × (r × ω) with c = (1 − (x/2) cot(x/2)) / x², x = |r|.
#[cube]
fn rotation_vector_rate<F: Float>(vector: V3<F>, omega: V3<F>) -> V3<F> {
    let one = lit::<F>(1.0);
    let limit = lit::<F>(SERIES_LIMIT);
    let double = is_double::<F>();
    // Beyond the limit, the vector of the same rotation whose angle is at most π.
    let long = vector.dot(vector);
    let far = limit < long;
    let angle = select(far, long, one).sqrt();
    let whole = (angle * lit::<F>(0.5 / std::f64::consts::PI)).round();
    let rest = fma(-whole, lit::<F>(2.0 * std::f64::consts::PI), angle);
    let r = vector * select(far, rest / angle, one);
    let square = r.dot(r);
    let wide = limit < square;
    let half = lit::<F>(0.5) * select(wide, square, one).sqrt();
    let turn = sin_cos::<F>(half);
    let closed = (one - half * turn.cos / turn.sin) / select(wide, square, one);
    let series = polynomial::<F>(square, comptime!(bortz(double)));
    let coefficient = select(wide, closed, series);
    let turned = r.cross(omega);
    r.cross(turned).times_plus(coefficient, turned.times_plus(lit::<F>(0.5), omega))
}

/// x² up to which the series is used.
const SERIES_LIMIT: f64 = 3.0;

/// Series of (1 − (x/2) cot(x/2)) / x² in x², |B₂ₙ| / (2n)! with Bernoulli's numbers, the highest power first.
fn bortz(double: bool) -> Vec<f64> {
    let all = [
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
    all[if double { 0 } else { 5 }..].to_vec()
}
