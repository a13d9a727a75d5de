//! Envs on the device: whole rollouts without a call of the host.

use cubecl::client::Client;
use cubecl::prelude::*;
use cubecl::server::Handle;
use dappo_lanes::{Model, Precision};

use crate::constants::row;
use crate::device::{Device, THREADS, check};
use crate::engine::{Number, check_process, upload};
use crate::error::Error;
use crate::kernel::{advance, evaluate};
use crate::networks::{TILE, gather, layer, prepare, sample};
use crate::skeleton::Skeleton;
use crate::task::kernels::{OUTCOME, begin_episodes, begin_step, end, end_step, observe_placed};
use crate::task::plan::{JAM, Places, Plan, Task};
use crate::task::scene::clock;
use crate::task::variation::{kinds, vary};

/// The most cubes of a launch in one dimension.
const MAX_CUBES: usize = 65_535;
/// Rows that go through the value net at once, about.
const ROWS: usize = 1 << 17;

/// A task, with the numbers of its models and damage classes.
pub struct TaskTable {
    /// The task.
    pub plan: Plan,
    /// Of each model: initial positions, jams (index of the joint in qvel, share, position for which it was compiled,
    /// lowest and highest position), numbers of its variant, feet, `[models, model_len]`.
    pub models: Vec<f64>,
    /// Of each damage class: sum of the probabilities up to it, whether it cuts off the touch signal of each limb, its
    /// models, its code, `[classes, class_len]`.
    pub classes: Vec<f64>,
}

/// A tanh MLP with a linear output layer.
#[derive(Debug, Clone, Copy)]
pub struct Net<'a> {
    /// Inputs, units of the hidden layers, outputs.
    pub sizes: &'a [usize],
    /// Layer by layer: the weight, row-major `[inputs, outputs]`, then the bias.
    pub parameters: &'a [f32],
}

/// What acts in a rollout.
#[derive(Debug, Clone, Copy)]
pub struct Networks<'a> {
    /// Chooses the means of the actions.
    pub policy: Net<'a>,
    /// Estimates values; it is given privileged entries, too.
    pub value: Net<'a>,
    /// Logarithm of the standard deviations of the actions, `[nu]`.
    pub log_std: &'a [f32],
    /// Means and scales that entries of an observation are standardised with, and the bound of what results; `None` if
    /// they pass as they are.
    pub statistics: Option<(&'a [f32], &'a [f32], f32)>,
    /// Factor of the damage code.
    pub code_scale: f32,
}

/// A rollout of T steps of N envs, time-major.
#[derive(Debug, Clone, Default)]
pub struct Collected {
    /// Observations before each step, `[T, N, O]`.
    pub obs: Vec<f32>,
    /// Actions, `[T, N, A]`.
    pub actions: Vec<f32>,
    /// Their means, `[T, N, A]`.
    pub means: Vec<f32>,
    /// Their log-densities, `[T, N]`.
    pub log_probs: Vec<f32>,
    /// Values of the observations, `[T, N]`.
    pub values: Vec<f32>,
    /// Values of the last observations of episodes that the time limit has ended, `[T, N]`; 0 elsewhere.
    pub final_values: Vec<f32>,
    /// Values of the observations after the last step, `[N]`.
    pub last_values: Vec<f32>,
    /// Rewards, `[T, N]`.
    pub rewards: Vec<f32>,
    /// Velocities along +x, m/s, `[T, N]`.
    pub forward_velocity: Vec<f32>,
    /// Failures, `[T, N]`.
    pub terminated: Vec<bool>,
    /// Time limits, `[T, N]`.
    pub truncated: Vec<bool>,
    /// Worlds that diverged.
    pub diverged: u64,
}

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

/// The episode of an env.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Clock {
    /// Random key of the env.
    pub key: u64,
    /// Number of the episode.
    pub number: u64,
    /// Steps done.
    pub step: u32,
    /// Damage class of the episode.
    pub class: u32,
    /// Steps of the episodes before, back to that which drew the class.
    pub class_steps: u32,
    /// Step at which the damage strikes.
    pub onset: u32,
    /// Steps for which it lasts; 0: for good.
    pub duration: u32,
    /// Steps until it returns; 0: never.
    pub pause: u32,
    /// Steps by which its code is late.
    pub code_delay: u32,
    /// Damage class of the physics.
    pub in_force: u32,
    /// Compiled model of the physics.
    pub model: u32,
}

