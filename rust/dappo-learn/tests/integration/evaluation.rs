//! Evaluations over a backend without physics: what reaches the policy, and how episodes are counted.

use std::cell::RefCell;

use crate::counter::{CODE, Counter, ROBOT, ROW};
use dappo_learn::config::Config;
use dappo_learn::envs::{EnvFactory, Sizes};
use dappo_learn::evaluate::{Encoding, Evaluation, Policy, evaluate, evaluate_told};
use dappo_learn::{Compute, Simulator};
use dappo_sim::{Backend, DamageSpace, Robot, SimError};

const CLASSES: usize = 33;
const EPISODES: usize = 4;
const STEPS: usize = 3;

struct Factory {
    robot: Robot,
    space: DamageSpace,
}

impl Factory {
    fn new(max_damaged_limbs: usize) -> Self {
        let types = vec!["jammed_joint".into(), "missing_toe".into()];
        let space = DamageSpace::new(4, types, max_damaged_limbs).unwrap();
        Self { robot: Robot::from_toml(ROBOT).unwrap(), space }
    }
}

impl EnvFactory for Factory {
    fn robot(&self) -> &Robot {
        &self.robot
    }

    fn space(&self) -> &DamageSpace {
        &self.space
    }

    fn sizes(&self, _: &Config) -> Result<Sizes, SimError> {
        Ok(Sizes { obs_dim: ROW + CODE, code_length: CODE, action_dim: 2 })
    }

    fn simulator(&self, compute: Compute) -> Simulator {
        Simulator {
            backend: "counter".into(),
            precision: compute.precision.name().into(),
            device: compute.device.name().into(),
            physics: "none".into(),
        }
    }

    fn backend(&self, envs: usize, _: Option<&str>, _: Compute) -> Result<Box<dyn Backend>, SimError> {
        Ok(Box::new(Counter::new(envs, self.space.classes().len())))
    }
}

/// Keeps every observation, and acts on the class and the step that it shows.
struct Recorder<F> {
    act: F,
    /// Length of an observation.
    width: usize,
    seen: RefCell<Vec<Vec<f32>>>,
}

/// An observation: the step of the episode, the class, the code.
struct Seen<'a> {
    step: usize,
    class: usize,
    code: &'a [f32],
}

fn read(row: &[f32]) -> Seen<'_> {
    Seen { step: row[1] as usize, class: row[2] as usize, code: &row[ROW..] }
}

impl<F: Fn(usize, usize) -> [f32; 2]> Recorder<F> {
    fn new(act: F) -> Self {
        Self { act, width: ROW + CODE, seen: RefCell::default() }
    }
}

impl<F: Fn(usize, usize) -> [f32; 2]> Policy for Recorder<F> {
    fn mean_actions(&self, obs: &[f32]) -> dappo_learn::Result<Vec<f32>> {
        self.seen.borrow_mut().push(obs.to_vec());
        Ok(obs
            .chunks_exact(self.width)
            .map(read)
            .flat_map(|seen| (self.act)(seen.class, seen.step))
            .collect())
    }
}

fn config(episodes: usize, observe_damage: bool) -> Config {
    let mut config = Config::default();
    config.evaluation.episodes = episodes;
    config.env.observe_damage = observe_damage;
    config.env.max_episode_steps = Some(STEPS);
    config
}

/// The codes that a policy was shown, `[STEPS][N]`, after a check that all else is the env's.
fn codes_shown(encoding: Encoding, episodes: usize) -> Vec<Vec<Vec<f32>>> {
    let policy = Recorder::new(|_, _| [1.0, 0.0]);
    let config = config(episodes, true);
    evaluate(&policy, &config, encoding, &Factory::new(2), &|| false).unwrap().unwrap();
    let seen = policy.seen.into_inner();
    assert_eq!(seen.len(), STEPS);
    let mut codes = Vec::new();
    for (step, obs) in seen.iter().enumerate() {
        let rows: Vec<Seen<'_>> = obs.chunks_exact(ROW + CODE).map(read).collect();
        assert_eq!(rows.len(), CLASSES * episodes);
        for (env, row) in rows.iter().enumerate() {
            assert_eq!((row.step, row.class), (step, env / episodes), "the env keeps its damage");
        }
        codes.push(rows.iter().map(|row| row.code.to_vec()).collect());
    }
    codes
}

