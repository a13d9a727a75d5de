//! One env as the terms see it.

use cubecl::prelude::*;

use super::plan::{COMMAND, FOOT, Task};
use super::random::Stream;
use crate::math::{Quat, V3, copied_in_kernels, lit};

/// Where the numbers of an env begin in the buffers of all envs.
#[derive(CubeType, Clone, Copy)]
pub struct Env {
    pub index: usize,
    pub state: usize,
    pub readings: usize,
    pub ctrl: usize,
    pub memory: usize,
    pub clock: usize,
}
copied_in_kernels!(plain: EnvExpand);

/// Places in the whole numbers of an env.
pub mod clock {
    pub const KEY_LOW: usize = 0;
    pub const KEY_HIGH: usize = 1;
    pub const NUMBER_LOW: usize = 2;
    pub const NUMBER_HIGH: usize = 3;
    pub const STEP: usize = 4;
    pub const CLASS: usize = 5;
    /// Steps of the episodes before, back to that which drew the class.
    pub const CLASS_STEPS: usize = 6;
    pub const ONSET: usize = 7;
    pub const DURATION: usize = 8;
    pub const PAUSE: usize = 9;
    pub const CODE_DELAY: usize = 10;
    /// Damage class of the physics.
    pub const IN_FORCE: usize = 11;
    /// Model from which constants of the env's own have to be computed, plus 1; 0 if they need not be.
    pub const VARIES: usize = 12;
    pub const LEN: usize = 13;
}

/// What several terms need.
#[derive(CubeType, Clone, Copy)]
pub struct Scene<F: Float> {
    /// Unit vector of gravity in the root's frame.
    pub gravity: V3<F>,
    /// Linear velocity of the root in its frame.
    pub lin_vel: V3<F>,
    /// Velocity of the root along +x over the step, m/s.
    pub forward_velocity: F,
    /// Row of the active damage class among the numbers of all classes.
    pub class: usize,
    /// Steps of the episode.
    pub step: u32,
}
copied_in_kernels!(SceneExpand);

#[cube]
impl Env {
    pub fn new(index: usize, #[comptime] task: Task) -> Env {
        let shape = comptime!(task.places.shape);
        Env {
            index,
            state: index * comptime!(shape.state()),
            readings: index * comptime!(shape.readings()),
            ctrl: index * comptime!(shape.dofs()),
            memory: index * comptime!(task.plan.row()),
            clock: index * comptime!(clock::LEN),
        }
    }

    /// The random numbers of the env's episode.
    pub fn stream(self, clocks: &[u32]) -> Stream {
        Stream {
            key_low: clocks[self.clock + clock::KEY_LOW],
            key_high: clocks[self.clock + clock::KEY_HIGH],
            episode_low: clocks[self.clock + clock::NUMBER_LOW],
            episode_high: clocks[self.clock + clock::NUMBER_HIGH],
        }
    }

    /// Those of a step of the episode.
    pub fn stream_of_step(self, clocks: &[u32], step: u32) -> Stream {
        Stream {
            key_low: clocks[self.clock + clock::KEY_LOW],
            key_high: clocks[self.clock + clock::KEY_HIGH],
            episode_low: step,
            episode_high: clocks[self.clock + clock::NUMBER_LOW],
        }
    }
}

#[cube]
impl<F: Float> Scene<F> {
    pub fn new(
        state: &[F],
        env: Env,
        forward_velocity: F,
        class: u32,
        step: u32,
        #[comptime] task: Task,
    ) -> Scene<F> {
        let velocity = comptime!(task.places.qvel(0));
        let axes = rotation::<F>(state, env).axes();
        let gravity = V3::<F>::new(lit::<F>(0.0), lit::<F>(0.0), lit::<F>(-1.0));
        let linear = V3::<F>::new(
            state[env.state + velocity],
            state[env.state + comptime!(velocity + 1)],
            state[env.state + comptime!(velocity + 2)],
        );
        Scene::<F> {
            gravity: axes.unrotate(gravity),
            lin_vel: axes.unrotate(linear),
            forward_velocity,
            class: class as usize * comptime!(task.plan.class_len()),
            step,
        }
    }
}

/// Orientation of the root. Noise may have changed the length of its quaternion, which MuJoCo ignores.
#[cube]
pub fn rotation<F: Float>(state: &[F], env: Env) -> Quat<F> {
    let at = env.state + 3usize;
    let vector = V3::<F>::new(state[at + 1], state[at + 2], state[at + 3]);
    Quat::<F> { w: state[at], v: vector }.normalized()
}

/// A position of MuJoCo's qpos.
#[cube]
pub fn qpos<F: Float>(
    state: &[F],
    memory: &[F],
    env: Env,
    #[comptime] index: usize,
    #[comptime] task: Task,
) -> F {
    let counted = state[env.state + comptime!(task.places.qpos(index))];
    if comptime!(index < 2) {
        counted + memory[env.memory + comptime!(task.plan.origin() + index)]
    } else {
        counted
    }
}

