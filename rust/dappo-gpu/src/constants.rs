//! The numbers of a [`Model`] as rows of one buffer, which kernels index by the damage class of each world.
//!
//! A row is that of the root, followed by one part a thread: its joints from the root outwards, then its contact points.

use dappo_lanes::Model;
use dappo_lanes::model::{Cone, Inertia, Link, Point, Softness, Surface, Vector};

use crate::shape::Shape;
use crate::skeleton::Skeleton;

/// Places in the part of the root.
pub mod root {
    pub const TIMESTEP: usize = 0;
    /// Acceleration upwards that has the effect of gravity.
    pub const LIFT: usize = 1;
    pub const FLOOR: usize = 4;
    /// 1 / (mean inertia · nv): makes the solver's stopping rule independent of the robot's size.
    pub const SOLVER_SCALE: usize = 5;
    pub const BODY: usize = 6;
    pub const ARMATURE: usize = BODY + super::body::LEN;
    pub const DAMPING: usize = ARMATURE + 1;
    pub const LEN: usize = DAMPING + 1;
}

/// Places in a mass distribution.
pub mod body {
    pub const MASS: usize = 0;
    pub const COM: usize = 1;
    pub const TENSOR: usize = 4;
    pub const COMPENSATED: usize = 10;
    pub const COMPENSATED_COM: usize = 11;
    pub const LEN: usize = 14;
}

/// Places in the part of a joint.
pub mod link {
    pub const OFFSET: usize = 0;
    pub const AXES: usize = 3;
    pub const ZERO: usize = 12;
    pub const BODY: usize = 13;
    pub const ARMATURE: usize = BODY + super::body::LEN;
    pub const DAMPING: usize = ARMATURE + 1;
    pub const STIFFNESS: usize = DAMPING + 1;
    pub const SPRING_REFERENCE: usize = STIFFNESS + 1;
    pub const FRICTION_LOSS: usize = SPRING_REFERENCE + 1;
    /// 1/R of the constraint of dry friction.
    pub const FRICTION_WEIGHT: usize = FRICTION_LOSS + 1;
    /// Damping of its reference acceleration.
    pub const FRICTION_DAMPING: usize = FRICTION_WEIGHT + 1;
    pub const RANGE: usize = FRICTION_DAMPING + 1;
    pub const MARGIN: usize = RANGE + 2;
    pub const LIMIT: usize = MARGIN + 1;
    pub const INVERSE_WEIGHT: usize = LIMIT + super::softness::LEN;
    pub const GEAR: usize = INVERSE_WEIGHT + 1;
    pub const GAIN: usize = GEAR + 1;
    pub const BIAS: usize = GAIN + 1;
    pub const CTRL_RANGE: usize = BIAS + 3;
    pub const FORCE_RANGE: usize = CTRL_RANGE + 2;
    pub const ACTUATOR_RANGE: usize = FORCE_RANGE + 2;
    pub const LEN: usize = ACTUATOR_RANGE + 2;
}

/// Places in the part of a contact point.
pub mod point {
    pub const POSITION: usize = 0;
    pub const SIZE: usize = 3;
    pub const MARGIN: usize = 6;
    pub const FRICTION: usize = 7;
    /// Regularisation R of an edge of the pyramid at impedance d is this · (1 − d) / d.
    pub const RESISTANCE: usize = 8;
    pub const SOFTNESS: usize = 9;
    pub const TANGENT: usize = SOFTNESS + super::softness::LEN;
    /// Axes of a cylinder or an ellipsoid; the first is the way from the middle of a box to its corner.
    pub const AXES: usize = TANGENT + 3;
    pub const LEN: usize = AXES + 9;
}

/// Places in a [`Softness`].
pub mod softness {
    pub const STIFFNESS: usize = 0;
    pub const DAMPING: usize = 1;
    pub const LOWEST: usize = 2;
    pub const SPAN: usize = 3;
    pub const INVERSE_WIDTH: usize = 4;
    pub const MIDPOINT: usize = 5;
    pub const LEN: usize = 6;
}

impl Shape {
    /// Numbers of a thread.
    pub const fn limb_len(&self) -> usize {
        self.joints * link::LEN + self.slots * point::LEN
    }

    /// Numbers of a model.
    pub const fn row(&self) -> usize {
        root::LEN + self.lanes * self.limb_len()
    }

    /// Where a joint's numbers begin in those of a thread.
    #[expect(clippy::unused_self, reason = "as for contact points")]
    pub const fn link(&self, joint: usize) -> usize {
        joint * link::LEN
    }

    /// Where a contact point's numbers begin in those of a thread.
    pub const fn point(&self, slot: usize) -> usize {
        self.joints * link::LEN + slot * point::LEN
    }
}

