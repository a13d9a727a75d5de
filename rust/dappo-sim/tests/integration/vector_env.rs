//! The vector env over a backend without physics, so that every number it returns is known.

use crate::counter::{CODE, Counter, ROBOT, ROW};
use dappo_sim::curriculum::{ClassDistribution, ClassMix, Strata};
use dappo_sim::vector_env::{DamageCourse, ResetOptions, StepRange};
use dappo_sim::{Autoreset, DamageSpace, Robot, SimError, VectorEnv, VectorEnvConfig};

/// Damage that stays, from one of these steps on.
fn course(first: usize, last: usize) -> DamageCourse {
    DamageCourse { onset: StepRange { first, last }, ..DamageCourse::default() }
}

fn space() -> DamageSpace {
    DamageSpace::new(4, vec!["jammed_joint".into(), "missing_toe".into()], 2).unwrap()
}

fn config(envs: usize, autoreset: Autoreset) -> VectorEnvConfig {
    VectorEnvConfig {
        keys: (0..envs as u64).map(|env| 1000 + env).collect(),
        observe_damage: true,
        autoreset,
        max_episode_steps: 3,
        classes: ClassDistribution::uniform(33),
        min_class_steps: 0,
        course: DamageCourse::default(),
    }
}

fn counter(envs: usize, table: usize) -> Box<Counter> {
    Box::new(Counter::new(&Robot::from_toml(ROBOT).unwrap(), envs, table))
}

fn make(config: VectorEnvConfig) -> Result<VectorEnv, SimError> {
    VectorEnv::new(counter(config.keys.len(), 33), &space(), config)
}

fn started(config: VectorEnvConfig) -> VectorEnv {
    let mut env = make(config).unwrap();
    env.reset(ResetOptions::default()).unwrap();
    env
}

/// The observation of an env without its code: episode, step, class.
fn counts(env: &VectorEnv, index: usize) -> [f32; 3] {
    let at = index * env.obs_dim();
    env.buffers().obs[at..at + 3].try_into().unwrap()
}

fn code(env: &VectorEnv, index: usize) -> Vec<f32> {
    env.buffers().obs[index * env.obs_dim() + ROW..(index + 1) * env.obs_dim()].to_vec()
}

/// Reward 1 and no fall in each of two envs.
const WALK: [f32; 4] = [1.0, 0.0, 1.0, 0.0];
/// As `WALK`, but the first env falls.
const FALL: [f32; 4] = [1.0, 1.0, 1.0, 0.0];

#[test]
fn next_step_mode_spends_one_step_on_the_reset() {
    let mut env = started(config(2, Autoreset::NextStep));
    env.step(&FALL).unwrap();
    assert_eq!(env.buffers().terminated, [true, false]);
    assert_eq!(env.buffers().rewards, [1.0, 1.0]);
    assert_eq!((counts(&env, 0)[..2].to_vec(), env.buffers().episode_step[0]), (vec![0.0, 1.0], 1));

    env.step(&FALL).unwrap();
    assert_eq!(env.buffers().terminated, [false, false]);
    assert_eq!(env.buffers().rewards, [0.0, 1.0]);
    assert_eq!(counts(&env, 0)[..2], [1.0, 0.0]);
    assert_eq!((&env.buffers().episode_step[..], env.buffers().forward_velocity[0]), (&[0, 2][..], 0.0));

    env.step(&WALK).unwrap();
    assert_eq!(counts(&env, 0)[..2], [1.0, 1.0]);
    assert_eq!(
        (&env.buffers().truncated[..], &env.buffers().terminated[..]),
        (&[false, true][..], &[false; 2][..])
    );
}

#[test]
fn same_step_mode_resets_at_once_and_keeps_what_the_reset_overwrites() {
    let mut env = started(config(2, Autoreset::SameStep));
    let class = env.buffers().damage_class[0];
    let last_code = code(&env, 0);
    env.step(&FALL).unwrap();
    let buffers = env.buffers();
    assert_eq!(buffers.terminated, [true, false]);
    assert_eq!(buffers.rewards, [1.0, 1.0]);
    assert_eq!(buffers.final_mask, [true, false]);
    assert_eq!(buffers.final_obs[..3], [0.0, 1.0, class as f32]);
    assert_eq!(buffers.final_obs[3..3 + CODE], last_code);
    assert_eq!((buffers.final_damage_class[0], buffers.final_damage_onset[0]), (class, 0));
    assert_eq!((buffers.final_forward_velocity[0], buffers.forward_velocity[0]), (10.0, 0.0));
    assert_eq!(counts(&env, 0), [1.0, 0.0, env.buffers().damage_class[0] as f32]);
    assert_eq!(code(&env, 0), space().classes()[env.buffers().damage_class[0] as usize].code(4, 2));

    env.step(&WALK).unwrap();
    assert_eq!(env.buffers().final_mask, [false, false]);
    assert_eq!(env.buffers().terminated, [false, false]);
}

