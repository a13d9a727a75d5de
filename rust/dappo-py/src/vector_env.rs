//! `VectorEnv` in Python: N damage-randomised episodes on all cores.

mod running;
mod views;

use dappo_sim::task::{Reflection, Reflections};
use dappo_sim::vector_env::{Buffers, ResetOptions, VectorEnv, VectorEnvConfig, VectorEnvSnapshot};
use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;

use crate::arguments::not_contiguous;
use crate::class_table::ClassTable;
use crate::errors::{Kind, OrRaise, raise};
use crate::symmetry;
use crate::warp::Room;
use running::{Running, Wish};
use views::{view1, view2};

/// N damage-randomised episodes; `dappo_batch.envs` gives them Gymnasium's face.
#[pyclass(name = "VectorEnv", module = "dappo_batch._core")]
pub struct PyVectorEnv {
    running: Option<Running>,
    /// The buffers of a closed env, which numpy views may still show.
    kept: Option<Buffers>,
    num_envs: usize,
    nq: usize,
    nv: usize,
    device: &'static str,
    backend_note: String,
}

/// The state of a `VectorEnv` between two steps.
#[pyclass(name = "EnvState", module = "dappo_batch._core", frozen)]
pub struct PyEnvState {
    snapshot: VectorEnvSnapshot,
}

impl PyVectorEnv {
    fn env(&self) -> PyResult<&VectorEnv> {
        Ok(&self.running()?.env)
    }

    fn running(&self) -> PyResult<&Running> {
        self.running.as_ref().ok_or_else(closed)
    }

    fn running_mut(&mut self) -> PyResult<&mut Running> {
        self.running.as_mut().ok_or_else(closed)
    }
}

fn closed() -> PyErr {
    raise(Kind::Simulation, "the vector env is closed; make a new one")
}

/// Entries below zero mean "draw".
fn optional(values: Option<PyReadonlyArray1<'_, i64>>) -> PyResult<Option<Vec<Option<usize>>>> {
    values
        .map(|values| {
            Ok(values.as_slice().map_err(not_contiguous)?.iter().map(|&v| usize::try_from(v).ok()).collect())
        })
        .transpose()
}

/// Entries of a reflection.
type Images = Vec<(usize, f32)>;
type Flags<'py> = Bound<'py, PyArray1<bool>>;
type Numbers<'py> = Bound<'py, PyArray1<f64>>;
type Integers<'py> = Bound<'py, PyArray1<i64>>;
type Rows<'py> = Bound<'py, PyArray2<f32>>;
type States<'py> = Bound<'py, PyArray2<f64>>;