/// Stands for no limit: WGSL knows no infinities.
const FAR: f64 = 1e30;
const IDENTITY: [Vector; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

/// A row of constants while it is written.
struct Row(Vec<f64>);

impl Row {
    fn put(&mut self, values: &[f64]) {
        self.0.extend(values.iter().map(|value| value.clamp(-FAR, FAR)));
    }

    fn body(&mut self, inertia: &Inertia) {
        self.put(&[inertia.mass]);
        self.put(&inertia.com);
        self.put(&inertia.tensor);
        self.put(&[inertia.compensated]);
        self.put(&inertia.compensated_com);
    }

    fn softness(&mut self, softness: &Softness) {
        let [lowest, highest] = softness.impedance;
        self.put(&[softness.stiffness, softness.damping, lowest, highest - lowest]);
        self.put(&[1.0 / softness.width, softness.midpoint]);
    }

    fn link(&mut self, link: &Link) {
        self.put(&link.offset);
        self.put(link.axes.as_flattened());
        self.put(&[link.zero]);
        self.body(&link.inertia);
        self.put(&[link.armature, link.damping, link.stiffness, link.spring_reference, link.friction_loss]);
        // Dry friction has no violation, so its impedance is that at 0.
        let impedance = link.friction_softness.impedance[0];
        self.put(&[impedance / ((1.0 - impedance) * link.inverse_weight), link.friction_softness.damping]);
        self.put(&link.range);
        self.put(&[link.margin]);
        self.softness(&link.limit);
        self.put(&[link.inverse_weight]);
        let unlimited = [-FAR, FAR];
        if let Some(actuator) = &link.actuator {
            self.put(&[actuator.gear, actuator.gain]);
            self.put(&actuator.bias);
            self.put(&actuator.ctrl_range);
            self.put(&actuator.force_range);
        } else {
            self.put(&[0.0; 5]);
            self.put(&unlimited);
            self.put(&unlimited);
        }
        self.put(&link.actuator_range);
    }

    /// A joint beyond the end of a limb: positive inertia and no limits; nothing hangs on it and nothing moves it.
    fn completing_joint(&mut self) {
        let rigid = Softness {
            stiffness: 1.0,
            damping: 1.0,
            impedance: [0.5; 2],
            width: 1.0,
            midpoint: 0.5,
            power: 1,
        };
        let unlimited = [-FAR, FAR];
        let nothing = Inertia {
            mass: 0.0,
            com: [0.0; 3],
            tensor: [0.0; 6],
            compensated: 0.0,
            compensated_com: [0.0; 3],
        };
        self.link(&Link {
            offset: [0.0; 3],
            axes: IDENTITY,
            zero: 0.0,
            inertia: nothing,
            armature: 1.0,
            damping: 0.0,
            stiffness: 0.0,
            spring_reference: 0.0,
            friction_loss: 0.0,
            friction_softness: rigid,
            actuator_range: unlimited,
            range: unlimited,
            margin: 0.0,
            limit: rigid,
            inverse_weight: 1.0,
            dof: 0,
            actuator: None,
        });
    }

    fn point(&mut self, point: &Point, model: &Model) {
        self.put(&point.position);
        self.put(&point.size);
        let sliding = point.friction[0];
        let square = sliding * sliding;
        // Documentation: Computation, "Constraint model", diagonal approximation; for a pyramid MuJoCo takes
        // 2 μ² (1 + μ²) times the inverse weight for each of its edges.
        let scale = match model.cone {
            Cone::Pyramidal => 2.0 * square / model.impedance_ratio * (1.0 + square),
            Cone::Elliptic => 1.0,
        };
        self.put(&[point.margin, sliding, scale * point.inverse_weight]);
        self.softness(&point.softness);
        self.put(&point.tangent.unwrap_or_default());
        match point.surface {
            Surface::Ball | Surface::Corner => self.put(&[0.0; 9]),
            Surface::Rim { axes, .. } | Surface::Ellipsoid { axes } => self.put(axes.as_flattened()),
        }
    }

    /// A point that never touches.
    fn absent_point(&mut self) {
        let start = self.0.len();
        self.0.resize(start + point::LEN, 0.0);
        let numbers = &mut self.0[start..];
        numbers[point::MARGIN] = -FAR;
        numbers[point::FRICTION] = 1.0;
        numbers[point::RESISTANCE] = 1.0;
        numbers[point::SIZE..point::SIZE + 3].fill(1.0);
        for (number, axis) in numbers[point::AXES..].iter_mut().zip(IDENTITY.as_flattened()) {
            *number = *axis;
        }
        let impedance = &mut numbers[point::SOFTNESS..][..softness::LEN];
        impedance.copy_from_slice(&[1.0, 1.0, 0.5, 0.0, 1.0, 0.5]);
    }
}

/// The row of a model, `[shape.row()]`.
pub fn row(skeleton: &Skeleton, model: &Model) -> Vec<f64> {
    let shape = &skeleton.shape;
    let mut row = Row(Vec::with_capacity(shape.row()));
    row.put(&[model.timestep]);
    // Not −g, which would be −0 along x and y.
    row.put(&model.gravity.map(|g| 0.0 - g));
    row.put(&[model.floor, 1.0 / (model.mean_inertia * model.dofs() as f64)]);
    row.body(&model.root);
    row.put(&[model.root_armature, model.root_damping]);
    for lane in 0..shape.lanes {
        for joint in 0..shape.joints {
            match model.limbs.get(lane).and_then(|limb| limb.get(joint)) {
                Some(link) => row.link(link),
                None => row.completing_joint(),
            }
        }
        for slot in 0..shape.slots {
            match skeleton.points[lane][slot].and_then(|index| model.points.get(index)) {
                Some(point) => row.point(point, model),
                None => row.absent_point(),
            }
        }
    }
    row.0
}
