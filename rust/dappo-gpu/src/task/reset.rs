//! How robots are placed at the start of an episode, and how damage strikes them.

use cubecl::prelude::*;

use super::events::{draw_command, draw_events};
use super::plan::{JAM, Task};
use super::random::purpose;
use super::scene::{Env, clock};
use crate::math::lit;

/// Gives an env a damage class, whose joints jam where they are.
///
/// `rows`, `[envs]`, says which row of the table of constants the physics of each env has. Those of damage classes and
/// their variants come first, then one row an env, `own`, for envs that have constants of their own.
#[cube]
pub fn give_class<F: Float>(
    state: &[F],
    memory: &mut [F],
    clocks: &mut [u32],
    rows: &mut [u32],
    classes: &[F],
    models: &[F],
    env: Env,
    class: u32,
    own: u32,
    #[comptime] task: Task,
) {
    let plan = comptime!(task.plan.clone());
    let nq = comptime!(task.places.nq());
    clocks[env.clock + clock::IN_FORCE] = class;
    let model = model_of::<F>(&*memory, classes, env, class, comptime!(task.clone()));
    let numbers = model as usize * comptime!(plan.model_len(nq)) + nq;
    #[unroll]
    for jam in 0..comptime!(plan.jams) {
        let at = numbers + comptime!(jam * JAM);
        let place = usize::cast_from(models[at]);
        let position = state[env.state + 7 + place];
        let stopped = min(max(position, models[at + 3]), models[at + 4]);
        let shift = models[at + 1] * (stopped - models[at + 2]);
        memory[env.memory + comptime!(plan.memory.jams.start + jam)] = shift;
    }
    if comptime!(plan.varies()) {
        clocks[env.clock + clock::VARIES] = model + 1u32;
        rows[env.index] = own;
    } else {
        rows[env.index] = model;
    }
}

/// The compiled model of an env with this damage class.
#[cube]
pub fn model_of<F: Float>(memory: &[F], classes: &[F], env: Env, class: u32, #[comptime] task: Task) -> u32 {
    let plan = comptime!(task.plan.clone());
    let at = class as usize * comptime!(plan.class_len()) + comptime!(1 + plan.limbs.len());
    if comptime!(plan.variants > 1) {
        let variant = memory[env.memory + comptime!(plan.memory.variant.start)];
        u32::cast_from(classes[at + usize::cast_from(variant)])
    } else {
        u32::cast_from(classes[at])
    }
}

/// Places a robot at the start of the episode that has just begun: reference pose plus noise, forces at rest.
#[cube]
pub fn place<F: Float>(
    state: &mut [F],
    readings: &mut [F],
    ctrl: &mut [F],
    memory: &mut [F],
    clocks: &mut [u32],
    rows: &mut [u32],
    classes: &[F],
    models: &[F],
    env: Env,
    class: u32,
    own: u32,
    #[comptime] task: Task,
) {
    let plan = comptime!(task.plan.clone());
    let shape = comptime!(task.places.shape);
    let (nq, nv) = comptime!((task.places.nq(), task.places.nv()));
    let stream = env.stream(&*clocks);
    let total = memory[env.memory + comptime!(plan.memory.total.start.min(plan.memory.len))];
    for k in 0..comptime!(plan.row()) {
        memory[env.memory + k] = lit::<F>(0.0);
    }
    if comptime!(!plan.memory.total.is_empty()) {
        memory[env.memory + comptime!(plan.memory.total.start)] = total;
    }
    if comptime!(plan.variants > 1) {
        let bound = comptime!(plan.variants as u32).runtime();
        let variant = F::cast_from(stream.below(comptime!(purpose::VARIANT), 0u32, bound));
        memory[env.memory + comptime!(plan.memory.variant.start)] = variant;
    }
    let model = model_of::<F>(&*memory, classes, env, class, comptime!(task.clone()));
    let numbers = model as usize * comptime!(plan.model_len(nq));
    let compiled = numbers + comptime!(plan.compiled_numbers(nq));
    draw_events::<F>(memory, models, stream, env, compiled, comptime!(task.clone()));
    draw_command::<F>(memory, &*clocks, env, comptime!(task.clone()));

    // Joints that only complete the shape of the robot must not keep what a world that diverged has left in them.
    for k in 0..comptime!(shape.state()) {
        state[env.state + k] = lit::<F>(0.0);
    }
    for k in 0..comptime!(shape.dofs()) {
        ctrl[env.ctrl + k] = lit::<F>(0.0);
    }
    // MuJoCo computes forces on bodies after a step, not after a reset.
    for k in 0..comptime!(shape.readings()) {
        readings[env.readings + k] = lit::<F>(0.0);
    }
    let (spread, speed) = comptime!((plan.qpos_noise.get(), plan.qvel_noise.get()));
    #[unroll]
    for k in 0..comptime!(nq) {
        let mut position = models[numbers + k];
        if comptime!(spread != 0.0) {
            let index = comptime!(k as u32).runtime();
            let uniform = stream.uniform::<F>(comptime!(purpose::INITIAL_STATE), index);
            position += lit::<F>(spread) * (lit::<F>(2.0) * uniform - lit::<F>(1.0));
        }
        if comptime!(k < 2) {
            memory[env.memory + comptime!(plan.origin() + k)] = position;
        } else {
            state[env.state + comptime!(task.places.qpos(k))] = position;
        }
    }
    if comptime!(speed != 0.0) {
        #[unroll]
        for k in 0..comptime!(nv) {
            let (first, index) = comptime!((nq as u32, k as u32));
            let normal =
                stream.normal::<F>(comptime!(purpose::INITIAL_STATE), first.runtime(), index.runtime());
            state[env.state + comptime!(task.places.qvel(k))] = lit::<F>(speed) * normal;
        }
    }
    give_class::<F>(&*state, memory, clocks, rows, classes, models, env, class, own, comptime!(task.clone()));
}
