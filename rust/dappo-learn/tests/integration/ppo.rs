//! The learner as a whole: it learns, resuming is bit-identical, it does not depend on threads.

use std::path::PathBuf;

use burn::tensor::Device;
use dappo_learn::Sizes;
use dappo_learn::{LearnError, Ppo, PpoConfig, PpoLosses, Rollout, Schedule, gae};
use dappo_nn::{Gradients, PolicyState};
use dappo_sim::rng::{Purpose, Stream};
use dappo_sim::task::{Image, Reflection, Reflections};

const OBS: usize = 3;
const CODE: usize = 1;
const ACTIONS: usize = 2;
const SIZES: Sizes = Sizes { obs_dim: OBS, privileged: 0, code_length: CODE, action_dim: ACTIONS };

fn small() -> PpoConfig {
    PpoConfig {
        hidden: vec![16, 16],
        minibatch_size: 128,
        value_minibatch_size: 128,
        epochs: 4,
        value_epochs: 3,
        ..PpoConfig::default()
    }
}

fn learner(config: &PpoConfig) -> Ppo {
    Ppo::new(config, SIZES, 7, &Device::flex()).unwrap()
}

/// A mirror that changes the signs of obs₀ and of the second action.
fn mirror() -> Reflections {
    let signs = |signs: &[f32]| {
        Reflection::new(signs.iter().enumerate().map(|(of, &sign)| Image { of, sign }).collect())
    };
    Reflections { obs: signs(&[-1.0, 1.0, 1.0]), action: signs(&[1.0, -1.0]) }
}

/// A bandit: every step is an episode, and the best action is (obs₀, −code) / 2.
fn play(ppo: &Ppo, iteration: u64) -> Rollout {
    play_with(ppo, iteration, |obs| obs)
}

/// The same where obs₀ is what `shown` makes of it.
fn play_with(ppo: &Ppo, iteration: u64, shown: fn(f32) -> f32) -> Rollout {
    let (horizon, envs) = (8, 64);
    let mut stream = Stream::new(11, iteration, Purpose::ActionNoise);
    let networks = ppo.frozen().unwrap();
    let mut rollout = Rollout::new(horizon, envs, ACTIONS, networks.transform().clone());
    for step in 0..horizon {
        let obs: Vec<f32> = (0..envs)
            .flat_map(|_| {
                [shown(2.0 * stream.normal() as f32), 5.0 + stream.normal() as f32, stream.below(2) as f32]
            })
            .collect();
        let noise: Vec<f32> = (0..envs * ACTIONS).map(|_| stream.normal() as f32).collect();
        let decision = networks.act(&obs, &noise, &mut PolicyState::default()).unwrap();
        let reward = |(obs, action): (&[f32], &[f32])| {
            let error = (action[0] - obs[0] / 2.0).powi(2) + (action[1] + obs[2] / 2.0).powi(2);
            -f64::from(error)
        };
        let rewards: Vec<f64> =
            obs.chunks_exact(OBS).zip(decision.actions.chunks_exact(ACTIONS)).map(reward).collect();
        rollout.record_decision(step, &obs, &decision).unwrap();
        rollout.record_outcome(step, &rewards, &[true; 64], &[false; 64]).unwrap();
    }
    rollout
}

fn train(ppo: &mut Ppo) -> (f64, PpoLosses) {
    let rollout = play(ppo, ppo.updates());
    learn(ppo, &rollout)
}

fn learn(ppo: &mut Ppo, rollout: &Rollout) -> (f64, PpoLosses) {
    let targets = gae(rollout, ppo.config().gamma, ppo.config().gae_lambda).unwrap();
    let mean = rollout.rewards.iter().map(|r| f64::from(*r)).sum::<f64>() / rollout.len() as f64;
    (mean, ppo.update(rollout, &targets, 0.0).unwrap())
}

/// Adam's first step has the length of the learning rate for each weight, whatever the gradient is.
#[test]
fn a_linear_schedule_shortens_the_steps_of_both_networks() {
    let once =
        PpoConfig { epochs: 1, value_epochs: 1, minibatch_size: 512, value_minibatch_size: 512, ..small() };
    let moved = |schedule, done| {
        let mut ppo = learner(&PpoConfig { schedule, ..once.clone() });
        let before = ppo.frozen().unwrap();
        let rollout = play(&ppo, 0);
        let targets = gae(&rollout, once.gamma, once.gae_lambda).unwrap();
        let rate = ppo.update(&rollout, &targets, done).unwrap().learning_rate;
        let after = ppo.frozen().unwrap();
        let nets = [(before.policy.net(), after.policy.net()), (before.value(), after.value())];
        let longest = nets.map(|(before, after)| {
            let steps = before.parameters().iter().zip(after.parameters()).map(|(x, y)| (x - y).abs());
            steps.fold(0.0, f32::max)
        });
        (rate, longest)
    };
    let (rate, [policy, value]) = moved(Schedule::Linear, 0.75);
    assert!((rate - once.learning_rate / 4.0).abs() < 1e-12, "{rate}");
    for (step, rate) in [(policy, once.learning_rate), (value, once.value_learning_rate)] {
        assert!((f64::from(step) - rate / 4.0).abs() < 0.01 * rate, "{step} at a rate of {rate}");
    }
    assert_eq!(moved(Schedule::Linear, 0.0), moved(Schedule::Constant, 0.75));
}

