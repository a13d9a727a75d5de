//! What a backend reports of one env.

/// The physics of one env after a step, as MuJoCo names it; it has not diverged.
#[derive(Debug, Clone, Copy)]
pub struct Signals<'a> {
    /// Active damage class.
    pub class: usize,
    /// Positions, `[nq]`.
    pub qpos: &'a [f64],
    /// Velocities, `[nv]`.
    pub qvel: &'a [f64],
    /// Controls, `[nu]`.
    pub ctrl: &'a [f64],
    /// Forces of the actuators at the last evaluation, N·m for joints, `[nu]`.
    pub actuator_force: &'a [f64],
    /// External contact force on every body (torque, then force, world frame), `[nbody · 6]`.
    pub cfrc_ext: &'a [f64],
    /// Sensor readings, `[nsensordata]`.
    pub sensordata: &'a [f64],
    /// Velocity of the main body along +x over the step, m/s.
    pub forward_velocity: f64,
    /// Whether each limb's touch signal is cut off by its damage, `[limbs]`.
    pub disabled_touch: &'a [bool],
}

impl Signals<'_> {
    /// External contact force on a body, N, along the world's axes.
    pub(super) fn contact_force(&self, body: usize) -> [f64; 3] {
        let row = &self.cfrc_ext[body * 6 + 3..body * 6 + 6];
        [row[0], row[1], row[2]]
    }
}
