//! A contest over a backend without physics: which agents walk, and that they walk the same episodes.

use std::cell::{Cell, RefCell};

use dappo_learn::Sizes;
use dappo_learn::config::Config;
use dappo_learn::envs::EnvFactory;
use dappo_learn::walk::{Event, EventKind, Kept, KnownClasses, MeanActions, Trial, Walks};
use dappo_nn::diagnoser::DiagnoserNet;
use dappo_nn::{FrozenMlp, InputTransform, Policy, Standardizer, cpu};
use dappo_sim::rng::env_keys;
use dappo_sim::task::Reflections;
use dappo_sim::vector_env::{DamageCourse, StepRange, VectorEnv, VectorEnvConfig};
use dappo_sim::{Backend, DamageSpace, Physics, Robot, SimError};

use super::Contest;
use crate::controller::{Controller, ControllerConfig, Skills, Trigger};
use crate::{Description, Diagnoser, Head, Method, Subject, Twin};
use counter::{CODE, Counter, ROBOT, ROW};

#[path = "../../../dappo-sim/tests/integration/counter/mod.rs"]
mod counter;

/// Length of an observation: positions and the one velocity.
const OBS: usize = ROW + 1;
const STEPS: usize = 6;
const COURSE: DamageCourse = DamageCourse {
    onset: StepRange { first: 2, last: 2 },
    duration: None,
    pause: None,
    code_delay: StepRange { first: 0, last: 0 },
};
const SEED: u64 = 11;
const EPISODES: usize = 2;
/// The healthy robot, and the first damage type at limb 1.
const CLASSES: [usize; 2] = [0, 3];

/// What the envs of one agent were made of: the keys of their initial states, and when the damage strikes.
type Made = (Vec<u64>, DamageCourse);

/// Makes envs that count, and keeps what they were made of.
struct Factory {
    robot: Robot,
    space: DamageSpace,
    made: RefCell<Vec<Made>>,
}

