//! Contacts of points with the floor.
//! (Documentation: Computation, "Constraint model", contacts.)

use crate::constants::{Carrier, Constants, PointConstants, Shape, Skeleton};
use crate::coords::Coords;
use crate::kinematics::Kinematics;
use crate::lane::{Lane, Mask};
use crate::math::{Axes, Vec3, add, cross, dot, rotate, scale, scale_add, splat3, sub, unrotate, zero3};
use crate::model::{Cone, RimPlace};

/// One point that touches the floor in some lane.
///
/// Its constraints follow from six numbers: one along each of the floor's normal n, μ t₁ and μ t₂, and one
/// about each of n, t₁ and t₂, scaled by the coefficients of torsional and rolling friction. Those about the
/// axes matter only with such friction.
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
    /// Coefficient of torsional friction, and that of rolling friction over μ.
    pub turning: [T; 2],
    /// Velocity of the contact when each joint of the limb turns with 1 rad/s.
    pub columns: [Vec3<T>; J],
    pub cone: Cone,
    /// Number of friction dimensions: 0, 2, 3 or 5.
    pub frictions: usize,
    /// 1/R of the normal or of every edge, and 0 in lanes without the contact.
    pub weight: T,
    /// Square of the friction of the regularised elliptic cone.
    pub cone_friction: T,
    /// Reference acceleration.
    pub reference: Residual<T>,
    /// J a − reference at the solver's present point.
    pub residual: Residual<T>,
    /// Change of the residual along the solver's search direction.
    pub slope: Residual<T>,
    /// Lanes in which each edge of a pyramid pushes at the beginning of a line search.
    pub active: [T::Mask; 4],
}

/// The numbers of a contact's constraints.
#[derive(Clone, Copy)]
pub struct Residual<T> {
    /// Along n, μ t₁ and μ t₂.
    pub linear: Vec3<T>,
    /// About n, t₁ and t₂, scaled by the coefficients of friction.
    pub angular: Vec3<T>,
}

impl<T: Lane> Residual<T> {
    #[inline(always)]
    pub fn zero() -> Self {
        Self { linear: zero3(), angular: zero3() }
    }
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

    /// J x about n, t₁ and t₂. A function of its own, since few robots have such friction.
    #[inline(always)]
    pub fn around<const L: usize>(&self, kinematics: &Kinematics<T, L, J>, x: &Coords<T, L, J>) -> Vec3<T> {
        T::run(
            #[inline(always)]
            || self.turned_around(kinematics, x),
        )
    }

    #[inline(always)]
    fn turned_around<const L: usize>(
        &self,
        kinematics: &Kinematics<T, L, J>,
        x: &Coords<T, L, J>,
    ) -> Vec3<T> {
        let mut angular = x.angular();
        if let Some((limb, joints)) = self.limb {
            for joint in 0..joints {
                angular = scale_add(kinematics.links[limb][joint].hinge(), x.limbs[limb][joint], angular);
            }
        }
        unrotate(&self.turning_axes(), angular)
    }

    /// n, t₁ and t₂, scaled by the coefficients of torsional and rolling friction.
    #[inline(always)]
    pub fn turning_axes(&self) -> Axes<T> {
        let zero = T::zero();
        let [torsional, rolling] = self.turning;
        let [x, y] = [rolling * self.tangent[0], rolling * self.tangent[1]];
        [[zero, zero, torsional], [x, y, zero], [-y, x, zero]]
    }

    /// n, μ t₁ and μ t₂.
    #[inline(always)]
    pub fn axes(&self) -> Axes<T> {
        let (zero, one) = (T::zero(), T::of(1.0));
        let [x, y] = self.tangent;
        [[zero, zero, one], [x, y, zero], [-y, x, zero]]
    }

    /// The world's components of a force with components along n, μ t₁, μ t₂.
    #[inline(always)]
    pub fn world(&self, [normal, first, second]: Vec3<T>) -> Vec3<T> {
        let [x, y] = self.tangent;
        [x * first - y * second, y.mul_add(first, x * second), normal]
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
        let (at, distance, touching) = match &carrier.shape {
            Shape::Ball | Shape::Corner(_) => {
                let position = point.position;
                let lift = position[2]
                    .mul_add(axes[2][2], position[1].mul_add(axes[1][2], position[0] * axes[0][2]));
                let radius = point.size[0];
                let distance = height + origin[2] + lift - radius;
                let mut touching = distance.lt(T::splat(carrier.margin));
                // Most points are in the air, so that this is what costs.
                if !touching.any() {
                    continue;
                }
                if let Shape::Corner(way) = carrier.shape {
                    // MuJoCo takes the corners below the middle of a box and leaves out those above.
                    touching = touching & !T::zero().lt(rotate(axes, splat3(way))[2]);
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
        if !touching.any() {
            continue;
        }
        present = present | touching;
        out.push(Contact {
            point: index,
            limb: carrier.link.map(|(limb, joint)| (limb, joint + 1)),
            at,
            tangent: tangent(carrier, point, axes),
            turning: [point.torsional, point.rolling],
            columns: columns(carrier, kinematics, at),
            cone: carrier.cone,
            frictions: carrier.frictions,
            weight: T::zero(),
            cone_friction: point.cone_friction,
            reference: Residual::zero(),
            residual: Residual::zero(),
            slope: Residual::zero(),
            active: [T::Mask::none(); 4],
        });
        if let Some(contact) = out.last_mut() {
            soften(contact, kinematics, carrier, point, distance, touching, velocity);
        }
    }
    present
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

/// Axes that are given in a frame, in the world's coordinates.
#[inline(always)]
fn turned<T: Lane>(axes: &Axes<T>, inner: &[[T::Scalar; 3]; 3]) -> Axes<T> {
    [rotate(axes, splat3(inner[0])), rotate(axes, splat3(inner[1])), rotate(axes, splat3(inner[2]))]
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
    kinematics: &Kinematics<T, L, J>,
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
    contact.reference.linear = [-(damping * v[0]) - pull, -(damping * v[1]), -(damping * v[2])];
    if contact.turns() {
        contact.reference.angular = scale(contact.around(kinematics, velocity), -damping);
    }
}

/// Force and torque about `center` of a contact at the solver's present point.
#[inline(always)]
pub fn wrench<T: Lane, const J: usize>(contact: &Contact<T, J>, center: Vec3<T>) -> (Vec3<T>, Vec3<T>) {
    let force = scale(contact.world(contact.push().gradient), -T::of(1.0));
    let mut torque = cross(sub(contact.at, center), force);
    if contact.turns() {
        torque = sub(torque, rotate(&contact.turning_axes(), contact.turn().gradient));
    }
    (force, torque)
}
