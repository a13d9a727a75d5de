//! Terms: how an observation, a reward and the end of an episode follow from the physics.
//!
//! A backend fills [`Signals`] after an env step; [`Task`] turns them into what a learner sees. The
//! definitions are shared by all backends, so that they can differ in their physics alone.

mod observation;
mod reward;
mod task;

pub use observation::ObservationTerm;
pub use reward::RewardTerm;
pub use task::Task;

/// The physics of one env after a step, as MuJoCo names it; it has not diverged.
#[derive(Debug, Clone, Copy)]
pub struct Signals<'a> {
    /// Positions, `[nq]`.
    pub qpos: &'a [f64],
    /// Velocities, `[nv]`.
    pub qvel: &'a [f64],
    /// Controls, `[nu]`.
    pub ctrl: &'a [f64],
    /// External contact force on every body (torque, then force, world frame), `[nbody · 6]`.
    pub cfrc_ext: &'a [f64],
    /// Sensor readings, `[nsensordata]`.
    pub sensordata: &'a [f64],
    /// Velocity of the main body along +x over the step, m/s.
    pub forward_velocity: f64,
    /// Whether each limb's touch signal is cut off by its damage, `[limbs]`.
    pub disabled_touch: &'a [bool],
}
