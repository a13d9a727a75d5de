//! One thread's `mjData`: the only place that calls libmujoco.

use super::library::{Data, Model, MujocoLibrary};
use super::table::{ModelTable, WorkerFields};
use crate::backend::{Reset, out_of_bounds, velocity};
use crate::error::SimError;
use crate::task::{Signals, Task};

/// An `mjData` that stands for one env at a time.
pub(super) struct Worker {
    library: MujocoLibrary,
    fields: WorkerFields,
    state_size: usize,
}

// SAFETY: a worker is the only user of its mjData (contract of `WorkerFields::new`), and libmujoco keeps no
// thread-local state about it.
unsafe impl Send for Worker {}

impl Worker {
    pub(super) fn new(
        library: &MujocoLibrary,
        fields: WorkerFields,
        table: &ModelTable,
    ) -> Result<Self, SimError> {
        // SAFETY: the model is valid (contract of `ModelTable::new`).
        let size = unsafe { (library.state_size)(table.model(0), table.state_spec) };
        let state_size = usize::try_from(size)
            .map_err(|_| SimError::Config(format!("MuJoCo reports a state of {size} numbers")))?;
        Ok(Self { library: library.clone(), fields, state_size })
    }

    /// Numbers in MuJoCo's part of a state row.
    pub(super) fn state_size(&self) -> usize {
        self.state_size
    }

    pub(super) fn qpos(&self) -> &[f64] {
        self.fields.qpos.get()
    }

    pub(super) fn qvel(&self) -> &[f64] {
        self.fields.qvel.get()
    }

    fn data(&self) -> Data {
        self.fields.data
    }

    /// Position of the main body along x as of the last physics evaluation, as Gymnasium reads it.
    fn main_body_x(&self) -> f64 {
        self.fields.main_body_xpos.get()[0]
    }

    /// Makes the data stand for the env whose state is `row`.
    pub(super) fn load(&mut self, table: &ModelTable, row: &[f64]) {
        // SAFETY: model and data are valid and of equal sizes, as all models are; the row holds `state_size` numbers.
        unsafe {
            (self.library.set_state)(table.model(0), self.data(), row.as_ptr(), table.state_spec);
        };
    }

    fn store(&mut self, table: &ModelTable, row: &mut [f64]) {
        // SAFETY: as in `load`.
        unsafe {
            (self.library.get_state)(table.model(0), self.data(), row.as_mut_ptr(), table.state_spec);
        };
        row[self.state_size] = self.main_body_x();
    }

    /// Starts an episode: reference pose plus noise, forces at rest.
    pub(super) fn reset(
        &mut self,
        task: &Task,
        table: &ModelTable,
        reset: &Reset,
        row: &mut [f64],
        obs: &mut [f32],
    ) {
        task.begin(self.memory(row), reset);
        self.clear(task, table, reset.class, row);
        // `clear` left the default pose and no velocity.
        reset.scatter(task.reset, self.fields.qpos.get_mut(), self.fields.qvel.get_mut());
        task.jam(self.memory(row), reset.class, self.qpos());
        self.begin(task, table, reset.class, row, obs);
    }

    /// Starts an episode from given positions and velocities.
    pub(super) fn set_state(
        &mut self,
        task: &Task,
        table: &ModelTable,
        class: usize,
        (qpos, qvel): (&[f64], &[f64]),
        row: &mut [f64],
        obs: &mut [f32],
    ) {
        self.clear(task, table, class, row);
        self.fields.qpos.get_mut().copy_from_slice(qpos);
        self.fields.qvel.get_mut().copy_from_slice(qvel);
        self.begin(task, table, class, row, obs);
    }

    /// Sets the env to the reference pose of its class, at rest.
    pub(super) fn restart(
        &mut self,
        task: &Task,
        table: &ModelTable,
        class: usize,
        row: &mut [f64],
        obs: &mut [f32],
    ) {
        self.clear(task, table, class, row);
        task.jam(self.memory(row), class, self.qpos());
        self.begin(task, table, class, row, obs);
    }

    /// Lets the joints of a damage class jam that becomes active in the state `row`.
    pub(super) fn jam(&mut self, task: &Task, table: &ModelTable, class: usize, row: &mut [f64]) {
        self.load(table, row);
        task.jam(self.memory(row), class, self.qpos());
    }

