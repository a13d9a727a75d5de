//! [`Group`] for one lane type and one shape of robot.

use std::sync::{Arc, Mutex, PoisonError};

use crate::constants::Constants;
use crate::coords::Coords;
use crate::dynamics::Dynamics;
use crate::forces::Forces;
use crate::group::{Group, Readout, WorldAccess};
use crate::integrate::{Observer, Substep};
use crate::lane::{Lane, Mask};
use crate::model::Model;
use crate::skeleton::Skeleton;
use crate::state::{Position, State};

/// What all groups of an engine share.
pub struct Robot<T: Lane, const L: usize, const J: usize, const W: usize> {
    pub skeleton: Skeleton<T, L, J>,
    pub classes: Vec<Model>,
    /// Dynamics that no group uses at present. They are large: a thread that takes the one it returned last
    /// finds it in its cache.
    pub spare: Mutex<Vec<Box<Dynamics<T, L, J, W>>>>,
}

impl<T: Lane, const L: usize, const J: usize, const W: usize> Robot<T, L, J, W> {
    /// Calls `use_it` with room for the evaluation of the dynamics.
    fn with_dynamics<R>(&self, use_it: impl FnOnce(&mut Dynamics<T, L, J, W>) -> R) -> R {
        let spare = || self.spare.lock().unwrap_or_else(PoisonError::into_inner);
        let taken = spare().pop();
        let mut dynamics = taken.unwrap_or_else(|| Box::new(Dynamics::new(&self.skeleton)));
        let result = use_it(&mut dynamics);
        spare().push(dynamics);
        result
    }
}

/// As many worlds as a register has lanes.
pub struct Worlds<T: Lane, const L: usize, const J: usize, const W: usize> {
    robot: Arc<Robot<T, L, J, W>>,
    constants: Constants<T, L, J>,
    /// x and y of the root count from `origin`, so that single precision does not wear off far away.
    state: State<T, L, J>,
    origin: Vec<[f64; 2]>,
    ctrl: [[T; J]; L],
    evaluated_x: Vec<f64>,
    qacc: Coords<T, L, J>,
    forces: Forces<T>,
    /// Forces of the motors and servos.
    motor_force: [[T; J]; L],
}

/// Keeps what the last substep of a step shows.
struct Recorder<'a, T: Lane, const L: usize, const J: usize, const W: usize> {
    skeleton: &'a Skeleton<T, L, J>,
    forces: &'a mut Forces<T>,
    qacc: &'a mut Coords<T, L, J>,
    motor_force: &'a mut [[T; J]; L],
    mask: T::Mask,
    /// x of the root at the last evaluation.
    x: T,
    /// Whether this is the last substep.
    listening: bool,
}

impl<T: Lane, const L: usize, const J: usize, const W: usize> Observer<T, L, J, W>
    for Recorder<'_, T, L, J, W>
{
    #[inline(always)]
    fn first(&mut self, dynamics: &Dynamics<T, L, J, W>) {
        if self.listening {
            // MuJoCo evaluates sensors before the integrator's further stages.
            self.forces.set_touch(self.skeleton, &dynamics.contacts, self.mask);
        }
    }

    #[inline(always)]
    fn last(&mut self, dynamics: &Dynamics<T, L, J, W>, position: &Position<T, L, J>) {
        if self.listening {
            self.forces.set_bodies(self.skeleton, dynamics, self.mask);
            *self.qacc = dynamics.qacc();
            *self.motor_force = dynamics.actuation.motor;
            self.x = position.root[0];
        }
    }
}

impl<T: Lane, const L: usize, const J: usize, const W: usize> Worlds<T, L, J, W> {
    /// Entries of qvel; qpos has one more.
    fn dofs(&self) -> usize {
        self.robot.skeleton.dofs
    }

    pub fn new(robot: Arc<Robot<T, L, J, W>>) -> Self {
        let skeleton = &robot.skeleton;
        let mut worlds = Self {
            constants: Constants::new(skeleton.points.len()),
            state: State::zero(),
            origin: vec![[0.0; 2]; T::WIDTH],
            ctrl: [[T::zero(); J]; L],
            evaluated_x: vec![0.0; T::WIDTH],
            qacc: Coords::zero(),
            motor_force: [[T::zero(); J]; L],
            forces: Forces::zero(skeleton.bodies, skeleton.touch_sensors),
            robot,
        };
        let qvel = vec![0.0; worlds.dofs()];
        let mut qpos = vec![0.0; worlds.dofs() + 1];
        qpos[3] = 1.0;
        for lane in 0..T::WIDTH {
            worlds.set_class(lane, 0);
            worlds.set_state(lane, &qpos, &qvel);
        }
        worlds
    }

