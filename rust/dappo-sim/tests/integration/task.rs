//! What a task remembers between steps: commands, curriculum, delays.

use dappo_sim::task::{ActuatorParts, Anatomy, Signals, Task, Variants};
use dappo_sim::{Layout, Reset, Robot};

const ROBOT: &str = r#"
name = "cube"
mjcf = "cube.xml"
main_body = "cube"
frame_skip = 1
max_episode_steps = 100
limbs = [{ name = "a", body = "a", joints = ["a"] }]
damage = { types = [], max_damaged_limbs = 0 }
actions = { type = "control", scale = { "first" = 2.0, "sec.*" = 3.0 } }
reset = { qpos_noise = 0.0, qvel_noise = 0.0 }
observation = { policy = { terms = [{ term = "command" }] }, critic = { terms = [{ term = "base_height" }] } }
rewards = { survive = { weight = 0.5 }, fall = { term = "termination", weight = -1.0 } }
terminations = { height = [0.5, 2.0] }

[commands.velocity]
lin_vel_x = [-4.0, -2.0]
lin_vel_y = [3.0, 3.0]
ang_vel_z = [0.0, 1.0]
resample_every = [0.01, 0.01]

[curriculum.commands]
start = 0.25
steps = 40
"#;

fn layout() -> Layout {
    let actuator = |name: &str| ActuatorParts { name: name.into(), joint: None, is_position: false };
    Layout {
        nq: 7,
        nv: 6,
        nu: 2,
        nbody: 1,
        nsensordata: 0,
        timestep: 0.01,
        main_body: 0,
        limb_bodies: vec![vec![]],
        touch_addresses: vec![],
        hidden_state: String::new(),
        anatomy: Anatomy {
            actuators: vec![actuator("first"), actuator("second")],
            start_ctrl: vec![0.0; 2],
            ..Anatomy::default()
        },
        variants: Variants::default(),
    }
}

fn task(text: &str, training: bool) -> Result<Task, String> {
    let robot = Robot::from_toml(text).map_err(|error| error.to_string())?;
    Task::new(&robot, &layout(), None, training).map_err(|error| error.to_string())
}

/// Steps of one env at a height; returns its commands and the last reward.
fn run(task: &Task, steps: usize, height: f64) -> (Vec<[f64; 3]>, f64) {
    let mut row = vec![0.0; task.memory_len()];
    let qpos = [0.0, 0.0, height, 1.0, 0.0, 0.0, 0.0];
    let signals = Signals {
        class: 0,
        qpos: &qpos,
        qvel: &[0.0; 6],
        ctrl: &[0.0; 2],
        actuator_force: &[0.0; 2],
        cfrc_ext: &[0.0; 6],
        sensordata: &[],
        forward_velocity: 0.0,
        disabled_touch: &[],
    };
    let (mut commands, mut reward) = (Vec::new(), 0.0);
    for step in 0..steps {
        if step % 10 == 0 {
            task.begin(&mut row, &Reset { env: 0, class: 0, key: 7, episode: step as u64 / 10 });
        }
        let command = task.command(&row);
        commands.push([command[0], command[1], command[2]]);
        let mut terms = vec![0.0; task.reward_len()];
        let outcome = task.outcome(&mut row, &signals, &mut terms);
        reward = outcome.reward;
        assert_eq!(terms.iter().sum::<f64>(), reward);
        assert_eq!(outcome.terminated, !(0.5..=2.0).contains(&height));
    }
    (commands, reward)
}

#[test]
fn commands_grow_over_the_episodes_of_a_training_and_have_their_ranges_elsewhere() {
    let (grown, _) = run(&task(ROBOT, true).unwrap(), 80, 1.0);
    for (step, command) in grown.iter().enumerate() {
        // The share is 1/4 at first and 1 after 40 steps, whatever episode they are in.
        let share = (0.25 + 0.75 * step as f64 / 40.0).min(1.0);
        assert!((command[1] - 3.0 * share).abs() < 1e-12, "{step}: {command:?}");
        assert!((-4.0 * share..=-2.0 * share).contains(&command[0]), "{step}: {command:?}");
    }
    let (full, _) = run(&task(ROBOT, false).unwrap(), 80, 1.0);
    assert!(full.iter().all(|command| command[1] == 3.0 && (-4.0..=-2.0).contains(&command[0])));
    assert!(full.windows(2).filter(|pair| pair[0] != pair[1]).count() > 70);
}

#[test]
fn a_fall_costs_its_term_and_only_a_training_observes_what_the_critic_is_given() {
    assert_eq!(run(&task(ROBOT, true).unwrap(), 1, 1.0).1, 0.5);
    assert_eq!(run(&task(ROBOT, true).unwrap(), 1, 0.4).1, -1.0);
    let (training, other) = (task(ROBOT, true).unwrap(), task(ROBOT, false).unwrap());
    assert_eq!((training.obs_dim(), training.privileged()), (4, 1));
    assert_eq!((other.obs_dim(), other.privileged()), (3, 0));
    assert_eq!(other.reward_names().collect::<Vec<_>>(), ["fall", "survive"]);
}

#[test]
fn actions_are_scaled_by_the_pattern_of_their_actuator() {
    let task = task(ROBOT, false).unwrap();
    let mut ctrl = [0.0; 2];
    task.act(&mut vec![0.0; task.memory_len()], &[0.5, -7.0], &mut ctrl);
    assert_eq!(ctrl, [1.0, -3.0]);
    assert_eq!(
        task.controls().map(|(_, offset, scale)| (offset, scale)).collect::<Vec<_>>(),
        [(0.0, 2.0), (0.0, 3.0)]
    );
}