/// Envs on a device.
pub struct Envs {
    client: Client,
    process: u32,
    precision: Precision,
    task: Task,
    nv: usize,
    /// Number of envs.
    len: usize,
    /// Number of models; their constants come before those of the envs.
    count: usize,
    numbers: Buffer,
    kinds: Buffer,
    rows: Buffer,
    placed: Buffer,
    state: Buffer,
    readings: Buffer,
    ctrl: Buffer,
    memory: Buffer,
    clocks: Buffer,
    classes: Buffer,
    models: Buffer,
    noise_keys: Buffer,
    /// Observations after the last step, `[N, O]`.
    obs: Buffer,
}

/// A buffer and the number of its entries.
#[derive(Clone)]
struct Buffer {
    handle: Handle,
    len: usize,
}

impl Buffer {
    fn of<T: CubeElement>(client: &Client, values: &[T]) -> Self {
        // No buffer is empty.
        let handle = match values {
            [] => client.empty(size_of::<T>()),
            values => client.create_from_slice(T::as_bytes(values)),
        };
        Self { handle, len: values.len().max(1) }
    }

    fn numbers<F: Number>(client: &Client, values: &[f64]) -> Self {
        Self { handle: upload::<F>(client, values), len: values.len() }
    }

    fn zeros<T: CubeElement + Default>(client: &Client, len: usize) -> Self {
        Self::of(client, &vec![T::default(); len.max(1)])
    }

    fn empty<T>(client: &Client, len: usize) -> Self {
        Self { handle: client.empty(len.max(1) * size_of::<T>()), len: len.max(1) }
    }

    fn arg(&self) -> BufferArg {
        // SAFETY: the length is that of the buffer.
        unsafe { BufferArg::from_raw_parts(self.handle.clone(), self.len) }
    }
}

/// Enough cubes for so many threads.
fn cubes(threads: usize) -> CubeCount {
    let cubes = threads.div_ceil(THREADS).max(1);
    let columns = cubes.min(MAX_CUBES);
    CubeCount::Static(columns as u32, cubes.div_ceil(columns) as u32, 1)
}

fn cube() -> CubeDim {
    CubeDim::new_1d(THREADS as u32)
}

impl Envs {
    /// Envs with these random keys, at the start of their first episodes. `noise_keys` are those of the exploration
    /// noise.
    ///
    /// # Errors
    /// If the kernels do not support the robot, or the device lacks what they need: all the reasons.
    pub fn new(
        models: &[Model],
        precision: Precision,
        device: &Device,
        table: TaskTable,
        keys: &[u64],
        noise_keys: &[u64],
    ) -> Result<Self, Error> {
        let skeleton = Skeleton::new(models)?;
        let client = device.client();
        check(&client, skeleton.shape.lanes, precision)?;
        let open = match precision {
            Precision::F32 => Self::open::<f32>,
            Precision::F64 => Self::open::<f64>,
        };
        Ok(open(models, &skeleton, precision, client, table, keys, noise_keys))
    }

