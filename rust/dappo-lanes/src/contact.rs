//! Contacts of points with the floor as pyramidal friction cones.
//! (Documentation: Computation, "Constraint model", contacts; "Contact", pyramidal cones.)

use crate::constants::{Carrier, Constants, PointConstants, Skeleton};
use crate::coords::Coords;
use crate::kinematics::Kinematics;
use crate::lane::{Lane, Mask};
use crate::math::{Axes, Vec3, add, cross, rotate, scale_add, splat3, sub, zero3};

/// One point that touches the floor in some lane.
///
/// The pyramid's four edges are n ± μ t₁ and n ± μ t₂ with the floor's normal n; their constraints follow
/// from three numbers, one along each of n, μ t₁ and μ t₂.
#[derive(Clone, Copy)]
pub struct Contact<T: Lane, const J: usize> {
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
    /// 1/R of every edge, and 0 in lanes without the contact.
    pub weight: T,
    /// Reference acceleration along n, μ t₁, μ t₂.
    pub reference: Vec3<T>,
    /// J a − reference at the solver's present point.
    pub residual: Vec3<T>,
    /// Change of the residual along the solver's search direction.
    pub slope: Vec3<T>,
    /// Lanes in which each edge pushes at the beginning of a line search.
    pub active: [T::Mask; 4],
}

impl<T: Lane, const J: usize> Contact<T, J> {
    /// J x: velocity (or acceleration) of the contact along n, μ t₁, μ t₂.
    #[inline(always)]
    pub fn along<const L: usize>(&self, x: &Coords<T, L, J>) -> Vec3<T> {
        let linear = [x.root[0], x.root[1], x.root[2]];
        let mut v = add(linear, cross(x.angular(), self.at));
        if let Some((limb, joints)) = self.limb {
            for joint in 0..joints {
                v = scale_add(self.columns[joint], x.limbs[limb][joint], v);
            }
        }
        let [x, y] = self.tangent;
        [v[2], x.mul_add(v[0], y * v[1]), x.mul_add(v[1], -(y * v[0]))]
    }

    /// The world's components of a force with components along n, μ t₁, μ t₂.
    #[inline(always)]
    pub fn world(&self, [normal, first, second]: Vec3<T>) -> Vec3<T> {
        let [x, y] = self.tangent;
        [x * first - y * second, y.mul_add(first, x * second), normal]
    }

    /// The four edges' residuals, from those along n, μ t₁, μ t₂.
    #[inline(always)]
    pub fn edges([normal, first, second]: Vec3<T>) -> [T; 4] {
        [normal + first, normal - first, normal + second, normal - second]
    }

    /// Forces along n, μ t₁, μ t₂ at the solver's present point: −D · residual where an edge pushes.
    #[inline(always)]
    pub fn force(&self) -> Vec3<T> {
        let mut f = Self::edges(self.residual);
        for edge in &mut f {
            *edge = -(self.weight * edge.min(T::zero()));
        }
        [(f[0] + f[1]) + (f[2] + f[3]), f[0] - f[1], f[2] - f[3]]
    }
}

