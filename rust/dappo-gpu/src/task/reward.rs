//! Terms of the reward, and when an episode has failed.

use cubecl::prelude::*;

use super::plan::{Constant, Measure, Task};
use super::scene::{
    CONTACT_FORCE, Env, Scene, actuator_force, cfrc_ext, command, contact_square, ctrl as control, deviation,
    foot, foot_number, foot_speed_square, is_standing_commanded, qpos, qvel, remembered,
};
use crate::math::{exponential, lit};

/// Whether the episode has failed.
#[cube]
pub fn has_failed<F: Float>(
    state: &[F],
    readings: &[F],
    memory: &[F],
    env: Env,
    scene: Scene<F>,
    #[comptime] task: Task,
) -> bool {
    let limits = comptime!(task.plan.limits.clone());
    let height = qpos::<F>(state, memory, env, 2usize, comptime!(task.clone()));
    let mut failed = false;
    if comptime!(limits.height[0].get() > f64::NEG_INFINITY) {
        failed = failed || height < lit::<F>(comptime!(limits.height[0].get()));
    }
    if comptime!(limits.height[1].get() < f64::INFINITY) {
        failed = failed || height > lit::<F>(comptime!(limits.height[1].get()));
    }
    failed = failed || -scene.gravity.z < lit::<F>(comptime!(limits.cosine.get()));
    #[unroll]
    for index in 0..comptime!(limits.bodies.len()) {
        let square =
            contact_square::<F>(readings, env, comptime!(limits.bodies[index]), comptime!(task.clone()));
        failed = failed || square > lit::<F>(comptime!(limits.force.get().powi(2)));
    }
    failed
}

/// Sum of all terms of the reward.
#[cube]
pub fn reward<F: Float>(
    state: &[F],
    readings: &[F],
    ctrl: &[F],
    memory: &[F],
    env: Env,
    scene: Scene<F>,
    failed: bool,
    #[comptime] task: Task,
) -> F {
    let mut sum = lit::<F>(0.0);
    #[unroll]
    for k in 0..comptime!(task.plan.rewards.len()) {
        let term = comptime!(task.plan.rewards[k]);
        let value = measure::<F>(
            state,
            readings,
            ctrl,
            memory,
            env,
            scene,
            failed,
            comptime!(term.measure),
            comptime!(task.clone()),
        );
        sum += lit::<F>(comptime!(term.weight.get())) * value;
    }
    sum
}