fn code_of(class: usize) -> Vec<f32> {
    Factory::new(2).space.classes()[class].code(4, 2)
}

#[test]
fn a_policy_is_told_the_truth_or_that_nothing_is_damaged() {
    for codes in codes_shown(Encoding::True, EPISODES) {
        for (env, code) in codes.iter().enumerate() {
            assert_eq!(*code, code_of(env / EPISODES));
        }
    }
    for codes in codes_shown(Encoding::Zero, EPISODES) {
        assert!(codes.iter().all(|code| *code == [0.0; CODE]));
    }
}

#[test]
fn a_wrong_code_is_that_of_another_class_and_held_through_the_episode() {
    let shown = codes_shown(Encoding::Wrong, EPISODES);
    assert!(shown.iter().all(|codes| *codes == shown[0]), "held through the episode");
    let valid: Vec<Vec<f32>> = (0..CLASSES).map(code_of).collect();
    let mut told = [0; CLASSES];
    for (env, code) in shown[0].iter().enumerate() {
        let class = valid.iter().position(|valid| valid == code).unwrap();
        assert_ne!(class, env / EPISODES);
        told[class] += 1;
    }
    // 132 uniform draws leave a given class out with probability e⁻⁴, and more than ten of 33 hardly ever.
    assert!(told.iter().filter(|&&count| count > 0).count() > 22, "{told:?}");
    assert!((0..CLASSES).any(|class| {
        let of_class = &shown[0][class * EPISODES..(class + 1) * EPISODES];
        of_class.iter().any(|code| *code != of_class[0])
    }));
}

#[test]
fn a_random_code_changes_every_step() {
    let shown = codes_shown(Encoding::Random, EPISODES);
    let bits: Vec<f32> = shown.iter().flatten().flatten().copied().collect();
    assert!(bits.iter().all(|&bit| bit == 0.0 || bit == 1.0));
    // 3168 fair bits: the mean has the standard deviation 0.5 / √3168 = 0.0089.
    let mean = bits.iter().sum::<f32>() / bits.len() as f32;
    assert!((mean - 0.5).abs() < 4.0 * 0.0089, "{mean}");
    // Two codes of 8 bits are equal with probability 1/256, so that 132 pairs hold more than 6 hardly ever.
    let equal = |left: &[Vec<f32>], right: &[Vec<f32>]| {
        left.iter().zip(right).filter(|(left, right)| left == right).count()
    };
    assert!(equal(&shown[0], &shown[1]) <= 6);
    assert!(equal(&shown[1], &shown[2]) <= 6);
    // Neighbours: the same start state in another class, and another start state in the same class.
    assert!(equal(&shown[0], &shown[0][EPISODES..]) <= 6);
    assert!(equal(&shown[0], &shown[0][1..]) <= 6);
}

#[test]
fn an_episode_is_told_the_same_however_many_others_there_are() {
    for encoding in [Encoding::Wrong, Encoding::Random] {
        let (few, many) = (codes_shown(encoding, 2), codes_shown(encoding, EPISODES));
        for (few, many) in few.iter().zip(&many) {
            for (env, code) in few.iter().enumerate() {
                assert_eq!(*code, many[env / 2 * EPISODES + env % 2]);
            }
        }
    }
}

fn evaluation(act: impl Fn(usize, usize) -> [f32; 2]) -> Evaluation {
    let policy = Recorder::new(act);
    let config = config(EPISODES, true);
    evaluate(&policy, &config, Encoding::True, &Factory::new(2), &|| false).unwrap().unwrap()
}

