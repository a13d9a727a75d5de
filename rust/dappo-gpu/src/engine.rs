//! The device's side: constants of all damage classes, and launches.

use std::sync::{Arc, Mutex, PoisonError};

use cubecl::bytes::Bytes;
use cubecl::client::Client;
use cubecl::prelude::*;
use cubecl::server::Handle;
use dappo_lanes::{Model, Precision};

use crate::constants::row;
use crate::device::{Device, THREADS, check};
use crate::error::Error;
use crate::group::{Group, Robot, World};
use crate::kernel::{advance, copy_rows, evaluate};
use crate::skeleton::Skeleton;

/// The most cubes of a launch: what every device can count to in one dimension.
const MAX_CUBES: usize = 65_535;
/// The most worlds of a group: one bit each in a mask.
const MAX_WIDTH: usize = u32::BITS as usize;

/// The damage classes of one robot on a device, ready to be simulated.
pub struct Engine {
    client: Client,
    robot: Arc<Robot>,
    precision: Precision,
    /// Rows of the damage classes.
    classes: Vec<f64>,
    num_worlds: usize,
    table: Mutex<Table>,
    /// The process that opened the device.
    process: u32,
}

/// The constants on the device: rows of the damage classes, and once some world has its own, one of each world.
struct Table {
    handle: Handle,
    rows: usize,
}

/// A number type of kernels that the host knows too.
pub(crate) trait Number: Float + CubeElement + Default {
    fn of(value: f64) -> Self;
    fn to(self) -> f64;
}

impl Number for f32 {
    fn of(value: f64) -> Self {
        value as f32
    }

    fn to(self) -> f64 {
        self.into()
    }
}

impl Number for f64 {
    fn of(value: f64) -> Self {
        value
    }

    fn to(self) -> f64 {
        self
    }
}

/// What is computed.
#[derive(Clone, Copy)]
enum Run {
    /// The forces in the present states.
    Forward,
    /// Substeps.
    Step(u32),
}

impl Engine {
    /// An engine for `num_worlds` robots, given by the models of all damage classes.
    ///
    /// # Errors
    /// If the kernels do not support the robot, or the device lacks what they need: all the reasons.
    pub fn new(
        classes: &[Model],
        precision: Precision,
        device: &Device,
        num_worlds: usize,
    ) -> Result<Self, Error> {
        let skeleton = Skeleton::new(classes)?;
        let client = device.client();
        check(&client, skeleton.shape.lanes, precision)?;
        let rows: Vec<f64> = classes.iter().flat_map(|class| row(&skeleton, class)).collect();
        let handle = match precision {
            Precision::F32 => upload::<f32>(&client, &rows),
            Precision::F64 => upload::<f64>(&client, &rows),
        };
        let single = precision == Precision::F32;
        Ok(Self {
            client,
            robot: Arc::new(Robot { skeleton, classes: classes.len(), single }),
            precision,
            classes: rows,
            num_worlds,
            table: Mutex::new(Table { handle, rows: classes.len() }),
            process: std::process::id(),
        })
    }

    /// All worlds, as groups of `width`, at most 32, all of class 0 and with all positions and velocities zero.
    #[must_use]
    pub fn groups(&self, width: usize) -> Vec<Group> {
        let width = width.clamp(1, MAX_WIDTH);
        (0..self.num_worlds)
            .step_by(width)
            .map(|first| Group::new(&self.robot, first, width.min(self.num_worlds - first)))
            .collect()
    }

    /// Computes the forces that act in the present states, for the worlds of each group's mask (bit i = world i).
    ///
    /// # Errors
    /// If the device fails.
    pub fn forward(&self, groups: &mut [(&mut Group, u32)]) -> Result<(), Error> {
        self.run(groups, Run::Forward)
    }

    /// Advances the worlds of each group's mask by a number of substeps; the others stay as they are.
    ///
    /// # Errors
    /// If the device fails.
    pub fn step(&self, groups: &mut [(&mut Group, u32)], substeps: usize) -> Result<(), Error> {
        self.run(groups, Run::Step(substeps as u32))
    }

    fn run(&self, groups: &mut [(&mut Group, u32)], run: Run) -> Result<(), Error> {
        check_process(self.process)?;
        let mut worlds: Vec<&mut World> = groups
            .iter_mut()
            .flat_map(|(group, mask)| {
                let mask = *mask;
                let worlds = group.worlds.iter_mut().enumerate();
                worlds.filter(move |(lane, _)| mask >> lane & 1 == 1).map(|(_, world)| world)
            })
            .collect();
        match self.precision {
            Precision::F32 => self.launch_all::<f32>(&mut worlds, run),
            Precision::F64 => self.launch_all::<f64>(&mut worlds, run),
        }
    }

    fn launch_all<F: Number>(&self, worlds: &mut [&mut World], run: Run) -> Result<(), Error> {
        self.vary::<F>(worlds);
        let shape = &self.robot.skeleton.shape;
        for worlds in worlds.chunks_mut(MAX_CUBES * THREADS / shape.lanes) {
            let (states, readings) = self.launch::<F>(worlds, run)?;
            let states = F::from_bytes(&states).chunks_exact(shape.state());
            let readings = F::from_bytes(&readings).chunks_exact(shape.readings());
            for ((world, state), readings) in worlds.iter_mut().zip(states).zip(readings) {
                // Of an evaluation, accelerations and the forces of contacts.
                let (own, shown) = match run {
                    Run::Forward => (shape.guess(), shape.body_readings()),
                    Run::Step(_) => (0, 0),
                };
                take_over(&mut world.state[own..], &state[own..]);
                take_over(&mut world.readings[shown..], &readings[shown..]);
                if let Run::Step(_) = run {
                    world.set_origin();
                }
            }
        }
        Ok(())
    }

