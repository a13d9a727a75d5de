//! Some worlds of an engine: their states on the host.

use std::sync::Arc;

use dappo_lanes::{Model, Readout, WorldAccess};

use crate::constants::row;
use crate::skeleton::Skeleton;

/// What all groups of an engine share.
pub struct Robot {
    pub skeleton: Skeleton,
    pub classes: usize,
    /// Whether kernels compute in single precision.
    pub single: bool,
}

/// Neighbouring worlds. The device computes those of several groups at once: [`Engine`](crate::Engine).
pub struct Group {
    pub(crate) robot: Arc<Robot>,
    pub(crate) worlds: Vec<World>,
}

/// One world.
pub(crate) struct World {
    /// Its row in the table of constants.
    pub model: usize,
    /// Constants that are none of a damage class and not yet on the device.
    pub varied: Option<Vec<f64>>,
    /// x and y of the root count from here, so that single precision does not wear off far away.
    pub origin: [f64; 2],
    /// Positions, velocities, and accelerations of the last evaluation, as the kernel has them.
    pub state: Vec<f64>,
    /// Controls of the joints, as the kernel has them.
    pub ctrl: Vec<f64>,
    /// What the kernel shows.
    pub readings: Vec<f64>,
    pub evaluated_x: f64,
    /// Row of the table that is its own.
    own_model: usize,
}

impl Group {
    /// Worlds of class 0 with all positions and velocities zero; `first` is the index of the first one.
    pub(crate) fn new(robot: &Arc<Robot>, first: usize, width: usize) -> Self {
        let shape = &robot.skeleton.shape;
        let mut state = vec![0.0; shape.state()];
        state[3] = 1.0;
        let worlds = (0..width)
            .map(|lane| World {
                model: 0,
                varied: None,
                origin: [0.0; 2],
                state: state.clone(),
                ctrl: vec![0.0; shape.dofs()],
                readings: vec![0.0; shape.readings()],
                evaluated_x: 0.0,
                own_model: robot.classes + first + lane,
            })
            .collect();
        Self { robot: Arc::clone(robot), worlds }
    }

    /// A number as the kernel has it.
    fn rounded(&self, value: f64) -> f64 {
        if self.robot.single { f64::from(value as f32) } else { value }
    }

    /// Reads a row of coordinates that begins at `start` of a state.
    fn read_coords(&self, lane: usize, start: usize, out: &mut [f64]) {
        let row = &self.worlds[lane].state[start..];
        out[..6].copy_from_slice(&row[..6]);
        for joint in &self.robot.skeleton.joints {
            out[joint.dof] = row[6 + joint.place];
        }
    }

    fn set_coords(&mut self, lane: usize, start: usize, values: &[f64]) {
        self.clear(lane, start, 6);
        for (at, &value) in values.iter().enumerate().take(6) {
            self.worlds[lane].state[start + at] = self.rounded(value);
        }
        let robot = Arc::clone(&self.robot);
        for joint in &robot.skeleton.joints {
            self.worlds[lane].state[start + 6 + joint.place] = self.rounded(values[joint.dof]);
        }
    }

    fn read_qpos(&self, lane: usize, out: &mut [f64]) {
        let World { origin, state, .. } = &self.worlds[lane];
        out[..7].copy_from_slice(&state[..7]);
        out[0] += origin[0];
        out[1] += origin[1];
        for joint in &self.robot.skeleton.joints {
            out[joint.dof + 1] = state[7 + joint.place];
        }
    }

    fn set_qpos(&mut self, lane: usize, qpos: &[f64]) {
        let robot = Arc::clone(&self.robot);
        let rounded: Vec<f64> = qpos.iter().map(|&value| self.rounded(value)).collect();
        self.clear(lane, 0, 7);
        let World { origin, state, .. } = &mut self.worlds[lane];
        *origin = [qpos[0], qpos[1]];
        state[2..7].copy_from_slice(&rounded[2..7]);
        for joint in &robot.skeleton.joints {
            state[7 + joint.place] = rounded[joint.dof + 1];
        }
    }

    /// Sets a part of a state to zero, which begins with `root` numbers of the root. Joints that only complete the
    /// shape of the robot must not keep what a world that diverged has left in them.
    fn clear(&mut self, lane: usize, start: usize, root: usize) {
        let end = start + root + self.robot.skeleton.shape.dofs();
        self.worlds[lane].state[start..end].fill(0.0);
    }

    fn dofs(&self) -> usize {
        self.robot.skeleton.dofs
    }

    /// Where velocities and the solver's guess begin in a state.
    fn starts(&self) -> (usize, usize) {
        let shape = &self.robot.skeleton.shape;
        (shape.velocity(), shape.guess())
    }
}

