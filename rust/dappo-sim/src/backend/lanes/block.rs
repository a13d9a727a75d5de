//! One group of lanes with its scratch memory: the envs that share a register.

use dappo_lanes::{Group, Readout};

use super::compile::{LaneTable, Sizes};
use crate::backend::{Reset, control, out_of_bounds, velocity};
use crate::terms::{Signals, Task};

/// A group, and where one of its lanes is read to.
pub(super) struct Block {
    group: Box<dyn Group>,
    /// x position of each root before a step.
    before: Vec<f64>,
    /// Controls of all lanes, `[width, nu]`.
    ctrl: Vec<f64>,
    qpos: Vec<f64>,
    qvel: Vec<f64>,
    qacc: Vec<f64>,
    cfrc_ext: Vec<f64>,
    touch: Vec<f64>,
}

/// The outputs of the envs of one block, one entry a lane but for `obs`, whose rows are `stride` apart.
pub(super) struct BlockOutputs<'a> {
    pub obs: &'a mut [f32],
    pub stride: usize,
    pub rewards: &'a mut [f64],
    pub terminated: &'a mut [bool],
    pub forward_velocity: &'a mut [f64],
    pub diverged: &'a mut [bool],
}

impl Block {
    /// Healthy robots in their reference pose, in every lane: those without an env stay there.
    pub fn new(group: Box<dyn Group>, table: &LaneTable) -> Self {
        let Sizes { nq, nv, nu, nbody, touch } = table.sizes();
        let width = group.width();
        let mut block = Self {
            group,
            before: vec![0.0; width],
            ctrl: vec![0.0; width * nu],
            qpos: vec![0.0; nq],
            qvel: vec![0.0; nv],
            qacc: vec![0.0; nv],
            cfrc_ext: vec![0.0; nbody * 6],
            touch: vec![0.0; touch],
        };
        for lane in 0..width {
            block.group.set_state(lane, table.start(0), &block.qvel);
        }
        block
    }

    /// Starts the episodes of `resets`, one entry a lane: reference pose plus noise, forces at rest.
    ///
    /// # Shapes
    /// - `resets`: `[lanes]`; `obs`: rows that begin `stride` numbers apart
    pub fn reset(
        &mut self,
        task: &Task,
        table: &LaneTable,
        resets: &[Option<Reset>],
        obs: &mut [f32],
        stride: usize,
    ) {
        for (lane, reset) in started(resets) {
            self.qpos.copy_from_slice(table.start(reset.class));
            self.qvel.fill(0.0);
            reset.scatter(task.reset, &mut self.qpos, &mut self.qvel);
            self.group.set_class(lane, reset.class);
            self.group.set_state(lane, &self.qpos, &self.qvel);
        }
        let class_of = |lane: usize| resets[lane].map(|reset| reset.class);
        self.begin(task, table, resets.len(), class_of, obs, stride);
    }

    /// Sets the envs for which `class_of` has a class to a given state.
    ///
    /// # Shapes
    /// - `qpos`: `[lanes, nq]`, `qvel`: `[lanes, nv]`; `obs`: rows that begin `stride` numbers apart
    pub fn set_state(
        &mut self,
        task: &Task,
        table: &LaneTable,
        class_of: impl Fn(usize) -> Option<usize>,
        (qpos, qvel): (&[f64], &[f64]),
        obs: &mut [f32],
        stride: usize,
    ) {
        let states = qpos.chunks_exact(self.qpos.len()).zip(qvel.chunks_exact(self.qvel.len()));
        let lanes = states.len();
        for (lane, (qpos, qvel)) in states.enumerate().filter(|(lane, _)| class_of(*lane).is_some()) {
            self.group.set_state(lane, qpos, qvel);
        }
        self.begin(task, table, lanes, class_of, obs, stride);
    }

    /// Computes the forces of the lanes that have just been placed, and observes them. `class_of` returns
    /// their class.
    fn begin(
        &mut self,
        task: &Task,
        table: &LaneTable,
        lanes: usize,
        class_of: impl Fn(usize) -> Option<usize>,
        obs: &mut [f32],
        stride: usize,
    ) {
        let nu = task.layout().nu;
        let placed = |lane: &usize| class_of(*lane).is_some();
        for lane in (0..lanes).filter(placed) {
            self.ctrl[lane * nu..(lane + 1) * nu].fill(0.0);
            self.group.set_ctrl(lane, &self.ctrl[lane * nu..(lane + 1) * nu]);
        }
        self.group.forward(mask((0..lanes).filter(placed)));
        for lane in 0..lanes {
            let Some(class) = class_of(lane) else { continue };
            self.read(lane);
            // As after mj_resetData and mj_forward: MuJoCo fills these in on demand, after a step.
            self.cfrc_ext.fill(0.0);
            let signals = self.signals(lane, nu, table.disabled_touch(class), 0.0);
            task.observe(&signals, &mut obs[lane * stride..][..task.obs_dim()]);
        }
    }

