//! The `mujoco` backend: libmujoco on every core.
//!
//! One `mjData` a thread and one small state row an env: before a step the row is written into the
//! thread's `mjData`, afterwards it is read back. An env changes its damage class by using another
//! class's `mjModel`, which works because all classes have equal sizes (checked at compile time).

mod library;
mod table;
mod varied;
mod worker;

use std::sync::{Mutex, MutexGuard, PoisonError};

use rayon::prelude::*;

use super::{Backend, BackendSnapshot, ObsRows, Physics, Reset, StepOutputs, check_class, check_envs};
use crate::error::{SimError, expect_len};
use crate::task::Task;

pub use library::MujocoLibrary;
pub use table::{Field, ModelTable, WorkerFields};
pub use varied::VariedModel;
use worker::Worker;

/// libmujoco × rayon.
pub struct MujocoBackend {
    task: Task,
    table: ModelTable,
    workers: Vec<Mutex<Worker>>,
    /// Entries of a state row: MuJoCo's state, the main body's x position, then what the task remembers.
    row: usize,
    rows: Vec<f64>,
    classes: Vec<usize>,
}

impl MujocoBackend {
    /// A backend that simulates up to `workers.len()` envs at a time: one for each thread that will step it.
    pub fn new(
        task: Task,
        library: &MujocoLibrary,
        table: ModelTable,
        workers: Vec<WorkerFields>,
        num_envs: usize,
    ) -> Result<Self, SimError> {
        check_envs(num_envs)?;
        if workers.is_empty() {
            return Err(SimError::Config("the backend `mujoco` needs at least one mjData, got none".into()));
        }
        let workers: Vec<Worker> = workers
            .into_iter()
            .map(|fields| Worker::new(library, fields, &table))
            .collect::<Result<_, _>>()?;
        let row = workers[0].state_size() + 1 + task.memory_len();
        Ok(Self {
            task,
            table,
            workers: workers.into_iter().map(Mutex::new).collect(),
            row,
            rows: vec![0.0; num_envs * row],
            classes: vec![0; num_envs],
        })
    }
}

/// A worker that no other thread uses: that of the current thread of the pool, or another one where the pool has more
/// threads than there are workers. Nothing that holds a worker takes up other work of the pool.
fn worker(workers: &[Mutex<Worker>]) -> MutexGuard<'_, Worker> {
    let own = rayon::current_thread_index().unwrap_or(0) % workers.len();
    let mut candidates = workers[own..].iter().chain(&workers[..own]);
    candidates
        .find_map(|worker| worker.try_lock().ok())
        .unwrap_or_else(|| workers[own].lock().unwrap_or_else(PoisonError::into_inner))
}

impl Backend for MujocoBackend {
    fn physics(&self) -> Physics {
        Physics::Mujoco
    }

    fn num_envs(&self) -> usize {
        self.classes.len()
    }

    fn num_classes(&self) -> usize {
        self.table.len()
    }

    fn task(&self) -> &Task {
        &self.task
    }

    fn memory(&self, env: usize) -> &[f64] {
        &self.rows[(env + 1) * self.row - self.task.memory_len()..(env + 1) * self.row]
    }

    fn reset(&mut self, resets: &[Reset], obs: ObsRows<'_>) -> Result<(), SimError> {
        let mut wanted: Vec<Option<Reset>> = vec![None; self.num_envs()];
        for reset in resets {
            check_class(reset.class, self.table.len())?;
            self.classes[reset.env] = reset.class;
            wanted[reset.env] = Some(*reset);
        }
        let (task, table, workers) = (&self.task, &self.table, &self.workers);
        (self.rows.par_chunks_mut(self.row), obs.data.par_chunks_mut(obs.stride), wanted.par_iter())
            .into_par_iter()
            .for_each(|(row, obs, reset)| {
                if let Some(reset) = reset {
                    worker(workers).reset(task, table, reset, row, &mut obs[..task.obs_dim()]);
                }
            });
        Ok(())
    }

    fn set_classes(&mut self, changes: &[(usize, usize)]) -> Result<(), SimError> {
        for &(env, class) in changes {
            check_class(class, self.table.len())?;
            self.classes[env] = class;
            if self.task.jams() {
                let row = &mut self.rows[env * self.row..(env + 1) * self.row];
                worker(&self.workers).jam(&self.task, &self.table, class, row);
            }
        }
        Ok(())
    }

