//! What of a task the kernels of the backend `warp` compute.

use dappo_sim::SimError;
use dappo_sim::robot::Robot;
use dappo_sim::task::{
    ActionKind, Commands, Curriculum, Events, Measure, ObservationTerm, Quantity, Scale, Variants,
};

/// Refuses a robot whose task has something that the kernels lack.
pub fn check(robot: &Robot, variants: &Variants) -> Result<(), SimError> {
    let mut missing = Vec::new();
    let mut refuse = |condition: bool, what: &str| {
        if condition {
            missing.push(what.to_owned());
        }
    };
    refuse(!matches!(robot.actions.scale, Scale::All(_)), "[actions] scale by pattern");
    refuse(robot.actions.kind != ActionKind::Control, "[actions] type = \"joint_position\"");
    refuse(robot.commands != Commands::default(), "[commands]");
    refuse(robot.events != Events::default(), "[events]");
    refuse(variants.names.iter().any(|name| name == "severity"), "a range of damage.severity");
    refuse(!variants.jams.is_empty(), "damage whose place follows from the onset (at = \"current\")");
    refuse(robot.curriculum != Curriculum::default(), "[curriculum]");
    refuse(robot.reset.keyframe.is_some(), "[reset] keyframe");
    refuse(robot.observation.critic.is_some(), "[observation.critic]");
    refuse(robot.terminations.height.is_none(), "an episode without [terminations] height");
    refuse(robot.terminations.tilt.is_some(), "[terminations.tilt]");
    refuse(robot.terminations.contact.is_some(), "[terminations.contact]");
    refuse(robot.terminations.python.is_some(), "[terminations.python]");
    for term in &robot.observation.policy.terms {
        refuse(
            !is_known(term),
            &format!("the observation term `{}`{}", term.quantity.name(), modifiers(term)),
        );
    }
    for function in robot.reward.functions.values() {
        for term in &function.terms {
            refuse(!is_measured(&term.measure), &format!("the reward term `{}`", term.name));
        }
    }
    if missing.is_empty() {
        return Ok(());
    }
    Err(SimError::Config(format!(
        "robot `{}`: the backend `warp` does not support {}; use --device cpu (device=\"cpu\" in Python)",
        robot.name,
        missing.join(", ")
    )))
}

/// What makes a term that the kernels know one that they do not.
fn modifiers(term: &ObservationTerm) -> &'static str {
    let is_known_plain =
        matches!(term.quantity, Quantity::CfrcExt | Quantity::Qpos { .. } | Quantity::Qvel | Quantity::Touch);
    if is_known_plain { " with noise, clip, scale, delay or history" } else { "" }
}

fn is_known(term: &ObservationTerm) -> bool {
    let ObservationTerm { quantity, noise, clip, scale, delay, history } = term;
    let is_plain = (*noise, *scale, *delay, *history) == (0.0, 1.0, 0, 1);
    is_plain
        && match quantity {
            Quantity::CfrcExt => true,
            Quantity::Qpos { .. } | Quantity::Qvel | Quantity::Touch => clip.is_none(),
            _ => false,
        }
}

fn is_measured(measure: &Measure) -> bool {
    matches!(
        measure,
        Measure::ForwardVelocity
            | Measure::Survive
            | Measure::LimbContacts
            | Measure::CtrlSquared
            | Measure::ContactForcesSquared { .. }
            | Measure::LinkLoadsSquared { .. }
    )
}
