//! Some envs of a backend whose worlds compute forces and steps together: what the task does with each of them.
//!
//! A reset is [`place`](Block::place), an evaluation of forces, and [`observe_first`](Block::observe_first). A step is
//! [`prepare`](Block::prepare), substeps, and [`conclude`](Block::conclude), which leaves envs that diverged placed
//! anew.

use dappo_lanes::{Readout, WorldAccess};

use super::lanes::{LaneTable, Sizes};
use super::{Reset, out_of_bounds, velocity};
use crate::task::{Signals, Task};

/// A group of at most 32 worlds, what the task remembers of them, and where one of them is read to.
pub(super) struct Block<W: ?Sized> {
    pub group: Box<W>,
    /// Numbers that the task remembers of each lane, `[width, memory_len]`.
    memory: Vec<f64>,
    /// x position of each root before a step.
    before: Vec<f64>,
    /// Controls of all lanes, `[width, nu]`.
    ctrl: Vec<f64>,
    reading: Reading,
}

/// One lane, read from its group.
struct Reading {
    qpos: Vec<f64>,
    qvel: Vec<f64>,
    qacc: Vec<f64>,
    cfrc_ext: Vec<f64>,
    touch: Vec<f64>,
    actuator_force: Vec<f64>,
}

/// The outputs of the envs of one block, one entry a lane but for `obs`, whose rows are `stride` apart.
pub(super) struct BlockOutputs<'a> {
    pub obs: &'a mut [f32],
    pub stride: usize,
    pub rewards: &'a mut [f64],
    /// Terms of the reward, `[lanes, terms]`.
    pub reward_terms: &'a mut [f64],
    pub terminated: &'a mut [bool],
    pub forward_velocity: &'a mut [f64],
    pub diverged: &'a mut [bool],
}

impl<W: WorldAccess + ?Sized> Block<W> {
    /// Healthy robots in their reference pose, in every lane: those without an env stay there.
    pub fn new(group: Box<W>, task: &Task, table: &LaneTable) -> Self {
        let Sizes { nq, nv, nu, nbody, touch } = table.sizes();
        let width = group.width();
        let mut block = Self {
            group,
            memory: vec![0.0; width * task.memory_len()],
            before: vec![0.0; width],
            ctrl: vec![0.0; width * nu],
            reading: Reading {
                qpos: vec![0.0; nq],
                qvel: vec![0.0; nv],
                qacc: vec![0.0; nv],
                cfrc_ext: vec![0.0; nbody * 6],
                touch: vec![0.0; touch],
                actuator_force: vec![0.0; nu],
            },
        };
        for lane in 0..width {
            block.group.set_state(lane, task.start_or(table.start(0)), &block.reading.qvel);
        }
        block
    }

    /// Places the episodes of `resets` at their start, one entry a lane: reference pose plus noise, forces at rest.
    /// Returns their lanes.
    ///
    /// # Shapes
    /// - `resets`: `[lanes]`
    pub fn place(&mut self, task: &Task, table: &LaneTable, resets: &[Option<Reset>]) -> u32 {
        for (lane, reset) in started(resets) {
            let row = row_of(&mut self.memory, task, lane);
            task.begin(row, reset);
            let Reading { qpos, qvel, .. } = &mut self.reading;
            qpos.copy_from_slice(task.start_or(table.start(task.model(row, reset.class))));
            qvel.fill(0.0);
            reset.scatter(task.reset, qpos, qvel);
            task.jam(row, reset.class, qpos);
            self.group.set_state(lane, qpos, qvel);
            self.set_class(task, table, lane, reset.class);
        }
        self.release(task, mask(started(resets).map(|(lane, _)| lane)))
    }

    /// Places the lanes that are not to be skipped in a given state, and returns them.
    ///
    /// # Shapes
    /// - `skip`: `[lanes]`; `qpos`: `[lanes, nq]`; `qvel`: `[lanes, nv]`
    pub fn put(&mut self, task: &Task, skip: &[bool], qpos: &[f64], qvel: &[f64]) -> u32 {
        let Reading { qpos: one, qvel: other, .. } = &self.reading;
        let states = qpos.chunks_exact(one.len()).zip(qvel.chunks_exact(other.len()));
        for (lane, (qpos, qvel)) in states.enumerate().filter(|(lane, _)| !skip[*lane]) {
            self.group.set_state(lane, qpos, qvel);
        }
        self.release(task, mask((0..skip.len()).filter(|&lane| !skip[lane])))
    }