/// Everything that a bit could differ in: the next rollout, the normaliser, β and the factor.
fn fingerprint(ppo: &Ppo) -> (Vec<u32>, String) {
    let rollout = play(ppo, 99);
    let numbers = [rollout.means, rollout.values, rollout.log_probs, rollout.actions].concat();
    let bits = numbers.iter().map(|x| x.to_bits()).collect();
    (bits, format!("{:?} {:?} {}", ppo.normalizer(), ppo.adaptation(), ppo.updates()))
}

pub fn temporary(name: &str) -> PathBuf {
    let dir = std::env::temp_dir().join(format!("dappo-learn-{name}-{}", std::process::id()));
    std::fs::create_dir_all(&dir).unwrap();
    dir
}

#[test]
fn the_policy_of_a_continuous_bandit_improves_and_uses_the_code() {
    let config = PpoConfig { learning_rate: 3e-3, ..small() };
    let mut ppo = learner(&config);
    let (first, _) = train(&mut ppo);
    let mut last = (first, None);
    for _ in 0..60 {
        let (mean, losses) = train(&mut ppo);
        last = (mean, Some(losses));
    }
    // The noise alone costs 2 e⁻¹ = 0.74 at the initial variance, ignoring the observation 1 + 1/8 more.
    assert!(first < -1.4, "first mean reward {first}");
    assert!(last.0 > -0.5, "last mean reward {}, losses {:?}", last.0, last.1);
    let obs = [2.0, 5.0, 0.0, 2.0, 5.0, 1.0];
    let actions = ppo.frozen().unwrap().policy.mean_actions(&obs).unwrap();
    assert!((actions[0] - 1.0).abs() < 0.35, "{actions:?}");
    assert!(actions[1] - actions[3] > 0.25, "the code should move the second action by 1/2: {actions:?}");
}

/// With obs₀ > 0 alone, the best action is (obs₀, −code) / 2: in the mirror (−obs₀, code) / 2 with obs₀ < 0.
#[test]
fn a_learner_with_a_mirror_learns_the_side_that_it_has_not_seen() {
    let config = PpoConfig { learning_rate: 3e-3, ..small() };
    let learned = |mirror: Option<Reflections>| {
        let mut ppo = learner(&config).with_mirror(mirror).unwrap();
        for _ in 0..120 {
            let rollout = play_with(&ppo, ppo.updates(), f32::abs);
            learn(&mut ppo, &rollout);
        }
        let networks = ppo.frozen().unwrap();
        let act = |obs0: f32| networks.policy.mean_actions(&[obs0, 5.0, 1.0]).unwrap();
        let values = networks.values(&[2.0, 5.0, 1.0, -2.0, 5.0, 1.0], &PolicyState::default()).unwrap();
        (act(2.0), act(-2.0), values, ppo.normalizer().mean()[0])
    };
    let (seen, other, values, mean) = learned(Some(mirror()));
    assert!((seen[0] - 1.0).abs() < 0.35 && seen[1] < -0.1, "{seen:?}");
    assert!((seen[0] - other[0]).abs() < 1e-5 && (seen[1] + other[1]).abs() < 1e-5, "{seen:?}, {other:?}");
    assert!((values[0] - values[1]).abs() < 1e-5 && mean.abs() < 1e-9, "{values:?}, mean of obs₀ {mean}");
    let (_, other, _, mean) = learned(None);
    assert!(other[0] < 0.3 && other[1] < 0.0 && mean > 1.0, "without the mirror {other:?}, {mean}");
}

#[test]
fn a_mirror_of_another_length_is_refused() {
    let other = Reflections { action: Reflection::default(), ..mirror() };
    let message = learner(&small()).with_mirror(Some(other)).err().unwrap().to_string();
    assert_eq!(message, "action_dim of the reflection has 0 elements, expected 2");
}

