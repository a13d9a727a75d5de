//! Parts of a compiled robot that terms refer to: actuated joints, feet and the default pose.

/// Parts of a robot, equal for all its compiled models but for the feet.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Anatomy {
    /// Positions with which an episode begins, `[nq]`: those of a keyframe, or of the MJCF.
    pub start: Vec<f64>,
    /// Controls that hold this pose, `[nu]`: those of the keyframe, or the positions of the joints.
    pub start_ctrl: Vec<f64>,
    /// Actuators in the order of the controls.
    pub actuators: Vec<ActuatorParts>,
    /// Names of the bodies, the world first.
    pub bodies: Vec<String>,
    /// Feet of each compiled model, in the order of the limbs; empty if the limbs have none.
    pub feet: Vec<Vec<Foot>>,
}

/// An actuator and the hinge that it turns.
#[derive(Debug, Clone, PartialEq)]
pub struct ActuatorParts {
    /// Name of the actuator.
    pub name: String,
    /// Its hinge; `None` if it moves something else.
    pub joint: Option<JointParts>,
    /// Whether its control is a joint position.
    pub is_position: bool,
}

/// A hinge.
#[derive(Debug, Clone, PartialEq)]
pub struct JointParts {
    /// Name of the joint.
    pub name: String,
    /// Index in qpos.
    pub qpos: usize,
    /// Index in qvel.
    pub dof: usize,
    /// Lowest and highest position, rad; infinite without limits.
    pub range: [f64; 2],
}

/// A point that is fixed to the last body of a limb, and the bodies between it and the root.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Foot {
    /// Body that carries the point, a row of `cfrc_ext`.
    pub body: usize,
    /// Bodies from the one on the root outwards.
    pub links: Vec<FootLink>,
    /// The point in the frame of the last body, m.
    pub offset: [f64; 3],
}

/// A body between the root and a foot, with at most one hinge.
#[derive(Debug, Clone, PartialEq)]
pub struct FootLink {
    /// Position in the parent's frame, m.
    pub position: [f64; 3],
    /// Orientation in the parent's frame, a unit quaternion (w, x, y, z).
    pub orientation: [f64; 4],
    /// Its hinge; `None` for a body that is fixed to its parent.
    pub hinge: Option<FootHinge>,
}

/// The hinge of a [`FootLink`].
#[derive(Debug, Clone, PartialEq)]
pub struct FootHinge {
    /// Axis in the body's frame, a unit vector.
    pub axis: [f64; 3],
    /// A point of the axis in the body's frame, m.
    pub anchor: [f64; 3],
    /// Index in qpos.
    pub qpos: usize,
    /// Index in qvel.
    pub dof: usize,
    /// Joint position at which the body has its orientation in the parent's frame.
    pub reference: f64,
}

impl Foot {
    /// Position (m) and velocity (m/s) of the point, along the world's axes.
    ///
    /// # Shapes
    /// - `qpos`: `[nq]`, `qvel`: `[nv]`, both beginning with the free joint, whose frame is `root`
    pub(super) fn motion(&self, root: &Frame, qpos: &[f64], qvel: &[f64]) -> ([f64; 3], [f64; 3]) {
        let mut frame = *root;
        for link in &self.links {
            frame = frame.child(link, qpos, qvel);
        }
        let arm = frame.turn(self.offset);
        (add(frame.origin, arm), add(frame.velocity, cross(frame.angular_velocity, arm)))
    }
}

/// A moving frame, along the world's axes.
#[derive(Clone, Copy)]
pub(super) struct Frame {
    origin: [f64; 3],
    /// Rows of the rotation matrix from the frame to the world.
    rotation: [[f64; 3]; 3],
    velocity: [f64; 3],
    angular_velocity: [f64; 3],
}

impl Frame {
    /// The frame of the root.
    pub(super) fn of_root(qpos: &[f64], qvel: &[f64]) -> Self {
        let rotation = root_rotation(qpos);
        Self {
            origin: [qpos[0], qpos[1], qpos[2]],
            rotation,
            velocity: [qvel[0], qvel[1], qvel[2]],
            angular_velocity: apply(&rotation, [qvel[3], qvel[4], qvel[5]]),
        }
    }