impl World {
    /// Keeps what a step has shown of x, and makes where the root is now the point from which x and y count.
    pub fn set_origin(&mut self) {
        self.evaluated_x = self.origin[0] + self.readings[0];
        for (origin, coordinate) in self.origin.iter_mut().zip(&mut self.state) {
            *origin += *coordinate;
            *coordinate = 0.0;
        }
    }
}

impl WorldAccess for Group {
    fn width(&self) -> usize {
        self.worlds.len()
    }

    fn set_class(&mut self, lane: usize, class: usize) {
        let world = &mut self.worlds[lane];
        world.model = class;
        world.varied = None;
    }

    fn set_model(&mut self, lane: usize, model: &Model) {
        let numbers = row(&self.robot.skeleton, model);
        let world = &mut self.worlds[lane];
        world.model = world.own_model;
        world.varied = Some(numbers);
    }

    fn set_state(&mut self, lane: usize, qpos: &[f64], qvel: &[f64]) {
        let (velocity, guess) = self.starts();
        self.set_qpos(lane, qpos);
        self.set_coords(lane, velocity, qvel);
        self.worlds[lane].state[guess..].fill(0.0);
        self.worlds[lane].evaluated_x = qpos[0];
    }

    fn add_root_velocity(&mut self, lane: usize, change: [f64; 6]) {
        let (velocity, _) = self.starts();
        for (at, change) in change.into_iter().enumerate() {
            self.worlds[lane].state[velocity + at] =
                self.rounded(self.worlds[lane].state[velocity + at] + change);
        }
    }

    fn set_ctrl(&mut self, lane: usize, ctrl: &[f64]) {
        let robot = Arc::clone(&self.robot);
        for joint in &robot.skeleton.joints {
            if let Some(actuator) = joint.actuator {
                self.worlds[lane].ctrl[joint.place] = ctrl[actuator];
            }
        }
    }

    fn read(&self, lane: usize, readout: Readout<'_>) {
        let (velocity, _) = self.starts();
        self.read_qpos(lane, readout.qpos);
        self.read_coords(lane, velocity, readout.qvel);
        let skeleton = &self.robot.skeleton;
        let (shape, readings) = (&skeleton.shape, &self.worlds[lane].readings);
        readout.cfrc_ext.fill(0.0);
        let bodies = skeleton.bodies.iter().flatten();
        for (body, force) in bodies.zip(readings[shape.body_readings()..].chunks_exact(6)) {
            let Some(body) = body else { continue };
            for (sum, entry) in readout.cfrc_ext[6 * body..6 * body + 6].iter_mut().zip(force) {
                *sum += entry;
            }
        }
        readout.touch.fill(0.0);
        let sensors = skeleton.touches.iter().flatten();
        for (sensor, force) in sensors.zip(&readings[shape.touch_readings()..]) {
            if let Some(sensor) = sensor {
                readout.touch[*sensor] += force;
            }
        }
    }

    fn evaluated_x(&self, lane: usize) -> f64 {
        self.worlds[lane].evaluated_x
    }

    fn accelerations(&self, lane: usize, qacc: &mut [f64]) {
        let (_, guess) = self.starts();
        self.read_coords(lane, guess, qacc);
    }

    fn actuator_forces(&self, lane: usize, forces: &mut [f64]) {
        for joint in &self.robot.skeleton.joints {
            if let Some(actuator) = joint.actuator {
                forces[actuator] = self.worlds[lane].readings[1 + joint.place];
            }
        }
    }

    fn row(&self) -> usize {
        3 * self.dofs() + 2
    }

    fn save(&self, lane: usize, row: &mut [f64]) {
        let (velocity, guess) = self.starts();
        let (qpos, rest) = row.split_at_mut(self.dofs() + 1);
        let (qvel, rest) = rest.split_at_mut(self.dofs());
        let (warm_start, rest) = rest.split_at_mut(self.dofs());
        self.read_qpos(lane, qpos);
        self.read_coords(lane, velocity, qvel);
        self.read_coords(lane, guess, warm_start);
        rest[0] = self.evaluated_x(lane);
    }

    fn load(&mut self, lane: usize, row: &[f64]) {
        let (velocity, guess) = self.starts();
        let (qpos, rest) = row.split_at(self.dofs() + 1);
        let (qvel, rest) = rest.split_at(self.dofs());
        let (warm_start, rest) = rest.split_at(self.dofs());
        self.set_qpos(lane, qpos);
        self.set_coords(lane, velocity, qvel);
        self.set_coords(lane, guess, warm_start);
        self.worlds[lane].evaluated_x = rest[0];
    }
}
