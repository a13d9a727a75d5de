//! Motion of the feet, which follows from positions and velocities.

use cubecl::prelude::*;

use super::plan::{FOOT, FOOT_LINK, Task};
use super::scene::{CONTACT_FORCE, Env, contact_square, foot, qpos, qvel, rotation};
use crate::math::{Axes, Quat, V3, copied_in_kernels, lit, sin_cos, v3_at};

/// A moving frame, along the world's axes.
#[derive(CubeType, CubeTypeMut, Clone, Copy)]
struct Frame<F: Float> {
    origin: V3<F>,
    orientation: Quat<F>,
    velocity: V3<F>,
    angular_velocity: V3<F>,
}
copied_in_kernels!(FrameExpand);

/// Takes up where the feet are after a step of `time` seconds. `model` is where the numbers of the env's model begin.
#[cube]
pub fn move_feet<F: Float>(
    state: &[F],
    readings: &[F],
    models: &[F],
    memory: &mut [F],
    env: Env,
    model: usize,
    time: F,
    #[comptime] task: Task,
) {
    let (nq, start) = comptime!((task.places.nq(), task.plan.memory.feet.start));
    let orientation = rotation::<F>(state, env);
    let own = V3::<F>::new(
        qvel::<F>(state, env, 3usize, comptime!(task.clone())),
        qvel::<F>(state, env, 4usize, comptime!(task.clone())),
        qvel::<F>(state, env, 5usize, comptime!(task.clone())),
    );
    let root = Frame::<F> {
        origin: V3::<F>::new(
            qpos::<F>(state, &*memory, env, 0usize, comptime!(task.clone())),
            qpos::<F>(state, &*memory, env, 1usize, comptime!(task.clone())),
            qpos::<F>(state, &*memory, env, 2usize, comptime!(task.clone())),
        ),
        orientation,
        velocity: v3_at::<F>(state, env.state + comptime!(task.places.qvel(0))),
        angular_velocity: orientation.axes().rotate(own),
    };
    #[unroll]
    for index in 0..comptime!(task.plan.feet.len()) {
        let numbers = model + comptime!(task.plan.foot_numbers(nq, index));
        let frame = last_link::<F>(state, models, root, env, numbers, index, comptime!(task.clone()));
        let offset = comptime!(task.plan.feet[index].hinges.len() * FOOT_LINK);
        let arm = frame.orientation.axes().rotate(v3_at::<F>(models, numbers + offset));
        let position = frame.origin + arm;
        let velocity = frame.velocity + frame.angular_velocity.cross(arm);
        let body = comptime!(task.plan.feet[index].body);
        let force = contact_square::<F>(readings, env, body, comptime!(task.clone())).sqrt();
        let row = env.memory + comptime!(start + index * FOOT);
        memory[row + foot::POSITION] = position.x;
        memory[row + comptime!(foot::POSITION + 1)] = position.y;
        memory[row + comptime!(foot::POSITION + 2)] = position.z;
        memory[row + foot::VELOCITY] = velocity.x;
        memory[row + comptime!(foot::VELOCITY + 1)] = velocity.y;
        memory[row + comptime!(foot::VELOCITY + 2)] = velocity.z;
        memory[row + foot::FORCE] = force;
        let in_contact = force > lit::<F>(CONTACT_FORCE);
        let air_time = memory[row + foot::AIR_TIME];
        memory[row + foot::LANDED_AFTER] = select(in_contact, air_time, lit::<F>(0.0));
        memory[row + foot::AIR_TIME] = select(in_contact, lit::<F>(0.0), air_time + time);
    }
}

/// The frame of the body that carries a foot.
#[cube]
fn last_link<F: Float>(
    state: &[F],
    models: &[F],
    root: Frame<F>,
    env: Env,
    numbers: usize,
    #[comptime] index: usize,
    #[comptime] task: Task,
) -> Frame<F> {
    let mut origin = Array::<F>::new(3usize);
    let mut turn = Array::<F>::new(4usize);
    let mut velocity = Array::<F>::new(3usize);
    let mut spin = Array::<F>::new(3usize);
    keep3::<F>(&mut origin, root.origin);
    keep4::<F>(&mut turn, root.orientation);
    keep3::<F>(&mut velocity, root.velocity);
    keep3::<F>(&mut spin, root.angular_velocity);
    #[unroll]
    for link in 0..comptime!(task.plan.feet[index].hinges.len()) {
        let at = numbers + comptime!(link * FOOT_LINK);
        let parent = quaternion::<F>(&turn).axes();
        let omega = kept3::<F>(&spin);
        let arm = parent.rotate(v3_at::<F>(models, at));
        let place = kept3::<F>(&origin) + arm;
        let motion = kept3::<F>(&velocity) + omega.cross(arm);
        let vector = v3_at::<F>(models, at + 4usize);
        let fixed = quaternion::<F>(&turn).times(Quat::<F> { w: models[at + 3], v: vector });
        if comptime!(task.plan.feet[index].hinges[link].is_some()) {
            let hinge = comptime!(task.plan.feet[index].hinges[link].unwrap_or(7));
            let axis = v3_at::<F>(models, at + 7usize);
            let anchor = v3_at::<F>(models, at + 10usize);
            let angle = state[env.state + comptime!(task.places.qpos(hinge))] - models[at + 13];
            let half = sin_cos::<F>(angle * lit::<F>(0.5));
            let turned = fixed.times(Quat::<F> { w: half.cos, v: axis * half.sin });
            let axes: Axes<F> = fixed.axes();
            let rate = state[env.state + comptime!(task.places.qvel(hinge - 1))];
            let omega_turned = omega + axes.rotate(axis) * rate;
            // The anchor is where both bodies move alike.
            let out = axes.rotate(anchor);
            let back = turned.axes().rotate(anchor) * lit::<F>(-1.0);
            keep3::<F>(&mut origin, place + out + back);
            keep3::<F>(&mut velocity, motion + omega.cross(out) + omega_turned.cross(back));
            keep3::<F>(&mut spin, omega_turned);
            keep4::<F>(&mut turn, turned);
        } else {
            keep3::<F>(&mut origin, place);
            keep3::<F>(&mut velocity, motion);
            keep4::<F>(&mut turn, fixed);
        }
    }
    Frame::<F> {
        origin: kept3::<F>(&origin),
        orientation: quaternion::<F>(&turn),
        velocity: kept3::<F>(&velocity),
        angular_velocity: kept3::<F>(&spin),
    }
}

#[cube]
fn keep3<F: Float>(array: &mut Array<F>, v: V3<F>) {
    array[0] = v.x;
    array[1] = v.y;
    array[2] = v.z;
}

#[cube]
fn kept3<F: Float>(array: &Array<F>) -> V3<F> {
    V3::<F>::new(array[0], array[1], array[2])
}

#[cube]
fn keep4<F: Float>(array: &mut Array<F>, q: Quat<F>) {
    array[0] = q.w;
    array[1] = q.v.x;
    array[2] = q.v.y;
    array[3] = q.v.z;
}

#[cube]
fn quaternion<F: Float>(array: &Array<F>) -> Quat<F> {
    Quat::<F> { w: array[0], v: V3::<F>::new(array[1], array[2], array[3]) }
}
