//! Hinges with their limits and actuators.

use dappo_lanes::Unsupported;
use dappo_lanes::model::{Actuator, Link};

use super::arrays::ModelArrays;
use super::features::Owner;
use super::refuse::{Reasons, refuse};
use super::softness::softness;
use super::tree::{Hinge, Tree};

/// Degrees of freedom of the root.
const ROOT_DOFS: usize = 6;
/// `mjBIAS_AFFINE`.
const AFFINE: i32 = 1;

/// The links of every limb.
pub(super) fn links(model: &ModelArrays, tree: &Tree, reasons: &mut Reasons) -> Vec<Vec<Link>> {
    let actuators = actuators(model, reasons);
    let mut link = |hinge: &Hinge| reasons.keep(link(model, hinge, actuators[hinge.joint]));
    tree.limbs.iter().map(|limb| limb.iter().filter_map(&mut link).collect()).collect()
}

fn link(model: &ModelArrays, hinge: &Hinge, actuator: Option<Actuator>) -> Result<Link, Unsupported> {
    let joint = hinge.joint;
    let called = || model.called(Owner::Joint, joint);
    let dof = model.jnt_dofadr[joint] as usize;
    let position = model.jnt_qposadr[joint] as usize;
    let range = limited(model.jnt_limited[joint], &model.jnt_range, joint);
    let margin = model.jnt_margin[joint];
    if 2.0 * margin >= range[1] - range[0] {
        return refuse(format!("{} is always near both limits ({range:?}, margin {margin})", called()));
    }
    let soft = |solref: &[f64], solimp: &[f64], index: usize| {
        softness(ModelArrays::row(solref, index), ModelArrays::row(solimp, index), model.timestep)
            .or_else(|why| refuse(format!("{}: {why}", called())))
    };
    Ok(Link {
        offset: hinge.frame.origin,
        axes: hinge.frame.axes,
        zero: model.qpos0[position],
        inertia: hinge.inertia(),
        armature: model.dof_armature[dof],
        damping: model.dof_damping[dof],
        stiffness: model.jnt_stiffness[joint],
        spring_reference: model.qpos_spring[position],
        friction_loss: model.dof_frictionloss[dof],
        friction_softness: soft(&model.dof_solref, &model.dof_solimp, dof)?,
        actuator_range: limited(model.jnt_actfrclimited[joint], &model.jnt_actfrcrange, joint),
        range,
        margin,
        limit: soft(&model.jnt_solref, &model.jnt_solimp, joint)?,
        inverse_weight: model.dof_invweight0[dof],
        dof,
        actuator,
    })
}

/// Armature and damping of the free joint, each the same for all of its degrees of freedom.
pub(super) fn root_parameters(model: &ModelArrays, reasons: &mut Reasons) -> [f64; 2] {
    let root = || model.called(Owner::Joint, 0);
    if let Some(loss) = model.dof_frictionloss.iter().take(ROOT_DOFS).find(|loss| **loss != 0.0) {
        reasons.add(format!("{}, the free one, has friction loss {loss}, expected 0", root()));
    }
    if let Some(stiffness) = model.jnt_stiffness.first().filter(|stiffness| **stiffness != 0.0) {
        reasons.add(format!("{}, the free one, has stiffness {stiffness}, expected 0", root()));
    }
    [("armature", &model.dof_armature), ("damping", &model.dof_damping)].map(|(what, values)| {
        let values: Vec<f64> = values.iter().copied().take(ROOT_DOFS).collect();
        let first = values.first().copied().unwrap_or(0.0);
        if values.iter().any(|value| *value != first) {
            reasons.add(format!("{}, the free one, has {what} {values:?}, expected equal entries", root()));
        }
        first
    })
}

/// The actuator of every joint.
fn actuators(model: &ModelArrays, reasons: &mut Reasons) -> Vec<Option<Actuator>> {
    let mut of_joint: Vec<Option<Actuator>> = vec![None; model.njnt];
    for index in 0..model.nu {
        let called = || model.called(Owner::Actuator, index);
        if model.actuator_ctrlnum.get(index) != Some(&1) || model.actuator_ctrlnum.len() != model.nu {
            reasons.add(format!("{} has other than one control", called()));
            continue;
        }
        // What does not move a joint is refused as another transmission.
        let Some(place) = of_joint.get_mut(model.actuator_trnid[2 * index] as usize) else { continue };
        if model.actuator_trnid[2 * index] == 0 {
            reasons.add(format!("{} moves the free joint", called()));
        } else if let Some(other) = place {
            let other = model.called(Owner::Actuator, other.index);
            reasons.add(format!("{other} and {} move the same joint; it supports one a joint", called()));
        } else {
            *place = reasons.keep(actuator(model, index));
        }
    }
    of_joint
}

fn actuator(model: &ModelArrays, index: usize) -> Result<Actuator, Unsupported> {
    let gear: [f64; 6] = ModelArrays::row(&model.actuator_gear, index);
    let parameters = |array: &[f64]| ModelArrays::vector(&array[array.len() / model.nu * index..], 0);
    let kind = model.actuator_biastype[index];
    let called = || model.called(Owner::Actuator, index);
    if gear[1..].iter().any(|ratio| *ratio != 0.0) {
        return refuse(format!("{} has gear {gear:?}; it supports the first entry alone", called()));
    }
    if kind > AFFINE {
        return refuse(format!(
            "{} has a bias other than an affine one (actuator_biastype = {kind})",
            called()
        ));
    }
    Ok(Actuator {
        index,
        gear: gear[0],
        gain: parameters(&model.actuator_gainprm)[0],
        bias: if kind == AFFINE { parameters(&model.actuator_biasprm) } else { [0.0; 3] },
        ctrl_range: limited(model.actuator_ctrllimited[index], &model.actuator_ctrlrange, index),
        force_range: limited(model.actuator_forcelimited[index], &model.actuator_forcerange, index),
    })
}

/// A range, infinite where it is not active.
fn limited(flag: i32, ranges: &[f64], index: usize) -> [f64; 2] {
    if flag == 0 { [f64::NEG_INFINITY, f64::INFINITY] } else { ModelArrays::row(ranges, index) }
}
