//! Reads a Python `ClassTable` (compiled MuJoCo models) and creates backends from it.

use std::path::PathBuf;

use dappo_sim::backend::gpu;
use dappo_sim::backend::lanes::{LaneTable, LanesBackend, ModelArrays, Rules};
use dappo_sim::backend::mujoco::{
    Field, ModelTable, MujocoBackend, MujocoLibrary, VariedModel, WorkerFields,
};
use dappo_sim::memory::{Bytes, of_envs};
use dappo_sim::simd;
use dappo_sim::task::Task;
use dappo_sim::{Backend, BackendKind, DamageSpace, Layout, Physics, Robot, SimError, WarpDevice};
use numpy::{PyArrayDyn, PyArrayMethods, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyList;

use crate::anatomy;
use crate::damage::PyDamageSpace;
use crate::errors::OrRaise;
use crate::model_reader::PyModel;
use crate::python_terms::PythonTerms;
use crate::variants;
use crate::warp::{self, Room, WarpBackend};

/// What of a backend is not the robot's.
#[derive(Debug, Clone, Copy)]
pub struct BackendOptions<'a> {
    /// Name of the reward; the robot's default for `None`.
    pub reward: Option<&'a str>,
    /// Whether a policy is trained: observations contain what the value net alone is given, and the curriculum holds.
    pub training: bool,
    /// Number of envs.
    pub num_envs: usize,
    /// Threads of the pool that it will compute in.
    pub threads: usize,
    /// What simulates.
    pub physics: Physics,
    /// Room for contacts on a GPU.
    pub room: Room,
}

/// What Rust needs of a class table, besides the models themselves.
pub struct ClassTable<'py> {
    object: Bound<'py, PyAny>,
    /// The robot file.
    pub robot: Robot,
    /// The damage classes.
    pub space: DamageSpace,
    /// Sizes and addresses.
    pub layout: Layout,
}

/// Why the lane engine cannot simulate the robot of a class table, or else in what it differs from the options of
/// the MJCF: two lists of sentences.
#[pyfunction]
pub fn lane_support(table: &Bound<'_, PyAny>) -> PyResult<(Vec<String>, Vec<String>)> {
    match ClassTable::read(table)?.compile_lanes()? {
        Ok(table) => Ok((Vec::new(), table.notes().to_vec())),
        Err(SimError::Unsupported(reasons)) => Ok((reasons, Vec::new())),
        Err(error) => Err(error).or_raise(),
    }
}

/// The name of the device that the backend `gpu` would use; an error with the reason why there is none.
#[pyfunction]
pub fn gpu_device() -> PyResult<String> {
    gpu::device().or_raise()
}

impl<'py> ClassTable<'py> {
    /// Reads a `dappo_batch.model.ClassTable`.
    pub fn read(object: &Bound<'py, PyAny>) -> PyResult<Self> {
        let toml: String = object.getattr("robot")?.getattr("toml_text")?.extract()?;
        let robot = Robot::from_toml(&toml).or_raise()?;
        let space = object.getattr("space")?.cast::<PyDamageSpace>()?.get().inner.clone();
        let model = object.getattr("models")?.get_item(0)?;
        let size = |name: &str| -> PyResult<usize> { model.getattr(name)?.extract() };
        let layout = Layout {
            nq: size("nq")?,
            nv: size("nv")?,
            nu: size("nu")?,
            nbody: size("nbody")?,
            nsensordata: size("nsensordata")?,
            timestep: model.getattr("opt")?.getattr("timestep")?.extract()?,
            main_body: object.getattr("main_body")?.extract()?,
            limb_bodies: object.getattr("limb_bodies")?.extract()?,
            touch_addresses: object.getattr("touch_addresses")?.extract()?,
            hidden_state: object.getattr("hidden_state")?.extract()?,
            anatomy: anatomy::read(object)?,
            variants: variants::read(object)?,
        };
        Ok(Self { object: object.clone(), robot, space, layout })
    }

    /// The table of the robot [with this history](Robot::with_history).
    pub fn with_history(self, steps: Option<usize>) -> PyResult<Self> {
        let robot = self.robot.with_history(steps).or_raise()?;
        Ok(Self { robot, ..self })
    }

