//! Envs on the device: whole rollouts without a call of the host.

mod buffer;
mod episode;
mod networks;
mod rollout;
mod states;

use cubecl::client::Client;
use dappo_lanes::{Model, Precision};

use crate::constants::row;
use crate::device::{Device, check};
use crate::engine::Number;
use crate::error::Error;
use crate::kernel::evaluate;
use crate::skeleton::Skeleton;
use crate::task::kernels::{begin_episodes, observe_placed};
use crate::task::places::Places;
use crate::task::plan::{JAM, Plan, Task};
use crate::task::scene::clock;
use crate::task::variation::{kinds, vary};
use buffer::{Buffer, cube, cubes};
use episode::halves;

pub use episode::Clock;
pub use networks::{Net, Networks};
pub use rollout::Collected;
pub use states::EnvStates;

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
}

fn failure(error: impl std::fmt::Debug) -> Error {
    Error::Device(format!("{error:?}"))
}