    fn open<F: Number>(
        models: &[Model],
        skeleton: &Skeleton,
        precision: Precision,
        client: Client,
        table: TaskTable,
        keys: &[u64],
        noise_keys: &[u64],
    ) -> Self {
        let places = Places::new(skeleton);
        let TaskTable { plan, models: mut numbers, classes } = table;
        let (nq, envs, shape) = (places.nq(), keys.len(), places.shape);
        for numbers in numbers.chunks_exact_mut(plan.model_len(nq)) {
            for jam in numbers[nq..].chunks_exact_mut(JAM).take(plan.jams) {
                jam[0] = (jam[0] as usize).checked_sub(6).map_or(0, |joint| places.joints[joint]) as f64;
            }
        }
        let mut constants: Vec<f64> = models.iter().flat_map(|model| row(skeleton, model)).collect();
        if plan.varies() {
            constants.resize((models.len() + envs) * shape.row(), 0.0);
        }
        let mut clocks = vec![0; envs * clock::LEN];
        for (row, &key) in clocks.chunks_exact_mut(clock::LEN).zip(keys) {
            row[clock::KEY_LOW..=clock::KEY_HIGH].copy_from_slice(&halves(key));
            // The first episode has the number 0.
            row[clock::NUMBER_LOW..=clock::NUMBER_HIGH].fill(u32::MAX);
        }
        let noise: Vec<u32> = noise_keys.iter().flat_map(|&key| halves(key)).collect();
        let envs = Self {
            process: std::process::id(),
            precision,
            nv: places.nv(),
            len: envs,
            count: models.len(),
            numbers: Buffer::numbers::<F>(&client, &constants),
            kinds: Buffer::of(&client, &kinds(skeleton, &models[0])),
            rows: Buffer::zeros::<u32>(&client, envs),
            placed: Buffer::zeros::<u32>(&client, envs),
            state: Buffer::zeros::<F>(&client, envs * shape.state()),
            readings: Buffer::zeros::<F>(&client, envs * shape.readings()),
            ctrl: Buffer::zeros::<F>(&client, envs * shape.dofs()),
            memory: Buffer::zeros::<F>(&client, envs * plan.row()),
            clocks: Buffer::of(&client, &clocks),
            classes: Buffer::numbers::<F>(&client, &classes),
            models: Buffer::numbers::<F>(&client, &numbers),
            noise_keys: Buffer::of(&client, &noise),
            obs: Buffer::zeros::<f32>(&client, envs * plan.obs_len()),
            task: Task { plan, places },
            client,
        };
        envs.begin::<F>();
        envs
    }

    /// Number of envs.
    #[must_use]
    pub fn num_envs(&self) -> usize {
        self.len
    }

    /// The task.
    #[must_use]
    pub fn plan(&self) -> &Plan {
        &self.task.plan
    }

    /// Replaces the numbers of the damage classes: from the next episodes on, others may be more likely.
    pub fn set_classes(&mut self, classes: &[f64]) {
        self.classes = match self.precision {
            Precision::F32 => Buffer::numbers::<f32>(&self.client, classes),
            Precision::F64 => Buffer::numbers::<f64>(&self.client, classes),
        };
    }

    /// Runs a policy for `horizon` steps. `first_step` numbers them over the whole run, so that every (env, step) has
    /// noise of its own.
    ///
    /// # Errors
    /// If the device fails.
    pub fn collect(
        &mut self,
        networks: &Networks<'_>,
        horizon: usize,
        first_step: u64,
    ) -> Result<Collected, Error> {
        check_process(self.process)?;
        match self.precision {
            Precision::F32 => self.collect_as::<f32>(networks, horizon, first_step),
            Precision::F64 => self.collect_as::<f64>(networks, horizon, first_step),
        }
    }

    fn collect_as<F: Number>(
        &mut self,
        networks: &Networks<'_>,
        horizon: usize,
        first_step: u64,
    ) -> Result<Collected, Error> {
        let (envs, width, nu) = (self.len, self.task.plan.obs_len(), self.task.plan.nu());
        let empty = |len: usize| Buffer::empty::<f32>(&self.client, len);
        let buffers = Buffers {
            obs: empty((horizon + 1) * envs * width),
            // Written, and read, only where an episode has ended.
            final_obs: empty(horizon * envs * width),
            actions: empty(horizon * envs * nu),
            means: empty(horizon * envs * nu),
            log_probs: empty(horizon * envs),
            values: empty((horizon + 1) * envs),
            outcomes: empty(horizon * envs * OUTCOME),
        };
        let observed = width - self.task.plan.code;
        let policy = Uploaded::new(&self.client, networks, networks.policy, observed);
        let value = Uploaded::new(&self.client, networks, networks.value, observed);
        let std: Vec<f32> = networks.log_std.iter().map(|log_std| log_std.exp()).collect();
        let std = Buffer::of(&self.client, &std);
        let all: Vec<u32> = (0..envs as u32).collect();
        self.gather(&self.obs, &all, &buffers.obs);
        for step in 0..horizon {
            let row = step * envs;
            self.run(&policy, &buffers.obs, row * width, &buffers.means, row * nu, envs);
            self.sample::<F>(networks.log_std, &std, &buffers, step, first_step + step as u64);
            self.step::<F>(&buffers, step);
        }
        let steps = (ROWS / envs).clamp(1, horizon + 1);
        for first in (0..=horizon).step_by(steps) {
            let rows = steps.min(horizon + 1 - first) * envs;
            let row = first * envs;
            self.run(&value, &buffers.obs, row * width, &buffers.values, row, rows);
        }
        self.obs = Buffer::empty::<f32>(&self.client, envs * width);
        let last: Vec<u32> = all.iter().map(|env| (horizon * envs) as u32 + env).collect();
        self.gather(&buffers.obs, &last, &self.obs);
        let mut collected = buffers.read(&self.client, horizon, envs, width)?;
        self.bootstrap(&value, &buffers, &mut collected)?;
        Ok(collected)
    }