#[test]
fn without_autoreset_an_ended_env_stands_still_until_a_masked_reset() {
    let mut env = started(config(2, Autoreset::Disabled));
    env.step(&FALL).unwrap();
    env.step(&WALK).unwrap();
    assert_eq!(env.buffers().terminated, [true, false]);
    assert_eq!(env.buffers().rewards, [0.0, 1.0]);
    assert_eq!([counts(&env, 0)[1], counts(&env, 1)[1]], [1.0, 2.0]);

    let other = counts(&env, 1);
    env.reset(ResetOptions { mask: Some(&[true, false]), ..ResetOptions::default() }).unwrap();
    assert_eq!(env.buffers().terminated, [false, false]);
    assert_eq!(counts(&env, 0)[..2], [1.0, 0.0]);
    assert_eq!((counts(&env, 1), &env.buffers().episode_step[..]), (other, &[0, 2][..]));
    env.step(&WALK).unwrap();
    assert_eq!(env.buffers().rewards, [1.0, 1.0]);
}

#[test]
fn a_damage_whose_step_comes_after_the_end_of_the_episode_has_no_effect() {
    for mode in [Autoreset::Disabled, Autoreset::NextStep] {
        let mut env = make(VectorEnvConfig { course: course(1, 1), ..config(2, mode) }).unwrap();
        let classes = [Some(7), Some(7)];
        env.reset(ResetOptions { classes: Some(&classes), ..ResetOptions::default() }).unwrap();
        env.step(&FALL).unwrap();
        let (ended, healthy) = (counts(&env, 0), code(&env, 0));
        assert_eq!((&env.buffers().damage_class[..], &healthy[..]), (&[0, 0][..], &[0.0; CODE][..]));

        env.step(&WALK).unwrap();
        // The other env walks on, damaged.
        assert_eq!((env.buffers().damage_class[1], counts(&env, 1)), (7, [0.0, 2.0, 7.0]));
        assert_eq!((env.buffers().damage_class[0], code(&env, 0)), (0, healthy));
        match mode {
            Autoreset::Disabled => assert_eq!(counts(&env, 0), ended),
            _ => assert_eq!(counts(&env, 0), [1.0, 0.0, 0.0]),
        }
        assert_eq!(env.snapshot().unwrap().backend.classes, [0, 7]);
    }
}

#[test]
fn a_fall_in_the_last_step_is_both_terminated_and_truncated() {
    let mut env = started(config(2, Autoreset::SameStep));
    env.step(&WALK).unwrap();
    env.step(&WALK).unwrap();
    assert_eq!(env.buffers().truncated, [false, false]);
    env.step(&FALL).unwrap();
    assert_eq!(
        (&env.buffers().terminated[..], &env.buffers().truncated[..]),
        (&[true, false][..], &[true; 2][..])
    );
    assert_eq!(env.buffers().final_mask, [true, true]);
}

#[test]
fn the_damage_strikes_at_its_onset_and_not_before() {
    let settings = VectorEnvConfig { max_episode_steps: 100, ..config(2, Autoreset::SameStep) };
    let mut env = make(settings).unwrap();
    let (classes, onsets) = ([Some(5), Some(5)], [Some(2), Some(0)]);
    env.reset(ResetOptions { classes: Some(&classes), onsets: Some(&onsets), ..ResetOptions::default() })
        .unwrap();
    assert_eq!(
        (&env.buffers().damage_class[..], &env.buffers().damage_onset[..]),
        (&[0, 5][..], &[2, 0][..])
    );
    let damaged = space().classes()[5].code(4, 2);
    for step in 1..=5 {
        env.step(&WALK).unwrap();
        let struck = step > 2;
        assert_eq!(env.buffers().damage_class[0], if struck { 5 } else { 0 }, "step {step}");
        assert_eq!(counts(&env, 0)[2], if struck { 5.0 } else { 0.0 }, "physics of step {step}");
        assert_eq!(
            code(&env, 0),
            if struck { damaged.clone() } else { vec![0.0; CODE] },
            "code of step {step}"
        );
        assert_eq!(code(&env, 1), damaged);
    }
}

