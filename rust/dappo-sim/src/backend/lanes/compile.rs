//! From compiled MuJoCo models to the lane engine's.

use dappo_lanes::model::{Integrator, Vector};
use dappo_lanes::{Engine, Model, Precision as Format, Simd, Unsupported};

use super::arrays::ModelArrays;
use super::contacts::{Contacts, attach_sensors};
use super::features::Owner;
use super::joints::{limit_softness, links};
use super::refuse::{check_features, refuse};
use super::tree::Tree;
use crate::backend::Precision;
use crate::error::SimError;

/// The damage classes of a robot, compiled for the lane engine.
#[derive(Debug, Clone, PartialEq)]
pub struct LaneTable {
    models: Vec<Model>,
    /// Positions with which an episode begins, one row a class.
    starts: Vec<Vec<f64>>,
    muted_touch: Vec<Vec<bool>>,
    velocities: usize,
}

impl LaneTable {
    /// Compiles all classes, or returns what of the robot the engine does not support.
    ///
    /// `main_body` is the body whose velocity is measured.
    ///
    /// # Shapes
    /// `muted_touch`: `[classes][limbs]`, whether a class mutes the touch signal of a limb
    pub fn compile(
        classes: &[ModelArrays],
        main_body: usize,
        muted_touch: Vec<Vec<bool>>,
    ) -> Result<Self, SimError> {
        let Some(healthy) = classes.first().filter(|_| classes.len() == muted_touch.len()) else {
            return Err(SimError::Config(format!(
                "a class table needs one model and one touch mask a class, got {} and {}",
                classes.len(),
                muted_touch.len()
            )));
        };
        let compiled = classes.iter().enumerate().map(|(class, arrays)| {
            compile(arrays, main_body).map_err(|Unsupported(why)| match class {
                0 => Unsupported(why),
                _ => Unsupported(format!("in damage class {class}, {why}")),
            })
        });
        let mut models: Vec<Model> = compiled.collect::<Result<_, _>>().map_err(unsupported)?;
        align(&mut models);
        let table = Self {
            models,
            starts: classes.iter().map(|arrays| arrays.qpos0.clone()).collect(),
            muted_touch,
            velocities: healthy.nv,
        };
        // The engine has conditions of its own, whatever the precision and the instruction set.
        table.engine(Precision::F64, Simd::Portable)?;
        Ok(table)
    }

    /// The lane engine for this robot.
    pub fn engine(&self, precision: Precision, simd: Simd) -> Result<Engine, SimError> {
        Engine::new(self.models.clone(), Format::from(precision), simd).map_err(unsupported)
    }

    /// Number of damage classes.
    #[must_use]
    pub fn classes(&self) -> usize {
        self.models.len()
    }

    /// Entries of qpos, qvel and ctrl, number of bodies and of touch sensors.
    #[must_use]
    pub fn sizes(&self) -> Sizes {
        let model = &self.models[0];
        Sizes {
            nq: self.starts[0].len(),
            nv: self.velocities,
            nu: model.actuators,
            nbody: model.bodies,
            touch: model.touch_sensors,
        }
    }

    pub(super) fn start(&self, class: usize) -> &[f64] {
        &self.starts[class]
    }

    pub(super) fn muted_touch(&self, class: usize) -> &[bool] {
        &self.muted_touch[class]
    }
}

/// Lengths of the arrays of one world.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Sizes {
    /// Entries of qpos.
    pub nq: usize,
    /// Entries of qvel.
    pub nv: usize,
    /// Number of actuators.
    pub nu: usize,
    /// Number of bodies, the world included.
    pub nbody: usize,
    /// Number of touch sensors.
    pub touch: usize,
}

fn unsupported(Unsupported(why): Unsupported) -> SimError {
    SimError::Unsupported(why)
}

/// Directions that differ by less are the same, but for rounding: MuJoCo derives that of a capsule from its ends.
const ROUNDING: f64 = 1e-12;

/// Gives all classes the very directions of the healthy robot where only rounding distinguishes them.
fn align(models: &mut [Model]) {
    let Some((healthy, damaged)) = models.split_first_mut() else { return };
    for model in damaged {
        for (point, like) in model.points.iter_mut().zip(&healthy.points) {
            snap(&mut point.tangent, like.tangent);
            snap(&mut point.corner, like.corner);
        }
    }
}

/// Takes over a direction that is almost the same.
fn snap(own: &mut Option<Vector>, like: Option<Vector>) {
    if let (Some(own), Some(like)) = (own, like)
        && own.iter().zip(&like).all(|(own, like)| (own - like).abs() < ROUNDING)
    {
        *own = like;
    }
}

/// One model compiled for the engine.
fn compile(arrays: &ModelArrays, main_body: usize) -> Result<Model, Unsupported> {
    check_features(arrays)?;
    let integrator = integrator(arrays)?;
    let tree = Tree::new(arrays)?;
    if tree.root != main_body {
        let (main, root) = (arrays.called(Owner::Body, main_body), arrays.called(Owner::Body, tree.root));
        return refuse(format!("main_body, {main}, is not {root}, which hangs on the free joint"));
    }
    let limbs = links(arrays, &tree)?;
    let mut contacts = Contacts::new(arrays, &tree)?;
    attach_sensors(arrays, &tree, &mut contacts.points)?;
    Ok(Model {
        timestep: arrays.timestep,
        integrator,
        gravity: -arrays.gravity[2],
        floor: contacts.floor,
        mean_inertia: arrays.meaninertia,
        root: tree.root_inertia(),
        limbs,
        points: contacts.points,
        contact: contacts.softness,
        limit: limit_softness(arrays)?,
        bodies: arrays.nbody,
        touch_sensors: arrays.nsensor,
        actuators: arrays.nu,
    })
}

/// `mjtIntegrator`.
fn integrator(arrays: &ModelArrays) -> Result<Integrator, Unsupported> {
    match (arrays.integrator, arrays.rotation_correction) {
        (0, _) => Ok(Integrator::Euler),
        (1, Some(rotation_correction)) => Ok(Integrator::Rk4 { rotation_correction }),
        (1, None) => refuse("this version of MuJoCo rotates bodies in RK4 differently from the engine"),
        (3, _) => Ok(Integrator::ImplicitFast),
        (other, _) => {
            refuse(format!("opt.integrator is {other}; it supports Euler (0), RK4 (1) and implicitfast (3)"))
        }
    }
}
