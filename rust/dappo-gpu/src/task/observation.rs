//! Terms of the observation vector.

use cubecl::prelude::*;

use super::plan::{Constant, Observed, Quantity, Task};
use super::random::Stream;
use super::scene::{
    CONTACT_FORCE, Env, Scene, cfrc_ext, command, deviation, foot, foot_number, qpos, qvel, remembered, touch,
};
use crate::math::{lit, sin_cos};

/// Writes what one group of terms observes of an env, from entry `first` of `out` on. `frames` is where its earlier
/// values are in what the env remembers; all of them take the present one if `is_first`.
#[cube]
pub fn observe<F: Float>(
    state: &[F],
    readings: &[F],
    classes: &[F],
    memory: &mut [F],
    out: &mut [f32],
    first: usize,
    env: Env,
    scene: Scene<F>,
    stream: Stream,
    is_first: bool,
    #[comptime] terms: Vec<Observed>,
    #[comptime] purpose: u32,
    #[comptime] frames: usize,
    #[comptime] task: Task,
) {
    #[unroll]
    for k in 0..comptime!(terms.len()) {
        let (term, start) =
            comptime!((terms[k], terms[..k].iter().map(|t| t.history * t.width).sum::<usize>()));
        let draws =
            comptime!(terms[..k].iter().filter(|t| t.noise.get() > 0.0).map(|t| t.width as u32).sum::<u32>());
        let kept = comptime!(frames + terms[..k].iter().map(|t| t.frames * t.width).sum::<usize>());
        #[unroll]
        for i in 0..comptime!(term.width) {
            let value = quantity::<F>(
                state,
                readings,
                classes,
                &*memory,
                env,
                scene,
                comptime!(term.quantity),
                i,
                comptime!(task.clone()),
            );
            let mut entry = f32::cast_from(value);
            if comptime!(term.noise.get() > 0.0) {
                let uniform = stream.uniform::<F>(purpose, comptime!(draws + i as u32).runtime());
                let centred = lit::<F>(2.0) * uniform - lit::<F>(1.0);
                entry += f32::cast_from(lit::<F>(comptime!(term.noise.get())) * centred);
            }
            if comptime!(term.clip.is_some()) {
                let bound = lit::<f32>(comptime!(term.clip.map_or(0.0, Constant::get)));
                entry = min(max(entry, -bound), bound);
            }
            if comptime!(term.scale.get() != 1.0) {
                entry *= lit::<f32>(comptime!(term.scale.get()));
            }
            if comptime!(term.frames == 0) {
                out[first + comptime!(start + i)] = entry;
            } else {
                let place = env.memory + comptime!(kept + i);
                let present = F::cast_from(entry);
                #[unroll]
                for frame in 0..comptime!(term.frames) {
                    let next = memory[place + comptime!((frame + 1).min(term.frames - 1) * term.width)];
                    let is_last = comptime!(frame + 1 == term.frames);
                    let value = select(is_first || is_last, present, next);
                    memory[place + comptime!(frame * term.width)] = value;
                    if comptime!(frame < term.history) {
                        out[first + comptime!(start + frame * term.width + i)] = f32::cast_from(value);
                    }
                }
            }
        }
    }
}

/// Entry `i` of a quantity.
#[cube]
fn quantity<F: Float>(
    state: &[F],
    readings: &[F],
    classes: &[F],
    memory: &[F],
    env: Env,
    scene: Scene<F>,
    #[comptime] quantity: Quantity,
    #[comptime] i: usize,
    #[comptime] task: Task,
) -> F {
    let remember = comptime!(task.plan.memory.clone());
    match quantity {
        Quantity::Qpos { skip } => {
            qpos::<F>(state, memory, env, comptime!(skip + i), comptime!(task.clone()))
        }
        Quantity::Qvel => qvel::<F>(state, env, i, comptime!(task.clone())),
        Quantity::CfrcExt => {
            cfrc_ext::<F>(readings, env, comptime!(i / 6), comptime!(i % 6), comptime!(task.clone()))
        }
        Quantity::Touch => {
            let force = touch::<F>(readings, env, comptime!(task.plan.touches[i]), comptime!(task.clone()));
            let works = classes[scene.class + comptime!(1 + i)] == lit::<F>(0.0);
            select(works && force > lit::<F>(0.0), lit::<F>(1.0), lit::<F>(0.0))
        }
        Quantity::BaseHeight => qpos::<F>(state, memory, env, 2usize, comptime!(task.clone())),
        Quantity::BaseLinVel => component::<F>(scene.lin_vel.x, scene.lin_vel.y, scene.lin_vel.z, i),
        Quantity::BaseAngVel => qvel::<F>(state, env, comptime!(3 + i), comptime!(task.clone())),
        Quantity::ProjectedGravity => component::<F>(scene.gravity.x, scene.gravity.y, scene.gravity.z, i),
        Quantity::Command => command::<F>(memory, env, i, comptime!(task.clone())),
        Quantity::JointPos => {
            let position = deviation::<F>(state, env, i, comptime!(task.clone()));
            if comptime!(task.plan.events.encoder_bias.is_some()) {
                let at = comptime!(remember.events.start + task.plan.encoders() + i);
                position + remembered::<F>(memory, env, at)
            } else {
                position
            }
        }
        Quantity::JointVel => {
            qvel::<F>(state, env, comptime!(task.plan.actuators[i].dof), comptime!(task.clone()))
        }
        Quantity::LastAction => remembered::<F>(memory, env, comptime!(remember.actions.start + i)),
        Quantity::Clock { period } => {
            let rate = comptime!(std::f64::consts::TAU * task.plan.dt.get() / period.get());
            let phase = sin_cos::<F>(F::cast_from(scene.step) * lit::<F>(rate));
            if comptime!(i == 0) { phase.sin } else { phase.cos }
        }
        Quantity::FootContact => {
            let force = foot_number::<F>(memory, env, i, comptime!(foot::FORCE), comptime!(task.clone()));
            select(force > lit::<F>(CONTACT_FORCE), lit::<F>(1.0), lit::<F>(0.0))
        }
        Quantity::FootVel => {
            let number = comptime!(foot::VELOCITY + i % 3);
            foot_number::<F>(memory, env, comptime!(i / 3), number, comptime!(task.clone()))
        }
        Quantity::FootHeight => {
            foot_number::<F>(memory, env, i, comptime!(foot::POSITION + 2), comptime!(task.clone()))
        }
        Quantity::FootAirTime => {
            foot_number::<F>(memory, env, i, comptime!(foot::AIR_TIME), comptime!(task.clone()))
        }
        Quantity::Events => remembered::<F>(memory, env, comptime!(remember.events.start + i)),
    }
}

#[cube]
fn component<F: Float>(x: F, y: F, z: F, #[comptime] i: usize) -> F {
    if comptime!(i == 0) {
        x
    } else if comptime!(i == 1) {
        y
    } else {
        z
    }
}