#[test]
fn two_updates_equal_one_update_then_saving_loading_and_another_to_the_bit() {
    let config = small();
    let dir = temporary("resume");
    let mut straight = learner(&config);
    train(&mut straight);
    let (_, expected) = train(&mut straight);

    let mut first = learner(&config);
    train(&mut first);
    first.save(&dir).unwrap();
    drop(first);
    let mut resumed = Ppo::load(&dir, &config, &Device::flex()).unwrap();
    let (_, got) = train(&mut resumed);
    assert_eq!(got, expected);
    assert_eq!(fingerprint(&resumed), fingerprint(&straight));

    // A third update depends on Adam's moments and the value batch once more.
    assert_eq!(train(&mut resumed), train(&mut straight));
    std::fs::remove_dir_all(dir).unwrap();
}

#[test]
fn a_learner_saved_before_its_first_update_resumes_too() {
    let dir = temporary("fresh");
    let mut ppo = learner(&small());
    ppo.save(&dir).unwrap();
    let mut resumed = Ppo::load(&dir, &small(), &Device::flex()).unwrap();
    assert_eq!(train(&mut resumed), train(&mut ppo));
    assert_eq!(fingerprint(&resumed), fingerprint(&ppo));
    std::fs::remove_dir_all(dir).unwrap();
}

#[test]
fn a_loaded_learner_acts_the_same() {
    let dir = temporary("evaluate");
    let mut ppo = learner(&small());
    train(&mut ppo);
    ppo.save(&dir).unwrap();
    let loaded = Ppo::load(&dir, &small(), &Device::flex()).unwrap();
    let obs = [0.3, 5.0, 1.0, -2.0, 4.0, 0.0];
    let expected = ppo.frozen().unwrap().policy.mean_actions(&obs).unwrap();
    assert_eq!(loaded.frozen().unwrap().policy.mean_actions(&obs).unwrap(), expected);
    std::fs::remove_dir_all(dir).unwrap();
}

#[test]
fn an_update_does_not_depend_on_the_number_of_threads() {
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut ppo = learner(&small());
            let outcomes = [train(&mut ppo), train(&mut ppo)];
            (outcomes, fingerprint(&ppo))
        })
    };
    assert_eq!(run(1), run(2));
}

#[test]
fn an_update_that_goes_too_far_stops_early_and_raises_the_kl_weight() {
    let config = PpoConfig { learning_rate: 0.05, epochs: 10, ..small() };
    let mut ppo = learner(&config);
    let (_, losses) = train(&mut ppo);
    assert!(losses.kl > 4.0 * config.kl_target, "{losses:?}");
    assert!(losses.epochs_run < 10, "{losses:?}");
    assert_eq!(losses.kl_coef, 1.5);
}

#[test]
fn a_training_that_diverges_says_so_and_leaves_no_network_of_no_use() {
    // A step takes a policy that hardly varies so far that the square of its KL is beyond single precision.
    let config = PpoConfig { initial_log_variance: -40.0, kl_hinge: 1e9, learning_rate: 1.0, ..small() };
    let mut ppo = learner(&config);
    let error = (0..3).find_map(|iteration| {
        let rollout = play(&ppo, iteration);
        let targets = gae(&rollout, 0.9, 0.9).unwrap();
        ppo.update(&rollout, &targets, 0.0).err()
    });
    assert!(matches!(error, Some(LearnError::Diverged { .. })), "{error:?}");
    let message = error.unwrap().to_string();
    assert!(message.starts_with("the training has diverged: "), "{message}");
    assert!(message.contains("expected a finite number"), "{message}");
}

#[test]
fn a_checkpoint_whose_weights_are_not_finite_is_rejected_with_its_path() {
    let dir = temporary("not-finite");
    learner(&small()).save(&dir).unwrap();
    let path = dir.join("value.bpk");
    let mut bytes = std::fs::read(&path).unwrap();
    // The file ends with the last array.
    let end = bytes.len() - 4;
    bytes[end..].copy_from_slice(&f32::NAN.to_le_bytes());
    std::fs::write(path, bytes).unwrap();
    let message = Ppo::load(&dir, &small(), &Device::flex()).err().unwrap().to_string();
    assert!(message.contains("value.bpk") && message.contains("holds NaN, expected finite"), "{message}");
    std::fs::remove_dir_all(dir).unwrap();
}

#[test]
fn checkpoints_of_other_networks_and_missing_files_are_rejected_with_their_path() {
    let dir = temporary("mismatch");
    learner(&small()).save(&dir).unwrap();
    let other = PpoConfig { hidden: vec![8], ..small() };
    let message = Ppo::load(&dir, &other, &Device::flex()).err().unwrap().to_string();
    assert!(message.contains("learner.toml: hidden is [16, 16], expected [8]"), "{message}");
    std::fs::remove_file(dir.join("policy.bpk")).unwrap();
    let message = Ppo::load(&dir, &small(), &Device::flex()).err().unwrap().to_string();
    assert!(message.contains("policy.bpk"), "{message}");
    std::fs::remove_dir_all(dir).unwrap();
}