    /// Advances the envs of the block by one env step, but for those to skip.
    ///
    /// # Shapes
    /// - `classes`, `skip`: `[lanes]`; `actions`: `[lanes, nu]`
    pub fn step(
        &mut self,
        task: &Task,
        table: &LaneTable,
        classes: &[usize],
        skip: &[bool],
        actions: &[f32],
        outputs: &mut BlockOutputs<'_>,
    ) {
        let nu = task.layout().nu;
        let stepped = || (0..classes.len()).filter(|&lane| !skip[lane]);
        let lanes = mask(stepped());
        if lanes == 0 {
            return;
        }
        for lane in stepped() {
            let ctrl = &mut self.ctrl[lane * nu..(lane + 1) * nu];
            for (ctrl, action) in ctrl.iter_mut().zip(&actions[lane * nu..(lane + 1) * nu]) {
                *ctrl = control(task, *action);
            }
            self.group.set_ctrl(lane, ctrl);
        }
        for lane in 0..classes.len() {
            self.before[lane] = self.group.evaluated_x(lane);
        }
        self.group.step(lanes, task.frame_skip);
        let mut diverged = 0;
        for lane in stepped() {
            self.read(lane);
            outputs.diverged[lane] = self.has_diverged(lane);
            if outputs.diverged[lane] {
                diverged |= 1 << lane;
                continue;
            }
            let forward = velocity(task, self.before[lane], self.group.evaluated_x(lane));
            let signals = self.signals(lane, nu, table.disabled_touch(classes[lane]), forward);
            let terminated = task.terminated(&signals);
            outputs.rewards[lane] = task.reward(&signals, terminated);
            outputs.terminated[lane] = terminated;
            outputs.forward_velocity[lane] = forward;
            task.observe(&signals, &mut outputs.obs[lane * outputs.stride..][..task.obs_dim()]);
        }
        if diverged != 0 {
            self.fail(task, table, classes, diverged, outputs);
        }
    }

    /// Whether the lane that has just been read is beyond what the physics can continue from.
    fn has_diverged(&mut self, lane: usize) -> bool {
        self.group.accelerations(lane, &mut self.qacc);
        [&self.qpos, &self.qvel, &self.qacc].into_iter().any(|values| out_of_bounds(values))
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
        let class_of = |lane: usize| (lanes >> lane & 1 == 1).then(|| classes[lane]);
        self.qvel.fill(0.0);
        for lane in 0..classes.len() {
            let Some(class) = class_of(lane) else { continue };
            self.group.set_state(lane, table.start(class), &self.qvel);
            outputs.rewards[lane] = 0.0;
            outputs.terminated[lane] = true;
            outputs.forward_velocity[lane] = 0.0;
        }
        self.begin(task, table, classes.len(), class_of, outputs.obs, outputs.stride);
    }

    pub fn set_class(&mut self, lane: usize, class: usize) {
        self.group.set_class(lane, class);
    }

    /// Reads positions and velocities of a lane.
    ///
    /// # Shapes
    /// - `qpos`: `[nq]`, `qvel`: `[nv]`
    pub fn state(&self, lane: usize, qpos: &mut [f64], qvel: &mut [f64]) {
        let (mut cfrc_ext, mut touch) = (self.cfrc_ext.clone(), self.touch.clone());
        self.group.read(lane, Readout { qpos, qvel, cfrc_ext: &mut cfrc_ext, touch: &mut touch });
    }

    /// Numbers in a saved row.
    pub fn row(&self) -> usize {
        self.group.row()
    }

    pub fn save(&self, lane: usize, row: &mut [f64]) {
        self.group.save(lane, row);
    }

    pub fn load(&mut self, lane: usize, class: usize, row: &[f64]) {
        self.group.set_class(lane, class);
        self.group.load(lane, row);
    }

    fn read(&mut self, lane: usize) {
        let Self { group, qpos, qvel, cfrc_ext, touch, .. } = self;
        group.read(lane, Readout { qpos, qvel, cfrc_ext, touch });
    }

    /// What `read` has read of a lane.
    fn signals<'a>(
        &'a self,
        lane: usize,
        nu: usize,
        disabled_touch: &'a [bool],
        forward_velocity: f64,
    ) -> Signals<'a> {
        Signals {
            qpos: &self.qpos,
            qvel: &self.qvel,
            ctrl: &self.ctrl[lane * nu..(lane + 1) * nu],
            cfrc_ext: &self.cfrc_ext,
            sensordata: &self.touch,
            forward_velocity,
            disabled_touch,
        }
    }
}

fn started(resets: &[Option<Reset>]) -> impl Iterator<Item = (usize, &Reset)> {
    resets.iter().enumerate().filter_map(|(lane, reset)| reset.as_ref().map(|reset| (lane, reset)))
}

/// The bits of some lanes.
fn mask(lanes: impl Iterator<Item = usize>) -> u32 {
    lanes.fold(0, |bits, lane| bits | 1 << lane)
}