    fn step(&mut self, actions: &[f32], skip: &[bool], outputs: StepOutputs<'_>) -> Result<(), SimError> {
        let (task, table, workers) = (&self.task, &self.table, &self.workers);
        let nu = task.layout().nu;
        expect_len("actions", actions.len(), self.classes.len() * nu)?;
        expect_len("skip", skip.len(), self.classes.len())?;
        let obs_dim = task.obs_dim();
        (
            self.rows.par_chunks_mut(self.row),
            self.classes.par_iter(),
            skip.par_iter(),
            actions.par_chunks(nu),
            outputs.obs.data.par_chunks_mut(outputs.obs.stride),
            outputs.rewards.par_iter_mut(),
            outputs.reward_terms.par_chunks_mut(task.reward_len()),
            outputs.terminated.par_iter_mut(),
            outputs.forward_velocity.par_iter_mut(),
            outputs.diverged.par_iter_mut(),
        )
            .into_par_iter()
            .for_each(
                |(row, &class, &skip, action, obs, reward, terms, terminated, velocity, diverged)| {
                    if skip {
                        return;
                    }
                    let mut worker = worker(workers);
                    let forward = worker.step(task, table, class, row, action);
                    *diverged = forward.is_none();
                    let Some(forward) = forward else {
                        worker.restart(task, table, class, row, &mut obs[..obs_dim]);
                        terms.fill(0.0);
                        (*reward, *terminated, *velocity) = (0.0, true, 0.0);
                        return;
                    };
                    *velocity = forward;
                    let signals = worker.signals(table, class, *velocity);
                    let memory = worker.memory(row);
                    let outcome = task.outcome(memory, &signals, terms);
                    (*reward, *terminated) = (outcome.reward, outcome.terminated);
                    task.observe(memory, &signals, &mut obs[..obs_dim]);
                },
            );
        Ok(())
    }

    fn state(&self, qpos: &mut [f64], qvel: &mut [f64]) -> Result<(), SimError> {
        let (nq, nv) = (self.task.layout().nq, self.task.layout().nv);
        expect_len("qpos", qpos.len(), self.num_envs() * nq)?;
        expect_len("qvel", qvel.len(), self.num_envs() * nv)?;
        let mut worker = self.workers[0].lock().unwrap_or_else(PoisonError::into_inner);
        let states = qpos.chunks_exact_mut(nq).zip(qvel.chunks_exact_mut(nv));
        for (row, (qpos, qvel)) in self.rows.chunks_exact(self.row).zip(states) {
            worker.load(&self.table, row);
            qpos.copy_from_slice(worker.qpos());
            qvel.copy_from_slice(worker.qvel());
        }
        Ok(())
    }

    fn set_state(
        &mut self,
        qpos: &[f64],
        qvel: &[f64],
        skip: &[bool],
        obs: ObsRows<'_>,
    ) -> Result<(), SimError> {
        let (task, table, workers) = (&self.task, &self.table, &self.workers);
        let (nq, nv) = (task.layout().nq, task.layout().nv);
        expect_len("qpos", qpos.len(), self.classes.len() * nq)?;
        expect_len("qvel", qvel.len(), self.classes.len() * nv)?;
        expect_len("skip", skip.len(), self.classes.len())?;
        (
            self.rows.par_chunks_mut(self.row),
            self.classes.par_iter(),
            skip.par_iter(),
            qpos.par_chunks(nq),
            qvel.par_chunks(nv),
            obs.data.par_chunks_mut(obs.stride),
        )
            .into_par_iter()
            .filter(|(_, _, skip, ..)| !**skip)
            .for_each(|(row, &class, _, qpos, qvel, obs)| {
                worker(workers).set_state(task, table, class, (qpos, qvel), row, &mut obs[..task.obs_dim()]);
            });
        Ok(())
    }

    fn snapshot(&self) -> Result<BackendSnapshot, SimError> {
        Ok(BackendSnapshot { row: self.row, rows: self.rows.clone(), classes: self.classes.clone() })
    }

    fn restore(&mut self, snapshot: &BackendSnapshot) -> Result<(), SimError> {
        snapshot.check(self.row, self.num_envs(), self.table.len())?;
        self.rows.copy_from_slice(&snapshot.rows);
        self.classes.copy_from_slice(&snapshot.classes);
        Ok(())
    }
}
