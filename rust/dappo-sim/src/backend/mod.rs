//! Backends: the physics of N envs at once.
//!
//! A backend is dumb so that backends can be compared: it resets, changes damage classes and steps. Time
//! limits, autoreset, class draws and damage codes belong to the [vector env](crate::vector_env).

mod block;
pub mod gpu;
pub mod lanes;
pub mod mujoco;
mod physics;
mod settings;
mod worlds;

pub use physics::{Physics, WarpDevice};
pub use settings::{BackendKind, Device, Precision};
pub use worlds::{LaneWorlds, Worlds};

use crate::error::SimError;
use crate::rng::{Purpose, Stream};
use crate::robot::ResetNoise;
use crate::task::{Anatomy, Task, Variants};

/// Sizes and addresses of a compiled robot, equal for all its damage classes.
#[derive(Debug, Clone, PartialEq)]
pub struct Layout {
    /// Entries of qpos.
    pub nq: usize,
    /// Entries of qvel.
    pub nv: usize,
    /// Number of actuators.
    pub nu: usize,
    /// Number of bodies, the world included.
    pub nbody: usize,
    /// Entries of sensordata.
    pub nsensordata: usize,
    /// Physics timestep, s.
    pub timestep: f64,
    /// Body whose x position gives the forward velocity.
    pub main_body: usize,
    /// Bodies of each limb.
    pub limb_bodies: Vec<Vec<usize>>,
    /// Index of each limb's touch sensor in sensordata; empty without touch sensors.
    pub touch_addresses: Vec<usize>,
    /// What the state holds besides positions and velocities, for messages; empty if that is all.
    pub hidden_state: String,
    /// Parts that terms refer to.
    pub anatomy: Anatomy,
    /// Compiled variants of the damage classes.
    pub variants: Variants,
}

/// Start of a new episode. The initial state is drawn from (`key`, `episode`).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Reset {
    /// Index of the env.
    pub env: usize,
    /// Damage class that is active from the start.
    pub class: usize,
    /// Random key of the env.
    pub key: u64,
    /// Number of the episode.
    pub episode: u64,
}

impl Reset {
    /// Adds the noise of the initial state to the default pose and to velocities of zero.
    ///
    /// # Shapes
    /// - `qpos`: `[nq]`, `qvel`: `[nv]`
    fn scatter(&self, noise: ResetNoise, qpos: &mut [f64], qvel: &mut [f64]) {
        let mut stream = Stream::new(self.key, self.episode, Purpose::InitialState);
        for position in qpos {
            *position += noise.qpos_noise * (2.0 * stream.uniform() - 1.0);
        }
        for velocity in qvel {
            *velocity += noise.qvel_noise * stream.normal();
        }
    }
}

/// Rows of observations inside a wider array: env i starts at `i · stride`.
#[derive(Debug)]
pub struct ObsRows<'a> {
    /// The array, `[N · stride]`.
    pub data: &'a mut [f32],
    /// Distance between rows, at least the observation's length; entries beyond it are left alone.
    pub stride: usize,
}

/// Where a step writes its results, one entry an env.
#[derive(Debug)]
pub struct StepOutputs<'a> {
    /// Observations.
    pub obs: ObsRows<'a>,
    /// Rewards, `[N]`.
    pub rewards: &'a mut [f64],
    /// Failures, `[N]`.
    pub terminated: &'a mut [bool],
    /// Values of the terms of the reward, their weights included, `[N, terms]`.
    pub reward_terms: &'a mut [f64],
    /// Velocities of the main body along +x, m/s, `[N]`.
    pub forward_velocity: &'a mut [f64],
    /// Whether the physics has diverged in this step, `[N]`.
    pub diverged: &'a mut [bool],
}

/// The physics of N envs, computed in the [thread pool](crate::ThreadPool) that it is called in.
pub trait Backend: Send + Sync {
    /// What simulates, with its names.
    fn physics(&self) -> Physics;

    /// Number of envs.
    fn num_envs(&self) -> usize;

    /// Number of damage classes in the class table.
    fn num_classes(&self) -> usize;

    /// Observation, reward and termination of the robot.
    fn task(&self) -> &Task;