    fn clear(&mut self, task: &Task, table: &ModelTable, class: usize, row: &[f64]) {
        let model = table.model(task.model(self.remembered(row), class));
        // SAFETY: model and data are valid and of equal sizes.
        unsafe { (self.library.reset_data)(model, self.data()) };
        if let Some(start) = task.start() {
            self.fields.qpos.get_mut().copy_from_slice(start);
        }
    }

    /// The model of the env whose state is `row`: where those of envs differ, the worker's own, with what is random.
    fn model(&mut self, task: &Task, table: &ModelTable, class: usize, row: &[f64]) -> Model {
        let memory = self.remembered(row);
        let index = task.model(memory, class);
        match (task.variation(memory), self.fields.models.get_mut(index)) {
            (Some(variation), Some(own)) => {
                own.vary(&variation);
                own.jam(task.jammed(memory, index));
                own.model()
            }
            _ => table.model(index),
        }
    }

    /// What the task remembers of the env whose state is `row`.
    pub(super) fn memory<'a>(&self, row: &'a mut [f64]) -> &'a mut [f64] {
        &mut row[self.state_size + 1..]
    }

    fn remembered<'a>(&self, row: &'a [f64]) -> &'a [f64] {
        &row[self.state_size + 1..]
    }

    fn begin(&mut self, task: &Task, table: &ModelTable, class: usize, row: &mut [f64], obs: &mut [f32]) {
        let model = self.model(task, table, class, row);
        // SAFETY: model and data are valid and of equal sizes.
        unsafe { (self.library.forward)(model, self.data()) };
        self.store(table, row);
        task.observe_first(self.memory(row), &self.signals(table, class, 0.0), obs);
    }

    /// Advances the env by one env step and returns its forward velocity, m/s; `None` if the physics has diverged.
    pub(super) fn step(
        &mut self,
        task: &Task,
        table: &ModelTable,
        class: usize,
        row: &mut [f64],
        action: &[f32],
    ) -> Option<f64> {
        self.load(table, row);
        let memory = self.memory(row);
        task.act(memory, action, self.fields.ctrl.get_mut());
        if let Some(change) = task.push(memory) {
            let velocities = self.fields.qvel.get_mut().iter_mut();
            velocities.zip(change).for_each(|(velocity, change)| *velocity += change);
        }
        let (model, data) = (self.model(task, table, class, row), self.data());
        for _ in 0..task.frame_skip {
            // SAFETY: model and data are valid and of equal sizes.
            unsafe { (self.library.step)(model, data) };
        }
        if self.has_diverged() {
            return None;
        }
        // SAFETY: as above. MuJoCo computes cfrc_ext on demand only.
        unsafe { (self.library.rne_post_constraint)(model, data) };
        let before = row[self.state_size];
        self.store(table, row);
        Some(velocity(task, before, self.main_body_x()))
    }

    /// Whether a state since the last `clear` was beyond what the physics can continue from.
    fn has_diverged(&self) -> bool {
        // SAFETY: the addresses are those of counters in the worker's mjData (contract of `WorkerFields::new`).
        let warned = |&address: &usize| unsafe { (address as *const i32).read() } > 0;
        // `mj_step` looks at the state that it begins with. It counts what it finds, then resets the data and goes
        // on as if nothing had happened.
        self.fields.divergences.iter().any(warned) || out_of_bounds(self.qpos()) || out_of_bounds(self.qvel())
    }

    /// What the last evaluation left in the data.
    pub(super) fn signals<'a>(
        &'a self,
        table: &'a ModelTable,
        class: usize,
        forward_velocity: f64,
    ) -> Signals<'a> {
        Signals {
            class,
            qpos: self.qpos(),
            qvel: self.qvel(),
            ctrl: self.fields.ctrl.get(),
            actuator_force: self.fields.actuator_force.get(),
            cfrc_ext: self.fields.cfrc_ext.get(),
            sensordata: self.fields.sensordata.get(),
            forward_velocity,
            disabled_touch: table.disabled_touch(class),
        }
    }
}
