//! From compiled MuJoCo models to the lane engine's.

use dappo_lanes::model::{Actuator, Cone, Integrator, Surface, Vector};
use dappo_lanes::{Engine, Model, Precision as Format, Simd, Unsupported};

use super::arrays::ModelArrays;
use super::contacts::{Contacts, attach_sensors, check_geoms};
use super::features::Owner;
use super::joints::{links, root_parameters};
use super::refuse::{EULER_DAMPING_OFF, Reasons, check_features, notes, refuse};
use super::tree::Tree;
use crate::backend::Precision;
use crate::error::SimError;
use crate::task::{Jam, Variation};

/// The damage classes of a robot and their variants, compiled for the lane engine.
#[derive(Debug, Clone, PartialEq)]
pub struct LaneTable {
    models: Vec<Model>,
    /// Positions with which an episode begins, one row a model.
    starts: Vec<Vec<f64>>,
    disabled_touch: Vec<Vec<bool>>,
    notes: Vec<String>,
}

impl LaneTable {
    /// Compiles all models, or returns all of the robot that the engine does not support.
    ///
    /// The first models are those of the classes, in their order, then come their variants. `main_body` is the body whose
    /// velocity is measured.
    ///
    /// # Shapes
    /// - `touch_addresses`: `[limbs]`, addresses in sensordata of the touch sensors that are read, or empty
    /// - `disabled_touch`: `[classes][limbs]`, whether a class disables the touch signal of a limb
    pub fn compile(
        compiled: &[ModelArrays],
        main_body: usize,
        touch_addresses: &[usize],
        disabled_touch: Vec<Vec<bool>>,
    ) -> Result<Self, SimError> {
        let classes = disabled_touch.len();
        let Some(healthy) = compiled.first().filter(|_| (1..=compiled.len()).contains(&classes)) else {
            return Err(SimError::Config(format!(
                "a class table needs a model and a touch mask of each class, got {} and {classes}",
                compiled.len(),
            )));
        };
        let mut models = Vec::with_capacity(compiled.len());
        for (index, arrays) in compiled.iter().enumerate() {
            // What the healthy robot has, all models have.
            models.push(compile(arrays, main_body, touch_addresses).map_err(|mut reasons| {
                let place = match index {
                    0 => String::new(),
                    class if class < classes => format!("in damage class {class}, "),
                    _ => "in a compiled variant, ".into(),
                };
                reasons.iter_mut().for_each(|why| why.insert_str(0, &place));
                SimError::Unsupported(reasons)
            })?);
        }
        align(&mut models);
        let table = Self {
            models,
            starts: compiled.iter().map(|arrays| arrays.qpos0.clone()).collect(),
            disabled_touch,
            notes: notes(healthy),
        };
        // The engine has conditions of its own, whatever the precision and the instruction set.
        table.engine(Precision::F64, Simd::Portable)?;
        Ok(table)
    }

    /// The lane engine for this robot.
    pub fn engine(&self, precision: Precision, simd: Simd) -> Result<Engine, SimError> {
        Engine::new(self.models.clone(), Format::from(precision), simd).map_err(unsupported)
    }

    /// Where the engine deliberately differs from the options of the model, one sentence each.
    #[must_use]
    pub fn notes(&self) -> &[String] {
        &self.notes
    }

    /// Number of damage classes.
    #[must_use]
    pub fn classes(&self) -> usize {
        self.disabled_touch.len()
    }

    /// Entries of qpos, qvel and ctrl, number of bodies and of touch sensors.
    #[must_use]
    pub fn sizes(&self) -> Sizes {
        let model = &self.models[0];
        Sizes {
            nq: self.starts[0].len(),
            nv: model.dofs(),
            nu: model.actuators,
            nbody: model.bodies,
            touch: model.touch_sensors,
        }
    }

    /// The compiled models: those of the classes in their order, then their variants.
    #[must_use]
    pub fn models(&self) -> &[Model] {
        &self.models
    }

    pub(crate) fn start(&self, model: usize) -> &[f64] {
        &self.starts[model]
    }

    /// A model with what is random about an env, and by how much the limits of jammed joints have moved.
    pub(in crate::backend) fn varied<'a>(
        &self,
        model: usize,
        variation: &Variation,
        jammed: impl Iterator<Item = (&'a Jam, f64)>,
    ) -> Model {
        let mut model = self.models[model].clone();
        if let Some([x, y, z]) = variation.gravity {
            let gravity = model.gravity.iter().map(|g| g * g).sum::<f64>().sqrt();
            model.gravity = [gravity * x, gravity * y, gravity * z];
        }
        for (jam, shift) in jammed {
            let links = model.limbs.iter_mut().flatten();
            for link in links.filter(|link| link.dof == jam.dof) {
                link.range = link.range.map(|limit| limit + shift);
            }
        }
        for point in &mut model.points {
            point.friction = point.friction.map(|coefficient| coefficient * variation.friction);
        }
        for link in model.limbs.iter_mut().flatten() {
            link.damping *= variation.joint_damping;
            link.armature *= variation.joint_armature;
            if let Some(actuator) = &mut link.actuator {
                vary_actuator(actuator, variation);
            }
        }
        model
    }