    /// Sets the controls of lanes to zero, and returns the lanes.
    fn release(&mut self, task: &Task, lanes: u32) -> u32 {
        let nu = task.layout().nu;
        for lane in (0..self.group.width()).filter(|&lane| contains(lanes, lane)) {
            self.ctrl[lane * nu..(lane + 1) * nu].fill(0.0);
            self.group.set_ctrl(lane, &self.ctrl[lane * nu..(lane + 1) * nu]);
        }
        lanes
    }

    /// Observes the lanes that have just been placed and whose forces have been computed.
    ///
    /// # Shapes
    /// - `classes`: `[lanes]`; `obs`: rows that begin `stride` numbers apart
    pub fn observe_first(
        &mut self,
        task: &Task,
        table: &LaneTable,
        lanes: u32,
        classes: &[usize],
        obs: &mut [f32],
        stride: usize,
    ) {
        let nu = task.layout().nu;
        for (lane, &class) in classes.iter().enumerate().filter(|(lane, _)| contains(lanes, *lane)) {
            self.reading.read(self.group.as_ref(), lane);
            // As after mj_resetData and mj_forward: MuJoCo fills these in on demand, after a step.
            self.reading.cfrc_ext.fill(0.0);
            let ctrl = &self.ctrl[lane * nu..(lane + 1) * nu];
            let signals = self.reading.signals(class, ctrl, table.disabled_touch(class), 0.0);
            let row = row_of(&mut self.memory, task, lane);
            task.observe_first(row, &signals, &mut obs[lane * stride..][..task.obs_dim()]);
        }
    }

    /// Prepares an env step of the envs that are not to be skipped, and returns their lanes.
    ///
    /// # Shapes
    /// - `skip`: `[lanes]`; `actions`: `[lanes, nu]`
    pub fn prepare(&mut self, task: &Task, skip: &[bool], actions: &[f32]) -> u32 {
        let nu = task.layout().nu;
        let stepped = || (0..skip.len()).filter(|&lane| !skip[lane]);
        for lane in stepped() {
            let row = row_of(&mut self.memory, task, lane);
            let ctrl = &mut self.ctrl[lane * nu..(lane + 1) * nu];
            task.act(row, &actions[lane * nu..(lane + 1) * nu], ctrl);
            self.group.set_ctrl(lane, ctrl);
            if let Some(change) = task.push(row) {
                self.group.add_root_velocity(lane, change);
            }
            self.before[lane] = self.group.evaluated_x(lane);
        }
        mask(stepped())
    }

    /// Writes the outputs of an env step of some lanes. Those that diverged are placed in their reference pose, at
    /// rest, and returned.
    ///
    /// # Shapes
    /// - `classes`: `[lanes]`
    pub fn conclude(
        &mut self,
        task: &Task,
        table: &LaneTable,
        lanes: u32,
        classes: &[usize],
        outputs: &mut BlockOutputs<'_>,
    ) -> u32 {
        let nu = task.layout().nu;
        let (mut diverged, terms) = (0, task.reward_len());
        for (lane, &class) in classes.iter().enumerate().filter(|(lane, _)| contains(lanes, *lane)) {
            self.reading.read(self.group.as_ref(), lane);
            outputs.diverged[lane] = self.reading.has_diverged();
            if outputs.diverged[lane] {
                diverged |= 1 << lane;
                continue;
            }
            let ctrl = &self.ctrl[lane * nu..(lane + 1) * nu];
            let forward = velocity(task, self.before[lane], self.group.evaluated_x(lane));
            let signals = self.reading.signals(class, ctrl, table.disabled_touch(class), forward);
            let row = row_of(&mut self.memory, task, lane);
            let outcome =
                task.outcome(row, &signals, &mut outputs.reward_terms[lane * terms..(lane + 1) * terms]);
            outputs.rewards[lane] = outcome.reward;
            outputs.terminated[lane] = outcome.terminated;
            outputs.forward_velocity[lane] = forward;
            task.observe(row, &signals, &mut outputs.obs[lane * outputs.stride..][..task.obs_dim()]);
        }
        if diverged != 0 {
            self.fail(task, table, classes, diverged, outputs);
        }
        diverged
    }

    /// Ends the episodes of the lanes that diverged, and sets these to their reference pose, at rest.
    fn fail(
        &mut self,
        task: &Task,
        table: &LaneTable,
        classes: &[usize],
        lanes: u32,
        outputs: &mut BlockOutputs<'_>,
    ) {
        let terms = task.reward_len();
        self.reading.qvel.fill(0.0);
        for (lane, &class) in classes.iter().enumerate().filter(|(lane, _)| contains(lanes, *lane)) {
            let row = row_of(&mut self.memory, task, lane);
            let start = task.start_or(table.start(task.model(row, class)));
            self.group.set_state(lane, start, &self.reading.qvel);
            if task.jams() {
                task.jam(row, class, start);
                self.set_class(task, table, lane, class);
            }
            outputs.reward_terms[lane * terms..(lane + 1) * terms].fill(0.0);
            outputs.rewards[lane] = 0.0;
            outputs.terminated[lane] = true;
            outputs.forward_velocity[lane] = 0.0;
        }
        self.release(task, lanes);
    }