#[test]
fn onsets_are_drawn_from_their_whole_range() {
    let settings = VectorEnvConfig { course: course(3, 6), ..config(400, Autoreset::SameStep) };
    let env = started(settings);
    for onset in 3..=6 {
        let count = env.buffers().damage_onset.iter().filter(|&&drawn| drawn == onset).count();
        // Binomial(400, 1/4): mean 100, standard deviation 8.7.
        assert!((60..=140).contains(&count), "onset {onset} was drawn {count} times");
    }
    assert!(env.buffers().damage_onset.iter().all(|onset| (3..=6).contains(onset)));
    assert!(env.buffers().damage_class.iter().all(|&class| class == 0));
}

/// Shares of episodes with no, one and two damaged limbs.
fn shares(env: &VectorEnv) -> [f64; 3] {
    let space = space();
    let mut counts = [0.0; 3];
    for &class in &env.buffers().damage_class {
        counts[space.classes()[class as usize].damages.len()] += 1.0 / env.num_envs() as f64;
    }
    counts
}

/// The share of the env steps that classes with odd ids have, whose robots fall in every step.
fn share_of_odd_classes(min_class_steps: usize) -> f64 {
    let mut env = started(VectorEnvConfig { min_class_steps, ..config(2000, Autoreset::SameStep) });
    let mut odd = 0;
    for _ in 0..30 {
        let falls: Vec<bool> = env.buffers().damage_class.iter().map(|class| class % 2 == 1).collect();
        odd += falls.iter().filter(|fall| **fall).count();
        env.step(&falls.iter().flat_map(|&fall| [1.0, f32::from(u8::from(fall))]).collect::<Vec<_>>())
            .unwrap();
    }
    odd as f64 / (30.0 * 2000.0)
}

#[test]
fn a_class_is_kept_for_its_least_steps() {
    for (min_class_steps, of_odd) in [(0, 1.0), (1, 1.0), (2, 2.0), (3, 3.0)] {
        let share = share_of_odd_classes(min_class_steps);
        // 16 of 33 classes are odd. Episodes of the others have three steps.
        let expected = 16.0 * of_odd / (16.0 * of_odd + 17.0 * 3.0);
        // Four standard deviations of 20 000 draws, and the few episodes that have not ended.
        assert!((share - expected).abs() < 0.02, "{min_class_steps}: {share}, expected {expected}");
    }
}

#[test]
fn a_class_that_a_reset_chose_is_kept_like_a_drawn_one() {
    let settings = VectorEnvConfig { min_class_steps: 3, ..config(400, Autoreset::SameStep) };
    let mut env = started(settings);
    env.reset(ResetOptions { classes: Some(&[Some(7); 400]), ..ResetOptions::default() }).unwrap();
    let fall = [1.0, 1.0].repeat(400);
    for _ in 0..2 {
        env.step(&fall).unwrap();
        assert!(env.buffers().damage_class.iter().all(|&class| class == 7));
    }
    env.step(&fall).unwrap();
    // Binomial(400, 1/33): mean 12, standard deviation 3.4.
    let kept = env.buffers().damage_class.iter().filter(|&&class| class == 7).count();
    assert!(kept < 40, "{kept} of 400 still have the class");
}

#[test]
fn class_draws_follow_the_stage_and_a_new_stage_begins_with_the_next_episode() {
    let healthy = ClassMix::Named("healthy".into()).distribution(&space()).unwrap();
    let mut env = started(VectorEnvConfig { classes: healthy, ..config(4000, Autoreset::SameStep) });
    assert!(env.buffers().damage_class.iter().all(|&class| class == 0));

    // Stage III of the Hexapod's curriculum (Verma et al., 2019).
    let mix = ClassMix::Strata(Strata { healthy: 0.42, single: 0.28, multiple: 0.30 });
    env.set_class_distribution(mix.distribution(&space()).unwrap()).unwrap();
    let walk = [1.0, 0.0].repeat(4000);
    env.step(&walk).unwrap();
    assert!(env.buffers().damage_class.iter().all(|&class| class == 0), "running episodes keep their class");
    env.step(&walk).unwrap();
    env.step(&walk).unwrap();
    let found = shares(&env);
    for (share, expected) in found.iter().zip([0.42, 0.28, 0.30]) {
        // Four standard deviations of a share of 4000 draws are at most 0.032.
        assert!((share - expected).abs() < 0.032, "{found:?}");
    }
}