    /// Calls `visit` with each joint's indices: limb, joint and entry of qvel.
    fn joints(&self, mut visit: impl FnMut(usize, usize, usize)) {
        for (limb, joints) in self.robot.skeleton.joints.iter().enumerate() {
            for (joint, shared) in joints.iter().enumerate() {
                if let Some(dof) = shared.dof {
                    visit(limb, joint, dof);
                }
            }
        }
    }

    fn read_coords(&self, coords: &Coords<T, L, J>, lane: usize, out: &mut [f64]) {
        for (out, entry) in out.iter_mut().zip(&coords.root) {
            *out = entry.get(lane);
        }
        self.joints(|limb, joint, dof| out[dof] = coords.limbs[limb][joint].get(lane));
    }

    fn coords(&self, lane: usize, mut coords: Coords<T, L, J>, values: &[f64]) -> Coords<T, L, J> {
        for (entry, &value) in coords.root.iter_mut().zip(values) {
            entry.set(lane, value);
        }
        self.joints(|limb, joint, dof| coords.limbs[limb][joint].set(lane, values[dof]));
        coords
    }

    fn read_qpos(&self, lane: usize, out: &mut [f64]) {
        let position = &self.state.position;
        for axis in 0..2 {
            out[axis] = self.origin[lane][axis] + position.root[axis].get(lane);
        }
        out[2] = position.root[2].get(lane);
        for (out, entry) in out[3..7].iter_mut().zip(&position.rotation) {
            *out = entry.get(lane);
        }
        self.joints(|limb, joint, dof| out[dof + 1] = position.joints[limb][joint].get(lane));
    }

    fn set_qpos(&mut self, lane: usize, qpos: &[f64]) {
        let mut position = self.state.position;
        self.origin[lane] = [qpos[0], qpos[1]];
        for (entry, value) in position.root.iter_mut().zip([0.0, 0.0, qpos[2]]) {
            entry.set(lane, value);
        }
        for (entry, &value) in position.rotation.iter_mut().zip(&qpos[3..7]) {
            entry.set(lane, value);
        }
        self.joints(|limb, joint, dof| position.joints[limb][joint].set(lane, qpos[dof + 1]));
        self.state.position = position;
    }
}

/// What is compiled for the instruction set.
impl<T: Lane, const L: usize, const J: usize, const W: usize> Worlds<T, L, J, W> {
    #[inline(always)]
    fn forward_lanes(&mut self, mask: T::Mask, dynamics: &mut Dynamics<T, L, J, W>) {
        let skeleton = &self.robot.skeleton;
        dynamics.forget();
        let mut substep = Substep { skeleton, constants: &self.constants, ctrl: &self.ctrl, dynamics };
        substep.forward(&self.state);
        let dynamics = substep.dynamics;
        let qacc = dynamics.qacc();
        self.qacc.replace(mask, &qacc);
        self.state.warm_start.replace(mask, &qacc);
        self.forces.set_touch(skeleton, &dynamics.contacts, mask);
        self.forces.set_bodies(skeleton, dynamics, mask);
    }

    #[inline(always)]
    fn step_lanes(&mut self, mask: T::Mask, substeps: usize, dynamics: &mut Dynamics<T, L, J, W>) -> T {
        let skeleton = &self.robot.skeleton;
        dynamics.forget();
        let mut substep = Substep { skeleton, constants: &self.constants, ctrl: &self.ctrl, dynamics };
        let mut recorder = Recorder {
            skeleton,
            forces: &mut self.forces,
            qacc: &mut self.qacc,
            motor_force: &mut self.motor_force,
            mask,
            x: T::zero(),
            listening: false,
        };
        let mut state = self.state;
        for index in 0..substeps {
            recorder.listening = index + 1 == substeps;
            substep.advance(&mut state, &mut recorder);
        }
        let x = recorder.x;
        self.state.replace(mask, &state);
        x
    }
}

impl<T: Lane, const L: usize, const J: usize, const W: usize> WorldAccess for Worlds<T, L, J, W> {
    fn width(&self) -> usize {
        T::WIDTH
    }

    fn set_class(&mut self, lane: usize, class: usize) {
        self.constants.set(lane, &self.robot.classes[class]);
    }

    fn set_model(&mut self, lane: usize, model: &Model) {
        self.constants.set(lane, model);
    }

