//! Contacts of points with the floor.
//! (Documentation: Computation, "Constraint model", contacts.)

use cubecl::prelude::*;

use crate::constants::{point, softness};
use crate::coords::Coords;
use crate::impedance::impedance;
use crate::kinematics::LinkPose;
use crate::math::{Axes, V3, axes_at, copied_in_kernels, lit, v3_at};
use crate::shape::{Shape, SurfaceShape};
use crate::surface::{Touch, at_center, lowest, rim, touch};

/// A point that may touch the floor. Its weight is 0 while it does not.
#[derive(CubeType, Clone, Copy)]
pub struct Contact<F: Float> {
    /// The contact, from the root's origin.
    pub at: V3<F>,
    /// x and y of μ t₁; t₂ is t₁ turned by 90°: t₂ = n × t₁.
    pub tx: F,
    pub ty: F,
    /// 1/R of every edge of the pyramid.
    pub weight: F,
    /// Reference acceleration along n, μ t₁ and μ t₂.
    pub reference: V3<F>,
}
copied_in_kernels!(ContactExpand);

/// The contact points of a thread.
#[derive(CubeType)]
pub struct Contacts<F: Float> {
    /// [slots]
    pub rows: Sequence<Contact<F>>,
    /// Velocity of each point when a joint of the limb turns with 1 rad/s, `[slots][joints]`.
    pub columns: Sequence<V3<F>>,
}

#[cube]
impl<F: Float> Contact<F> {
    /// Components along n, μ t₁, μ t₂ of a vector along the world's axes.
    pub fn own(self, v: V3<F>) -> V3<F> {
        V3::<F>::new(v.z, fma(self.tx, v.x, self.ty * v.y), fma(self.tx, v.y, -(self.ty * v.x)))
    }

    /// The world's components of a force with components along n, μ t₁, μ t₂.
    pub fn world(self, f: V3<F>) -> V3<F> {
        V3::<F>::new(self.tx * f.y - self.ty * f.z, fma(self.ty, f.y, self.tx * f.z), f.x)
    }
}

/// J x: velocity (or acceleration) of a contact along n, μ t₁, μ t₂.
#[cube]
pub fn along<F: Float>(
    contact: Contact<F>,
    columns: &Sequence<V3<F>>,
    x: &Coords<F>,
    #[comptime] slot: usize,
    #[comptime] shape: Shape,
) -> V3<F> {
    let mut v = x.linear() + x.angular().cross(contact.at);
    #[unroll]
    for joint in 0..comptime!(shape.slot[slot].moved_by) {
        v = columns[comptime!(slot * shape.joints + joint)].times_plus(x.limb[joint], v);
    }
    contact.own(v)
}

/// The contacts of all points of a thread; `height` is the root's above the floor.
#[cube]
pub fn contacts<F: Float>(
    numbers: &[F],
    limb: usize,
    height: F,
    root: Axes<F>,
    links: &Sequence<LinkPose<F>>,
    velocity: &Coords<F>,
    #[comptime] shape: Shape,
) -> Contacts<F> {
    let zero = lit::<F>(0.0);
    let one = lit::<F>(1.0);
    let mut rows = Sequence::<Contact<F>>::new();
    let mut columns = Sequence::<V3<F>>::new();
    #[unroll]
    for slot in 0..comptime!(shape.slots) {
        let own = comptime!(shape.slot[slot]);
        let carrier = comptime!(own.moved_by.wrapping_sub(1));
        let axes = if comptime!(own.moved_by == 0) { root } else { links[carrier].axes };
        let origin = if comptime!(own.moved_by == 0) { V3::<F>::zero() } else { links[carrier].anchor };
        let at = limb + comptime!(shape.point(slot));
        let touch = place::<F>(numbers, at, axes, origin, height, comptime!(own.surface));
        #[unroll]
        for joint in 0..comptime!(shape.joints) {
            if comptime!(joint < own.moved_by) {
                let pose = links[joint];
                columns.push(pose.axes.z.cross(touch.at - pose.anchor));
            } else {
                columns.push(V3::<F>::zero());
            }
        }
        let violation = touch.distance - numbers[at + point::MARGIN];
        let d = impedance::<F>(numbers, at + point::SOFTNESS, violation.abs(), own.power);
        let weight = d / ((one - d) * numbers[at + point::RESISTANCE]);
        let direction = tangent::<F>(numbers, at, axes, own.follows);
        let silent = Contact::<F> {
            at: touch.at,
            tx: direction.x,
            ty: direction.y,
            weight: select(touch.touching, weight, zero),
            reference: V3::<F>::zero(),
        };
        let damping = numbers[at + point::SOFTNESS + softness::DAMPING];
        let v = along::<F>(silent, &columns, velocity, slot, shape) * -damping;
        let pull = numbers[at + point::SOFTNESS + softness::STIFFNESS] * d * violation;
        rows.push(Contact::<F> {
            at: touch.at,
            tx: silent.tx,
            ty: silent.ty,
            weight: silent.weight,
            reference: V3::<F>::new(v.x - pull, v.y, v.z),
        });
    }
    Contacts::<F> { rows, columns }
}

/// Where a point touches the floor, its distance, and whether it touches.
#[cube]
fn place<F: Float>(
    numbers: &[F],
    at: usize,
    axes: Axes<F>,
    origin: V3<F>,
    height: F,
    #[comptime] surface: SurfaceShape,
) -> Touch<F> {
    let margin = numbers[at + point::MARGIN];
    let center = origin + axes.rotate(v3_at::<F>(numbers, at + point::POSITION));
    if comptime!(surface == SurfaceShape::Ball) {
        at_center::<F>(center, numbers[at + point::SIZE], height, margin)
    } else if comptime!(surface == SurfaceShape::Corner) {
        let corner = at_center::<F>(center, lit::<F>(0.0), height, margin);
        // MuJoCo takes the corners below the middle of a box and leaves out those above.
        let way = axes.rotate(v3_at::<F>(numbers, at + point::SIZE));
        Touch::<F> {
            at: corner.at,
            distance: corner.distance,
            touching: corner.touching && way.z <= lit::<F>(0.0),
        }
    } else {
        let size = v3_at::<F>(numbers, at + point::SIZE);
        let own = axes.turned(axes_at::<F>(numbers, at + point::AXES));
        let surface = if comptime!(surface == SurfaceShape::Ellipsoid) {
            lowest::<F>(own, size)
        } else {
            rim::<F>(own, size, surface)
        };
        touch::<F>(center + surface, height, margin)
    }
}

/// x and y of μ t₁: the floor's projection of the capsule's axis, or the world's y (`mju_makeFrame`).
#[cube]
fn tangent<F: Float>(numbers: &[F], at: usize, axes: Axes<F>, #[comptime] follows: bool) -> V3<F> {
    let zero = lit::<F>(0.0);
    let friction = numbers[at + point::FRICTION];
    if comptime!(follows) {
        let t = axes.rotate(v3_at::<F>(numbers, at + point::TANGENT));
        let length = fma(t.x, t.x, t.y * t.y).sqrt();
        // Upright: MuJoCo falls back on x.
        let upright = length < lit::<F>(1e-15);
        let factor = friction / select(upright, lit::<F>(1.0), length);
        V3::<F>::new(select(upright, friction, t.x * factor), select(upright, zero, t.y * factor), zero)
    } else {
        V3::<F>::new(zero, friction, zero)
    }
}