    /// Brings constants to the device that are none of a damage class.
    fn vary<F: Number>(&self, worlds: &mut [&mut World]) {
        let length = self.robot.skeleton.shape.row();
        let varied = worlds.iter_mut().filter_map(|world| Some((world.model as u32, world.varied.take()?)));
        let (places, rows): (Vec<u32>, Vec<Vec<f64>>) = varied.unzip();
        if places.is_empty() {
            return;
        }
        let mut table = self.table.lock().unwrap_or_else(PoisonError::into_inner);
        if table.rows == self.robot.classes {
            table.rows += self.num_worlds;
            table.handle = self.client.empty(table.rows * length * size_of::<F>());
            let all: Vec<u32> = (0..self.robot.classes as u32).collect();
            self.copy::<F>(&table, &all, &self.classes);
        }
        self.copy::<F>(&table, &places, &rows.concat());
    }

    /// Copies rows into the table.
    ///
    /// # Shapes
    /// - `places`: `[n]`; `rows`: `[n, row]`
    fn copy<F: Number>(&self, table: &Table, places: &[u32], rows: &[f64]) {
        let (client, length) = (&self.client, self.robot.skeleton.shape.row());
        let most = (MAX_CUBES * THREADS / length).max(1);
        for (places, rows) in places.chunks(most).zip(rows.chunks(most * length)) {
            // SAFETY: the lengths are those of the buffers, and all places are rows of the table.
            unsafe {
                copy_rows::launch_unchecked::<F>(
                    client,
                    CubeCount::Static(rows.len().div_ceil(THREADS) as u32, 1, 1),
                    CubeDim::new_1d(THREADS as u32),
                    BufferArg::from_raw_parts(upload::<F>(client, rows), rows.len()),
                    BufferArg::from_raw_parts(client.create_from_slice(u32::as_bytes(places)), places.len()),
                    BufferArg::from_raw_parts(table.handle.clone(), table.rows * length),
                    places.len(),
                    length,
                );
            }
        }
    }

    /// Computes worlds: their new states and readings, as bytes.
    fn launch<F: Number>(&self, worlds: &[&mut World], run: Run) -> Result<(Bytes, Bytes), Error> {
        let (client, shape) = (&self.client, self.robot.skeleton.shape);
        let count = worlds.len();
        let models: Vec<u32> = worlds.iter().map(|world| world.model as u32).collect();
        let gathered = |part: fn(&World) -> &[f64]| -> Vec<F> {
            worlds.iter().flat_map(|world| part(world)).map(|&number| F::of(number)).collect()
        };
        let state = client.create_from_slice(F::as_bytes(&gathered(|world| &world.state)));
        let ctrl = client.create_from_slice(F::as_bytes(&gathered(|world| &world.ctrl)));
        let readings = client.empty(count * shape.readings() * size_of::<F>());
        let table = self.table.lock().unwrap_or_else(PoisonError::into_inner);
        let threads = count * shape.lanes;
        let cubes = CubeCount::Static(threads.div_ceil(THREADS) as u32, 1, 1);
        let cube = CubeDim::new_1d(THREADS as u32);
        // SAFETY: the lengths are those of the buffers, models are rows of the table, and the kernels' loops end.
        unsafe {
            let numbers = BufferArg::from_raw_parts(table.handle.clone(), table.rows * shape.row());
            let models = BufferArg::from_raw_parts(client.create_from_slice(u32::as_bytes(&models)), count);
            let ctrl = BufferArg::from_raw_parts(ctrl, count * shape.dofs());
            let state = BufferArg::from_raw_parts(state.clone(), count * shape.state());
            let readings = BufferArg::from_raw_parts(readings.clone(), count * shape.readings());
            match run {
                Run::Forward => {
                    let all = client.create_from_slice(u32::as_bytes(&vec![1; count]));
                    let all = BufferArg::from_raw_parts(all, count);
                    evaluate::launch_unchecked::<F>(
                        client, cubes, cube, numbers, models, all, ctrl, state, readings, count, true, shape,
                    );
                }
                Run::Step(substeps) => advance::launch_unchecked::<F>(
                    client, cubes, cube, numbers, models, ctrl, state, readings, count, substeps, shape,
                ),
            }
        }
        drop(table);
        let both = client.read(vec![state, readings]).map_err(|error| Error::Device(format!("{error:?}")))?;
        match <[Bytes; 2]>::try_from(both) {
            Ok([state, readings]) => Ok((state, readings)),
            Err(other) => Err(Error::Device(format!("it returned {} buffers instead of 2", other.len()))),
        }
    }
}

/// Takes over numbers of the device.
fn take_over<F: Number>(own: &mut [f64], numbers: &[F]) {
    for (own, number) in own.iter_mut().zip(numbers) {
        *own = number.to();
    }
}

pub(crate) fn upload<F: Number>(client: &Client, numbers: &[f64]) -> Handle {
    let numbers: Vec<F> = numbers.iter().map(|&number| F::of(number)).collect();
    client.create_from_slice(F::as_bytes(&numbers))
}

/// Fails in a process that was forked from the one that opened the device.
pub(crate) fn check_process(opened: u32) -> Result<(), Error> {
    if opened == std::process::id() {
        return Ok(());
    }
    Err(Error::Device(
        "the device was opened before this process was forked, and a GPU cannot be used on both sides of a fork; start \
         processes with the method `spawn` or `forkserver`"
            .into(),
    ))
}
