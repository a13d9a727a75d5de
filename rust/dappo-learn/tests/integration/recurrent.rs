//! Recurrent policies.

use burn::tensor::Device;
use dappo_learn::{Ppo, PpoConfig, Rollout, Sizes, gae};
use dappo_nn::PolicyState;
use dappo_sim::rng::{Purpose, Stream};
use dappo_sim::task::{Image, Reflection, Reflections};

use crate::ppo::temporary;

const OBS: usize = 3;
const ACTIONS: usize = 2;

/// A task for a memory: the first step of an episode of four shows a number that the policy is to repeat in the last one,
/// where it observes nothing.
fn recall(ppo: &Ppo, iteration: u64, state: &mut PolicyState) -> (Rollout, f64) {
    let (horizon, envs) = (16, 64);
    let mut stream = Stream::new(12, iteration, Purpose::ActionNoise);
    let networks = ppo.frozen().unwrap();
    let mut rollout =
        Rollout::new(horizon, envs, ACTIONS, networks.transform().clone()).from_state(state.clone());
    let (mut cues, mut sum) = (vec![0.0; envs], 0.0);
    for step in 0..horizon {
        let (is_first, is_last) = (step % 4 == 0, step % 4 == 3);
        let mut obs = Vec::new();
        for cue in &mut cues {
            if is_first {
                *cue = if stream.below(2) == 0 { -0.5_f32 } else { 0.5 };
            }
            obs.extend([if is_first { *cue } else { 0.0 }, f32::from(u8::from(is_last)), 0.0]);
        }
        let noise: Vec<f32> = (0..envs * ACTIONS).map(|_| stream.normal() as f32).collect();
        let decision = networks.act(&obs, &noise, state).unwrap();
        let error = |(cue, mean): (&f32, &[f32])| f64::from((mean[0] - cue).powi(2));
        if is_last {
            sum += cues.iter().zip(decision.means.chunks_exact(ACTIONS)).map(error).sum::<f64>();
        }
        let reward = |(cue, action): (&f32, &[f32])| if is_last { -error((cue, action)) } else { 0.0 };
        let rewards: Vec<f64> = cues.iter().zip(decision.actions.chunks_exact(ACTIONS)).map(reward).collect();
        rollout.record_decision(step, &obs, &decision).unwrap();
        rollout.record_outcome(step, &rewards, &[is_last; 64], &[false; 64]).unwrap();
        if is_last {
            (0..envs).for_each(|env| state.begin(env));
        }
    }
    (rollout, sum / (envs * horizon / 4) as f64)
}

fn recalling(lstm: Option<usize>) -> (Ppo, PolicyState) {
    let config = PpoConfig {
        lstm,
        hidden: vec![16],
        minibatch_size: 256,
        kl_target: 0.03,
        learning_rate: 3e-3,
        ..PpoConfig::default()
    };
    let sizes = Sizes { obs_dim: OBS, privileged: 0, code_length: 0, action_dim: ACTIONS };
    let ppo = Ppo::new(&config, sizes, 3, &Device::flex()).unwrap();
    (ppo, PolicyState::new(64, config.memory()))
}

fn learn_to_recall((ppo, state): &mut (Ppo, PolicyState), updates: usize) -> f64 {
    let mut error = f64::NAN;
    for _ in 0..updates {
        let (rollout, found) = recall(ppo, ppo.updates(), state);
        error = found;
        let targets = gae(&rollout, ppo.config().gamma, ppo.config().gae_lambda).unwrap();
        ppo.update(&rollout, &targets, 0.0).unwrap();
    }
    error
}

#[test]
fn a_recurrent_policy_recalls_what_another_cannot_and_continues_from_its_files() {
    // Without the cue the best repetition is 0, with the mean squared error 1/4.
    let mut without = recalling(None);
    assert!((learn_to_recall(&mut without, 40) - 0.25).abs() < 0.05);
    let mut with = recalling(Some(16));
    let error = learn_to_recall(&mut with, 40);
    assert!(error < 0.05, "{error}");

    let scratch = temporary("recurrent");
    with.0.save(&scratch).unwrap();
    let mut loaded = (Ppo::load(&scratch, with.0.config(), &Device::flex()).unwrap(), with.1.clone());
    assert_eq!(learn_to_recall(&mut loaded, 2), learn_to_recall(&mut with, 2));
    assert_eq!(loaded.0.frozen().unwrap(), with.0.frozen().unwrap());
    for lstm in [None, Some(8)] {
        let other = PpoConfig { lstm, ..with.0.config().clone() };
        let message = Ppo::load(&scratch, &other, &Device::flex()).err().unwrap().to_string();
        assert!(message.contains("lstm is 16, expected"), "{message}");
    }
    std::fs::remove_dir_all(scratch).unwrap();
}

#[test]
fn a_recurrent_policy_that_is_its_own_mirror_image_stays_one() {
    let (ppo, mut state) = recalling(Some(7));
    // The cue and the first action change their signs.
    let signs = |signs: &[f32]| {
        Reflection::new(signs.iter().enumerate().map(|(of, &sign)| Image { of, sign }).collect())
    };
    let mirror = Reflections { obs: signs(&[-1.0, 1.0, 1.0]), action: signs(&[-1.0, 1.0]) };
    let mut ppo = ppo.with_mirror(Some(mirror)).unwrap();
    for _ in 0..3 {
        let (rollout, _) = recall(&ppo, ppo.updates(), &mut state);
        let targets = gae(&rollout, 0.9, 0.9).unwrap();
        ppo.update(&rollout, &targets, 0.0).unwrap();
    }
    let networks = ppo.frozen().unwrap();
    let [mut one, mut other] = [PolicyState::new(1, 7), PolicyState::new(1, 7)];
    for cue in [0.5, 0.0, -0.3] {
        let got = networks.act(&[-cue, 0.0, 0.0], &[0.0; 2], &mut other).unwrap();
        let expected = networks.act(&[cue, 0.0, 0.0], &[0.0; 2], &mut one).unwrap();
        assert!((got.means[0] + expected.means[0]).abs() < 1e-6 && expected.means[0].abs() > 1e-4);
        assert!((got.means[1] - expected.means[1]).abs() < 1e-6);
        assert!((got.values[0] - expected.values[0]).abs() < 1e-5);
    }
}
