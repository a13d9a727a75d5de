//! What is random about a robot and its world besides damage, and what it is asked to do.

use cubecl::prelude::*;

use super::plan::{COMMAND, Constant, Interval, Plan, Push, Task};
use super::random::{Stream, purpose, steps, within};
use super::scene::{Env, clock};
use crate::math::{lit, sin_cos};

fn bounds(range: Interval) -> [f64; 2] {
    range.map(Constant::get)
}

/// The ranges of the factors of a variation, in its order.
fn factors(plan: &Plan) -> [Option<[f64; 2]>; 6] {
    let events = &plan.events;
    [
        events.friction,
        events.motor_strength,
        events.kp,
        events.kd,
        events.joint_damping,
        events.joint_armature,
    ]
    .map(|range| range.map(bounds))
}

/// Draws everything for an episode. `compiled` is where the numbers of its variant begin among those of the models.
#[cube]
pub fn draw_events<F: Float>(
    memory: &mut [F],
    models: &[F],
    stream: Stream,
    env: Env,
    compiled: usize,
    #[comptime] task: Task,
) {
    let plan = comptime!(task.plan.clone());
    let events = comptime!(plan.events);
    let start = env.memory + comptime!(plan.memory.events.start);
    let tilt = comptime!(events.gravity.map(bounds));
    // Draws come in this order: gravity, factors, encoders, delay, push.
    let after_tilt = comptime!(if tilt.is_some() { 2u32 } else { 0u32 });
    if comptime!(events.varies()) {
        #[unroll]
        for k in 0..6usize {
            let range = comptime!(factors(&plan)[k]);
            if comptime!(range.is_some()) {
                let earlier = comptime!(factors(&plan)[..k].iter().flatten().count() as u32);
                let index = comptime!(after_tilt + earlier).runtime();
                let range = comptime!(range.unwrap_or_default());
                memory[start + k] = within::<F>(stream, comptime!(purpose::EVENTS), index, range);
            } else {
                memory[start + k] = lit::<F>(1.0);
            }
        }
        if comptime!(tilt.is_some()) {
            let range = comptime!(tilt.unwrap_or_default());
            let angle = within::<F>(stream, comptime!(purpose::EVENTS), 0u32, range);
            let all_around = comptime!([0.0, std::f64::consts::TAU]);
            let heading = within::<F>(stream, comptime!(purpose::EVENTS), 1u32, all_around);
            let (angle, heading) = (sin_cos::<F>(angle), sin_cos::<F>(heading));
            memory[start + 6] = angle.sin * heading.cos;
            memory[start + 7] = angle.sin * heading.sin;
            memory[start + 8] = -angle.cos;
        } else {
            memory[start + 6] = lit::<F>(0.0);
            memory[start + 7] = lit::<F>(0.0);
            memory[start + 8] = lit::<F>(-1.0);
        }
    }
    let after_factors = comptime!(after_tilt + factors(&plan).iter().flatten().count() as u32);
    let after_encoders =
        comptime!(after_factors + if events.encoder_bias.is_some() { plan.nu() as u32 } else { 0 });
    if comptime!(events.encoder_bias.is_some()) {
        let range = comptime!(events.encoder_bias.map(bounds).unwrap_or_default());
        #[unroll]
        for k in 0..comptime!(plan.nu()) {
            let index = comptime!(after_factors + k as u32).runtime();
            let bias = within::<F>(stream, comptime!(purpose::EVENTS), index, range);
            memory[start + comptime!(plan.encoders() + k)] = bias;
        }
    }
    if comptime!(events.action_delay.is_some()) {
        let [fewest, most] = comptime!(events.action_delay.unwrap_or_default());
        let index = comptime!(after_encoders).runtime();
        let bound = comptime!(most - fewest + 1).runtime();
        let delay = stream.below(comptime!(purpose::EVENTS), index, bound) + fewest;
        memory[start + comptime!(plan.delay())] = F::cast_from(delay);
    }
    #[unroll]
    for k in 0..comptime!(plan.variant_numbers) {
        memory[start + comptime!(plan.compiled() + k)] = models[compiled + k];
    }
    if comptime!(events.push.is_some()) {
        let every = comptime!(events.push.map(|push| bounds(push.every)).unwrap_or_default());
        let after_delay = comptime!(after_encoders + u32::from(events.action_delay.is_some()));
        let time = within::<F>(stream, comptime!(purpose::EVENTS), comptime!(after_delay).runtime(), every);
        let first = F::cast_from(steps::<F>(time, comptime!(plan.dt.get())));
        memory[start + comptime!(plan.push())] = first;
    }
}

