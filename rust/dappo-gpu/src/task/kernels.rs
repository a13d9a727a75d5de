//! The kernels of a task, one thread an env: before and after the physics of a step.

use cubecl::prelude::*;

use super::action::act;
use super::episode::{class_at, class_of_code_at, next_episode, show_code};
use super::events::{draw_command, push};
use super::feet::move_feet;
use super::observation::observe;
use super::plan::Task;
use super::random::purpose;
use super::reset::{give_class, model_of, place};
use super::reward::{has_failed, reward};
use super::scene::{Env, Scene, clock};
use crate::math::lit;

/// Begins the next episode of every env.
///
/// # Shapes
/// - `state`: `[envs, state]`; `readings`: `[envs, readings]`; `ctrl`: `[envs, dofs]`; `memory`: `[envs, row]`
/// - `clocks`: `[envs, LEN]`; `rows`, `placed`: `[envs]`
/// - `classes`: `[classes, class_len]`; `models`: `[models, model_len]`
#[cube(launch_unchecked)]
pub fn begin_episodes<F: Float>(
    state: &mut [F],
    readings: &mut [F],
    ctrl: &mut [F],
    memory: &mut [F],
    clocks: &mut [u32],
    rows: &mut [u32],
    placed: &mut [u32],
    classes: &[F],
    models: &[F],
    envs: usize,
    count: usize,
    #[comptime] task: Task,
) {
    if ABSOLUTE_POS < envs {
        let env = Env::new(ABSOLUTE_POS, comptime!(task.clone()));
        next_episode::<F>(clocks, classes, env, comptime!(task.clone()));
        let class = class_at(&*clocks, env, 0u32);
        let own = (count + ABSOLUTE_POS) as u32;
        place::<F>(
            state,
            readings,
            ctrl,
            memory,
            clocks,
            rows,
            classes,
            models,
            env,
            class,
            own,
            comptime!(task.clone()),
        );
        placed[ABSOLUTE_POS] = 1u32;
    }
}

/// Begins a step: damage strikes or ends, actions become controls, robots are pushed.
///
/// # Shapes
/// - `actions`: `[…, envs, nu]`, those of this step from `first` on
#[cube(launch_unchecked)]
pub fn begin_step<F: Float>(
    state: &mut [F],
    ctrl: &mut [F],
    memory: &mut [F],
    clocks: &mut [u32],
    rows: &mut [u32],
    classes: &[F],
    models: &[F],
    actions: &[f32],
    first: usize,
    envs: usize,
    count: usize,
    #[comptime] task: Task,
) {
    if ABSOLUTE_POS < envs {
        let env = Env::new(ABSOLUTE_POS, comptime!(task.clone()));
        let step = clocks[env.clock + clock::STEP];
        let class = class_at(&*clocks, env, step);
        clocks[env.clock + clock::VARIES] = 0u32;
        if step > 0u32 && class != clocks[env.clock + clock::IN_FORCE] {
            let own = (count + ABSOLUTE_POS) as u32;
            give_class::<F>(
                &*state,
                memory,
                clocks,
                rows,
                classes,
                models,
                env,
                class,
                own,
                comptime!(task.clone()),
            );
        }
        let action = first + ABSOLUTE_POS * comptime!(task.plan.nu());
        act::<F>(actions, action, ctrl, memory, env, comptime!(task.clone()));
        push::<F>(state, memory, &*clocks, env, comptime!(task.clone()));
    }
}

/// What a step shows of an env: reward, velocity along +x and how the episode has ended.
pub const OUTCOME: usize = 3;

/// The ends of an episode, which add up.
pub mod end {
    pub const TERMINATED: f64 = 1.0;
    pub const TRUNCATED: f64 = 2.0;
    pub const DIVERGED: f64 = 4.0;
}

/// `mjMAXVAL`: MuJoCo takes a state or an acceleration with a greater entry for diverged.
const MAX_VALUE: f64 = 1e10;

