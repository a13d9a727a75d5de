//! Where the numbers of a robot are on the device, by the indices that MuJoCo gives them.

use crate::shape::Shape;
use crate::skeleton::Skeleton;

/// Where the numbers of the physics are in the rows of a shape.
#[derive(Clone, Debug, Hash, PartialEq, Eq)]
pub struct Places {
    pub shape: Shape,
    /// Place of each joint beyond the root in a row of coordinates, by its index in qvel less 6.
    pub joints: Vec<usize>,
    /// Where the forces on each body begin among the readings.
    pub bodies: Vec<Vec<usize>>,
    /// Where each touch sensor is among the readings.
    pub touches: Vec<Vec<usize>>,
}

impl Places {
    /// The places of a robot.
    #[must_use]
    pub fn new(skeleton: &Skeleton) -> Self {
        let shape = skeleton.shape;
        let mut joints = vec![0; skeleton.dofs - 6];
        for joint in &skeleton.joints {
            joints[joint.dof - 6] = joint.place;
        }
        let lanes = |of: &[Vec<Option<usize>>]| -> Vec<(usize, usize)> {
            let places = of.iter().flatten().enumerate();
            places.filter_map(|(place, part)| part.map(|part| (part, place))).collect()
        };
        let gathered = |parts: Vec<(usize, usize)>, count: usize, start: usize, width: usize| {
            let mut places = vec![Vec::new(); count];
            for (part, place) in parts {
                places[part].push(start + place * width);
            }
            places
        };
        let bodies = gathered(lanes(&skeleton.bodies), skeleton.num_bodies, shape.body_readings(), 6);
        let touches = gathered(lanes(&skeleton.touches), skeleton.num_touches, shape.touch_readings(), 1);
        Self { shape, joints, bodies, touches }
    }

    /// Number of positions.
    #[must_use]
    pub fn nq(&self) -> usize {
        7 + self.joints.len()
    }

    /// Number of velocities.
    #[must_use]
    pub fn nv(&self) -> usize {
        6 + self.joints.len()
    }

    /// Where a position is in a state.
    #[must_use]
    pub fn qpos(&self, index: usize) -> usize {
        if index < 7 { index } else { 7 + self.joints[index - 7] }
    }

    /// Where an acceleration is in a state.
    #[must_use]
    pub fn qacc(&self, index: usize) -> usize {
        self.shape.guess() + if index < 6 { index } else { 6 + self.joints[index - 6] }
    }

    /// Where a velocity is in a state.
    #[must_use]
    pub fn qvel(&self, index: usize) -> usize {
        self.shape.velocity() + if index < 6 { index } else { 6 + self.joints[index - 6] }
    }
}
