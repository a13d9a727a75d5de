//! One group of lanes: the envs that share a register.

use dappo_lanes::Group;

use super::compile::LaneTable;
use crate::backend::Reset;
use crate::backend::block::{Block, BlockOutputs};
use crate::task::Task;

impl Block<dyn Group> {
    /// Starts the episodes of `resets`, one entry a lane, in damage classes that `classes` contains too.
    ///
    /// # Shapes
    /// - `resets`, `classes`: `[lanes]`; `obs`: rows that begin `stride` numbers apart
    pub fn reset(
        &mut self,
        task: &Task,
        table: &LaneTable,
        resets: &[Option<Reset>],
        classes: &[usize],
        obs: &mut [f32],
        stride: usize,
    ) {
        let lanes = self.place(task, table, resets);
        self.group.forward(lanes);
        self.observe_first(task, table, lanes, classes, obs, stride);
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
        let lanes = self.prepare(task, skip, actions);
        if lanes == 0 {
            return;
        }
        self.group.step(lanes, task.frame_skip);
        let diverged = self.conclude(task, table, lanes, classes, outputs);
        if diverged != 0 {
            self.group.forward(diverged);
            self.observe_first(task, table, diverged, classes, outputs.obs, outputs.stride);
        }
    }
}
