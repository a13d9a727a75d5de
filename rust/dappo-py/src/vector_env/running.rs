//! Construction of a vector env from the arguments in Python.

use dappo_sim::backend::{BackendKind, Device, Physics, Precision};
use dappo_sim::curriculum::ClassDistribution;
use dappo_sim::threads::available;
use dappo_sim::vector_env::{Autoreset, DamageCourse, StepRange, VectorEnv, VectorEnvConfig};
use numpy::PyReadonlyArray1;
use pyo3::prelude::*;

use crate::arguments::not_contiguous;
use crate::class_table::{BackendOptions, ClassTable};
use crate::errors::{Kind, OrRaise, raise};
use crate::pool::Pool;
use crate::warp::{self, Room};

/// A vector env and the threads that step it.
pub(super) struct Running {
    pub env: VectorEnv,
    pub pool: Pool,
}

/// What simulates the envs, as the arguments ask for it.
pub(super) struct Wish<'a> {
    pub num_envs: usize,
    pub reward: Option<&'a str>,
    pub threads: Option<usize>,
    pub device: &'a str,
    pub backend: &'a str,
    pub precision: &'a str,
    pub room: Room,
}

impl Running {
    /// Starts the envs; also returns the device of the physics, and why it is not the lane engine or in what that
    /// differs from the MJCF.
    pub fn start(
        table: &ClassTable,
        config: VectorEnvConfig,
        wish: &Wish<'_>,
    ) -> PyResult<(Self, &'static str, String)> {
        let device = warp::resolve(Device::parse(wish.device).or_raise()?).or_raise()?;
        let kind = BackendKind::parse(wish.backend).or_raise()?;
        let precision = Precision::parse(wish.precision).or_raise()?;
        let lanes = table.lane_table(kind)?;
        let physics = Physics::new(device, lanes.is_ok(), precision);
        let most = physics.most_threads(wish.num_envs);
        let pool = Pool::new(Some(wish.threads.unwrap_or_else(available).min(most)))?;
        let options = BackendOptions {
            reward: wish.reward,
            training: false,
            num_envs: wish.num_envs,
            threads: pool.num_threads(),
            physics,
            room: wish.room,
        };
        let backend = table.backend(&lanes, options)?;
        let env = VectorEnv::new(backend, &table.space, config).or_raise()?;
        let note = match (physics, lanes) {
            (Physics::Mujoco, Err(note)) => note,
            (Physics::Lanes(_) | Physics::Gpu(_), Ok(table)) => table.notes().join("; "),
            (Physics::Lanes(_) | Physics::Gpu(_) | Physics::Mujoco | Physics::Warp(_), _) => String::new(),
        };
        Ok((Self { env, pool }, physics.device(), note))
    }
}

/// When envs begin new episodes by themselves.
pub(super) fn autoreset(mode: &str) -> PyResult<Autoreset> {
    match mode {
        "next_step" => Ok(Autoreset::NextStep),
        "same_step" => Ok(Autoreset::SameStep),
        "disabled" => Ok(Autoreset::Disabled),
        other => Err(raise(
            Kind::Config,
            format!("autoreset is `{other}`, expected `next_step`, `same_step` or `disabled`"),
        )),
    }
}

/// How likely each of so many damage classes is; all alike without weights.
pub(super) fn distribution(
    weights: Option<PyReadonlyArray1<'_, f64>>,
    classes: usize,
) -> PyResult<ClassDistribution> {
    let Some(weights) = weights else { return Ok(ClassDistribution::uniform(classes)) };
    ClassDistribution::from_weights(weights.as_slice().map_err(not_contiguous)?).or_raise()
}

/// When damage begins, how long it lasts and pauses, and how late its code is, from first and last steps.
pub(super) fn course(
    onset: (usize, usize),
    duration: Option<(usize, usize)>,
    pause: Option<(usize, usize)>,
    code_delay: (usize, usize),
) -> DamageCourse {
    let steps = |(first, last)| StepRange { first, last };
    DamageCourse {
        onset: steps(onset),
        duration: duration.map(steps),
        pause: pause.map(steps),
        code_delay: steps(code_delay),
    }
}