/// Ends a step: reward, ends and observation; episodes that have ended are followed by their next ones.
///
/// # Shapes
/// - `obs`: `[…, envs, obs]`, those of this step from `next` on; `final_obs`: `[…, envs, obs]`, from `last` on, written
///   where an episode has ended
/// - `outcomes`: `[…, envs, OUTCOME]`, from `shown` on
#[cube(launch_unchecked)]
pub fn end_step<F: Float>(
    state: &mut [F],
    readings: &mut [F],
    ctrl: &mut [F],
    memory: &mut [F],
    clocks: &mut [u32],
    rows: &mut [u32],
    placed: &mut [u32],
    classes: &[F],
    models: &[F],
    obs: &mut [f32],
    final_obs: &mut [f32],
    outcomes: &mut [f32],
    next: usize,
    last: usize,
    shown: usize,
    envs: usize,
    count: usize,
    #[comptime] task: Task,
) {
    if ABSOLUTE_POS < envs {
        let env = Env::new(ABSOLUTE_POS, comptime!(task.clone()));
        let plan = comptime!(task.plan.clone());
        let width = comptime!(plan.obs_len());
        let diverged = has_diverged::<F>(&*state, env, comptime!(task.clone()));
        let before = clocks[env.clock + clock::STEP];
        let class = clocks[env.clock + clock::IN_FORCE];
        let forward_velocity = follow::<F>(state, &*readings, memory, env, comptime!(task.clone()));
        let step = before + 1u32;
        clocks[env.clock + clock::STEP] = step;
        if comptime!(plan.needs_feet()) {
            let model = model_of::<F>(&*memory, classes, env, class, comptime!(task.clone()));
            let numbers = model as usize * comptime!(plan.model_len(task.places.nq()));
            let time = lit::<F>(comptime!(plan.dt.get()));
            move_feet::<F>(&*state, &*readings, models, memory, env, numbers, time, comptime!(task.clone()));
        }
        let scene = Scene::<F>::new(&*state, env, forward_velocity, class, step, comptime!(task.clone()));
        let failed = has_failed::<F>(&*state, &*readings, &*memory, env, scene, comptime!(task.clone()));
        let sum =
            reward::<F>(&*state, &*readings, &*ctrl, &*memory, env, scene, failed, comptime!(task.clone()));
        if comptime!(!plan.memory.total.is_empty()) {
            memory[env.memory + comptime!(plan.memory.total.start)] += lit::<F>(1.0);
        }
        draw_command::<F>(memory, &*clocks, env, comptime!(task.clone()));
        let row = next + ABSOLUTE_POS * width;
        observe_all::<F>(
            &*state,
            &*readings,
            classes,
            memory,
            &*clocks,
            obs,
            row,
            env,
            scene,
            false,
            comptime!(task.clone()),
        );
        show_code::<F>(
            classes,
            obs,
            row + comptime!(width - plan.code),
            class_of_code_at(&*clocks, env, before),
            comptime!(task.clone()),
        );

        let truncated = step >= comptime!(plan.episode.max_steps);
        let terminated = failed || diverged;
        let at = shown + ABSOLUTE_POS * comptime!(OUTCOME);
        let nothing = lit::<f32>(0.0);
        outcomes[at] = select(diverged, nothing, f32::cast_from(sum));
        outcomes[at + 1] = select(diverged, nothing, f32::cast_from(forward_velocity));
        outcomes[at + 2] = select(terminated, lit::<f32>(end::TERMINATED), nothing)
            + select(truncated, lit::<f32>(end::TRUNCATED), nothing)
            + select(diverged, lit::<f32>(end::DIVERGED), nothing);
        clocks[env.clock + clock::VARIES] = 0u32;
        let ended = terminated || truncated;
        placed[ABSOLUTE_POS] = select(ended, 1u32, 0u32);
        if ended {
            let kept = last + ABSOLUTE_POS * width;
            for k in 0..width {
                final_obs[kept + k] = obs[row + k];
            }
            next_episode::<F>(clocks, classes, env, comptime!(task.clone()));
            let class = class_at(&*clocks, env, 0u32);
            let own = (count + ABSOLUTE_POS) as u32;
            place::<F>(
                state,
                readings,
                ctrl,
                memory,
                clocks,
                rows,
                classes,
                models,
                env,
                class,
                own,
                comptime!(task.clone()),
            );
        }
    }
}

