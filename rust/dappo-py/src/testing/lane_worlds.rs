//! `LaneWorlds` in Python: the bare lane engine, for tests and research.

use dappo_sim::backend::lanes::{LaneTable, Readout, Sizes};
use dappo_sim::backend::{LaneWorlds, Worlds, gpu};
use dappo_sim::simd::{self, Simd};
use dappo_sim::{BackendKind, Device, Precision, SimError};
use numpy::{PyArray2, PyArray3, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;

use crate::arguments::not_contiguous;
use crate::class_table::ClassTable;
use crate::errors::{Kind, OrRaise, raise};

type Matrix<'py> = Bound<'py, PyArray2<f64>>;
type Forces<'py> = Bound<'py, PyArray3<f64>>;

/// N worlds of the lane engine, one in each lane, or of the GPU engine, without episodes, observations or rewards. The
/// lane engine computes in the thread that calls.
#[pyclass(name = "LaneWorlds", module = "dappo_batch._core")]
pub struct PyLaneWorlds {
    worlds: Box<dyn Worlds>,
    count: usize,
    sizes: Sizes,
    simd: Simd,
    precision: Precision,
}

impl PyLaneWorlds {
    /// Places every world and sets its controls.
    fn place(
        &mut self,
        qpos: &PyReadonlyArray2<'_, f64>,
        qvel: &PyReadonlyArray2<'_, f64>,
        ctrl: &PyReadonlyArray2<'_, f64>,
    ) -> PyResult<()> {
        let Sizes { nq, nv, nu, .. } = self.sizes;
        for (name, array, columns) in [("qpos", qpos, nq), ("qvel", qvel, nv), ("ctrl", ctrl, nu)] {
            if array.shape() != [self.count, columns] {
                let (got, count) = (array.shape(), self.count);
                let message = format!("{name} has shape {got:?}, expected [{count}, {columns}]");
                return Err(raise(Kind::Shape, message));
            }
        }
        let (qpos, qvel, ctrl) = (
            qpos.as_slice().map_err(not_contiguous)?,
            qvel.as_slice().map_err(not_contiguous)?,
            ctrl.as_slice().map_err(not_contiguous)?,
        );
        for index in 0..self.count {
            let (group, lane) = self.worlds.world_mut(index);
            group.set_state(lane, &qpos[index * nq..][..nq], &qvel[index * nv..][..nv]);
            group.set_ctrl(lane, &ctrl[index * nu..][..nu]);
        }
        Ok(())
    }

    fn read<'py>(&self, py: Python<'py>) -> PyResult<(Matrix<'py>, Matrix<'py>, Forces<'py>, Matrix<'py>)> {
        let Sizes { nq, nv, nbody, touch, .. } = self.sizes;
        let (qpos, qvel) =
            (PyArray2::zeros(py, [self.count, nq], false), PyArray2::zeros(py, [self.count, nv], false));
        let forces = PyArray3::zeros(py, [self.count, nbody, 6], false);
        let touches = PyArray2::zeros(py, [self.count, touch], false);
        {
            let (mut positions, mut velocities) = (qpos.readwrite(), qvel.readwrite());
            let (mut loads, mut readings) = (forces.readwrite(), touches.readwrite());
            let positions = positions.as_slice_mut().map_err(not_contiguous)?;
            let velocities = velocities.as_slice_mut().map_err(not_contiguous)?;
            let loads = loads.as_slice_mut().map_err(not_contiguous)?;
            let readings = readings.as_slice_mut().map_err(not_contiguous)?;
            for world in 0..self.count {
                let readout = Readout {
                    qpos: &mut positions[world * nq..][..nq],
                    qvel: &mut velocities[world * nv..][..nv],
                    cfrc_ext: &mut loads[world * nbody * 6..][..nbody * 6],
                    touch: &mut readings[world * touch..][..touch],
                };
                let (group, lane) = self.worlds.world(world);
                group.read(lane, readout);
            }
        }
        Ok((qpos, qvel, forces, touches))
    }
}