/// Value of a term, without its weight.
#[allow(clippy::too_many_lines, reason = "one short arm a term")]
#[cube]
fn measure<F: Float>(
    state: &[F],
    readings: &[F],
    ctrl: &[F],
    memory: &[F],
    env: Env,
    scene: Scene<F>,
    failed: bool,
    #[comptime] measure: Measure,
    #[comptime] task: Task,
) -> F {
    let zero = lit::<F>(0.0);
    let one = lit::<F>(1.0);
    let (nu, feet) = comptime!((task.plan.nu(), task.plan.feet.len()));
    match measure {
        Measure::ForwardVelocity => scene.forward_velocity,
        Measure::Survive => select(failed, zero, one),
        Measure::Termination => select(failed, one, zero),
        Measure::LimbContacts => limbs_in_contact::<F>(readings, env, comptime!(task.clone())),
        Measure::CtrlSquared => {
            let mut sum = lit::<F>(0.0);
            #[unroll]
            for actuator in 0..comptime!(nu) {
                let value = control::<F>(ctrl, env, actuator, comptime!(task.clone()));
                sum += value * value;
            }
            sum
        }
        Measure::ContactForcesSquared { clip } => {
            let mut sum = lit::<F>(0.0);
            #[unroll]
            for body in 0..comptime!(task.plan.bodies) {
                sum += load::<F>(readings, env, body, comptime!(clip.get()), comptime!(task.clone()));
            }
            sum
        }
        Measure::LinkLoadsSquared { clip } => {
            let mut sum = lit::<F>(0.0);
            #[unroll]
            for body in 0..comptime!(task.plan.bodies) {
                let load = load::<F>(readings, env, body, comptime!(clip.get()), comptime!(task.clone()));
                sum += load * load;
            }
            sum
        }
        Measure::TrackLinVel { std } => {
            let x = scene.lin_vel.x - command::<F>(memory, env, 0usize, comptime!(task.clone()));
            let y = scene.lin_vel.y - command::<F>(memory, env, 1usize, comptime!(task.clone()));
            gaussian::<F>(x * x + y * y, comptime!(std.get()))
        }
        Measure::TrackAngVel { std } => {
            let wanted = command::<F>(memory, env, 2usize, comptime!(task.clone()));
            let error = qvel::<F>(state, env, 5usize, comptime!(task.clone())) - wanted;
            gaussian::<F>(error * error, comptime!(std.get()))
        }
        Measure::Upright { std } => gaussian::<F>(tilt_square::<F>(scene), comptime!(std.get())),
        Measure::TiltSquared => tilt_square::<F>(scene),
        Measure::LinVelZSquared => scene.lin_vel.z * scene.lin_vel.z,
        Measure::AngVelXySquared => {
            let roll = qvel::<F>(state, env, 3usize, comptime!(task.clone()));
            let pitch = qvel::<F>(state, env, 4usize, comptime!(task.clone()));
            roll * roll + pitch * pitch
        }
        Measure::BaseHeightSquared { target } => {
            let height = qpos::<F>(state, memory, env, 2usize, comptime!(task.clone()));
            let error = height - lit::<F>(comptime!(target.get()));
            error * error
        }
        Measure::ActionRateSquared => {
            let start = comptime!(task.plan.memory.actions.start);
            let mut sum = lit::<F>(0.0);
            #[unroll]
            for actuator in 0..comptime!(nu) {
                let now = remembered::<F>(memory, env, comptime!(start + actuator));
                let before = remembered::<F>(memory, env, comptime!(start + nu + actuator));
                sum += (now - before) * (now - before);
            }
            sum
        }
        Measure::TorqueSquared => {
            let mut sum = lit::<F>(0.0);
            #[unroll]
            for actuator in 0..comptime!(nu) {
                let force = actuator_force::<F>(readings, env, actuator, comptime!(task.clone()));
                sum += force * force;
            }
            sum
        }
        Measure::Power => {
            let mut sum = lit::<F>(0.0);
            #[unroll]
            for actuator in 0..comptime!(nu) {
                let dof = comptime!(task.plan.actuators[actuator].dof);
                let force = actuator_force::<F>(readings, env, actuator, comptime!(task.clone()));
                sum += (force * qvel::<F>(state, env, dof, comptime!(task.clone()))).abs();
            }
            sum
        }
        Measure::JointLimits { soft } => {
            let mut sum = lit::<F>(0.0);
            #[unroll]
            for actuator in 0..comptime!(nu) {
                let [low, high] = comptime!(task.plan.actuators[actuator].range.map(Constant::get));
                if comptime!(low.is_finite() && high.is_finite()) {
                    let index = comptime!(task.plan.actuators[actuator].qpos);
                    let position = qpos::<F>(state, memory, env, index, comptime!(task.clone()));
                    let away = (position - lit::<F>(comptime!(f64::midpoint(low, high)))).abs();
                    let allowed = comptime!(0.5 * soft.get() * (high - low));
                    sum += max(away - lit::<F>(allowed), lit::<F>(0.0));
                }
            }
            sum
        }
        Measure::PoseSquared => pose_square::<F>(state, env, comptime!(task.clone())),
        Measure::Pose { std } => {
            let square = pose_square::<F>(state, env, comptime!(task.clone()));
            gaussian::<F>(square * lit::<F>(comptime!(1.0 / nu as f64)), comptime!(std.get()))
        }
        Measure::StandStill => {
            let mut sum = lit::<F>(0.0);
            #[unroll]
            for actuator in 0..comptime!(nu) {
                sum += deviation::<F>(state, env, actuator, comptime!(task.clone())).abs();
            }
            select(is_standing_commanded::<F>(memory, env, comptime!(task.clone())), sum, zero)
        }
        Measure::FeetAirTime { threshold } => {
            let mut sum = lit::<F>(0.0);
            #[unroll]
            for index in 0..comptime!(feet) {
                let number = comptime!(foot::LANDED_AFTER);
                let landed = foot_number::<F>(memory, env, index, number, comptime!(task.clone()));
                sum += select(landed > zero, landed - lit::<F>(comptime!(threshold.get())), zero);
            }
            select(is_standing_commanded::<F>(memory, env, comptime!(task.clone())), zero, sum)
        }
        Measure::FeetSlip => {
            let mut sum = lit::<F>(0.0);
            #[unroll]
            for index in 0..comptime!(feet) {
                let number = comptime!(foot::FORCE);
                let force = foot_number::<F>(memory, env, index, number, comptime!(task.clone()));
                let speed = foot_speed_square::<F>(memory, env, index, comptime!(task.clone()));
                sum += select(force > lit::<F>(CONTACT_FORCE), speed, zero);
            }
            sum
        }
        Measure::FeetClearance { target } => {
            let mut sum = lit::<F>(0.0);
            #[unroll]
            for index in 0..comptime!(feet) {
                let number = comptime!(foot::POSITION + 2);
                let height = foot_number::<F>(memory, env, index, number, comptime!(task.clone()));
                let speed = foot_speed_square::<F>(memory, env, index, comptime!(task.clone())).sqrt();
                sum += (height - lit::<F>(comptime!(target.get()))).abs() * speed;
            }
            sum
        }
        Measure::Landing => {
            let mut sum = lit::<F>(0.0);
            #[unroll]
            for index in 0..comptime!(feet) {
                let (force, landed) = comptime!((foot::FORCE, foot::LANDED_AFTER));
                let force = foot_number::<F>(memory, env, index, force, comptime!(task.clone()));
                let landed = foot_number::<F>(memory, env, index, landed, comptime!(task.clone()));
                sum += select(landed > zero, force, zero);
            }
            sum
        }
    }
}