    /// What the task remembers of an env, `[memory_len]`; empty for a backend whose tasks remember nothing.
    fn memory(&self, env: usize) -> &[f64];

    /// Starts new episodes and writes their first observations. An env appears at most once.
    fn reset(&mut self, resets: &[Reset], obs: ObsRows<'_>) -> Result<(), SimError>;

    /// Changes the damage class of running episodes; the state of the env is kept.
    fn set_classes(&mut self, changes: &[(usize, usize)]) -> Result<(), SimError>;

    /// Advances every env by one env step, except those marked in `skip`, whose outputs are left alone.
    ///
    /// An env whose physics diverges fails: it is terminated with reward and velocity 0, and then stands at rest in
    /// the reference pose of its class, which is what its observation shows.
    ///
    /// # Shapes
    /// - `actions`: `[N, nu]`, clipped to ±1
    /// - `skip`: `[N]`
    fn step(&mut self, actions: &[f32], skip: &[bool], outputs: StepOutputs<'_>) -> Result<(), SimError>;

    /// Reads positions and velocities of all envs.
    ///
    /// # Shapes
    /// - `qpos`: `[N, nq]`, `qvel`: `[N, nv]`
    fn state(&self, qpos: &mut [f64], qvel: &mut [f64]) -> Result<(), SimError>;

    /// Sets every env, except those marked in `skip`, to a given state at rest from forces (as after a reset)
    /// and observes it. A backend of single precision rounds the state.
    ///
    /// # Shapes
    /// - `qpos`: `[N, nq]`, `qvel`: `[N, nv]`
    /// - `skip`: `[N]`
    fn set_state(
        &mut self,
        qpos: &[f64],
        qvel: &[f64],
        skip: &[bool],
        obs: ObsRows<'_>,
    ) -> Result<(), SimError>;

    /// Everything that the next step depends on, for checkpoints.
    fn snapshot(&self) -> Result<BackendSnapshot, SimError>;

    /// Goes back to a snapshot of a backend of the same robot, kind, precision and number of envs.
    fn restore(&mut self, snapshot: &BackendSnapshot) -> Result<(), SimError>;
}

/// The complete state of a backend.
#[derive(Debug, Clone, PartialEq)]
pub struct BackendSnapshot {
    /// Entries of `rows` an env.
    pub row: usize,
    /// State rows, `[N, row]`.
    pub rows: Vec<f64>,
    /// Active damage class, `[N]`.
    pub classes: Vec<usize>,
}

impl BackendSnapshot {
    /// Checks that a backend with rows of `row` numbers, `envs` envs and `classes` damage classes can
    /// continue from it.
    pub fn check(&self, row: usize, envs: usize, classes: usize) -> Result<(), SimError> {
        if self.row != row || self.rows.len() != envs * row || self.classes.len() != envs {
            return Err(SimError::Snapshot(format!(
                "it holds {} envs with {} numbers each, this backend has {envs} envs with {row}",
                self.classes.len(),
                self.row,
            )));
        }
        self.classes.iter().try_for_each(|&class| check_class(class, classes))
    }
}

/// Refuses a damage class that a table of `classes` classes does not have.
pub fn check_class(class: usize, classes: usize) -> Result<(), SimError> {
    if class < classes {
        return Ok(());
    }
    Err(SimError::Config(format!(
        "damage class {class} does not exist; the classes are 0 to {}",
        classes - 1
    )))
}

/// Velocity over an env step.
fn velocity(task: &Task, before: f64, after: f64) -> f64 {
    (after - before) / task.dt()
}

/// `mjMAXVAL`: MuJoCo takes a state or an acceleration with a greater entry for diverged.
const MAX_VALUE: f64 = 1e10;

/// Whether the physics cannot continue from these numbers (`mju_isBad`).
fn out_of_bounds(values: &[f64]) -> bool {
    values.iter().any(|value| value.is_nan() || value.abs() > MAX_VALUE)
}

/// Refuses a backend without envs.
fn check_envs(num_envs: usize) -> Result<(), SimError> {
    if num_envs > 0 {
        return Ok(());
    }
    Err(SimError::Config("a backend needs at least one env, got 0".into()))
}