#[test]
fn what_a_robot_lacks_is_named() {
    for (old, new, fault) in [
        (
            "\"sec.*\" = 3.0",
            "\"sec.*\" = 3.0, \".*t\" = 1.0",
            "more than one pattern matches the actuator `first`",
        ),
        (
            "\"sec.*\" = 3.0",
            "\"third\" = 3.0",
            "the pattern \"third\" matches no actuator; they are first, second",
        ),
        (", \"sec.*\" = 3.0", "", "no pattern matches the actuator `second`"),
        ("type = \"control\"", "type = \"joint_position\"", "is not a position servo on a hinge"),
        ("term = \"command\"", "term = \"joint_pos\"", "needs a hinge behind every actuator"),
        ("term = \"command\"", "term = \"foot_vel\"", "needs an entry `foot` in every [[limbs]]"),
        (
            "survive = { weight = 0.5 }",
            "pose_squared = { weight = 0.5 }",
            "the reward term `pose_squared` needs a hinge",
        ),
        ("[commands.velocity]", "[commands.speed]", "[commands]: unknown entries speed"),
        (
            "lin_vel_x = [-4.0, -2.0]",
            "lin_vel_x = [4.0, -2.0]",
            "[commands.velocity]: `lin_vel_x` is a list, expected [low",
        ),
        (
            "start = 0.25",
            "start = 1.5",
            "[curriculum.commands]: `start` is 1.5, expected a number from 0 to 1",
        ),
        ("height = [0.5, 2.0]", "tilt = { angle = 4.0 }", "[terminations.tilt]: `angle` is 4.0"),
        (
            "fall = { term = \"termination\"",
            "fall = { term = \"stumble\"",
            "[rewards.fall]: `term` is \"stumble\", expected one of",
        ),
    ] {
        assert_eq!(ROBOT.matches(old).count(), 1, "{old}");
        let found = task(&ROBOT.replace(old, new), false).err().unwrap_or_default();
        assert!(found.contains(fault), "{new} gave {found:?}, expected {fault:?}");
    }
}

#[test]
fn a_task_in_a_file_of_its_own_gives_way_to_the_robots_entries() {
    let (robot, task) = ROBOT.split_at(ROBOT.find("frame_skip").unwrap());
    let (limbs, task) = task.split_at(task.find("actions").unwrap());
    let limbs: Vec<&str> = limbs.lines().skip(2).collect();
    let robot =
        format!("{robot}{}\n[tasks.walk.commands.velocity]\nlin_vel_y = [1.0, 1.0]\n", limbs.join("\n"));
    let task = format!("frame_skip = 1\nmax_episode_steps = 100\n{task}");
    let merged = dappo_sim::robot::with_task(&robot, &task, "walk").unwrap();
    assert_eq!(Robot::faults(&merged), Vec::<String>::new());
    let velocity = Robot::from_toml(&merged).unwrap().commands.velocity.unwrap();
    assert_eq!((velocity.lin_vel_x, velocity.lin_vel_y), ([-4.0, -2.0], [1.0, 1.0]));
    let other = dappo_sim::robot::with_task(&robot, &task, "run").unwrap();
    assert_eq!(Robot::from_toml(&other).unwrap().commands.velocity.unwrap().lin_vel_y, [3.0, 3.0]);
    let unknown = dappo_sim::robot::with_task(&robot, &format!("{task}\n[limbs]\n"), "walk").unwrap_err();
    assert!(unknown.to_string().contains("the task `walk` has unknown entries limbs"), "{unknown}");
}

#[test]
fn a_fault_of_a_sensor_is_in_what_the_policy_observes_and_not_in_what_the_critic_does() {
    let fault = "[events.imu_fault]\nshare = 1.0\nkinds = [\"biased\"]\nonset = [0.01, 0.01]\n\
                 offset = { base_ang_vel = [0.5, 0.5] }\n";
    let terms = "{ term = \"base_ang_vel\" }";
    let text = ROBOT.replace("{ term = \"command\" }", terms).replace("{ term = \"base_height\" }", terms);
    let task = task(&format!("{text}{fault}"), true).unwrap();
    let mut row = vec![0.0; task.memory_len()];
    task.begin(&mut row, &Reset { env: 0, class: 0, key: 7, episode: 0 });
    let signals = Signals {
        class: 0,
        qpos: &[0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0],
        qvel: &[0.0, 0.0, 0.0, 1.0, 2.0, 3.0],
        ctrl: &[0.0; 2],
        actuator_force: &[0.0; 2],
        cfrc_ext: &[0.0; 6],
        sensordata: &[],
        forward_velocity: 0.0,
        disabled_touch: &[],
    };
    let mut obs = [0.0; 6];
    task.observe_first(&mut row, &signals, &mut obs);
    assert_eq!(obs, [1.0, 2.0, 3.0, 1.0, 2.0, 3.0]);
    task.outcome(&mut row, &signals, &mut vec![0.0; task.reward_len()]);
    task.observe(&mut row, &signals, &mut obs);
    assert_eq!(obs, [1.5, 2.5, 3.5, 1.0, 2.0, 3.0]);
}
