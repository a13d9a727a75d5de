//! Contacts of points with the floor.
//! (Documentation: Computation, "Constraint model", contacts.)

use crate::cone::ConeContact;
use crate::constants::{Constants, PointConstants};
use crate::coords::Coords;
use crate::kinematics::{Kinematics, LinkPose};
use crate::lane::{Lane, Mask};
use crate::math::{
    Axes, Vec3, add, cross, dot, negate, rotate, scale, scale_add, splat3, sub, turned, zero3,
};
use crate::model::RimPlace;
use crate::pyramid::Pyramid;
use crate::skeleton::{Carrier, Shape, Skeleton};

/// The contacts of an evaluation, each kind in the order of the points.
pub struct Contacts<T: Lane, const J: usize, const W: usize> {
    /// Contacts with sliding friction in a pyramid, the only ones of most robots.
    pub pyramids: Vec<Pyramid<T, J, W>>,
    /// The others.
    pub cones: Vec<ConeContact<T, J, W>>,
    /// The pyramids of the evaluation before.
    before: Vec<Pyramid<T, J, W>>,
}

/// Where a point touches the floor in some lane, and how that moves with the robot.
#[derive(Clone, Copy)]
pub struct Contact<T: Lane, const J: usize, const W: usize> {
    /// Index of the point.
    pub point: usize,
    /// Limb of the point, and how many of its joints move the point.
    pub limb: Option<(usize, usize)>,
    /// The contact, from the root's origin.
    pub at: Vec3<T>,
    /// x and y of μ t₁; t₂ is t₁ turned by 90°: t₂ = n × t₁.
    pub tangent: [T; 2],
    /// Velocity of the contact when each joint of the limb turns with 1 rad/s.
    pub columns: [Vec3<T>; J],
    /// Velocity of the contact when each joint of the trunk turns with 1 rad/s.
    pub trunk_columns: [Vec3<T>; W],
    /// How many of these move the contact besides the joints of its limb.
    carried_by: usize,
    /// 1/R of the normal or of every edge, and 0 in lanes without the contact.
    pub weight: T,
    /// Reference acceleration along n, μ t₁ and μ t₂.
    pub reference: Vec3<T>,
}

impl<T: Lane, const J: usize, const W: usize> Contact<T, J, W> {
    /// How many joints of the trunk move the contact besides those of its limb.
    #[inline(always)]
    pub fn trunk_joints(&self) -> usize {
        // The bound takes loops over them out of the code for robots without a trunk.
        self.carried_by.min(W)
    }

    /// J x: velocity (or acceleration) of the contact along n, μ t₁, μ t₂.
    #[inline(always)]
    pub fn along<const L: usize>(&self, x: &Coords<T, L, J>) -> Vec3<T> {
        let linear = [x.root[0], x.root[1], x.root[2]];
        let mut v = add(linear, cross(x.angular(), self.at));
        if let Some((limb, joints)) = self.limb {
            for joint in 0..joints {
                v = scale_add(self.columns[joint], x.limbs[limb][joint], v);
            }
            for joint in 0..self.trunk_joints() {
                v = scale_add(self.trunk_columns[joint], x.limbs[0][joint], v);
            }
        }
        let [x, y] = self.tangent;
        [v[2], x.mul_add(v[0], y * v[1]), x.mul_add(v[1], -(y * v[0]))]
    }

    /// Whether the solver adds it together with a limb: its own, or limb 0 for contacts of the root.
    #[inline(always)]
    pub fn is_added_with(&self, limb: usize) -> bool {
        self.limb.map_or(0, |(own, _)| own) == limb
    }

    /// J x − reference.
    #[inline(always)]
    pub fn residual<const L: usize>(&self, x: &Coords<T, L, J>) -> Vec3<T> {
        sub(self.along(x), self.reference)
    }

    /// The world's components of a force with components along n, μ t₁, μ t₂.
    #[inline(always)]
    pub fn world(&self, [normal, first, second]: Vec3<T>) -> Vec3<T> {
        let [x, y] = self.tangent;
        [x * first - y * second, y.mul_add(first, x * second), normal]
    }

    /// Force, and torque about `center`, whose components along n, μ t₁, μ t₂ are minus a gradient.
    #[inline(always)]
    pub fn wrench(&self, gradient: Vec3<T>, center: Vec3<T>) -> (Vec3<T>, Vec3<T>) {
        let force = negate(self.world(gradient));
        (force, cross(sub(self.at, center), force))
    }
}

impl<T: Lane, const J: usize, const W: usize> Contacts<T, J, W> {
    /// Room for the contacts of a robot.
    pub fn new(points: usize) -> Self {
        Self { pyramids: Vec::with_capacity(points), cones: Vec::new(), before: Vec::with_capacity(points) }
    }

    /// Forgets the evaluation before.
    #[inline(always)]
    pub fn forget(&mut self) {
        self.pyramids.clear();
    }