/// A velocity of MuJoCo's qvel.
#[cube]
pub fn qvel<F: Float>(state: &[F], env: Env, #[comptime] index: usize, #[comptime] task: Task) -> F {
    state[env.state + comptime!(task.places.qvel(index))]
}

/// A component of the external force on a body: torque, then force.
#[cube]
pub fn cfrc_ext<F: Float>(
    readings: &[F],
    env: Env,
    #[comptime] body: usize,
    #[comptime] component: usize,
    #[comptime] task: Task,
) -> F {
    let mut sum = lit::<F>(0.0);
    #[unroll]
    for part in 0..comptime!(task.places.bodies[body].len()) {
        sum += readings[env.readings + comptime!(task.places.bodies[body][part] + component)];
    }
    sum
}

/// Squared contact force on a body, N².
#[cube]
pub fn contact_square<F: Float>(
    readings: &[F],
    env: Env,
    #[comptime] body: usize,
    #[comptime] task: Task,
) -> F {
    let mut sum = lit::<F>(0.0);
    #[unroll]
    for component in 3..6usize {
        let force = cfrc_ext::<F>(readings, env, body, component, comptime!(task.clone()));
        sum += force * force;
    }
    sum
}

/// What a touch sensor reads.
#[cube]
pub fn touch<F: Float>(readings: &[F], env: Env, #[comptime] sensor: usize, #[comptime] task: Task) -> F {
    let mut sum = lit::<F>(0.0);
    #[unroll]
    for part in 0..comptime!(task.places.touches[sensor].len()) {
        sum += readings[env.readings + comptime!(task.places.touches[sensor][part])];
    }
    sum
}

/// Force of an actuator, N·m.
#[cube]
pub fn actuator_force<F: Float>(
    readings: &[F],
    env: Env,
    #[comptime] actuator: usize,
    #[comptime] task: Task,
) -> F {
    readings[env.readings + comptime!(1 + task.places.joints[task.plan.actuators[actuator].dof - 6])]
}

/// Control of an actuator.
#[cube]
pub fn ctrl<F: Float>(ctrl: &[F], env: Env, #[comptime] actuator: usize, #[comptime] task: Task) -> F {
    ctrl[env.ctrl + comptime!(task.places.joints[task.plan.actuators[actuator].dof - 6])]
}

/// A number that the task remembers.
#[cube]
pub fn remembered<F: Float>(memory: &[F], env: Env, #[comptime] at: usize) -> F {
    memory[env.memory + at]
}

/// A component of the commanded velocity: forward, to the left, rate of turn.
#[cube]
pub fn command<F: Float>(memory: &[F], env: Env, #[comptime] component: usize, #[comptime] task: Task) -> F {
    memory[env.memory + comptime!(task.plan.memory.command.start + component)]
}

/// Commands up to here, m/s and rad/s, are to stand still.
const STANDING: f64 = 0.1;

/// Whether the command is to stand still.
#[cube]
pub fn is_standing_commanded<F: Float>(memory: &[F], env: Env, #[comptime] task: Task) -> bool {
    let mut square = lit::<F>(0.0);
    #[unroll]
    for component in 0..comptime!(COMMAND) {
        let wanted = command::<F>(memory, env, component, comptime!(task.clone()));
        square += wanted * wanted;
    }
    square <= lit::<F>(comptime!(STANDING * STANDING))
}

/// Difference of an actuated joint from the default pose, rad.
#[cube]
pub fn deviation<F: Float>(state: &[F], env: Env, #[comptime] actuator: usize, #[comptime] task: Task) -> F {
    let place = comptime!(task.places.qpos(task.plan.actuators[actuator].qpos));
    state[env.state + place] - lit::<F>(comptime!(task.plan.actuators[actuator].start.get()))
}

/// Numbers of a foot that an env remembers.
pub mod foot {
    pub const POSITION: usize = 0;
    pub const VELOCITY: usize = 3;
    /// Contact force, N.
    pub const FORCE: usize = 6;
    /// Time since it left the floor, s.
    pub const AIR_TIME: usize = 7;
    /// How long it was in the air if it has landed in the last step, s; 0 otherwise.
    pub const LANDED_AFTER: usize = 8;
}

/// Contact force from which a foot counts as touching, N.
pub const CONTACT_FORCE: f64 = 1.0;

/// A number of a foot.
#[cube]
pub fn foot_number<F: Float>(
    memory: &[F],
    env: Env,
    #[comptime] foot: usize,
    #[comptime] number: usize,
    #[comptime] task: Task,
) -> F {
    memory[env.memory + comptime!(task.plan.memory.feet.start + foot * FOOT + number)]
}

/// Squared speed of a foot along the floor, m²/s².
#[cube]
pub fn foot_speed_square<F: Float>(
    memory: &[F],
    env: Env,
    #[comptime] index: usize,
    #[comptime] task: Task,
) -> F {
    let x = foot_number::<F>(memory, env, index, comptime!(foot::VELOCITY), comptime!(task.clone()));
    let y = foot_number::<F>(memory, env, index, comptime!(foot::VELOCITY + 1), comptime!(task.clone()));
    x * x + y * y
}
