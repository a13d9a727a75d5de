//! Saved states of envs.

use cubecl::prelude::*;
use dappo_lanes::Precision;

use super::buffer::Buffer;
use super::episode::Clock;
use super::{Envs, failure};
use crate::engine::{Number, check_process};
use crate::error::Error;
use crate::task::plan::Task;
use crate::task::scene::clock;

/// The state between two rollouts.
#[derive(Debug, Clone, PartialEq)]
pub struct EnvStates {
    /// Positions, velocities and accelerations, then x of the root at the last evaluation, `[N, nq + 2 nv + 1]`.
    pub physics: Vec<f64>,
    /// What the task remembers, `[N, len]`.
    pub memory: Vec<f64>,
    /// Episodes.
    pub clocks: Vec<Clock>,
    /// Observations, `[N, O]`.
    pub obs: Vec<f32>,
}

impl Envs {
    /// The state between two rollouts.
    ///
    /// # Errors
    /// If the device fails.
    pub fn states(&self) -> Result<EnvStates, Error> {
        check_process(self.process)?;
        match self.precision {
            Precision::F32 => self.states_as::<f32>(),
            Precision::F64 => self.states_as::<f64>(),
        }
    }

    fn states_as<F: Number>(&self) -> Result<EnvStates, Error> {
        let handles =
            [&self.state, &self.memory, &self.clocks, &self.obs].map(|buffer| buffer.handle.clone());
        let bytes = self.client.read(handles.to_vec()).map_err(failure)?;
        let [state, memory, clocks, obs] = &bytes[..] else {
            return Err(Error::Device(format!("it returned {} buffers instead of 4", bytes.len())));
        };
        let Task { plan, places } = &self.task;
        let (nq, row) = (places.nq(), plan.row());
        let mut states = EnvStates {
            physics: Vec::with_capacity(self.len * (nq + 2 * self.nv + 1)),
            memory: Vec::with_capacity(self.len * plan.memory.len),
            clocks: Vec::with_capacity(self.len),
            obs: f32::from_bytes(obs).to_vec(),
        };
        let states_and_memories = F::from_bytes(state)
            .chunks_exact(places.shape.state())
            .zip(F::from_bytes(memory).chunks_exact(row));
        for ((state, memory), clocks) in
            states_and_memories.zip(u32::from_bytes(clocks).chunks_exact(clock::LEN))
        {
            let origin = [0, 1].map(|k| memory[plan.origin() + k].to());
            let positions = (0..nq)
                .map(|index| state[places.qpos(index)].to() + origin.get(index).copied().unwrap_or_default());
            states.physics.extend(positions);
            states.physics.extend((0..self.nv).map(|index| state[places.qvel(index)].to()));
            states.physics.extend((0..self.nv).map(|index| state[places.qacc(index)].to()));
            states.physics.push(memory[plan.evaluated()].to() + origin[0]);
            states.memory.extend(memory[..plan.memory.len].iter().map(|number| number.to()));
            states.clocks.push(Clock::read(clocks));
        }
        Ok(states)
    }

    /// Goes back to a state of envs of the same task.
    ///
    /// # Errors
    /// If the device fails.
    pub fn restore(&mut self, states: &EnvStates) -> Result<(), Error> {
        check_process(self.process)?;
        match self.precision {
            Precision::F32 => self.restore_as::<f32>(states),
            Precision::F64 => self.restore_as::<f64>(states),
        }
        Ok(())
    }

    fn restore_as<F: Number>(&mut self, states: &EnvStates) {
        let Task { plan, places } = &self.task;
        let (nq, nv) = (places.nq(), self.nv);
        let mut state = vec![0.0; self.len * places.shape.state()];
        let mut memory = vec![0.0; self.len * plan.row()];
        let (mut clocks, mut rows) = (Vec::new(), Vec::new());
        let rows_of_states = states.physics.chunks_exact(nq + 2 * nv + 1);
        for (env, ((physics, clock), (state, memory))) in rows_of_states
            .zip(&states.clocks)
            .zip(state.chunks_exact_mut(places.shape.state()).zip(memory.chunks_exact_mut(plan.row())))
            .enumerate()
        {
            for (index, &position) in physics[..nq].iter().enumerate().skip(2) {
                state[places.qpos(index)] = position;
            }
            for index in 0..nv {
                state[places.qvel(index)] = physics[nq + index];
                state[places.qacc(index)] = physics[nq + nv + index];
            }
            let len = plan.memory.len;
            memory[..len].copy_from_slice(&states.memory[env * len..][..len]);
            memory[plan.origin()..plan.origin() + 2].copy_from_slice(&physics[..2]);
            memory[plan.evaluated()] = physics[nq + 2 * nv] - physics[0];
            clocks.extend(clock.write(plan.varies()));
            rows.push(if plan.varies() { (self.count + env) as u32 } else { clock.model });
        }
        let client = &self.client;
        self.state = Buffer::numbers::<F>(client, &state);
        self.memory = Buffer::numbers::<F>(client, &memory);
        self.clocks = Buffer::of(client, &clocks);
        self.rows = Buffer::of(client, &rows);
        self.ctrl = Buffer::zeros::<F>(client, self.ctrl.len);
        self.obs = Buffer::of(client, &states.obs);
        self.vary::<F>();
    }
}