impl Factory {
    fn new() -> Self {
        let types = vec!["jammed_joint".into(), "missing_toe".into()];
        let robot = ROBOT.replace(r#"{ term = "qpos" }"#, r#"{ term = "qpos" }, { term = "qvel" }"#);
        Self {
            robot: Robot::from_toml(&robot).unwrap(),
            space: DamageSpace::new(4, types, 1).unwrap(),
            made: RefCell::default(),
        }
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
        Ok(Sizes { obs_dim: OBS + CODE, privileged: 0, code_length: CODE, action_dim: 2 })
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
        Physics::Mujoco
    }

    fn backend(&self, envs: usize, _: Option<&str>, _: Physics) -> Result<Box<dyn Backend>, SimError> {
        Ok(Box::new(Counter::new(&self.robot, envs, self.space.classes().len())))
    }

    fn make(
        &self,
        config: VectorEnvConfig,
        reward: Option<&str>,
        physics: Physics,
    ) -> Result<VectorEnv, SimError> {
        self.made.borrow_mut().push((config.keys.clone(), config.course));
        VectorEnv::new(self.backend(config.keys.len(), reward, physics)?, self.space(), config)
    }
}

/// Its first action, which is the counter's reward, is `bias`, and 10 (i + 1) more for each bit i of its damage code; the
/// second is 0.
fn policy(bias: f32, code_length: usize) -> Policy {
    let mut parameters = vec![0.0; 2 * OBS];
    parameters.extend((0..code_length).flat_map(|bit| [10.0 * (bit + 1) as f32, 0.0]));
    parameters.extend([bias, 0.0]);
    let net = FrozenMlp::new(vec![OBS + code_length, 2], parameters).unwrap();
    let standardizer = Standardizer::of(vec![0.0; OBS], vec![1.0; OBS]).unwrap();
    Policy::new(net, InputTransform::standardized(standardizer, code_length, 1.0).unwrap()).unwrap()
}

/// Suspects damage whenever it may, records a diagnosis window of two steps, and accepts no diagnosis.
fn controller(factory: &Factory, robots: usize) -> Controller {
    let classes = factory.space.classes().len();
    let description = Description {
        method: Method::A,
        timesteps: 2,
        obs_dim: OBS,
        action_dim: 2,
        head: Head::Classes,
        embedding: 2,
        lstm: 2,
        hidden: vec![2],
        held_out: Vec::new(),
        twin: Some(Twin::default()),
        subject: Subject::new("counter", &factory.space),
        standardizer: Standardizer::of(vec![0.0; OBS], vec![0.0; OBS]).unwrap(),
    };
    let net = DiagnoserNet::new(&description.sizes(), 0, &cpu());
    let skills = Skills {
        policy: policy(1.0, CODE),
        expert: policy(7.0, 0),
        diagnoser: Diagnoser::new(description, net),
        // No counter is as fast.
        baselines: Some(vec![1e6; classes]),
    };
    let config = ControllerConfig {
        trigger: Some(Trigger::Speed),
        speed_window: 1,
        cooldown: 1,
        confidence: Some(1.0),
        ..ControllerConfig::default()
    };
    let twins = || Ok(factory.backend(robots, None, factory.evaluation_physics())?);
    Controller::new(skills, config, robots, twins).unwrap()
}

fn run(factory: &Factory, unaware: Option<&Policy>, stop: &dyn Fn() -> bool) -> Option<Contest> {
    let trial = Trial {
        classes: CLASSES.to_vec(),
        episodes: EPISODES,
        course: COURSE,
        seed: SEED,
        kept: Kept::Velocities,
    };
    let mut config = Config::default();
    config.env.max_episode_steps = Some(STEPS);
    let mut controller = controller(factory, CLASSES.len() * EPISODES);
    let known = KnownClasses::of(&factory.space);
    let unaware = unaware.map(|policy| (policy as &dyn MeanActions, factory as &dyn EnvFactory));
    Contest::run(&trial, &mut controller, unaware, &known, (&config, factory), stop).unwrap()
}

/// Σ first action of every episode.
fn actions(walks: &Walks) -> Vec<f64> {
    walks.episodes.iter().map(|episode| episode.episode_return).collect()
}

#[test]
fn every_agent_of_a_contest_acts_by_its_own_damage_code() {
    let unaware = policy(50.0, 0);
    let contest = run(&Factory::new(), Some(&unaware), &|| false).unwrap();
    // After a cool-down of one step the expert walks for two, and again after the diagnosis and its cool-down, always
    // under the policy of a healthy robot: 1 + 7 + 7 + 1 + 1 + 7.
    assert_eq!(actions(&contest.adapted), [24.0; 4]);
    // The code shows from step 3 on what acted from step 2 on; the damage is bit 2 of the code: 3 · 1 + 3 · 31.
    assert_eq!(actions(&contest.oracle), [6.0, 6.0, 96.0, 96.0]);
    assert_eq!(actions(&contest.no_adaptation), [6.0; 4]);
    assert_eq!(actions(&contest.unaware.unwrap()), [300.0; 4]);
    for episode in &contest.adapted.episodes {
        let steps: Vec<(u64, bool)> = episode.events.iter().map(suspected).collect();
        assert_eq!(steps, [(1, true), (3, false), (5, true)]);
    }
    for walks in [&contest.oracle, &contest.no_adaptation] {
        assert!(walks.episodes.iter().all(|episode| episode.events.is_empty()));
    }
}

/// The step of an event, and whether it is a suspicion; other events are diagnoses that were not accepted.
fn suspected(event: &Event) -> (u64, bool) {
    let is_suspicion = matches!(event.kind, EventKind::Suspected { .. });
    assert!(is_suspicion || matches!(event.kind, EventKind::Diagnosed { accepted: false, .. }), "{event:?}");
    (event.step, is_suspicion)
}

#[test]
fn all_agents_of_a_contest_walk_the_same_episodes() {
    let (factory, unaware) = (Factory::new(), policy(50.0, 0));
    let contest = run(&factory, Some(&unaware), &|| false).unwrap();
    let starts = env_keys(SEED, EPISODES);
    assert_ne!(starts[0], starts[1]);
    // The controller, the oracle, the policy without adaptation and one without damage code, each with every start in every class.
    assert_eq!(factory.made.into_inner(), vec![(starts.repeat(CLASSES.len()), COURSE); 4]);
    for walks in [&contest.adapted, &contest.oracle, &contest.no_adaptation, &contest.unaware.unwrap()] {
        let damage: Vec<_> = walks.episodes.iter().map(|episode| (episode.class, episode.onset)).collect();
        assert_eq!(damage, [(0, 2), (0, 2), (3, 2), (3, 2)]);
        for episode in &walks.episodes {
            // The counter's velocities are ten times the number of the step.
            assert_eq!(episode.velocities, [10.0, 20.0, 30.0, 40.0, 50.0, 60.0]);
        }
    }
}

#[test]
fn without_a_policy_that_is_unaware_of_damage_three_agents_walk_and_a_stop_ends_all() {
    let factory = Factory::new();
    assert!(run(&factory, None, &|| false).unwrap().unaware.is_none());
    assert_eq!(factory.made.borrow().len(), 3);
    // It is called before every step: six times an agent.
    for (calls_at_most, agents) in [(0, 1), (6, 2), (17, 3), (18, 4)] {
        let (factory, calls, unaware) = (Factory::new(), Cell::new(0), policy(50.0, 0));
        let stop = || {
            calls.set(calls.get() + 1);
            calls.get() > calls_at_most
        };
        assert!(run(&factory, Some(&unaware), &stop).is_none());
        assert_eq!(factory.made.borrow().len(), agents);
    }
}
