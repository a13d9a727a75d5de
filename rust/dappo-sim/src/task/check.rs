//! What of a compiled robot the terms of its task need.

use super::{Quantity, RewardTerm};
use crate::backend::Layout;
use crate::robot::Robot;

/// Refuses a compiled robot that the terms cannot be computed for.
pub(super) fn check(robot: &Robot, layout: &Layout, rewards: &[RewardTerm]) -> Result<(), String> {
    if layout.nq < 3 {
        return Err(format!("it has {} positions, but the third one is the height of its root", layout.nq));
    }
    if layout.nu == 0 {
        return Err("it has no actuators".into());
    }
    let anatomy = &layout.anatomy;
    let has_joints = anatomy.actuators.len() == layout.nu
        && anatomy.actuators.iter().all(|actuator| actuator.joint.is_some());
    let has_feet = anatomy.feet.first().is_some_and(|feet| !feet.is_empty());
    let needs = |what: String, joints: bool, feet: bool, command: bool| {
        if joints && !has_joints {
            return Err(format!("{what} needs a hinge behind every actuator"));
        }
        if feet && !has_feet {
            return Err(format!("{what} needs an entry `foot` in every [[limbs]]"));
        }
        if command && robot.commands.velocity.is_none() {
            return Err(format!("{what} needs [commands.velocity]"));
        }
        Ok(())
    };
    let critic = robot.observation.critic.iter().flat_map(|critic| &critic.terms);
    for term in robot.observation.policy.terms.iter().chain(critic) {
        let quantity = &term.quantity;
        if let Quantity::Qpos { skip } = quantity
            && *skip >= layout.nq
        {
            return Err(format!(
                "the observation term `qpos` skips {skip} of {} positions; expected fewer",
                layout.nq
            ));
        }
        let joints = matches!(quantity, Quantity::JointPos | Quantity::JointVel);
        let what = format!("the observation term `{}`", quantity.name());
        needs(what, joints, quantity.needs_feet(), *quantity == Quantity::Command)?;
    }
    for RewardTerm { name, measure, .. } in rewards {
        let what = format!("the reward term `{name}`");
        needs(what, measure.needs_joints(), measure.needs_feet(), measure.needs_command())?;
    }
    needs("[events.encoder_bias]".into(), robot.events.encoder_bias.is_some(), false, false)?;
    needs("[events.encoder_fault]".into(), robot.events.encoder_fault.is_some(), false, false)
}