    /// Damages a running robot.
    pub fn strike(&mut self, task: &Task, table: &LaneTable, lane: usize, class: usize) {
        if task.jams() {
            self.reading.read(self.group.as_ref(), lane);
            task.jam(row_of(&mut self.memory, task, lane), class, &self.reading.qpos);
        }
        self.set_class(task, table, lane, class);
    }

    /// Gives a lane the physics of a damage class, and what is random about its env.
    fn set_class(&mut self, task: &Task, table: &LaneTable, lane: usize, class: usize) {
        let row = &self.memory[lane * task.memory_len()..(lane + 1) * task.memory_len()];
        let model = task.model(row, class);
        match task.variation(row) {
            None => self.group.set_class(lane, model),
            Some(variation) => {
                let varied = table.varied(model, &variation, task.jammed(row, model));
                self.group.set_model(lane, &varied);
            }
        }
    }

    /// Reads positions and velocities of a lane.
    ///
    /// # Shapes
    /// - `qpos`: `[nq]`, `qvel`: `[nv]`
    pub fn state(&self, lane: usize, qpos: &mut [f64], qvel: &mut [f64]) {
        let (mut cfrc_ext, mut touch) = (self.reading.cfrc_ext.clone(), self.reading.touch.clone());
        self.group.read(lane, Readout { qpos, qvel, cfrc_ext: &mut cfrc_ext, touch: &mut touch });
    }

    /// What the task remembers of a lane.
    pub fn memory(&self, task: &Task, lane: usize) -> &[f64] {
        &self.memory[lane * task.memory_len()..(lane + 1) * task.memory_len()]
    }

    /// Numbers in a saved row.
    pub fn row(&self, task: &Task) -> usize {
        self.group.row() + task.memory_len()
    }

    pub fn save(&self, task: &Task, lane: usize, row: &mut [f64]) {
        let (physics, memory) = row.split_at_mut(self.group.row());
        self.group.save(lane, physics);
        memory.copy_from_slice(self.memory(task, lane));
    }

    pub fn load(&mut self, task: &Task, table: &LaneTable, lane: usize, class: usize, row: &[f64]) {
        let (physics, memory) = row.split_at(self.group.row());
        row_of(&mut self.memory, task, lane).copy_from_slice(memory);
        self.set_class(task, table, lane, class);
        self.group.load(lane, physics);
    }
}

impl Reading {
    fn read<W: WorldAccess + ?Sized>(&mut self, group: &W, lane: usize) {
        let Self { qpos, qvel, qacc, cfrc_ext, touch, actuator_force } = self;
        group.read(lane, Readout { qpos, qvel, cfrc_ext, touch });
        group.accelerations(lane, qacc);
        group.actuator_forces(lane, actuator_force);
    }

    /// Whether the lane is beyond what the physics can continue from.
    fn has_diverged(&self) -> bool {
        [&self.qpos, &self.qvel, &self.qacc].into_iter().any(|values| out_of_bounds(values))
    }

    fn signals<'a>(
        &'a self,
        class: usize,
        ctrl: &'a [f64],
        disabled_touch: &'a [bool],
        forward_velocity: f64,
    ) -> Signals<'a> {
        Signals {
            class,
            qpos: &self.qpos,
            qvel: &self.qvel,
            ctrl,
            actuator_force: &self.actuator_force,
            cfrc_ext: &self.cfrc_ext,
            sensordata: &self.touch,
            forward_velocity,
            disabled_touch,
        }
    }
}

/// What the task remembers of a lane.
fn row_of<'a>(memory: &'a mut [f64], task: &Task, lane: usize) -> &'a mut [f64] {
    &mut memory[lane * task.memory_len()..(lane + 1) * task.memory_len()]
}

fn started(resets: &[Option<Reset>]) -> impl Iterator<Item = (usize, &Reset)> {
    resets.iter().enumerate().filter_map(|(lane, reset)| reset.as_ref().map(|reset| (lane, reset)))
}

/// The bits of some lanes.
fn mask(lanes: impl Iterator<Item = usize>) -> u32 {
    lanes.fold(0, |bits, lane| bits | 1 << lane)
}

fn contains(lanes: u32, lane: usize) -> bool {
    lanes >> lane & 1 == 1
}
