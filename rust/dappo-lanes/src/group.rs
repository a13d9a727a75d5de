//! A group of worlds that share the lanes of SIMD registers.

use crate::model::Model;

/// Where [`WorldAccess::read`] writes the state of one world.
#[derive(Debug)]
pub struct Readout<'a> {
    /// Positions, `[nq]`.
    pub qpos: &'a mut [f64],
    /// Velocities, `[nv]`.
    pub qvel: &'a mut [f64],
    /// External contact forces of the last step (torque about the robot's centre of mass, then force, world
    /// axes), `[bodies · 6]`.
    pub cfrc_ext: &'a mut [f64],
    /// Normal forces of the touch sensors, `[touch_sensors]`.
    pub touch: &'a mut [f64],
}

/// Worlds of one robot, each a lane with its own damage class and state.
pub trait WorldAccess: Send + Sync {
    /// Number of worlds.
    fn width(&self) -> usize;

    /// Changes the damage class of a world; its state is kept.
    fn set_class(&mut self, lane: usize, class: usize);

    /// Gives a world the numbers of a model of the same robot that is none of its damage classes; its state is kept.
    fn set_model(&mut self, lane: usize, model: &Model);

    /// Places a world at rest from forces: nothing remains of its past.
    fn set_state(&mut self, lane: usize, qpos: &[f64], qvel: &[f64]);

    /// Adds to the velocities of the root, linear along the world's axes, then angular along its own.
    fn add_root_velocity(&mut self, lane: usize, change: [f64; 6]);

    /// Sets the controls of a world, `[actuators]`.
    fn set_ctrl(&mut self, lane: usize, ctrl: &[f64]);

    /// Reads the state of a world.
    fn read(&self, lane: usize, readout: Readout<'_>);

    /// x position of the root at the last evaluation of forces: with RK4, that of the last stage.
    fn evaluated_x(&self, lane: usize) -> f64;

    /// Accelerations of the last evaluation of forces, `[nv]`.
    fn accelerations(&self, lane: usize, qacc: &mut [f64]);

    /// Forces of the actuators at the last evaluation of a step, `[actuators]`.
    fn actuator_forces(&self, lane: usize, forces: &mut [f64]);

    /// Numbers in a state row.
    fn row(&self) -> usize;

    /// Writes everything that the next step depends on, but for class and controls, `[row]`.
    fn save(&self, lane: usize, row: &mut [f64]);

    /// Goes back to a saved row.
    fn load(&mut self, lane: usize, row: &[f64]);
}

/// As many worlds as fit into a SIMD register, computed by themselves.
pub trait Group: WorldAccess {
    /// Computes the forces that act in the present states, for the worlds of the mask (bit i = lane i).
    fn forward(&mut self, lanes: u32);

    /// Advances the worlds of the mask by a number of substeps; the others stay as they are.
    fn step(&mut self, lanes: u32, substeps: usize);
}
