//! Episodes: when they begin, and which damage class is active.

use cubecl::prelude::*;

use super::plan::Task;
use super::random::purpose;
use super::scene::{Env, clock};

/// Begins the next episode of an env: its number, its damage class, and when that is active.
#[cube]
pub fn next_episode<F: Float>(clocks: &mut [u32], classes: &[F], env: Env, #[comptime] task: Task) {
    let episode = comptime!(task.plan.episode);
    let row = env.clock;
    let number = clocks[row + clock::NUMBER_LOW] + 1u32;
    clocks[row + clock::NUMBER_LOW] = number;
    if number == 0u32 {
        clocks[row + clock::NUMBER_HIGH] += 1u32;
    }
    let stream = env.stream(&*clocks);
    let before = clocks[row + clock::CLASS_STEPS] + clocks[row + clock::STEP];
    if before > 0u32 && before < comptime!(episode.min_class_steps) {
        clocks[row + clock::CLASS_STEPS] = before;
    } else {
        let uniform = stream.uniform::<F>(comptime!(purpose::DAMAGE_CLASS), 0u32);
        clocks[row + clock::CLASS] = class_at_quantile::<F>(classes, uniform, comptime!(task.clone()));
        clocks[row + clock::CLASS_STEPS] = 0u32;
    }
    clocks[row + clock::STEP] = 0u32;
    let onset = comptime!(episode.onset);
    let bound = comptime!(onset[1] - onset[0] + 1);
    let drawn = stream.below(comptime!(purpose::ONSET), 0u32, comptime!(bound).runtime());
    clocks[row + clock::ONSET] = drawn + comptime!(onset[0]);
    if comptime!(episode.duration.is_some()) {
        let duration = comptime!(episode.duration.unwrap_or_default());
        let bound = comptime!(duration[1] - duration[0] + 1);
        let drawn = stream.below(comptime!(purpose::DAMAGE_DURATION), 0u32, comptime!(bound).runtime());
        clocks[row + clock::DURATION] = drawn + comptime!(duration[0]);
    }
    if comptime!(episode.pause.is_some()) {
        let pause = comptime!(episode.pause.unwrap_or_default());
        let bound = comptime!(pause[1] - pause[0] + 1);
        let drawn = stream.below(comptime!(purpose::DAMAGE_DURATION), 1u32, comptime!(bound).runtime());
        clocks[row + clock::PAUSE] = drawn + comptime!(pause[0]);
    }
    let delay = comptime!(episode.code_delay);
    let bound = comptime!(delay[1] - delay[0] + 1);
    let drawn = stream.below(comptime!(purpose::CODE_DELAY), 0u32, comptime!(bound).runtime());
    clocks[row + clock::CODE_DELAY] = drawn + comptime!(delay[0]);
}

/// The damage class at a quantile: the first whose sum of probabilities is above it, or where rounding leaves the last
/// sum below it, the last class of positive probability.
#[cube]
fn class_at_quantile<F: Float>(classes: &[F], quantile: F, #[comptime] task: Task) -> u32 {
    let (count, width) = comptime!((task.plan.classes, task.plan.class_len()));
    let top = classes[comptime!((count as usize - 1) * width)];
    let mut found = 0u32;
    let mut last = 0u32;
    for class in 0..comptime!(count) {
        let sum = classes[class as usize * comptime!(width)];
        found += select(sum <= quantile, 1u32, 0u32);
        last += select(sum < top, 1u32, 0u32);
    }
    select(found < comptime!(count), found, last)
}

/// The damage class that is active in a step of the episode: healthy before the onset and while the robot has recovered.
#[cube]
pub fn class_at(clocks: &[u32], env: Env, step: u32) -> u32 {
    let row = env.clock;
    let onset = clocks[row + clock::ONSET];
    let duration = clocks[row + clock::DURATION];
    let pause = clocks[row + clock::PAUSE];
    // Below the onset this is a large number, which counts for nothing.
    let since = step - onset;
    let period = duration + pause;
    let in_period = select(pause == 0u32, since, since % max(period, 1u32));
    let is_active = step >= onset && (duration == 0u32 || in_period < duration);
    select(is_active, clocks[row + clock::CLASS], 0u32)
}

/// The damage class whose code is observed after a step of the episode.
#[cube]
pub fn class_of_code_at(clocks: &[u32], env: Env, step: u32) -> u32 {
    let delay = clocks[env.clock + clock::CODE_DELAY];
    let class = class_at(clocks, env, step - min(delay, step));
    select(step >= delay, class, 0u32)
}

/// Writes the code of a damage class into an observation, from entry `first` of `out` on.
#[cube]
pub fn show_code<F: Float>(classes: &[F], out: &mut [f32], first: usize, class: u32, #[comptime] task: Task) {
    let start = comptime!(task.plan.class_len() - task.plan.code);
    let row = class as usize * comptime!(task.plan.class_len());
    #[unroll]
    for i in 0..comptime!(task.plan.code) {
        out[first + i] = f32::cast_from(classes[row + comptime!(start + i)]);
    }
}