    /// Values of the last observations of the episodes that the time limit has cut short.
    fn bootstrap(
        &self,
        net: &Uploaded<'_>,
        buffers: &Buffers,
        collected: &mut Collected,
    ) -> Result<(), Error> {
        let ends = collected.truncated.iter().zip(&collected.terminated).enumerate();
        let cut: Vec<u32> =
            ends.filter(|(_, (cut, fell))| **cut && !**fell).map(|(row, _)| row as u32).collect();
        if cut.is_empty() {
            return Ok(());
        }
        let rows = Buffer::empty::<f32>(&self.client, cut.len() * self.task.plan.obs_len());
        self.gather(&buffers.final_obs, &cut, &rows);
        let values = Buffer::empty::<f32>(&self.client, cut.len());
        self.run(net, &rows, 0, &values, 0, cut.len());
        let bytes = self.client.read_one(values.handle).map_err(failure)?;
        for (&row, &value) in cut.iter().zip(f32::from_bytes(&bytes)) {
            collected.final_values[row as usize] = value;
        }
        Ok(())
    }

    /// Advances all envs by one step.
    fn step<F: Number>(&self, buffers: &Buffers, step: usize) {
        let (client, envs, task) = (&self.client, self.len, &self.task);
        let shape = task.places.shape;
        let (width, nu) = (task.plan.obs_len(), task.plan.nu());
        // SAFETY: all lengths are those of the buffers, rows are those of the table of constants, and all loops end.
        unsafe {
            begin_step::launch_unchecked::<F>(
                client,
                cubes(envs),
                cube(),
                self.state.arg(),
                self.ctrl.arg(),
                self.memory.arg(),
                self.clocks.arg(),
                self.rows.arg(),
                self.classes.arg(),
                self.models.arg(),
                buffers.actions.arg(),
                step * envs * nu,
                envs,
                self.count,
                task.clone(),
            );
            self.vary::<F>();
            advance::launch_unchecked::<F>(
                client,
                cubes(envs * shape.lanes),
                cube(),
                self.numbers.arg(),
                self.rows.arg(),
                self.ctrl.arg(),
                self.state.arg(),
                self.readings.arg(),
                envs,
                task.plan.substeps,
                shape,
            );
            end_step::launch_unchecked::<F>(
                client,
                cubes(envs),
                cube(),
                self.state.arg(),
                self.readings.arg(),
                self.ctrl.arg(),
                self.memory.arg(),
                self.clocks.arg(),
                self.rows.arg(),
                self.placed.arg(),
                self.classes.arg(),
                self.models.arg(),
                buffers.obs.arg(),
                buffers.final_obs.arg(),
                buffers.outcomes.arg(),
                (step + 1) * envs * width,
                step * envs * width,
                step * envs * OUTCOME,
                envs,
                self.count,
                task.clone(),
            );
        }
        self.settle::<F>(&buffers.obs, (step + 1) * envs * width);
    }

    /// Begins the next episode of every env.
    fn begin<F: Number>(&self) {
        // SAFETY: as in `step`.
        unsafe {
            begin_episodes::launch_unchecked::<F>(
                &self.client,
                cubes(self.len),
                cube(),
                self.state.arg(),
                self.readings.arg(),
                self.ctrl.arg(),
                self.memory.arg(),
                self.clocks.arg(),
                self.rows.arg(),
                self.placed.arg(),
                self.classes.arg(),
                self.models.arg(),
                self.len,
                self.count,
                self.task.clone(),
            );
        }
        self.settle::<F>(&self.obs, 0);
    }

