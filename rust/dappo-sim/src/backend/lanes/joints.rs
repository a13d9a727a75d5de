//! Hinges with their limits and actuators.

use dappo_lanes::Unsupported;
use dappo_lanes::model::{Actuator, Link, Softness};

use super::arrays::ModelArrays;
use super::features::Owner;
use super::refuse::refuse;
use super::softness::softness;
use super::tree::{Hinge, Tree};

/// Degrees of freedom of the root.
const ROOT_DOFS: usize = 6;
/// `mjBIAS_AFFINE`.
const AFFINE: i32 = 1;

/// The links of every limb.
pub(super) fn links(model: &ModelArrays, tree: &Tree) -> Result<Vec<Vec<Link>>, Unsupported> {
    for (what, values) in [("armature", &model.dof_armature), ("damping", &model.dof_damping)] {
        if let Some(value) = values.iter().take(ROOT_DOFS).find(|value| **value != 0.0) {
            let root = model.called(Owner::Joint, 0);
            return refuse(format!("{root}, the free one, has {what} {value}, expected 0"));
        }
    }
    let actuators = actuators(model)?;
    let link = |hinge: &Hinge| link(model, hinge, actuators[hinge.joint]);
    tree.limbs.iter().map(|limb| limb.iter().map(link).collect()).collect()
}

fn link(model: &ModelArrays, hinge: &Hinge, actuator: Option<Actuator>) -> Result<Link, Unsupported> {
    let joint = hinge.joint;
    let dof = model.jnt_dofadr[joint] as usize;
    let range = limited(model.jnt_limited[joint], &model.jnt_range, joint);
    let margin = model.jnt_margin[joint];
    if 2.0 * margin >= range[1] - range[0] {
        let called = model.called(Owner::Joint, joint);
        return refuse(format!("{called} is always near both limits ({range:?}, margin {margin})"));
    }
    Ok(Link {
        offset: hinge.frame.origin,
        axes: hinge.frame.axes,
        zero: model.qpos0[model.jnt_qposadr[joint] as usize],
        inertia: hinge.inertia(),
        armature: model.dof_armature[dof],
        damping: model.dof_damping[dof],
        range,
        margin,
        inverse_weight: model.dof_invweight0[dof],
        dof,
        actuator,
    })
}

/// The one softness of all limits.
pub(super) fn limit_softness(model: &ModelArrays) -> Result<Softness, Unsupported> {
    let parameters = |joint: usize| {
        let solref: [f64; 2] = ModelArrays::row(&model.jnt_solref, joint);
        let solimp: [f64; 5] = ModelArrays::row(&model.jnt_solimp, joint);
        (solref, solimp)
    };
    let limited: Vec<usize> = (0..model.njnt).filter(|&joint| model.jnt_limited[joint] != 0).collect();
    let first = limited.first().copied().unwrap_or(0);
    if let Some(&other) = limited.iter().find(|&&joint| parameters(joint) != parameters(first)) {
        let (one, two) = (model.called(Owner::Joint, first), model.called(Owner::Joint, other));
        return refuse(format!(
            "the limits of {one} and {two} differ in solref or solimp; it supports one for all"
        ));
    }
    let (solref, solimp) = parameters(first);
    softness(solref, solimp, model.timestep)
        .or_else(|why| refuse(format!("{}: {why}", model.called(Owner::Joint, first))))
}

/// The actuator of every joint.
fn actuators(model: &ModelArrays) -> Result<Vec<Option<Actuator>>, Unsupported> {
    let mut of_joint: Vec<Option<Actuator>> = vec![None; model.njnt];
    for index in 0..model.nu {
        let called = || model.called(Owner::Actuator, index);
        if model.actuator_ctrlnum.get(index) != Some(&1) || model.actuator_ctrlnum.len() != model.nu {
            return refuse(format!("{} has other than one control", called()));
        }
        let joint = model.actuator_trnid[2 * index] as usize;
        if joint == 0 {
            return refuse(format!("{} moves the free joint", called()));
        }
        if let Some(other) = of_joint[joint] {
            let other = model.called(Owner::Actuator, other.index);
            return refuse(format!("{other} and {} move the same joint; it supports one a joint", called()));
        }
        of_joint[joint] = Some(actuator(model, index)?);
    }
    Ok(of_joint)
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