    /// Finds the contacts of all points; `height` is the root's above the floor.
    #[inline(always)]
    pub fn update<const L: usize>(
        &mut self,
        skeleton: &Skeleton<T, L, J>,
        constants: &Constants<T, L, J>,
        kinematics: &Kinematics<T, L, J>,
        height: T,
        velocity: &Coords<T, L, J>,
    ) {
        std::mem::swap(&mut self.pyramids, &mut self.before);
        self.pyramids.clear();
        self.cones.clear();
        let mut before = self.before.as_slice();
        for (index, (carrier, point)) in skeleton.points.iter().zip(&constants.points).enumerate() {
            let Some((at, distance, touching)) = place(carrier, point, kinematics, height) else {
                continue;
            };
            let carried_by = trunk_joints(carrier, skeleton);
            let mut contact = Contact {
                point: index,
                limb: carrier.link.map(|(limb, joint)| (limb, joint + 1)),
                at,
                tangent: tangent(carrier, point, kinematics),
                columns: match carrier.link {
                    None => [zero3(); J],
                    Some((limb, last)) => columns(&kinematics.links[limb], last + 1, at),
                },
                trunk_columns: columns(&kinematics.links[0], carried_by, at),
                carried_by,
                weight: T::zero(),
                reference: zero3(),
            };
            soften(&mut contact, carrier, point, distance, touching, velocity);
            if carrier.is_plain() {
                while let [first, rest @ ..] = before
                    && first.contact.point < index
                {
                    before = rest;
                }
                let same = before.first().filter(|first| first.contact.point == index);
                self.pyramids.push(Pyramid::new(contact, same));
            } else {
                let cones = &mut self.cones;
                T::run(
                    #[inline(always)]
                    || cones.push(ConeContact::new(contact, carrier, point, kinematics, velocity)),
                );
            }
        }
    }
}

/// Where a point touches the floor, its distance, and in which lanes it touches, if it does in any.
#[inline(always)]
fn place<T: Lane, const L: usize, const J: usize>(
    carrier: &Carrier<T>,
    point: &PointConstants<T>,
    kinematics: &Kinematics<T, L, J>,
    height: T,
) -> Option<(Vec3<T>, T, T::Mask)> {
    let (axes, origin) = frame(carrier, kinematics);
    let (at, distance, touching) = match &carrier.shape {
        Shape::Ball | Shape::Corner => {
            let position = point.position;
            let lift =
                position[2].mul_add(axes[2][2], position[1].mul_add(axes[1][2], position[0] * axes[0][2]));
            let is_corner = matches!(carrier.shape, Shape::Corner);
            let radius = if is_corner { T::zero() } else { point.size[0] };
            let distance = height + origin[2] + lift - radius;
            let mut touching = distance.lt(T::splat(carrier.margin));
            // Most points are in the air, so that this is what costs.
            if !touching.any() {
                return None;
            }
            if is_corner {
                // MuJoCo takes the corners below the middle of a box and leaves out those above.
                touching = touching & !T::zero().lt(rotate(axes, point.size)[2]);
            }
            let center = add(origin, rotate(axes, position));
            // The contact lies midway between floor and surface.
            let at = [center[0], center[1], center[2] - radius - T::of(0.5) * distance];
            (at, distance, touching)
        }
        Shape::Rim(cylinder, place) => {
            let surface = T::run(
                #[inline(always)]
                || rim(&turned(axes, cylinder), *place, point.size),
            );
            touch(carrier, add(rotate(axes, point.position), surface), origin, height)
        }
        Shape::Ellipsoid(ellipsoid) => {
            let surface = T::run(
                #[inline(always)]
                || lowest(&turned(axes, ellipsoid), point.size),
            );
            touch(carrier, add(rotate(axes, point.position), surface), origin, height)
        }
    };
    touching.any().then_some((at, distance, touching))
}

/// Axes and origin of the frame that carries a point.
#[inline(always)]
fn frame<'a, T: Lane, const L: usize, const J: usize>(
    carrier: &Carrier<T>,
    kinematics: &'a Kinematics<T, L, J>,
) -> (&'a Axes<T>, Vec3<T>) {
    match carrier.link {
        None => (&kinematics.root, zero3()),
        Some((limb, joint)) => {
            let pose = &kinematics.links[limb][joint];
            (&pose.axes, pose.anchor)
        }
    }
}

/// The contact of a point of a surface, given from the carrier's origin: where it is, its distance, and in
/// which lanes it touches.
#[inline(always)]
fn touch<T: Lane>(
    carrier: &Carrier<T>,
    surface: Vec3<T>,
    origin: Vec3<T>,
    height: T,
) -> (Vec3<T>, T, T::Mask) {
    let [x, y, z] = add(origin, surface);
    let distance = height + z;
    let at = [x, y, T::of(0.5).neg_mul_add(distance, z)];
    (at, distance, distance.lt(T::splat(carrier.margin)))
}