    /// Computes the forces of the robots that have just been placed, and observes them.
    fn settle<F: Number>(&self, obs: &Buffer, next: usize) {
        self.vary::<F>();
        let shape = self.task.places.shape;
        // SAFETY: as in `step`.
        unsafe {
            evaluate::launch_unchecked::<F>(
                &self.client,
                cubes(self.len * shape.lanes),
                cube(),
                self.numbers.arg(),
                self.rows.arg(),
                self.placed.arg(),
                self.ctrl.arg(),
                self.state.arg(),
                self.readings.arg(),
                self.len,
                false,
                shape,
            );
            observe_placed::launch_unchecked::<F>(
                &self.client,
                cubes(self.len),
                cube(),
                self.state.arg(),
                self.readings.arg(),
                self.memory.arg(),
                self.clocks.arg(),
                self.placed.arg(),
                self.classes.arg(),
                self.models.arg(),
                obs.arg(),
                next,
                self.len,
                self.task.clone(),
            );
        }
    }

    /// Computes the constants of envs of which they differ from those of their model.
    fn vary<F: Number>(&self) {
        if !self.task.plan.varies() {
            return;
        }
        // SAFETY: as in `step`.
        unsafe {
            vary::launch_unchecked::<F>(
                &self.client,
                cubes(self.len * self.task.places.shape.row()),
                cube(),
                self.numbers.arg(),
                self.kinds.arg(),
                self.memory.arg(),
                self.models.arg(),
                self.clocks.arg(),
                self.len,
                self.count,
                self.task.clone(),
            );
        }
    }

    /// Sends rows of observations from `first` on through a net; its outputs go to `out`, from `at` on.
    fn run(&self, net: &Uploaded<'_>, obs: &Buffer, first: usize, out: &Buffer, at: usize, rows: usize) {
        let (client, plan) = (&self.client, &self.task.plan);
        let observed = plan.obs_len() - plan.code;
        let inputs = net.sizes[0];
        let mut input = Buffer::empty::<f32>(client, rows * inputs);
        // SAFETY: as in `step`.
        unsafe {
            prepare::launch_unchecked(
                client,
                cubes(rows * inputs),
                cube(),
                obs.arg(),
                net.statistics.arg(),
                input.arg(),
                first,
                rows,
                net.clip,
                net.code_scale,
                observed,
                inputs - plan.code,
                plan.code,
            );
        }
        let (mut start, last) = (0, net.sizes.len() - 2);
        for (index, pair) in net.sizes.windows(2).enumerate() {
            let [inputs, outputs] = [pair[0], pair[1]];
            let is_hidden = index < last;
            let output = if is_hidden { Buffer::empty::<f32>(client, rows * outputs) } else { out.clone() };
            // SAFETY: as in `step`.
            unsafe {
                layer::launch_unchecked(
                    client,
                    cubes(rows.div_ceil(TILE) * outputs),
                    cube(),
                    input.arg(),
                    net.parameters.arg(),
                    output.arg(),
                    start,
                    if is_hidden { 0 } else { at },
                    rows,
                    inputs,
                    outputs,
                    is_hidden,
                );
            }
            start += (inputs + 1) * outputs;
            input = output;
        }
    }

    /// Samples the actions of a step from their means.
    fn sample<F: Number>(&self, log_std: &[f32], std: &Buffer, buffers: &Buffers, step: usize, number: u64) {
        let nu = log_std.len();
        let half_log_tau = 0.5 * std::f64::consts::TAU.ln();
        let constant = log_std.iter().map(|log_std| f64::from(*log_std) + half_log_tau).sum::<f64>() as f32;
        let [low, high] = halves(number);
        let row = step * self.len;
        // SAFETY: as in `step`.
        unsafe {
            sample::launch_unchecked::<F>(
                &self.client,
                cubes(self.len),
                cube(),
                self.noise_keys.arg(),
                std.arg(),
                buffers.means.arg(),
                buffers.actions.arg(),
                buffers.log_probs.arg(),
                row * nu,
                row,
                self.len,
                low,
                high,
                constant,
                nu,
            );
        }
    }