/// Observes the robots that have just been placed and whose forces have been computed.
///
/// # Shapes
/// - `obs`: `[…, envs, obs]`, those of this step from `next` on
#[cube(launch_unchecked)]
pub fn observe_placed<F: Float>(
    state: &[F],
    readings: &[F],
    memory: &mut [F],
    clocks: &[u32],
    placed: &[u32],
    classes: &[F],
    models: &[F],
    obs: &mut [f32],
    next: usize,
    envs: usize,
    #[comptime] task: Task,
) {
    if ABSOLUTE_POS < envs {
        if placed[ABSOLUTE_POS] == 1u32 {
            let env = Env::new(ABSOLUTE_POS, comptime!(task.clone()));
            let plan = comptime!(task.plan.clone());
            let width = comptime!(plan.obs_len());
            let class = clocks[env.clock + clock::IN_FORCE];
            let zero = lit::<F>(0.0);
            if comptime!(plan.needs_feet()) {
                let model = model_of::<F>(&*memory, classes, env, class, comptime!(task.clone()));
                let numbers = model as usize * comptime!(plan.model_len(task.places.nq()));
                move_feet::<F>(state, readings, models, memory, env, numbers, zero, comptime!(task.clone()));
            }
            let scene = Scene::<F>::new(state, env, zero, class, 0u32, comptime!(task.clone()));
            let row = next + ABSOLUTE_POS * width;
            observe_all::<F>(
                state,
                readings,
                classes,
                memory,
                clocks,
                obs,
                row,
                env,
                scene,
                true,
                comptime!(task.clone()),
            );
            let known = class_of_code_at(clocks, env, 0u32);
            show_code::<F>(classes, obs, row + comptime!(width - plan.code), known, comptime!(task.clone()));
        }
    }
}

/// Writes what the policy observes, and what the value net is given besides.
#[cube]
fn observe_all<F: Float>(
    state: &[F],
    readings: &[F],
    classes: &[F],
    memory: &mut [F],
    clocks: &[u32],
    obs: &mut [f32],
    row: usize,
    env: Env,
    scene: Scene<F>,
    is_first: bool,
    #[comptime] task: Task,
) {
    let plan = comptime!(task.plan.clone());
    let stream = env.stream_of_step(clocks, scene.step);
    observe::<F>(
        state,
        readings,
        classes,
        memory,
        obs,
        row,
        env,
        scene,
        stream,
        is_first,
        comptime!(plan.policy.clone()),
        comptime!(purpose::OBSERVATION_NOISE),
        comptime!(plan.memory.frames),
        comptime!(task.clone()),
    );
    let kept = comptime!(plan.policy.iter().map(|term| term.frames * term.width).sum::<usize>());
    observe::<F>(
        state,
        readings,
        classes,
        memory,
        obs,
        row + comptime!(plan.policy_len()),
        env,
        scene,
        stream,
        is_first,
        comptime!(plan.critic.clone()),
        comptime!(purpose::PRIVILEGED_NOISE),
        comptime!(plan.memory.frames + kept),
        comptime!(task.clone()),
    );
}

/// Whether a world is beyond what the physics can continue from.
#[cube]
fn has_diverged<F: Float>(state: &[F], env: Env, #[comptime] task: Task) -> bool {
    let mut within = true;
    for k in 0..comptime!(task.places.shape.state()) {
        // Nor is a number that is none below the bound.
        within = within && state[env.state + k].abs() <= lit::<F>(MAX_VALUE);
    }
    !within
}

/// Velocity of the root along +x over the step. Its x and y count from where it is now afterwards, so that single precision
/// does not wear off far away.
#[cube]
fn follow<F: Float>(
    state: &mut [F],
    readings: &[F],
    memory: &mut [F],
    env: Env,
    #[comptime] task: Task,
) -> F {
    let evaluated = env.memory + comptime!(task.plan.evaluated());
    let moved = readings[env.readings] - memory[evaluated];
    memory[evaluated] = readings[env.readings] - state[env.state];
    #[unroll]
    for k in 0..2usize {
        memory[env.memory + comptime!(task.plan.origin() + k)] += state[env.state + k];
        state[env.state + k] = lit::<F>(0.0);
    }
    moved * lit::<F>(comptime!(1.0 / task.plan.dt.get()))
}