#[test]
fn an_episode_depends_on_its_key_and_number_alone() {
    let mut many = started(config(6, Autoreset::SameStep));
    let single = VectorEnvConfig { keys: vec![1004], ..config(1, Autoreset::SameStep) };
    let mut single = started(single);
    for _ in 0..20 {
        many.step(&[1.0, 0.0].repeat(6)).unwrap();
        single.step(&[1.0, 0.0]).unwrap();
        assert_eq!(many.buffers().damage_class[4], single.buffers().damage_class[0]);
        assert_eq!(counts(&many, 4), counts(&single, 0));
    }
    // New keys begin at episode 0 again.
    let first: Vec<i64> = started(config(6, Autoreset::SameStep)).buffers().damage_class.clone();
    let keys: Vec<u64> = (1000..1006).collect();
    many.reset(ResetOptions { keys: Some(&keys), ..ResetOptions::default() }).unwrap();
    assert_eq!(many.buffers().damage_class, first);
    assert_eq!(counts(&many, 0)[0], 0.0);
}

#[test]
fn a_restored_env_goes_on_as_the_one_it_was_saved_from() {
    for mode in [Autoreset::NextStep, Autoreset::SameStep, Autoreset::Disabled] {
        let settings = || VectorEnvConfig { course: course(0, 3), ..config(2, mode) };
        let mut original = started(settings());
        // Saved while the first env waits for its reset, where the mode has such a state.
        original.step(&FALL).unwrap();
        let saved = original.snapshot().unwrap();
        let mut copy = make(settings()).unwrap();
        copy.restore(&saved).unwrap();
        assert_eq!(copy.snapshot().unwrap(), saved);
        assert_eq!(copy.buffers().damage_class, original.buffers().damage_class, "{mode:?}");
        for _ in 0..8 {
            original.step(&WALK).unwrap();
            copy.step(&WALK).unwrap();
            assert_eq!(copy.snapshot().unwrap(), original.snapshot().unwrap(), "{mode:?}");
            assert_eq!(copy.buffers().rewards, original.buffers().rewards, "{mode:?}");
        }
        let mut foreign = saved.clone();
        foreign.episodes[1][3] = 33;
        let message = copy.restore(&foreign).unwrap_err().to_string();
        assert!(message.ends_with("an episode has damage class 33, the classes are 0 to 32"), "{message}");
        assert_eq!(
            copy.snapshot().unwrap(),
            original.snapshot().unwrap(),
            "a refused snapshot changes nothing"
        );
        let message = make(config(3, mode)).unwrap().restore(&saved).unwrap_err().to_string();
        assert_eq!(message, "saved episodes has 2 entries, expected 3");
    }
}

#[test]
fn divergences_are_counted_over_the_life_of_an_env_and_end_its_episodes() {
    let diverge = [1.0, 2.0, 1.0, 0.0];
    for mode in [Autoreset::NextStep, Autoreset::SameStep, Autoreset::Disabled] {
        let mut env = started(config(2, mode));
        let saved = env.snapshot().unwrap();
        env.step(&diverge).unwrap();
        assert_eq!((env.diverged(), &env.buffers().terminated[..]), (1, &[true, false][..]), "{mode:?}");
        assert_eq!(env.buffers().diverged, [true, false], "{mode:?}");
        assert_eq!(env.buffers().rewards, [0.0, 1.0], "{mode:?}");
        env.step(&WALK).unwrap();
        assert_eq!(env.diverged(), 1, "counted once, {mode:?}");
        let stands_still = mode == Autoreset::Disabled;
        assert_eq!(env.buffers().diverged, [stands_still, false], "of the last step of the env, {mode:?}");
        env.reset(ResetOptions::default()).unwrap();
        assert_eq!(env.buffers().diverged, [false, false], "{mode:?}");
        env.step(&FALL).unwrap();
        assert_eq!(env.diverged(), 1, "a fall is none, {mode:?}");
        env.restore(&saved).unwrap();
        env.step(&diverge).unwrap();
        assert_eq!(env.diverged(), 2, "no part of a snapshot, {mode:?}");
    }
}

#[test]
fn a_policy_that_is_unaware_of_damage_gets_no_code() {
    let settings = VectorEnvConfig { observe_damage: false, ..config(2, Autoreset::SameStep) };
    let mut env = started(settings);
    assert_eq!((env.obs_dim(), env.code_length(), env.buffers().obs.len()), (ROW, 0, 2 * ROW));
    env.step(&FALL).unwrap();
    assert_eq!(env.buffers().final_obs.len(), 2 * ROW);
    assert_eq!(started(config(2, Autoreset::SameStep)).obs_dim(), ROW + CODE);
}

