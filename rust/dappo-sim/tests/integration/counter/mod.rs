//! A backend without physics: it counts, so that every number that a vector env returns is known.

use dappo_sim::backend::{BackendSnapshot, ObsRows};
use dappo_sim::task::{Anatomy, Task, Variants};
use dappo_sim::{Backend, Layout, Physics, Reset, Robot, SimError, StepOutputs};

/// Its robot.
pub const ROBOT: &str = r#"
name = "counter"
mjcf = "counter.xml"
main_body = "root"
frame_skip = 1
max_episode_steps = 100
action_scale = 1.0
limbs = [
    { name = "a", body = "a", joints = ["a"], toe_geom = "a" },
    { name = "b", body = "b", joints = ["b"], toe_geom = "b" },
    { name = "c", body = "c", joints = ["c"], toe_geom = "c" },
    { name = "d", body = "d", joints = ["d"], toe_geom = "d" },
]
damage = { types = ["jammed_joint", "missing_toe"], max_damaged_limbs = 2 }
reset = { qpos_noise = 0.0, qvel_noise = 0.0 }
termination = { height = [0.0, 1.0] }
observation = { terms = [{ term = "qpos" }] }
reward = { default = "r", r = { terms = [{ term = "forward_velocity", weight = 1.0 }] } }
"#;

/// Length of a state row and of the observation without code: episode, steps of the episode, class.
pub const ROW: usize = 3;
/// Length of a damage code.
pub const CODE: usize = 8;

/// Counts instead of simulating. The first action component is the reward; the second, above 0.5, is a fall, and above
/// 1.5 a divergence.
pub struct Counter {
    task: Task,
    rows: Vec<f64>,
    classes: Vec<usize>,
    table: usize,
}

impl Counter {
    /// Robots as [`ROBOT`] describes them, which may observe their velocity, too; it is 0.
    pub fn new(robot: &Robot, envs: usize, table: usize) -> Self {
        let layout = Layout {
            nq: ROW,
            nv: 1,
            nu: 2,
            nbody: 1,
            nsensordata: 0,
            timestep: 0.01,
            main_body: 0,
            limb_bodies: vec![vec![]; 4],
            touch_addresses: vec![],
            hidden_state: String::new(),
            anatomy: Anatomy::default(),
            variants: Variants::default(),
        };
        let task = Task::new(robot, &layout, None, false).unwrap();
        Self { task, rows: vec![0.0; envs * ROW], classes: vec![0; envs], table }
    }

    fn observe(&self, env: usize, obs: &mut ObsRows<'_>) {
        for (entry, value) in
            obs.data[env * obs.stride..].iter_mut().zip(&self.rows[env * ROW..(env + 1) * ROW])
        {
            *entry = *value as f32;
        }
    }
}

impl Backend for Counter {
    fn physics(&self) -> Physics {
        Physics::Mujoco
    }

    fn num_envs(&self) -> usize {
        self.classes.len()
    }

    fn num_classes(&self) -> usize {
        self.table
    }

    fn task(&self) -> &Task {
        &self.task
    }

    fn memory(&self, _env: usize) -> &[f64] {
        &[]
    }

    fn reset(&mut self, resets: &[Reset], mut obs: ObsRows<'_>) -> Result<(), SimError> {
        for reset in resets {
            self.classes[reset.env] = reset.class;
            let row = [reset.episode as f64, 0.0, reset.class as f64];
            self.rows[reset.env * ROW..(reset.env + 1) * ROW].copy_from_slice(&row);
            self.observe(reset.env, &mut obs);
        }
        Ok(())
    }

    fn set_classes(&mut self, changes: &[(usize, usize)]) -> Result<(), SimError> {
        for &(env, class) in changes {
            self.classes[env] = class;
        }
        Ok(())
    }

    fn step(&mut self, actions: &[f32], skip: &[bool], outputs: StepOutputs<'_>) -> Result<(), SimError> {
        let StepOutputs { mut obs, rewards, terminated, forward_velocity, diverged, .. } = outputs;
        for env in (0..self.num_envs()).filter(|&env| !skip[env]) {
            self.rows[env * ROW + 1] += 1.0;
            self.rows[env * ROW + 2] = self.classes[env] as f64;
            rewards[env] = f64::from(actions[2 * env]);
            terminated[env] = actions[2 * env + 1] > 0.5;
            forward_velocity[env] = 10.0 * self.rows[env * ROW + 1];
            diverged[env] = actions[2 * env + 1] > 1.5;
            if diverged[env] {
                (rewards[env], forward_velocity[env]) = (0.0, 0.0);
            }
            self.observe(env, &mut obs);
        }
        Ok(())
    }

    fn state(&self, qpos: &mut [f64], _: &mut [f64]) -> Result<(), SimError> {
        qpos.copy_from_slice(&self.rows);
        Ok(())
    }

    fn set_state(
        &mut self,
        qpos: &[f64],
        _: &[f64],
        skip: &[bool],
        mut obs: ObsRows<'_>,
    ) -> Result<(), SimError> {
        for env in (0..self.num_envs()).filter(|&env| !skip[env]) {
            self.rows[env * ROW..(env + 1) * ROW].copy_from_slice(&qpos[env * ROW..(env + 1) * ROW]);
            self.observe(env, &mut obs);
        }
        Ok(())
    }

    fn snapshot(&self) -> Result<BackendSnapshot, SimError> {
        Ok(BackendSnapshot { row: ROW, rows: self.rows.clone(), classes: self.classes.clone() })
    }

    fn restore(&mut self, snapshot: &BackendSnapshot) -> Result<(), SimError> {
        self.rows.clone_from(&snapshot.rows);
        self.classes.clone_from(&snapshot.classes);
        Ok(())
    }
}
