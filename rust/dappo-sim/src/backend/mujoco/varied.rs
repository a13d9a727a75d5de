//! Models whose numbers differ from env to env: each worker has its own, and writes it before it is used.

use super::library::Model;
use super::table::{Array, Field};
use crate::task::{Jam, Variation};

/// Numbers of an actuator in `actuator_gainprm` and `actuator_biasprm` (`mjNGAIN`, `mjNBIAS`).
const PARAMETERS: usize = 10;

/// An `mjModel` that belongs to one worker, with those of its arrays that vary.
pub struct VariedModel {
    model: usize,
    friction: [Varied; 2],
    damping: Varied,
    armature: Varied,
    gain: Varied,
    bias: Varied,
    force_range: Varied,
    gravity: Varied,
    range: Varied,
}

/// An array and the numbers that were compiled.
struct Varied {
    array: Array,
    compiled: Vec<f64>,
}

impl Varied {
    fn new(field: Field) -> Self {
        let array = Array(field);
        Self { compiled: array.get().to_vec(), array }
    }

    fn scale(&mut self, factor: f64) {
        for (number, compiled) in self.array.get_mut().iter_mut().zip(&self.compiled) {
            *number = factor * compiled;
        }
    }
}

impl VariedModel {
    /// Wraps the addresses of an `mjModel` and of its arrays `geom_friction`, `pair_friction`, `dof_damping`,
    /// `dof_armature`, `actuator_gainprm`, `actuator_biasprm`, `actuator_forcerange`, `opt.gravity` and `jnt_range`.
    ///
    /// # Safety
    /// `model` must be a valid `mjModel` that nothing else uses, and the fields its arrays, which stay where they are
    /// while this value lives.
    #[must_use]
    pub unsafe fn new(model: usize, fields: [Field; 9]) -> Self {
        let [geoms, pairs, damping, armature, gain, bias, force_range, gravity, range] =
            fields.map(Varied::new);
        Self { model, friction: [geoms, pairs], damping, armature, gain, bias, force_range, gravity, range }
    }

    pub(super) fn model(&self) -> Model {
        self.model as Model
    }

    /// Writes the numbers of an env. The lane engine does the same to its constants.
    pub(super) fn vary(&mut self, variation: &Variation) {
        self.friction.iter_mut().for_each(|friction| friction.scale(variation.friction));
        self.damping.scale(variation.joint_damping);
        self.armature.scale(variation.joint_armature);
        let strength = variation.motor_strength;
        self.force_range.scale(strength);
        let compiled = self.gain.compiled.iter().zip(&self.bias.compiled).enumerate();
        let numbers = self.gain.array.get_mut().iter_mut().zip(self.bias.array.get_mut());
        let mut kp = 1.0;
        for ((gain, bias), (index, (compiled_gain, compiled_bias))) in numbers.zip(compiled) {
            match index % PARAMETERS {
                0 => {
                    // Only a servo's gain is a stiffness.
                    let stiffness = self.bias.compiled[index + 1];
                    kp = if stiffness == 0.0 { 1.0 } else { variation.kp };
                    (*gain, *bias) = (strength * kp * compiled_gain, strength * compiled_bias);
                }
                1 => *bias = strength * kp * compiled_bias,
                2 => *bias = strength * variation.kd * compiled_bias,
                _ => {}
            }
        }
        if let Some(direction) = variation.gravity {
            let magnitude = self.gravity.compiled.iter().map(|g| g * g).sum::<f64>().sqrt();
            for (number, direction) in self.gravity.array.get_mut().iter_mut().zip(direction) {
                *number = magnitude * direction;
            }
        }
    }

    /// Moves the limits of jammed joints, rad.
    pub(super) fn jam<'a>(&mut self, jammed: impl Iterator<Item = (&'a Jam, f64)>) {
        let limits = self.range.array.get_mut();
        for (jam, shift) in jammed {
            for at in [2 * jam.joint, 2 * jam.joint + 1] {
                limits[at] = self.range.compiled[at] + shift;
            }
        }
    }
}
