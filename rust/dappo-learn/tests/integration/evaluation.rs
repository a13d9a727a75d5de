//! Evaluations over a backend without physics: what reaches the policy, and how episodes are counted.

use std::cell::RefCell;

use crate::counter::{CODE, Counter, ROBOT, ROW};
use crate::run_folder::{create, scratch};
use dappo_learn::Sizes;
use dappo_learn::config::Config;
use dappo_learn::envs::EnvFactory;
use dappo_learn::evaluate::{Conditions, Evaluation, evaluate};
use dappo_learn::run_folder::RunFolder;
use dappo_learn::walk::{Encoding, MeanActions};
use dappo_nn::PolicyState;
use dappo_sim::task::Reflections;
use dappo_sim::{Backend, BackendKind, DamageSpace, Physics, Precision, Robot, Severity, SimError};

pub const CLASSES: usize = 33;
const EPISODES: usize = 4;
pub const STEPS: usize = 3;

pub struct Factory {
    robot: Robot,
    space: DamageSpace,
}

impl Factory {
    pub fn new(max_damaged_limbs: usize) -> Self {
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

    fn sizes(&self, config: &Config) -> Result<Sizes, SimError> {
        let code_length = if config.env.observe_damage { CODE } else { 0 };
        Ok(Sizes { obs_dim: ROW + code_length, privileged: 0, code_length, action_dim: 2 })
    }

    fn mirror(&self, _: &Config) -> Result<Option<Reflections>, SimError> {
        Ok(None)
    }

    fn integrator(&self) -> &'static str {
        "none"
    }

    fn control_period(&self) -> f64 {
        0.01
    }

    fn training_physics(&self) -> Physics {
        Physics::Mujoco
    }

    fn evaluation_physics(&self) -> Physics {
        Physics::Lanes(Precision::F32)
    }

    fn backend(&self, envs: usize, _: Option<&str>, physics: Physics) -> Result<Box<dyn Backend>, SimError> {
        assert_eq!(physics, self.evaluation_physics());
        Ok(Box::new(Counter::new(&self.robot, envs, self.space.classes().len())))
    }
}

/// Keeps every observation, and acts on the class and the step that it shows.
pub struct Recorder<F> {
    pub act: F,
    /// Length of an observation.
    pub width: usize,
    pub seen: RefCell<Vec<Vec<f32>>>,
}

/// An observation: the step of the episode, the class, the code.
pub struct Seen<'a> {
    pub step: usize,
    pub class: usize,
    pub code: &'a [f32],
}

pub fn read(row: &[f32]) -> Seen<'_> {
    Seen { step: row[1] as usize, class: row[2] as usize, code: &row[ROW..] }
}

impl<F: Fn(usize, usize) -> [f32; 2]> Recorder<F> {
    pub fn new(act: F) -> Self {
        Self { act, width: ROW + CODE, seen: RefCell::default() }
    }
}

impl<F: Fn(usize, usize) -> [f32; 2]> MeanActions for Recorder<F> {
    fn mean_actions(&self, obs: &[f32], _: &mut PolicyState) -> dappo_learn::Result<Vec<f32>> {
        self.seen.borrow_mut().push(obs.to_vec());
        Ok(obs
            .chunks_exact(self.width)
            .map(read)
            .flat_map(|seen| (self.act)(seen.class, seen.step))
            .collect())
    }
}

pub fn config(episodes: usize, observe_damage: bool) -> Config {
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

pub fn code_of(class: usize) -> Vec<f32> {
    Factory::new(2).space.classes()[class].code(4, 2)
}

#[test]
fn a_policy_has_the_true_code_or_that_of_no_damage() {
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
    let mut drawn = [0; CLASSES];
    for (env, code) in shown[0].iter().enumerate() {
        let class = valid.iter().position(|valid| valid == code).unwrap();
        assert_ne!(class, env / EPISODES);
        drawn[class] += 1;
    }
    // 132 uniform draws leave a given class out with probability e⁻⁴, and more than ten of 33 hardly ever.
    assert!(drawn.iter().filter(|&&count| count > 0).count() > 22, "{drawn:?}");
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
fn an_episode_has_the_same_codes_however_many_others_there_are() {
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
        // Class 5 falls in its first step, class 3 diverges in its second; their later actions have no
        // effect.
        (5, 0) => [0.5, 1.0],
        (3 | 5, 1..) => [0.5, 2.0],
        _ => [0.5, 0.0],
    });
    assert_eq!(found.simulator.physics, Physics::Lanes(Precision::F32));
    assert_eq!(found.simulator.integrator, "none");
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
        // A step has 0.01 s.
        assert_eq!((c.forward_velocity, c.distance), (expected.2 / expected.4, expected.2 * 0.01));
    }
    let all = found.groups.last().unwrap();
    assert_eq!((all.group.as_str(), all.falls, all.diverged), ("all", 2 * EPISODES, EPISODES));
}