    fn add_root_velocity(&mut self, lane: usize, change: [f64; 6]) {
        for (entry, change) in self.state.velocity.root.iter_mut().zip(change) {
            entry.set(lane, entry.get(lane) + change);
        }
    }

    fn set_state(&mut self, lane: usize, qpos: &[f64], qvel: &[f64]) {
        self.set_qpos(lane, qpos);
        self.state.velocity = self.coords(lane, self.state.velocity, qvel);
        self.state.warm_start = self.coords(lane, self.state.warm_start, &vec![0.0; self.dofs()]);
        self.evaluated_x[lane] = qpos[0];
    }

    fn set_ctrl(&mut self, lane: usize, ctrl: &[f64]) {
        let robot = Arc::clone(&self.robot);
        for (limb, joints) in robot.skeleton.joints.iter().enumerate() {
            for (joint, shared) in joints.iter().enumerate() {
                if let Some(actuator) = shared.actuator {
                    self.ctrl[limb][joint].set(lane, ctrl[actuator]);
                }
            }
        }
    }

    fn read(&self, lane: usize, readout: Readout<'_>) {
        self.read_qpos(lane, readout.qpos);
        self.read_coords(&self.state.velocity, lane, readout.qvel);
        for (out, body) in readout.cfrc_ext.chunks_exact_mut(6).zip(&self.forces.bodies) {
            for (out, entry) in out.iter_mut().zip(body) {
                *out = entry.get(lane);
            }
        }
        for (out, touch) in readout.touch.iter_mut().zip(&self.forces.touch) {
            *out = touch.get(lane);
        }
    }

    fn accelerations(&self, lane: usize, qacc: &mut [f64]) {
        self.read_coords(&self.qacc, lane, qacc);
    }

    fn actuator_forces(&self, lane: usize, forces: &mut [f64]) {
        for (limb, joints) in self.robot.skeleton.joints.iter().enumerate() {
            for (joint, shared) in joints.iter().enumerate() {
                if let Some(actuator) = shared.actuator {
                    forces[actuator] = self.motor_force[limb][joint].get(lane);
                }
            }
        }
    }

    fn evaluated_x(&self, lane: usize) -> f64 {
        self.evaluated_x[lane]
    }

    fn row(&self) -> usize {
        3 * self.dofs() + 2
    }

    fn save(&self, lane: usize, row: &mut [f64]) {
        let (qpos, rest) = row.split_at_mut(self.dofs() + 1);
        let (qvel, rest) = rest.split_at_mut(self.dofs());
        let (warm_start, rest) = rest.split_at_mut(self.dofs());
        self.read_qpos(lane, qpos);
        self.read_coords(&self.state.velocity, lane, qvel);
        self.read_coords(&self.state.warm_start, lane, warm_start);
        rest[0] = self.evaluated_x[lane];
    }

    fn load(&mut self, lane: usize, row: &[f64]) {
        let (qpos, rest) = row.split_at(self.dofs() + 1);
        let (qvel, rest) = rest.split_at(self.dofs());
        let (warm_start, rest) = rest.split_at(self.dofs());
        self.set_qpos(lane, qpos);
        self.state.velocity = self.coords(lane, self.state.velocity, qvel);
        self.state.warm_start = self.coords(lane, self.state.warm_start, warm_start);
        self.evaluated_x[lane] = rest[0];
    }
}

impl<T: Lane, const L: usize, const J: usize, const W: usize> Group for Worlds<T, L, J, W> {
    fn forward(&mut self, lanes: u32) {
        let robot = Arc::clone(&self.robot);
        robot.with_dynamics(|dynamics| {
            T::run(
                #[inline(always)]
                || self.forward_lanes(T::Mask::from_bits(lanes), dynamics),
            );
        });
    }

    fn step(&mut self, lanes: u32, substeps: usize) {
        let robot = Arc::clone(&self.robot);
        let x = robot.with_dynamics(|dynamics| {
            T::run(
                #[inline(always)]
                || self.step_lanes(T::Mask::from_bits(lanes), substeps, dynamics),
            )
        });
        for lane in (0..T::WIDTH).filter(|lane| lanes >> lane & 1 == 1) {
            self.evaluated_x[lane] = self.origin[lane][0] + x.get(lane);
            for axis in 0..2 {
                let coordinate = &mut self.state.position.root[axis];
                self.origin[lane][axis] += coordinate.get(lane);
                coordinate.set(lane, 0.0);
            }
        }
    }
}