/// exp(−square / std²).
#[cube]
fn gaussian<F: Float>(square: F, #[comptime] std: f64) -> F {
    exponential::<F>(square * lit::<F>(comptime!(-1.0 / (std * std))))
}

/// Squared sine of the tilt.
#[cube]
fn tilt_square<F: Float>(scene: Scene<F>) -> F {
    scene.gravity.x * scene.gravity.x + scene.gravity.y * scene.gravity.y
}

/// Squared distance of the actuated joints from the default pose, rad².
#[cube]
fn pose_square<F: Float>(state: &[F], env: Env, #[comptime] task: Task) -> F {
    let mut sum = lit::<F>(0.0);
    #[unroll]
    for actuator in 0..comptime!(task.plan.nu()) {
        let away = deviation::<F>(state, env, actuator, comptime!(task.clone()));
        sum += away * away;
    }
    sum
}

/// Sum of the squared, clipped components of the external force on a body.
#[cube]
fn load<F: Float>(
    readings: &[F],
    env: Env,
    #[comptime] body: usize,
    #[comptime] clip: f64,
    #[comptime] task: Task,
) -> F {
    let mut sum = lit::<F>(0.0);
    if comptime!(!task.places.bodies[body].is_empty()) {
        #[unroll]
        for component in 0..6usize {
            let force = cfrc_ext::<F>(readings, env, body, component, comptime!(task.clone())).abs();
            let clipped = min(force, lit::<F>(clip));
            sum += clipped * clipped;
        }
    }
    sum
}

/// Number of limbs one of whose bodies carries an external force.
#[cube]
fn limbs_in_contact<F: Float>(readings: &[F], env: Env, #[comptime] task: Task) -> F {
    let mut count = lit::<F>(0.0);
    #[unroll]
    for limb in 0..comptime!(task.plan.limbs.len()) {
        let mut touched = lit::<F>(0.0);
        #[unroll]
        for k in 0..comptime!(task.plan.limbs[limb].len()) {
            let body = comptime!(task.plan.limbs[limb][k]);
            #[unroll]
            for component in 0..6usize {
                touched += cfrc_ext::<F>(readings, env, body, component, comptime!(task.clone())).abs();
            }
        }
        count += select(touched > lit::<F>(0.0), lit::<F>(1.0), lit::<F>(0.0));
    }
    count
}