#[expect(clippy::needless_pass_by_value, reason = "PyO3 hands arguments over by value")]
#[pymethods]
impl PyVectorEnv {
    #[new]
    #[pyo3(signature = (table, *, num_envs, seeds, reward=None, observe_damage=true, history=None,
                        autoreset="next_step", max_episode_steps=None, class_weights=None, min_class_steps=0,
                        onset=(0, 0), damage_duration=None, damage_pause=None, code_delay=(0, 0), threads=None,
                        device="cpu", backend="auto", precision="f32", njmax=None, nconmax=None))]
    #[expect(clippy::too_many_arguments, reason = "keyword arguments in Python")]
    fn new(
        table: &Bound<'_, PyAny>,
        num_envs: usize,
        seeds: PyReadonlyArray1<'_, u64>,
        reward: Option<&str>,
        observe_damage: bool,
        history: Option<usize>,
        autoreset: &str,
        max_episode_steps: Option<usize>,
        class_weights: Option<PyReadonlyArray1<'_, f64>>,
        min_class_steps: usize,
        onset: (usize, usize),
        damage_duration: Option<(usize, usize)>,
        damage_pause: Option<(usize, usize)>,
        code_delay: (usize, usize),
        threads: Option<usize>,
        device: &str,
        backend: &str,
        precision: &str,
        njmax: Option<usize>,
        nconmax: Option<usize>,
    ) -> PyResult<Self> {
        let table = ClassTable::read(table)?.with_history(history)?;
        let config = VectorEnvConfig {
            keys: seeds.as_slice().map_err(not_contiguous)?.to_vec(),
            observe_damage,
            autoreset: running::autoreset(autoreset)?,
            max_episode_steps: max_episode_steps.unwrap_or(table.robot.max_episode_steps),
            classes: running::distribution(class_weights, table.space.classes().len())?,
            min_class_steps,
            course: running::course(onset, damage_duration, damage_pause, code_delay),
        };
        let room = Room { njmax, nconmax };
        let wish = Wish { num_envs, reward, threads, device, backend, precision, room };
        let (running, device, backend_note) = Running::start(&table, config, &wish)?;
        Ok(Self {
            running: Some(running),
            kept: None,
            num_envs,
            nq: table.layout.nq,
            nv: table.layout.nv,
            device,
            backend_note,
        })
    }

    /// Number of envs.
    #[getter]
    fn num_envs(&self) -> usize {
        self.num_envs
    }

    /// Length of an observation, the damage code included.
    #[getter]
    fn obs_dim(&self) -> PyResult<usize> {
        Ok(self.env()?.obs_dim())
    }

    /// Length of an action.
    #[getter]
    fn action_dim(&self) -> PyResult<usize> {
        Ok(self.env()?.action_dim())
    }

    /// Number of worker threads.
    #[getter]
    fn num_threads(&self) -> PyResult<usize> {
        Ok(self.running()?.pool.num_threads())
    }

    /// Name of the backend.
    #[getter]
    fn backend(&self) -> PyResult<&str> {
        Ok(self.env()?.backend().physics().backend())
    }

    /// Where the physics is computed.
    #[getter]
    fn device(&self) -> &'static str {
        self.device
    }

    /// Why it is not the lane engine; empty if it is, or if another was chosen.
    #[getter]
    fn backend_note(&self) -> &str {
        &self.backend_note
    }

    /// Floating-point format of the physics.
    #[getter]
    fn precision(&self) -> PyResult<&str> {
        Ok(self.env()?.backend().physics().precision())
    }

    /// How often the physics of an env has diverged since the env was made.
    #[getter]
    fn diverged(&self) -> PyResult<u64> {
        Ok(self.env()?.diverged())
    }

    /// Starts new episodes in all envs or those of a mask.
    #[pyo3(signature = (*, seeds=None, mask=None, classes=None, onsets=None, durations=None, pauses=None))]
    #[expect(clippy::too_many_arguments, reason = "keyword arguments in Python")]
    fn reset(
        &mut self,
        py: Python<'_>,
        seeds: Option<PyReadonlyArray1<'_, u64>>,
        mask: Option<PyReadonlyArray1<'_, bool>>,
        classes: Option<PyReadonlyArray1<'_, i64>>,
        onsets: Option<PyReadonlyArray1<'_, i64>>,
        durations: Option<PyReadonlyArray1<'_, i64>>,
        pauses: Option<PyReadonlyArray1<'_, i64>>,
    ) -> PyResult<()> {
        let keys = seeds.as_ref().map(|keys| keys.as_slice().map_err(not_contiguous)).transpose()?;
        let mask = mask.as_ref().map(|mask| mask.as_slice().map_err(not_contiguous)).transpose()?;
        let (classes, onsets) = (optional(classes)?, optional(onsets)?);
        let (durations, pauses) = (optional(durations)?, optional(pauses)?);
        let options = ResetOptions {
            keys,
            mask,
            classes: classes.as_deref(),
            onsets: onsets.as_deref(),
            durations: durations.as_deref(),
            pauses: pauses.as_deref(),
        };
        let Running { env, pool } = self.running_mut()?;
        pool.run(py, || env.reset(options))
    }

    /// Advances every env by one step.
    fn step(&mut self, py: Python<'_>, actions: PyReadonlyArray2<'_, f32>) -> PyResult<()> {
        let Running { env, pool } = self.running_mut()?;
        let (rows, columns) = (actions.shape()[0], actions.shape()[1]);
        if (rows, columns) != (env.num_envs(), env.action_dim()) {
            return Err(raise(
                Kind::Shape,
                format!(
                    "actions have shape ({rows}, {columns}), expected ({}, {})",
                    env.num_envs(),
                    env.action_dim()
                ),
            ));
        }
        let actions = actions.as_slice().map_err(not_contiguous)?;
        pool.run(py, || env.step(actions))
    }

    /// Positions `[N, nq]` and velocities `[N, nv]` of all envs.
    fn get_state<'py>(&self, py: Python<'py>) -> PyResult<(States<'py>, States<'py>)> {
        let qpos = PyArray2::zeros(py, [self.num_envs, self.nq], false);
        let qvel = PyArray2::zeros(py, [self.num_envs, self.nv], false);
        {
            let (mut positions, mut velocities) = (qpos.readwrite(), qvel.readwrite());
            let positions = positions.as_slice_mut().map_err(not_contiguous)?;
            let velocities = velocities.as_slice_mut().map_err(not_contiguous)?;
            let Running { env, pool } = self.running()?;
            pool.run(py, || env.state(positions, velocities))?;
        }
        Ok((qpos, qvel))
    }

    /// Sets every env to a given state and refreshes the observations.
    #[pyo3(signature = (qpos, qvel, at_rest = false))]
    fn set_state(
        &mut self,
        py: Python<'_>,
        qpos: PyReadonlyArray2<'_, f64>,
        qvel: PyReadonlyArray2<'_, f64>,
        at_rest: bool,
    ) -> PyResult<()> {
        let positions = qpos.as_slice().map_err(not_contiguous)?;
        let velocities = qvel.as_slice().map_err(not_contiguous)?;
        let Running { env, pool } = self.running_mut()?;
        pool.run(py, || env.set_state(positions, velocities, at_rest))
    }

    /// Everything that the next steps depend on.
    fn save_state(&self, py: Python<'_>) -> PyResult<PyEnvState> {
        let Running { env, pool } = self.running()?;
        Ok(PyEnvState { snapshot: pool.run(py, || env.snapshot())? })
    }

    /// Goes back to a saved state of an env of the same robot, backend, precision and number of envs.
    fn restore_state(&mut self, py: Python<'_>, state: &PyEnvState) -> PyResult<()> {
        let Running { env, pool } = self.running_mut()?;
        pool.run(py, || env.restore(&state.snapshot))
    }

    /// Frees the env and its threads; every later call raises `SimulationError`.
    fn close(&mut self) {
        if let Some(running) = self.running.take() {
            self.kept = Some(running.env.into_buffers());
        }
    }

    #[getter]
    fn obs<'py>(this: &Bound<'py, Self>) -> PyResult<Rows<'py>> {
        view2(this, |buffers| &buffers.obs)
    }

    #[getter]
    fn final_obs<'py>(this: &Bound<'py, Self>) -> PyResult<Rows<'py>> {
        view2(this, |buffers| &buffers.final_obs)
    }

    #[getter]
    fn rewards<'py>(this: &Bound<'py, Self>) -> PyResult<Numbers<'py>> {
        view1(this, |buffers| &buffers.rewards)
    }

    /// Names of the terms of the reward.
    #[getter]
    fn reward_names(&self) -> PyResult<Vec<&str>> {
        Ok(self.env()?.backend().task().reward_names().collect())
    }

    /// Names and units of the entries of an observation, damage code not included.
    #[getter]
    fn entries(&self) -> PyResult<Vec<(String, String)>> {
        let entries = self.env()?.backend().task().entries().into_iter();
        Ok(entries.map(|entry| (entry.name, entry.unit)).collect())
    }

    /// The reflections of observations and actions: of each entry, which one it is of the vector, and its sign.
    fn reflections(&self, table: &Bound<'_, PyAny>, observe_damage: bool) -> PyResult<(Images, Images)> {
        let (symmetry, table) = (symmetry::find(table)?, ClassTable::read(table)?);
        let task = self.env()?.backend().task();
        let codes = observe_damage.then_some(&table.space);
        let Reflections { obs, action } = task.reflections(&symmetry, codes).or_raise()?;
        let pairs = |reflection: &Reflection| {
            reflection.entries().iter().map(|image| (image.of, image.sign)).collect()
        };
        Ok((pairs(&obs), pairs(&action)))
    }

    /// Names of what the events draw for an episode.
    #[getter]
    fn event_names(&self) -> PyResult<Vec<String>> {
        Ok(self.env()?.backend().task().event_names())
    }

    #[getter]
    fn command<'py>(this: &Bound<'py, Self>) -> PyResult<States<'py>> {
        view2(this, |buffers| &buffers.command)
    }

    #[getter]
    fn events<'py>(this: &Bound<'py, Self>) -> PyResult<States<'py>> {
        view2(this, |buffers| &buffers.events)
    }

    #[getter]
    fn reward_terms<'py>(this: &Bound<'py, Self>) -> PyResult<States<'py>> {
        view2(this, |buffers| &buffers.reward_terms)
    }

    #[getter]
    fn terminated<'py>(this: &Bound<'py, Self>) -> PyResult<Flags<'py>> {
        view1(this, |buffers| &buffers.terminated)
    }

    #[getter]
    fn truncated<'py>(this: &Bound<'py, Self>) -> PyResult<Flags<'py>> {
        view1(this, |buffers| &buffers.truncated)
    }

    #[getter]
    fn forward_velocity<'py>(this: &Bound<'py, Self>) -> PyResult<Numbers<'py>> {
        view1(this, |buffers| &buffers.forward_velocity)
    }

    #[getter]
    fn damage_class<'py>(this: &Bound<'py, Self>) -> PyResult<Integers<'py>> {
        view1(this, |buffers| &buffers.damage_class)
    }

    #[getter]
    fn damage_onset<'py>(this: &Bound<'py, Self>) -> PyResult<Integers<'py>> {
        view1(this, |buffers| &buffers.damage_onset)
    }

    #[getter]
    fn episode_step<'py>(this: &Bound<'py, Self>) -> PyResult<Integers<'py>> {
        view1(this, |buffers| &buffers.episode_step)
    }

    #[getter]
    fn final_mask<'py>(this: &Bound<'py, Self>) -> PyResult<Flags<'py>> {
        view1(this, |buffers| &buffers.final_mask)
    }

    #[getter]
    fn final_damage_class<'py>(this: &Bound<'py, Self>) -> PyResult<Integers<'py>> {
        view1(this, |buffers| &buffers.final_damage_class)
    }

    #[getter]
    fn final_damage_onset<'py>(this: &Bound<'py, Self>) -> PyResult<Integers<'py>> {
        view1(this, |buffers| &buffers.final_damage_onset)
    }

    #[getter]
    fn final_forward_velocity<'py>(this: &Bound<'py, Self>) -> PyResult<Numbers<'py>> {
        view1(this, |buffers| &buffers.final_forward_velocity)
    }
}