    /// The compiled robot of the lane engine if `kind` allows it, or else why not; empty if it was not
    /// requested.
    pub fn lane_table(&self, kind: BackendKind) -> PyResult<Result<LaneTable, String>> {
        if kind == BackendKind::Mujoco {
            return Ok(Err(String::new()));
        }
        // Python's errors are not the lane engine's, so everything is read before it compiles.
        let compiled = self.compile_lanes()?;
        kind.lane_table(|| compiled).or_raise()
    }

    /// The compiled robot of the lane engine, or why it cannot be.
    fn compile_lanes(&self) -> PyResult<Result<LaneTable, SimError>> {
        let (arrays, disabled_touch) = (self.arrays()?, self.disabled_touch()?);
        let Layout { main_body, touch_addresses, .. } = &self.layout;
        Ok(LaneTable::compile(&arrays, *main_body, touch_addresses, disabled_touch))
    }

    /// A backend over this table; `lanes` is what [`lane_table`](Self::lane_table) made of it.
    pub fn backend(
        &self,
        lanes: &Result<LaneTable, String>,
        options: BackendOptions<'_>,
    ) -> PyResult<Box<dyn Backend>> {
        let task = Task::new(&self.robot, &self.layout, options.reward, options.training).or_raise()?;
        let obs_dim = task.obs_dim() + self.space.code_length();
        of_envs(options.num_envs, &self.layout, obs_dim)
            .require(&format!("{} envs of the robot `{}`", options.num_envs, self.robot.name))
            .or_raise()?;
        let num_envs = options.num_envs;
        let backend = match options.physics {
            Physics::Lanes(precision) => {
                let refuse = |why: &String| {
                    SimError::Config(format!("the robot was not compiled for the backend `lanes`: {why}"))
                };
                let table = lanes.as_ref().map_err(refuse);
                table
                    .and_then(|table| {
                        LanesBackend::new(
                            task,
                            table.clone(),
                            precision,
                            &simd::choices()?,
                            num_envs,
                            options.threads,
                        )
                    })
                    .map(|backend| Box::new(backend) as Box<dyn Backend>)
                    .or_raise()
            }
            Physics::Gpu(precision) => {
                let refuse = |why: &String| {
                    let why = if why.is_empty() { "the backend `mujoco` was requested" } else { why };
                    SimError::Config(format!("the device gpu cannot be used: {why}"))
                };
                let table = lanes.as_ref().map_err(refuse);
                table.and_then(|table| gpu::open(task, table.clone(), precision, num_envs)).or_raise()
            }
            Physics::Mujoco => {
                let threads = options.threads.min(options.physics.most_threads(num_envs));
                self.mujoco_backend(task, num_envs, threads)
            }
            Physics::Warp(device) => self.warp_backend(task, device, options),
        }?;
        PythonTerms::around(backend)
    }

    fn warp_backend(
        &self,
        task: Task,
        device: WarpDevice,
        options: BackendOptions<'_>,
    ) -> PyResult<Box<dyn Backend>> {
        warp::check(&self.robot, &self.layout.variants).or_raise()?;
        let BackendOptions { reward, num_envs, room, .. } = options;
        let (table, classes) = (self.object.clone().unbind(), self.space.classes().len());
        let backend = WarpBackend::new(&table, task, reward, num_envs, classes, device, room);
        Ok(Box::new(backend.or_raise()?))
    }

    fn mujoco_backend(&self, task: Task, num_envs: usize, threads: usize) -> PyResult<Box<dyn Backend>> {
        let py = self.object.py();
        let path: PathBuf =
            py.import("dappo_batch.model.mujoco_library")?.call_method0("library_path")?.extract()?;
        let library = MujocoLibrary::load(&path).or_raise()?;
        if task.varies() {
            let models: usize = self.object.getattr("nbytes")?.extract()?;
            let what = format!("copies of the models of `{}` for {threads} threads", self.robot.name);
            Bytes::of(threads, models).require(&what).or_raise()?;
        }
        let workers = self.workers(threads, task.varies())?;
        let backend = MujocoBackend::new(task, &library, self.model_table()?, workers, num_envs);
        Ok(Box::new(backend.or_raise()?))
    }

