//! Placements of rigid bodies and mass distributions.

use dappo_lanes::model::{Inertia, Vector};

/// A placement: origin and axes of a frame, in the coordinates of another.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Pose {
    pub origin: Vector,
    pub axes: [Vector; 3],
}

impl Pose {
    pub const IDENTITY: Self =
        Self { origin: [0.0; 3], axes: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]] };

    /// From a position and a quaternion (w, x, y, z).
    pub fn new(origin: Vector, quat: [f64; 4]) -> Self {
        let norm = quat.iter().map(|q| q * q).sum::<f64>().sqrt();
        let [w, x, y, z] = quat.map(|q| q / norm);
        let axes = [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)],
            [2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)],
            [2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)],
        ];
        Self { origin, axes }
    }

    /// A direction of this frame in the outer coordinates.
    pub fn direction(&self, inner: Vector) -> Vector {
        std::array::from_fn(|i| (0..3).map(|axis| self.axes[axis][i] * inner[axis]).sum())
    }

    /// A point of this frame in the outer coordinates.
    pub fn point(&self, inner: Vector) -> Vector {
        add(self.origin, self.direction(inner))
    }

    /// A placement given in this frame, in the outer coordinates.
    pub fn then(&self, inner: &Self) -> Self {
        Self { origin: self.point(inner.origin), axes: inner.axes.map(|axis| self.direction(axis)) }
    }

    /// This placement in the coordinates of another one, both given in the same coordinates.
    pub fn seen_from(&self, frame: &Self) -> Self {
        let inside = |v: Vector| frame.axes.map(|axis| dot(axis, v));
        Self { origin: inside(sub(self.origin, frame.origin)), axes: self.axes.map(inside) }
    }

    /// The frame at `origin` with the z axis `z`, and an x axis as close as can be to that of `like`.
    pub fn with_z(origin: Vector, z: Vector, like: &Self) -> Self {
        let z = scale(z, 1.0 / norm(z));
        let across = like.axes.map(|axis| sub(axis, scale(z, dot(z, axis))));
        // The first axis that is not almost along z.
        let x = if norm(across[0]) > 0.1 { across[0] } else { across[1] };
        let x = scale(x, 1.0 / norm(x));
        Self { origin, axes: [x, cross(z, x), z] }
    }
}

/// The mass distribution of rigid bodies fixed to one another, collected one by one.
#[derive(Debug, Clone, Default)]
pub(super) struct Parts {
    bodies: Vec<Inertia>,
}

impl Parts {
    /// Adds a body with its principal axes at `pose`.
    ///
    /// `compensated` is the share of its weight that is compensated.
    pub fn add(&mut self, mass: f64, pose: &Pose, principal: Vector, compensated: f64) {
        let entry = |i: usize, j: usize| {
            (0..3).map(|axis| principal[axis] * pose.axes[axis][i] * pose.axes[axis][j]).sum()
        };
        self.bodies.push(Inertia {
            mass,
            com: pose.origin,
            tensor: PAIRS.map(|(i, j)| entry(i, j)),
            compensated: compensated * mass,
            compensated_com: pose.origin,
        });
    }

    /// All of them as one body.
    pub fn sum(&self) -> Inertia {
        let mass: f64 = self.bodies.iter().map(|body| body.mass).sum();
        let share = |body: &Inertia| if mass > 0.0 { body.mass / mass } else { 0.0 };
        let com = self.bodies.iter().fold([0.0; 3], |com, body| add(com, scale(body.com, share(body))));
        let mut tensor = [0.0; 6];
        for body in &self.bodies {
            let d = sub(body.com, com);
            for ((sum, (i, j)), own) in tensor.iter_mut().zip(PAIRS).zip(body.tensor) {
                // The parallel axis theorem.
                let square = if i == j { dot(d, d) } else { 0.0 };
                *sum += own + body.mass * (square - d[i] * d[j]);
            }
        }
        let compensated: f64 = self.bodies.iter().map(|body| body.compensated).sum();
        let mut compensated_com = [0.0; 3];
        if compensated != 0.0 {
            for body in &self.bodies {
                let part = body.compensated / compensated;
                compensated_com = add(compensated_com, scale(body.compensated_com, part));
            }
        }
        Inertia { mass, com, tensor, compensated, compensated_com }
    }
}

/// Rows and columns of the entries of [`Inertia::tensor`].
const PAIRS: [(usize, usize); 6] = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)];

pub(super) fn add(a: Vector, b: Vector) -> Vector {
    std::array::from_fn(|i| a[i] + b[i])
}

pub(super) fn sub(a: Vector, b: Vector) -> Vector {
    std::array::from_fn(|i| a[i] - b[i])
}

pub(super) fn scale(a: Vector, factor: f64) -> Vector {
    a.map(|x| x * factor)
}

pub(super) fn dot(a: Vector, b: Vector) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

pub(super) fn norm(a: Vector) -> f64 {
    dot(a, a).sqrt()
}

fn cross(a: Vector, b: Vector) -> Vector {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn close(a: &[f64], b: &[f64]) -> bool {
        a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-12)
    }

    #[test]
    fn a_placement_seen_from_another_and_put_back_is_itself() {
        let frame = Pose::new([1.0, -2.0, 3.0], [0.5, 0.1, -0.7, 0.3]);
        let other = Pose::new([0.2, 0.4, -1.0], [0.9, -0.3, 0.2, 0.8]);
        let again = frame.then(&other.seen_from(&frame));
        assert!(close(&again.origin, &other.origin));
        assert!(again.axes.iter().zip(&other.axes).all(|(a, b)| close(a, b)));
    }

    #[test]
    fn a_frame_along_a_hinge_is_right_handed_and_keeps_the_x_axis_where_it_can() {
        let upright = Pose::with_z([0.0; 3], [0.0, 0.0, 2.0], &Pose::IDENTITY);
        assert!(close(&upright.axes.concat(), &Pose::IDENTITY.axes.concat()));
        let along_x = Pose::with_z([0.0; 3], [-1.0, 0.0, 0.0], &Pose::IDENTITY);
        assert!(close(&along_x.axes[0], &[0.0, 1.0, 0.0]));
        for pose in [upright, along_x] {
            assert!(close(&cross(pose.axes[0], pose.axes[1]), &pose.axes[2]));
        }
    }

    #[test]
    fn two_point_masses_make_a_dumbbell() {
        let mut parts = Parts::default();
        for x in [-1.0, 3.0] {
            // Half of the right mass floats.
            let compensated = if x > 0.0 { 0.5 } else { 0.0 };
            parts.add(2.0, &Pose { origin: [x, 5.0, 0.0], ..Pose::IDENTITY }, [0.0; 3], compensated);
        }
        let dumbbell = parts.sum();
        assert_eq!((dumbbell.mass, dumbbell.com), (4.0, [1.0, 5.0, 0.0]));
        assert_eq!((dumbbell.compensated, dumbbell.compensated_com), (1.0, [3.0, 5.0, 0.0]));
        assert!(close(&dumbbell.tensor, &[0.0, 16.0, 16.0, 0.0, 0.0, 0.0]));
    }

    #[test]
    fn a_turned_body_has_its_moments_along_the_turned_axes() {
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let mut parts = Parts::default();
        // A quarter turn about z maps x to y.
        parts.add(1.0, &Pose::new([0.0; 3], [half, 0.0, 0.0, half]), [1.0, 2.0, 3.0], 0.0);
        assert!(close(&parts.sum().tensor, &[2.0, 1.0, 3.0, 0.0, 0.0, 0.0]));
    }
}