#[test]
fn a_policy_that_is_unaware_of_damage_has_no_other_code() {
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
fn a_stopped_evaluation_has_no_result() {
    let policy = Recorder::new(|_, _| [1.0, 0.0]);
    let calls = RefCell::new(0);
    let stop = || {
        *calls.borrow_mut() += 1;
        *calls.borrow() > 2
    };
    let found = evaluate(&policy, &config(1, true), Encoding::True, &Factory::new(2), &stop).unwrap();
    assert_eq!((found, policy.seen.borrow().len()), (None, 2));
}

#[test]
fn every_encoding_has_a_table_of_its_own() {
    let factory = Factory::new(1);
    let root = scratch("tables");
    let run = create(&root, 0).unwrap();
    for encoding in [Encoding::True, Encoding::Zero] {
        let still = Recorder::new(|_, _| [0.0, 0.0]);
        let found = evaluate(&still, &config(2, true), encoding, &factory, &|| false).unwrap().unwrap();
        found.write(&run.evaluation()).unwrap();
    }
    let mut names: Vec<_> = std::fs::read_dir(root.join("eval"))
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    let tables = ["groups.csv", "groups.zero.csv", "per_class.csv", "per_class.zero.csv"];
    assert_eq!(names, [&["evaluation.json", "evaluation.zero.json"], &tables[..]].concat());
    let table = std::fs::read_to_string(root.join("eval").join("per_class.csv")).unwrap();
    assert_eq!(table.lines().count(), 1 + factory.space().classes().len());
    std::fs::remove_dir_all(&root).unwrap();
}

#[test]
fn an_evaluation_with_other_settings_than_those_of_the_run_has_a_folder_of_its_own() {
    let root = scratch("extra");
    let run = create(&root, 0).unwrap();
    let (_, own) = RunFolder::open(&root).unwrap();
    let folder = |changed: Config| run.evaluation_with(&changed, None).unwrap().path("x");
    assert_eq!(folder(own.clone()), root.join("eval").join("x"));
    // Threads change no episode, and a choice that was left open is none.
    let mut machine = own.clone();
    (machine.env.threads, machine.env.backend) = (Some(3), BackendKind::Lanes);
    assert_eq!(folder(machine), root.join("eval").join("x"));
    let mut other = own;
    (other.evaluation.episodes, other.evaluation.seed, other.evaluation.precision) = (3, 7, Precision::F32);
    assert_eq!(folder(other), root.join("eval").join("episodes-3_precision-f32_seed-7").join("x"));
    std::fs::remove_dir_all(&root).unwrap();
}

#[test]
fn evaluations_of_other_episodes_cannot_stand_beside_each_other() {
    let (one, other) = (Factory::new(1), Factory::new(2));
    let conditions = |config: &Config, factory: &Factory| Conditions::new(config, factory).unwrap();
    let first = conditions(&config(2, true), &one);
    // Neither the number of episodes nor what the policy observes changes an episode.
    first.check("a", "b", &conditions(&config(5, false), &one)).unwrap();
    let refused = first.check("a", "b", &conditions(&config(2, true), &other)).unwrap_err().to_string();
    assert!(refused.contains("b cannot be evaluated together with a"), "{refused}");
    assert!(refused.contains("its `damage.max_damaged_limbs` is `2`, expected `1`"), "{refused}");
    let mut weaker = config(2, true);
    weaker.damage.severity = Severity::Same(0.5);
    let refused = first.check("a", "b", &conditions(&weaker, &one)).unwrap_err().to_string();
    assert!(refused.contains("its `damage.severity` is `0.5`, expected `1`"), "{refused}");
}