#[test]
fn falls_and_divergences_are_counted_in_their_own_class_and_once() {
    let found = evaluation(|class, step| match (class, step) {
        // Class 5 falls in its first step, class 3 diverges in its second; what they ask for later is not done.
        (5, 0) => [0.5, 1.0],
        (3 | 5, 1..) => [0.5, 2.0],
        _ => [0.5, 0.0],
    });
    assert_eq!(found.simulator.backend, "counter");
    assert_eq!((found.simulator.precision.as_str(), found.simulator.device.as_str()), ("f64", "cpu"));
    assert_eq!(found.classes.len(), CLASSES);
    for class in &found.classes {
        // Velocities are 10, 20, 30 and rewards 0.5; both are 0 in a step that diverges.
        let expected = match class.class {
            3 => (EPISODES, EPISODES, 10.0, 0.5, 2.0),
            5 => (EPISODES, 0, 10.0, 0.5, 1.0),
            _ => (0, 0, 60.0, 1.5, 3.0),
        };
        let c = class;
        assert_eq!((c.falls, c.diverged, c.forward_reward, c.episode_return, c.episode_length), expected);
        assert_eq!((c.episodes, c.standard_error), (EPISODES, 0.0));
    }
    let all = found.groups.last().unwrap();
    assert_eq!((all.group.as_str(), all.falls, all.diverged), ("all", 2 * EPISODES, EPISODES));
}

#[test]
fn a_policy_that_is_unaware_of_damage_is_told_nothing_else() {
    let unaware = |encoding| {
        let policy = Recorder { width: ROW, ..Recorder::new(|_, _| [1.0, 0.0]) };
        evaluate(&policy, &config(1, false), encoding, &Factory::new(2), &|| false)
    };
    assert!(unaware(Encoding::True).unwrap().is_some());
    for encoding in [Encoding::Zero, Encoding::Wrong, Encoding::Random] {
        let message = unaware(encoding).unwrap_err().to_string();
        let name = encoding.name();
        assert_eq!(
            message,
            format!(
                "the policy does not observe the damage, so that it cannot be given the encoding `{name}`; \
                 expected `true`"
            )
        );
    }
}

#[test]
fn without_another_class_there_is_no_wrong_code() {
    let policy = Recorder::new(|_, _| [1.0, 0.0]);
    let message = evaluate(&policy, &config(1, true), Encoding::Wrong, &Factory::new(0), &|| false)
        .unwrap_err()
        .to_string();
    assert_eq!(message, "the encoding `wrong` needs at least 2 damage classes, the robot has 1");
}

#[test]
fn an_evaluation_that_is_asked_to_stop_has_no_result() {
    let policy = Recorder::new(|_, _| [1.0, 0.0]);
    let asked = RefCell::new(0);
    let stop = || {
        *asked.borrow_mut() += 1;
        *asked.borrow() > 2
    };
    let found = evaluate(&policy, &config(1, true), Encoding::True, &Factory::new(2), &stop).unwrap();
    assert_eq!((found, policy.seen.borrow().len()), (None, 2));
}

#[test]
fn a_policy_can_be_told_any_class_about_any_robot() {
    let policy = Recorder::new(|class, _| [class as f32, 0.0]);
    let pairs = [(5, 0), (0, 7), (5, 5)];
    let rewards =
        evaluate_told(&policy, &config(2, true), &pairs, &Factory::new(2), &|| false).unwrap().unwrap();
    // The counter's forward velocity is ten times the step of the episode.
    assert_eq!(rewards, [60.0; 3]);
    for obs in policy.seen.into_inner() {
        for (env, row) in obs.chunks_exact(ROW + CODE).map(read).enumerate() {
            let (class, told) = pairs[env / 2];
            assert_eq!((row.class, row.code), (class, code_of(told).as_slice()));
        }
    }
}