    fn turn(&self, vector: [f64; 3]) -> [f64; 3] {
        apply(&self.rotation, vector)
    }

    fn child(&self, link: &FootLink, qpos: &[f64], qvel: &[f64]) -> Self {
        let arm = self.turn(link.position);
        let fixed = Self {
            origin: add(self.origin, arm),
            rotation: if link.orientation == UPRIGHT {
                self.rotation
            } else {
                product(&self.rotation, &matrix(link.orientation))
            },
            velocity: add(self.velocity, cross(self.angular_velocity, arm)),
            angular_velocity: self.angular_velocity,
        };
        let Some(hinge) = &link.hinge else { return fixed };
        let rotation = turned(&fixed.rotation, hinge.axis, qpos[hinge.qpos] - hinge.reference);
        let axis = fixed.turn(hinge.axis);
        let angular_velocity = add(self.angular_velocity, axis.map(|entry| entry * qvel[hinge.dof]));
        if hinge.anchor == [0.0; 3] {
            return Self { rotation, angular_velocity, ..fixed };
        }
        // The anchor is where both bodies move alike.
        let anchor = fixed.turn(hinge.anchor);
        let back = apply(&rotation, hinge.anchor).map(|entry| -entry);
        Self {
            origin: add(add(fixed.origin, anchor), back),
            velocity: add(
                add(fixed.velocity, cross(self.angular_velocity, anchor)),
                cross(angular_velocity, back),
            ),
            rotation,
            angular_velocity,
        }
    }
}

/// The orientation of most bodies in their parents' frames.
const UPRIGHT: [f64; 4] = [1.0, 0.0, 0.0, 0.0];

/// Rows of the rotation matrix of the root. Noise may have changed the length of its quaternion, which MuJoCo ignores.
pub(super) fn root_rotation(qpos: &[f64]) -> [[f64; 3]; 3] {
    let length = qpos[3..7].iter().map(|entry| entry * entry).sum::<f64>().sqrt();
    matrix(std::array::from_fn(|index| qpos[3 + index] / length))
}

/// Rows of the rotation matrix of a unit quaternion.
fn matrix([w, x, y, z]: [f64; 4]) -> [[f64; 3]; 3] {
    [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ]
}

/// Rows of a rotation matrix whose frame turns by an angle (rad) about one of its unit vectors.
fn turned(rotation: &[[f64; 3]; 3], axis: [f64; 3], angle: f64) -> [[f64; 3]; 3] {
    // Most hinges turn about an axis of their body: the two others mix.
    match axis {
        [1.0, 0.0, 0.0] => mixed::<1, 2>(rotation, angle.sin_cos()),
        [0.0, 1.0, 0.0] => mixed::<2, 0>(rotation, angle.sin_cos()),
        [0.0, 0.0, 1.0] => mixed::<0, 1>(rotation, angle.sin_cos()),
        [x, y, z] => {
            let (sin, cos) = (0.5 * angle).sin_cos();
            product(rotation, &matrix([cos, sin * x, sin * y, sin * z]))
        }
    }
}

/// A matrix whose columns A and B turn towards each other.
fn mixed<const A: usize, const B: usize>(matrix: &[[f64; 3]; 3], (sin, cos): (f64, f64)) -> [[f64; 3]; 3] {
    let mut mixed = *matrix;
    for (row, old) in mixed.iter_mut().zip(matrix) {
        row[A] = cos * old[A] + sin * old[B];
        row[B] = cos * old[B] - sin * old[A];
    }
    mixed
}

fn product(a: &[[f64; 3]; 3], b: &[[f64; 3]; 3]) -> [[f64; 3]; 3] {
    let entry = |row: usize, column: usize| (0..3).map(|k| a[row][k] * b[k][column]).sum();
    std::array::from_fn(|row| std::array::from_fn(|column| entry(row, column)))
}

fn apply(matrix: &[[f64; 3]; 3], vector: [f64; 3]) -> [f64; 3] {
    matrix.map(|row| row[0] * vector[0] + row[1] * vector[1] + row[2] * vector[2])
}

/// A vector of the world in a frame with this rotation matrix.
pub(super) fn apply_inverse(matrix: &[[f64; 3]; 3], vector: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|column| (0..3).map(|row| matrix[row][column] * vector[row]).sum())
}

fn add(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}