    pub(crate) fn disabled_touch(&self, class: usize) -> &[bool] {
        &self.disabled_touch[class]
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
    SimError::Unsupported(vec![why])
}

/// The backend `mujoco` does the same to the arrays of a model.
fn vary_actuator(actuator: &mut Actuator, variation: &Variation) {
    let strength = variation.motor_strength;
    let [constant, stiffness, slope] = actuator.bias;
    // Only a servo's gain is a stiffness.
    let kp = if stiffness == 0.0 { 1.0 } else { variation.kp };
    actuator.gain *= strength * kp;
    actuator.bias = [strength * constant, strength * kp * stiffness, strength * variation.kd * slope];
    actuator.force_range = actuator.force_range.map(|limit| strength * limit);
}

/// `mjCONE_ELLIPTIC`.
const ELLIPTIC: i32 = 1;
/// `mjMINVAL`.
const TINY: f64 = 1e-15;
/// Directions that differ by less are the same, but for rounding: MuJoCo derives that of a capsule from its ends.
const ROUNDING: f64 = 1e-12;

/// Gives all classes the very directions of the healthy robot where only rounding distinguishes them.
fn align(models: &mut [Model]) {
    let Some((healthy, damaged)) = models.split_first_mut() else { return };
    for model in damaged {
        for (point, like) in model.points.iter_mut().zip(&healthy.points) {
            if let (Some(own), Some(like)) = (&mut point.tangent, &like.tangent) {
                snap(own, like);
            }
            match (&mut point.surface, &like.surface) {
                (Surface::Rim { axes: own, .. }, Surface::Rim { axes: like, .. })
                | (Surface::Ellipsoid { axes: own }, Surface::Ellipsoid { axes: like }) => {
                    own.iter_mut().zip(like).for_each(|(own, like)| snap(own, like));
                }
                _ => {}
            }
        }
    }
}

/// Takes over a direction that is almost the same.
fn snap(own: &mut Vector, like: &Vector) {
    if own.iter().zip(like).all(|(own, like)| (own - like).abs() < ROUNDING) {
        *own = *like;
    }
}

/// One model compiled for the engine, or the reasons against it.
fn compile(arrays: &ModelArrays, main_body: usize, touch_addresses: &[usize]) -> Result<Model, Vec<String>> {
    let mut reasons = Reasons::default();
    check_features(arrays, touch_addresses, &mut reasons);
    check_geoms(arrays, &mut reasons);
    let integrator = reasons.keep(integrator(arrays));
    let model = reasons.keep(Tree::new(arrays)).and_then(|tree| {
        if tree.root != main_body {
            let (main, root) = (arrays.called(Owner::Body, main_body), arrays.called(Owner::Body, tree.root));
            reasons.add(format!("main_body, {main}, is not {root}, which hangs on the free joint"));
        }
        let [root_armature, root_damping] = root_parameters(arrays, &mut reasons);
        let limbs = links(arrays, &tree, &mut reasons);
        let mut contacts = Contacts::new(arrays, &tree, &mut reasons)?;
        attach_sensors(arrays, &tree, touch_addresses, &mut contacts.points, &mut reasons);
        Some(Model {
            timestep: arrays.timestep,
            integrator: integrator?,
            cone: if arrays.cone == ELLIPTIC { Cone::Elliptic } else { Cone::Pyramidal },
            impedance_ratio: arrays.impratio.max(TINY),
            gravity: ModelArrays::vector(&arrays.gravity, 0),
            floor: contacts.floor,
            mean_inertia: arrays.meaninertia,
            root: tree.root_inertia(),
            root_armature,
            root_damping,
            limbs,
            parents: tree.parents,
            points: contacts.points,
            bodies: arrays.nbody,
            touch_sensors: arrays.nsensordata,
            actuators: arrays.nu,
        })
    });
    reasons.unless_any(model)
}

/// `mjtIntegrator`.
fn integrator(arrays: &ModelArrays) -> Result<Integrator, Unsupported> {
    match (arrays.integrator, arrays.rules.rotation_correction) {
        (0, _) => Ok(Integrator::Euler { implicit_damping: arrays.disableflags & EULER_DAMPING_OFF == 0 }),
        (1, Some(rotation_correction)) => Ok(Integrator::Rk4 { rotation_correction }),
        (1, None) => refuse("this version of MuJoCo rotates bodies in RK4 differently from the engine"),
        (3, _) => {
            let clamped_without_derivative = arrays.rules.clamped_without_derivative;
            Ok(Integrator::ImplicitFast { clamped_without_derivative })
        }
        (other, _) => {
            refuse(format!("opt.integrator is {other}; it supports Euler (0), RK4 (1) and implicitfast (3)"))
        }
    }
}