    /// The arrays of all models.
    fn arrays(&self) -> PyResult<Vec<ModelArrays>> {
        let probe = |module: &str, name: &str| self.object.py().import(module)?.call_method0(name);
        let rules = Rules {
            rotation_correction: probe("dappo_batch.model.rotation_correction", "rotation_correction")?
                .extract()?,
            clamped_without_derivative: probe(
                "dappo_batch.model.clamped_actuators",
                "clamped_without_derivative",
            )?
            .extract()?,
        };
        let models = self.object.getattr("all_models")?;
        models.try_iter()?.map(|model| ModelArrays::read(&PyModel::new(model?)?, rules)).collect()
    }

    /// The limbs whose touch signal each class disables.
    fn disabled_touch(&self) -> PyResult<Vec<Vec<bool>>> {
        let disabled: Vec<Vec<usize>> = self.object.getattr("disabled_touch")?.extract()?;
        let mask = |limbs: &Vec<usize>| (0..self.space.limbs()).map(|limb| limbs.contains(&limb)).collect();
        Ok(disabled.iter().map(mask).collect())
    }

    fn model_table(&self) -> PyResult<ModelTable> {
        let py = self.object.py();
        let models = self.object.getattr("all_models")?;
        let addresses: Vec<usize> =
            models.try_iter()?.map(|model| model?.getattr("_address")?.extract()).collect::<PyResult<_>>()?;
        let spec: u32 =
            py.import("dappo_batch.model.mujoco_library")?.call_method0("state_spec")?.extract()?;
        // SAFETY: `_address` is the mjModel of each live Python model, kept alive by the table; the table has
        // checked that all models have equal sizes.
        let table = unsafe {
            ModelTable::new(&addresses, self.disabled_touch()?, spec, Box::new(self.object.clone().unbind()))
        };
        table.or_raise()
    }

    /// What each worker has of its own: a data, and where `varies` is set a copy of every model.
    fn workers(&self, count: usize, varies: bool) -> PyResult<Vec<WorkerFields>> {
        let datas = self.object.call_method1("worker_data", (count,))?;
        datas.try_iter()?.map(|data| self.worker(&data?, varies)).collect()
    }

    fn worker(&self, data: &Bound<'py, PyAny>, varies: bool) -> PyResult<WorkerFields> {
        let field = |name: &str| array(data, name);
        let xpos = field("xpos")?;
        let main_body_xpos =
            Field { address: xpos.address + self.layout.main_body * 3 * size_of::<f64>(), len: 3 };
        let fields = [
            field("qpos")?,
            field("qvel")?,
            field("ctrl")?,
            field("cfrc_ext")?,
            field("sensordata")?,
            field("actuator_force")?,
            main_body_xpos,
        ];
        let models = if varies {
            self.object.call_method0("worker_models")?
        } else {
            PyList::empty(data.py()).into_any()
        };
        let varied = models.try_iter()?.map(|model| varied(&model?)).collect::<PyResult<_>>()?;
        let library = data.py().import("dappo_batch.model.mujoco_library")?;
        let divergences: [usize; 3] = library.call_method1("divergence_counters", (data,))?.extract()?;
        let address: usize = data.getattr("_address")?.extract()?;
        let owner = Box::new((data.clone().unbind(), models.unbind()));
        // SAFETY: the arrays are views into this MjData, which Python has just made for this worker alone and
        // which the owner keeps alive, with the models.
        Ok(unsafe { WorkerFields::new(address, fields, varied, divergences, owner) })
    }
}

/// An array of a model or a data of Python.
fn array(object: &Bound<'_, PyAny>, name: &str) -> PyResult<Field> {
    let array = object.getattr(name)?.cast_into::<PyArrayDyn<f64>>()?;
    Ok(Field { address: array.data() as usize, len: array.len() })
}

/// A model that belongs to one worker.
fn varied(model: &Bound<'_, PyAny>) -> PyResult<VariedModel> {
    let names = [
        "geom_friction",
        "pair_friction",
        "dof_damping",
        "dof_armature",
        "actuator_gainprm",
        "actuator_biasprm",
        "actuator_forcerange",
    ];
    let mut fields = [Field { address: 0, len: 0 }; 9];
    for (field, name) in fields.iter_mut().zip(names) {
        *field = array(model, name)?;
    }
    fields[7] = array(&model.getattr("opt")?, "gravity")?;
    fields[8] = array(model, "jnt_range")?;
    let address: usize = model.getattr("_address")?.extract()?;
    // SAFETY: the arrays are views into this MjModel, a copy that Python has made for one worker, which keeps it.
    Ok(unsafe { VariedModel::new(address, fields) })
}