/// A point of a cylinder from its centre, as MuJoCo chooses those that touch a plane (`mjc_PlaneCylinder`).
#[inline(always)]
fn rim<T: Lane>(cylinder: &Axes<T>, place: RimPlace, size: Vec3<T>) -> Vec3<T> {
    let (zero, one) = (T::zero(), T::of(1.0));
    let [radius, half, _] = size;
    // The axis, pointing downwards.
    let upwards = zero.lt(cylinder[2][2]);
    let axis = scale(cylinder[2], T::select(upwards, -one, one));
    // The steepest way down across the axis; across a vertical one, x.
    let down = [axis[2] * axis[0], axis[2] * axis[1], axis[2].mul_add(axis[2], -one)];
    let square = dot(down, down);
    let vertical = square.lt(T::of(1e-30));
    let factor = T::select(vertical, one, one / T::select(vertical, one, square).sqrt());
    let mut across = zero3();
    for i in 0..3 {
        across[i] = radius * factor * T::select(vertical, cylinder[0][i], down[i]);
    }
    let end = scale(axis, half);
    match place {
        RimPlace::Lowest => add(across, end),
        RimPlace::OtherEnd => sub(across, end),
        RimPlace::Left | RimPlace::Right => {
            let sideways = cross(across, end);
            let length = dot(sideways, sideways).sqrt();
            let half_side = radius * T::of(0.5 * 3_f64.sqrt());
            let factor = if place == RimPlace::Left { half_side } else { -half_side } / length;
            scale_add(sideways, factor, scale_add(across, T::of(-0.5), end))
        }
    }
}

/// The lowest point of an ellipsoid, from its centre.
#[inline(always)]
fn lowest<T: Lane>(ellipsoid: &Axes<T>, size: Vec3<T>) -> Vec3<T> {
    // A sphere stretched by the semi-axes: its lowest point lies against the stretched normal.
    let down = [-(size[0] * ellipsoid[0][2]), -(size[1] * ellipsoid[1][2]), -(size[2] * ellipsoid[2][2])];
    let inverse = T::of(1.0) / dot(down, down).sqrt();
    rotate(ellipsoid, [size[0] * down[0] * inverse, size[1] * down[1] * inverse, size[2] * down[2] * inverse])
}

/// x and y of μ t₁: the floor's projection of the capsule's axis, or the world's y (`mju_makeFrame`).
#[inline(always)]
fn tangent<T: Lane, const L: usize, const J: usize>(
    carrier: &Carrier<T>,
    point: &PointConstants<T>,
    kinematics: &Kinematics<T, L, J>,
) -> [T; 2] {
    let Some(direction) = carrier.tangent else {
        return [T::zero(), point.friction];
    };
    let along = rotate(frame(carrier, kinematics).0, splat3(direction));
    let length = along[0].mul_add(along[0], along[1] * along[1]).sqrt();
    // Upright: MuJoCo falls back on x.
    let upright = length.lt(T::of(1e-15));
    let factor = point.friction / T::select(upright, T::of(1.0), length);
    [T::select(upright, point.friction, along[0] * factor), (along[1] * factor).keep(!upright)]
}

/// How many joints of the trunk move the limb that carries a point.
#[inline(always)]
fn trunk_joints<T: Lane, const L: usize, const J: usize>(
    carrier: &Carrier<T>,
    skeleton: &Skeleton<T, L, J>,
) -> usize {
    let parent = carrier.link.and_then(|(limb, _)| skeleton.parents[limb]);
    parent.map_or(0, |last| last + 1)
}

/// Velocity of a point when each of the first `count` links turns with 1 rad/s.
#[inline(always)]
fn columns<T: Lane, const N: usize>(links: &[LinkPose<T>], count: usize, at: Vec3<T>) -> [Vec3<T>; N] {
    let mut columns = [zero3(); N];
    for joint in 0..count.min(N) {
        columns[joint] = links[joint].velocity_at(at);
    }
    columns
}

/// Weight and reference acceleration (documentation: Computation, "Constraint model", "Impedance" and
/// "Reference acceleration").
#[inline(always)]
fn soften<T: Lane, const L: usize, const J: usize, const W: usize>(
    contact: &mut Contact<T, J, W>,
    carrier: &Carrier<T>,
    point: &PointConstants<T>,
    distance: T,
    touching: T::Mask,
    velocity: &Coords<T, L, J>,
) {
    let softness = &carrier.softness;
    let violation = distance - T::splat(carrier.margin);
    let impedance = softness.at(violation.abs());
    contact.weight = (impedance / ((T::of(1.0) - impedance) * point.softness)).keep(touching);
    let damping = T::splat(softness.damping);
    let v = contact.along(velocity);
    let pull = T::splat(softness.stiffness) * impedance * violation;
    contact.reference = [-(damping * v[0]) - pull, -(damping * v[1]), -(damping * v[2])];
}