/// Changes the velocity of the root if it is time to, linear along the world's axes, angular along its own.
#[cube]
pub fn push<F: Float>(state: &mut [F], memory: &mut [F], clocks: &[u32], env: Env, #[comptime] task: Task) {
    if comptime!(task.plan.events.push.is_some()) {
        let push: Option<Push> = comptime!(task.plan.events.push);
        let step = clocks[env.clock + clock::STEP];
        let at = env.memory + comptime!(task.plan.memory.events.start + task.plan.push());
        if step >= u32::cast_from(memory[at]) {
            let every = comptime!(push.map(|push| bounds(push.every)).unwrap_or_default());
            let linear = comptime!(push.map_or(0.0, |push| push.lin_vel.get()));
            let angular = comptime!(push.map_or(0.0, |push| push.ang_vel.get()));
            let stream = env.stream_of_step(clocks, step);
            let time = within::<F>(stream, comptime!(purpose::PUSH), 0u32, every);
            memory[at] += F::cast_from(steps::<F>(time, comptime!(task.plan.dt.get())));
            let velocity = env.state + comptime!(task.places.qvel(0));
            #[unroll]
            for k in 0..5usize {
                // x and y, then the three angular velocities.
                let half = comptime!(if k < 2 { linear } else { angular });
                let index = comptime!(1 + k as u32).runtime();
                let change = within::<F>(stream, comptime!(purpose::PUSH), index, comptime!([-half, half]));
                state[velocity + comptime!(if k < 2 { k } else { k + 1 })] += change;
            }
        }
    }
}

/// Draws the command if it is time to.
#[cube]
pub fn draw_command<F: Float>(memory: &mut [F], clocks: &[u32], env: Env, #[comptime] task: Task) {
    if comptime!(task.plan.command.is_some()) {
        let slot = env.memory + comptime!(task.plan.memory.command.start);
        let step = clocks[env.clock + clock::STEP];
        if step >= u32::cast_from(memory[slot + comptime!(COMMAND)]) {
            let ranges = comptime!(
                task.plan
                    .command
                    .map(|command| [command.lin_vel_x, command.lin_vel_y, command.ang_vel_z].map(bounds))
                    .unwrap_or_default()
            );
            let every = comptime!(
                task.plan.command.map(|command| bounds(command.resample_every)).unwrap_or_default()
            );
            let standing = comptime!(task.plan.command.map_or(0.0, |command| command.standing.get()));
            let stream = env.stream_of_step(clocks, step);
            let duration = within::<F>(stream, comptime!(purpose::COMMAND), 0u32, every);
            let stands = stream.uniform::<F>(comptime!(purpose::COMMAND), 1u32) < lit::<F>(standing);
            let share = share::<F>(&*memory, env, comptime!(task.clone()));
            #[unroll]
            for k in 0..comptime!(COMMAND) {
                let index = comptime!(2 + k as u32).runtime();
                let range = comptime!(ranges[k]);
                let drawn = share * within::<F>(stream, comptime!(purpose::COMMAND), index, range);
                memory[slot + k] = select(stands, lit::<F>(0.0), drawn);
            }
            let next = step + steps::<F>(duration, comptime!(task.plan.dt.get()));
            memory[slot + comptime!(COMMAND)] = F::cast_from(next);
        }
    }
}

/// The share of the ranges of the commands that is reached.
#[cube]
fn share<F: Float>(memory: &[F], env: Env, #[comptime] task: Task) -> F {
    let ramp = comptime!(task.plan.command.and_then(|command| command.ramp));
    if comptime!(ramp.is_some()) {
        let [start, length] = comptime!(ramp.map_or([1.0, 1.0], bounds));
        let total = memory[env.memory + comptime!(task.plan.memory.total.start)];
        let grown = lit::<F>(start) + lit::<F>(comptime!((1.0 - start) / length)) * total;
        min(grown, lit::<F>(1.0))
    } else {
        lit::<F>(1.0)
    }
}