/// The lane engine's view of a class table; any robot that it does not support is refused.
fn lane_table(table: &Bound<'_, PyAny>) -> PyResult<LaneTable> {
    ClassTable::read(table)?.lane_table(BackendKind::Lanes)?.map_err(|note| raise(Kind::Config, note))
}

#[expect(clippy::needless_pass_by_value, reason = "PyO3 hands arguments over by value")]
#[pymethods]
impl PyLaneWorlds {
    #[new]
    #[pyo3(signature = (table, classes, precision="f64", simd=None, device="cpu"))]
    fn new(
        table: &Bound<'_, PyAny>,
        classes: PyReadonlyArray1<'_, i64>,
        precision: &str,
        simd: Option<&str>,
        device: &str,
    ) -> PyResult<Self> {
        let precision = Precision::parse(precision).or_raise()?;
        let simd = match simd {
            None => simd::chosen(),
            name => simd::select(name, "simd"),
        };
        let simd = simd.or_raise()?;
        let table = lane_table(table)?;
        let classes = classes.as_slice().map_err(not_contiguous)?;
        let count = classes.len();
        let mut worlds = match Device::parse(device).or_raise()? {
            Device::Cpu => LaneWorlds::new(&table, precision, simd, count)
                .map(|worlds| Box::new(worlds) as Box<dyn Worlds>),
            Device::Gpu => gpu::worlds(&table, precision, count),
            _ => Err(SimError::Config(format!("device is `{device}`, expected `cpu` or `gpu`"))),
        }
        .or_raise()?;
        for (index, &class) in classes.iter().enumerate() {
            let class = usize::try_from(class).ok().filter(|&class| class < table.classes());
            let class = class.ok_or_else(|| {
                let last = table.classes() - 1;
                let message = format!("classes[{index}] is {}, expected 0 to {last}", classes[index]);
                raise(Kind::Config, message)
            })?;
            let (group, lane) = worlds.world_mut(index);
            group.set_class(lane, class);
        }
        Ok(Self { worlds, count, sizes: table.sizes(), simd, precision })
    }

    /// Worlds in a group: with the lane engine, those in a register.
    #[getter]
    fn width(&self) -> usize {
        if self.count == 0 { 0 } else { self.worlds.world(0).0.width() }
    }

    /// Instruction set.
    #[getter]
    fn simd(&self) -> &str {
        self.simd.name()
    }

    /// Floating-point format.
    #[getter]
    fn precision(&self) -> &str {
        self.precision.name()
    }

    /// Accelerations, external contact forces and touch in given states, as of `mj_forward`.
    fn forward<'py>(
        &mut self,
        py: Python<'py>,
        qpos: PyReadonlyArray2<'py, f64>,
        qvel: PyReadonlyArray2<'py, f64>,
        ctrl: PyReadonlyArray2<'py, f64>,
    ) -> PyResult<(Matrix<'py>, Forces<'py>, Matrix<'py>)> {
        self.place(&qpos, &qvel, &ctrl)?;
        py.detach(|| self.worlds.forward()).or_raise()?;
        let nv = self.sizes.nv;
        let qacc = PyArray2::zeros(py, [self.count, nv], false);
        {
            let mut accelerations = qacc.readwrite();
            let rows = accelerations.as_slice_mut().map_err(not_contiguous)?.chunks_exact_mut(nv);
            for (world, row) in rows.enumerate() {
                let (group, lane) = self.worlds.world(world);
                group.accelerations(lane, row);
            }
        }
        let (_, _, forces, touch) = self.read(py)?;
        Ok((qacc, forces, touch))
    }

    /// States, external contact forces and touch after `substeps` steps from given states.
    fn step<'py>(
        &mut self,
        py: Python<'py>,
        qpos: PyReadonlyArray2<'py, f64>,
        qvel: PyReadonlyArray2<'py, f64>,
        ctrl: PyReadonlyArray2<'py, f64>,
        substeps: usize,
    ) -> PyResult<(Matrix<'py>, Matrix<'py>, Forces<'py>, Matrix<'py>)> {
        self.place(&qpos, &qvel, &ctrl)?;
        py.detach(|| self.worlds.step(substeps)).or_raise()?;
        self.read(py)
    }
}