#[test]
fn a_state_that_is_set_is_observed_with_the_code_kept() {
    let mut env = started(config(1, Autoreset::SameStep));
    let kept = code(&env, 0);
    env.set_state(&[7.0, 8.0, 9.0], &[0.0], false).unwrap();
    assert_eq!((counts(&env, 0), code(&env, 0)), ([7.0, 8.0, 9.0], kept));
    let (mut qpos, mut qvel) = ([0.0; 3], [0.0]);
    env.state(&mut qpos, &mut qvel).unwrap();
    assert_eq!(qpos, [7.0, 8.0, 9.0]);
}

#[test]
fn impossible_settings_are_rejected() {
    let base = || config(2, Autoreset::SameStep);
    let refused = |config: VectorEnvConfig| make(config).err().unwrap().to_string();
    let weights = VectorEnvConfig { classes: ClassDistribution::uniform(9), ..base() };
    assert_eq!(refused(weights), "class weights has 9 entries, expected 33");
    let onset = VectorEnvConfig { course: course(3, 2), ..base() };
    assert_eq!(refused(onset), "onset is (3, 2), expected (first, last) in order, at least 0 and below 2^63");
    let steps = |first, last| Some(StepRange { first, last });
    for (duration, pause, error) in [
        (
            steps(0, 2),
            None,
            "damage_duration is (0, 2), expected (first, last) in order, at least 1 and below 2^63",
        ),
        (
            steps(1, 2),
            steps(3, 2),
            "damage_pause is (3, 2), expected (first, last) in order, at least 1 and below 2^63",
        ),
        (
            None,
            steps(1, 2),
            "damage_pause is set, but damage_duration is not: damage that stays does not return",
        ),
    ] {
        let course = DamageCourse { duration, pause, ..course(0, 0) };
        assert_eq!(refused(VectorEnvConfig { course, ..base() }), error);
    }
    let steps = VectorEnvConfig { max_episode_steps: 0, ..base() };
    assert_eq!(refused(steps), "max_episode_steps must be at least 1, got 0");
    let keys = VectorEnv::new(counter(3, 33), &space(), base()).err().unwrap();
    assert_eq!(keys.to_string(), "keys has 2 entries, expected 3");
    let table = VectorEnv::new(counter(2, 32), &space(), base()).err().unwrap();
    assert_eq!(table.to_string(), "class table has 32 entries, expected 33");
}

#[test]
fn wrong_arguments_are_rejected_and_change_nothing() {
    let mut env = make(config(2, Autoreset::SameStep)).unwrap();
    assert!(env.step(&WALK).unwrap_err().to_string().contains("reset before its first step"));
    assert!(env.set_state(&[0.0; 6], &[0.0; 2], false).unwrap_err().to_string().contains("must be reset"));
    let partly = ResetOptions { mask: Some(&[true, false]), ..ResetOptions::default() };
    assert!(env.reset(partly).unwrap_err().to_string().contains("must reset every env"));
    env.reset(ResetOptions::default()).unwrap();

    let before = env.snapshot().unwrap();
    let message = |result: Result<(), SimError>| result.unwrap_err().to_string();
    assert_eq!(message(env.step(&[0.0; 3])), "actions has 3 entries, expected 4");
    for (bad, shown) in [(f32::NAN, "NaN"), (f32::INFINITY, "inf"), (f32::NEG_INFINITY, "-inf")] {
        let text = message(env.step(&[0.0, 0.0, 0.0, bad]));
        assert!(text.contains("env 1") && text.contains(&format!("component 1 is {shown})")), "{text}");
    }
    let none = ResetOptions::default();
    assert_eq!(
        message(env.reset(ResetOptions { keys: Some(&[1]), ..none })),
        "seeds has 1 entries, expected 2"
    );
    assert_eq!(
        message(env.reset(ResetOptions { mask: Some(&[true]), ..none })),
        "reset mask has 1 entries, expected 2"
    );
    let classes = ResetOptions { classes: Some(&[None]), ..none };
    assert_eq!(message(env.reset(classes)), "damage classes has 1 entries, expected 2");
    let classes = ResetOptions { classes: Some(&[None, Some(33)]), ..none };
    assert_eq!(message(env.reset(classes)), "damage class 33 does not exist; the classes are 0 to 32");
    assert_eq!(
        message(env.reset(ResetOptions { onsets: Some(&[None; 3]), ..none })),
        "onsets has 3 entries, expected 2"
    );
    let weights = env.set_class_distribution(ClassDistribution::uniform(3));
    assert_eq!(message(weights), "class weights has 3 entries, expected 33");
    assert_eq!(env.snapshot().unwrap(), before);
}