/// Finds the contacts of all points, and the lanes in which there is any; `height` is the root's above the
/// floor.
#[inline(always)]
pub fn find_contacts<T: Lane, const L: usize, const J: usize>(
    skeleton: &Skeleton<T, L, J>,
    constants: &Constants<T, L, J>,
    kinematics: &Kinematics<T, L, J>,
    height: T,
    velocity: &Coords<T, L, J>,
    out: &mut Vec<Contact<T, J>>,
) -> T::Mask {
    out.clear();
    let mut present = T::Mask::none();
    for (index, (carrier, point)) in skeleton.points.iter().zip(&constants.points).enumerate() {
        let (axes, origin) = match carrier.link {
            None => (&kinematics.root, zero3()),
            Some((limb, joint)) => {
                let pose = &kinematics.links[limb][joint];
                (&pose.axes, pose.anchor)
            }
        };
        let lift = point.position[2]
            .mul_add(axes[2][2], point.position[1].mul_add(axes[1][2], point.position[0] * axes[0][2]));
        let distance = height + origin[2] + lift - point.radius;
        let mut touching = distance.lt(T::splat(carrier.margin));
        if !touching.any() {
            continue;
        }
        if let Some(corner) = carrier.corner {
            // MuJoCo takes the corners below the middle of a box and leaves out those above.
            touching = touching & !T::zero().lt(rotate(axes, splat3(corner))[2]);
        }
        present = present | touching;
        let center = add(origin, rotate(axes, point.position));
        // The contact lies midway between floor and surface.
        let at = [center[0], center[1], center[2] - point.radius - T::of(0.5) * distance];
        out.push(Contact {
            point: index,
            limb: carrier.link.map(|(limb, joint)| (limb, joint + 1)),
            at,
            tangent: tangent(carrier, point, axes),
            columns: columns(carrier, kinematics, at),
            weight: T::zero(),
            reference: zero3(),
            residual: zero3(),
            slope: zero3(),
            active: [T::Mask::none(); 4],
        });
        if let Some(contact) = out.last_mut() {
            soften(contact, skeleton, carrier, point, distance, touching, velocity);
        }
    }
    present
}

/// x and y of μ t₁: the floor's projection of the capsule's axis, or the world's y (`mju_makeFrame`).
#[inline(always)]
fn tangent<T: Lane>(carrier: &Carrier<T>, point: &PointConstants<T>, axes: &Axes<T>) -> [T; 2] {
    let Some(direction) = carrier.tangent else {
        return [T::zero(), point.friction];
    };
    let along = rotate(axes, splat3(direction));
    let length = along[0].mul_add(along[0], along[1] * along[1]).sqrt();
    // Upright: MuJoCo falls back on x.
    let upright = length.lt(T::of(1e-15));
    let factor = point.friction / T::select(upright, T::of(1.0), length);
    [T::select(upright, point.friction, along[0] * factor), (along[1] * factor).keep(!upright)]
}

#[inline(always)]
fn columns<T: Lane, const L: usize, const J: usize>(
    carrier: &Carrier<T>,
    kinematics: &Kinematics<T, L, J>,
    at: Vec3<T>,
) -> [Vec3<T>; J] {
    let mut columns = [zero3(); J];
    if let Some((limb, last)) = carrier.link {
        for joint in 0..last + 1 {
            columns[joint] = kinematics.links[limb][joint].velocity_at(at);
        }
    }
    columns
}

/// Weight and reference acceleration (documentation: Computation, "Constraint model", "Impedance" and
/// "Reference acceleration").
#[inline(always)]
fn soften<T: Lane, const L: usize, const J: usize>(
    contact: &mut Contact<T, J>,
    skeleton: &Skeleton<T, L, J>,
    carrier: &Carrier<T>,
    point: &PointConstants<T>,
    distance: T,
    touching: T::Mask,
    velocity: &Coords<T, L, J>,
) {
    let softness = &skeleton.contact;
    let violation = distance - T::splat(carrier.margin);
    let impedance = softness.at(violation.abs());
    contact.weight = (impedance / ((T::of(1.0) - impedance) * point.softness)).keep(touching);
    let damping = T::splat(softness.damping);
    let v = contact.along(velocity);
    let pull = T::splat(softness.stiffness) * impedance * violation;
    contact.reference = [-(damping * v[0]) - pull, -(damping * v[1]), -(damping * v[2])];
}

/// Force and torque about `center` of a contact's force at the solver's present point.
#[inline(always)]
pub fn wrench<T: Lane, const J: usize>(contact: &Contact<T, J>, center: Vec3<T>) -> (Vec3<T>, Vec3<T>) {
    let force = contact.world(contact.force());
    (force, cross(sub(contact.at, center), force))
}
