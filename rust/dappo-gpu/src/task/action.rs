//! From actions to controls.

use cubecl::prelude::*;

use super::plan::Task;
use super::scene::Env;
use crate::math::lit;

/// Turns the action of an env, which begins at `action` among all of them, into controls.
#[cube]
pub fn act<F: Float>(
    actions: &[f32],
    action: usize,
    ctrl: &mut [F],
    memory: &mut [F],
    env: Env,
    #[comptime] task: Task,
) {
    let plan = comptime!(task.plan.clone());
    let nu = comptime!(plan.nu());
    #[unroll]
    for k in 0..comptime!(nu) {
        let decided = min(max(actions[action + k], lit::<f32>(-1.0)), lit::<f32>(1.0));
        let mut arrived = F::cast_from(decided);
        if comptime!(!plan.memory.actions.is_empty()) {
            let last = env.memory + comptime!(plan.memory.actions.start + k);
            memory[last + nu] = memory[last];
            memory[last] = arrived;
        }
        if comptime!(!plan.memory.waiting.is_empty()) {
            let present = F::cast_from(decided);
            arrived = delayed::<F>(memory, present, env, k, comptime!(task.clone()));
        }
        let (offset, scale) = comptime!((plan.actuators[k].offset.get(), plan.actuators[k].scale.get()));
        let mut control = lit::<F>(offset) + lit::<F>(scale) * arrived;
        // A servo holds the position that its encoder reads.
        if comptime!(plan.actuators[k].is_position && plan.events.encoder_bias.is_some()) {
            control -= memory[env.memory + comptime!(plan.memory.events.start + plan.encoders() + k)];
        }
        ctrl[env.ctrl + comptime!(task.places.joints[plan.actuators[k].dof - 6])] = control;
    }
}

/// Lets an action of an actuator wait, and returns the one that arrives now.
#[cube]
fn delayed<F: Float>(
    memory: &mut [F],
    present: F,
    env: Env,
    #[comptime] actuator: usize,
    #[comptime] task: Task,
) -> F {
    let plan = comptime!(task.plan.clone());
    let nu = comptime!(plan.nu());
    let longest = comptime!(plan.memory.waiting.len() / nu);
    let delay = u32::cast_from(memory[env.memory + comptime!(plan.memory.events.start + plan.delay())]);
    let first = env.memory + comptime!(plan.memory.waiting.start + actuator);
    let mut arrived = present;
    #[unroll]
    for k in 0..comptime!(longest) {
        let waiting = memory[first + comptime!(k * nu)];
        // The newest waits at the end.
        arrived = select(delay == comptime!((longest - k) as u32), waiting, arrived);
        let next = if comptime!(k + 1 < longest) { memory[first + comptime!((k + 1) * nu)] } else { present };
        memory[first + comptime!(k * nu)] = next;
    }
    arrived
}