    /// Copies rows of observations into a buffer of their own.
    fn gather(&self, from: &Buffer, rows: &[u32], to: &Buffer) {
        let width = self.task.plan.obs_len();
        // SAFETY: as in `step`.
        unsafe {
            gather::launch_unchecked(
                &self.client,
                cubes(rows.len() * width),
                cube(),
                from.arg(),
                Buffer::of(&self.client, rows).arg(),
                to.arg(),
                rows.len(),
                width,
            );
        }
    }

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

fn failure(error: impl std::fmt::Debug) -> Error {
    Error::Device(format!("{error:?}"))
}

fn halves(whole: u64) -> [u32; 2] {
    [whole as u32, (whole >> 32) as u32]
}

impl Clock {
    fn read(row: &[u32]) -> Self {
        let whole = |at: usize| u64::from(row[at]) | u64::from(row[at + 1]) << 32;
        Self {
            key: whole(clock::KEY_LOW),
            number: whole(clock::NUMBER_LOW),
            step: row[clock::STEP],
            class: row[clock::CLASS],
            class_steps: row[clock::CLASS_STEPS],
            onset: row[clock::ONSET],
            duration: row[clock::DURATION],
            pause: row[clock::PAUSE],
            code_delay: row[clock::CODE_DELAY],
            in_force: row[clock::IN_FORCE],
            model: 0,
        }
    }

    fn write(&self, varies: bool) -> [u32; clock::LEN] {
        let mut row = [0; clock::LEN];
        row[clock::KEY_LOW..=clock::KEY_HIGH].copy_from_slice(&halves(self.key));
        row[clock::NUMBER_LOW..=clock::NUMBER_HIGH].copy_from_slice(&halves(self.number));
        row[clock::STEP] = self.step;
        row[clock::CLASS] = self.class;
        row[clock::CLASS_STEPS] = self.class_steps;
        row[clock::ONSET] = self.onset;
        row[clock::DURATION] = self.duration;
        row[clock::PAUSE] = self.pause;
        row[clock::CODE_DELAY] = self.code_delay;
        row[clock::IN_FORCE] = self.in_force;
        row[clock::VARIES] = if varies { self.model + 1 } else { 0 };
        row
    }
}

/// A net on the device.
struct Uploaded<'a> {
    sizes: &'a [usize],
    parameters: Buffer,
    statistics: Buffer,
    clip: f32,
    code_scale: f32,
}

impl<'a> Uploaded<'a> {
    /// A net for observations with so many entries before the damage code.
    fn new(client: &Client, networks: &Networks<'a>, net: Net<'a>, observed: usize) -> Self {
        let (statistics, clip) = networks.statistics.map_or_else(
            || ([vec![0.0; observed], vec![1.0; observed]].concat(), f32::MAX),
            |(mean, scale, clip)| ([mean, scale].concat(), clip),
        );
        Self {
            sizes: net.sizes,
            parameters: Buffer::of(client, net.parameters),
            statistics: Buffer::of(client, &statistics),
            clip,
            code_scale: networks.code_scale,
        }
    }
}

/// The buffers of a rollout.
struct Buffers {
    obs: Buffer,
    final_obs: Buffer,
    actions: Buffer,
    means: Buffer,
    log_probs: Buffer,
    values: Buffer,
    outcomes: Buffer,
}

impl Buffers {
    fn read(&self, client: &Client, horizon: usize, envs: usize, width: usize) -> Result<Collected, Error> {
        let handles = [&self.obs, &self.actions, &self.means, &self.log_probs, &self.values, &self.outcomes]
            .map(|buffer| buffer.handle.clone());
        let bytes = client.read(handles.to_vec()).map_err(failure)?;
        let mut arrays = bytes.iter().map(|bytes| f32::from_bytes(bytes).to_vec());
        let mut next = || arrays.next().unwrap_or_default();
        let mut collected = Collected {
            obs: next(),
            actions: next(),
            means: next(),
            log_probs: next(),
            values: next(),
            final_values: vec![0.0; horizon * envs],
            ..Collected::default()
        };
        collected.obs.truncate(horizon * envs * width);
        collected.last_values = collected.values.split_off(horizon * envs);
        for outcome in next().chunks_exact(OUTCOME) {
            let [reward, velocity, ends] = [outcome[0], outcome[1], outcome[2]];
            let ends = ends as u32;
            let has = |end: f64| ends & end as u32 != 0;
            collected.rewards.push(reward);
            collected.forward_velocity.push(velocity);
            collected.terminated.push(has(end::TERMINATED));
            collected.truncated.push(has(end::TRUNCATED));
            collected.diverged += u64::from(has(end::DIVERGED));
        }
        Ok(collected)
    }
}