#[test]
fn a_rollout_of_another_shape_is_rejected_by_name() {
    let mut ppo = learner(&small());
    let mut rollout = play(&ppo, 0);
    let targets = gae(&rollout, 0.9, 0.9).unwrap();
    rollout.action_dim = 1;
    let message = ppo.update(&rollout, &targets, 0.0).unwrap_err().to_string();
    assert!(message.starts_with("actions [T, N, A] has 1024 elements, expected 512"), "{message}");
}

/// In a build with the feature `gpu`; without a Vulkan driver this fails, as a training there would.
#[cfg(feature = "gpu")]
#[test]
fn a_learner_goes_from_the_cpu_to_a_gpu_and_back_and_learns_the_same() {
    let near = |got: f64, expected: f64| {
        assert!((got - expected).abs() < 1e-3 * (1.0 + expected.abs()), "{got}, expected {expected}");
    };
    let dir = temporary("gpu");
    let mut on_cpu = learner(&small());
    train(&mut on_cpu);
    on_cpu.save(&dir).unwrap();
    let mut on_gpu = Ppo::load(&dir, &small(), &dappo_learn::LearnerDevice::Gpu.open().unwrap()).unwrap();
    for iteration in 1..3 {
        let rollout = play(&on_cpu, iteration);
        let targets = gae(&rollout, 0.995, 0.98).unwrap();
        let (expected, got) = (
            on_cpu.update(&rollout, &targets, 0.0).unwrap(),
            on_gpu.update(&rollout, &targets, 0.0).unwrap(),
        );
        near(got.policy_loss, expected.policy_loss);
        near(got.value_loss, expected.value_loss);
        near(got.kl, expected.kl);
    }
    std::fs::remove_dir_all(&dir).unwrap();
    std::fs::create_dir_all(&dir).unwrap();
    on_gpu.save(&dir).unwrap();
    let returned = Ppo::load(&dir, &small(), &Device::flex()).unwrap();
    let (got, expected) = (play(&returned, 9), play(&on_cpu, 9));
    for (got, expected) in [(&got.means, &expected.means), (&got.values, &expected.values)] {
        got.iter().zip(expected).for_each(|(got, expected)| near(f64::from(*got), f64::from(*expected)));
    }
    std::fs::remove_dir_all(dir).unwrap();
}

#[test]
fn three_iterations_with_written_gradients_follow_those_with_burns_autodiff_and_adam() {
    assert_written_follow_recorded(None);
    assert_written_follow_recorded(Some(mirror()));
}

fn assert_written_follow_recorded(mirror: Option<Reflections>) {
    // One pass over the batch: a second would begin where rounding has already moved a ratio across the clip range.
    let config = |gradients| PpoConfig { gradients: Some(gradients), epochs: 1, value_epochs: 1, ..small() };
    let mut written = learner(&config(Gradients::Written)).with_mirror(mirror.clone()).unwrap();
    let mut recorded = learner(&config(Gradients::Recorded)).with_mirror(mirror).unwrap();
    let near = |got: f64, expected: f64| (got - expected).abs() <= 2e-4 * expected.abs().max(1e-2);
    for iteration in 0..3 {
        // Both learn from what the first one did.
        let rollout = play(&written, iteration);
        let targets = gae(&rollout, written.config().gamma, written.config().gae_lambda).unwrap();
        let got = written.update(&rollout, &targets, 0.0).unwrap();
        let expected = recorded.update(&rollout, &targets, 0.0).unwrap();
        for (name, got, expected) in [
            ("policy loss", got.policy_loss, expected.policy_loss),
            ("value loss", got.value_loss, expected.value_loss),
            ("KL divergence", got.kl, expected.kl),
            ("entropy", got.entropy, expected.entropy),
            ("learning rate", got.learning_rate, expected.learning_rate),
        ] {
            assert!(near(got, expected), "iteration {iteration}, {name}: {got}, expected {expected}");
        }
        let [got, expected] = [&written, &recorded].map(|ppo| {
            let networks = ppo.frozen().unwrap();
            let nets =
                [networks.policy.net(), networks.value()].map(|net| net.parameters().to_vec()).concat();
            [nets, networks.log_std().to_vec()].concat()
        });
        assert_eq!(got.len(), expected.len());
        for (got, expected) in got.iter().zip(expected) {
            assert!((got - expected).abs() < 2e-5, "iteration {iteration}: {got}, expected {expected}");
        }
    }
}
