//! Where everything is: frames, anchors and centres of mass, along the world's axes and from the root's
//! origin. (Documentation: Computation, "Kinematic tree".)

use crate::constants::Constants;
use crate::coords::Coords;
use crate::lane::Lane;
use crate::math::{
    Axes, Vec3, add, cross, quat_axes, quat_normalize, rotate, scale, scale_add, sin_cos, sub, turned, zero3,
};
use crate::skeleton::Skeleton;
use crate::state::Position;

/// The frames of all links.
pub struct Kinematics<T, const L: usize, const J: usize> {
    pub root: Axes<T>,
    pub root_com: Vec3<T>,
    pub links: [[LinkPose<T>; J]; L],
}

/// The frame of one link.
#[derive(Clone, Copy)]
pub struct LinkPose<T> {
    /// Axes of the link; the third is the hinge's.
    pub axes: Axes<T>,
    /// Anchor of the hinge.
    pub anchor: Vec3<T>,
    /// Centre of mass.
    pub com: Vec3<T>,
    /// Velocity, at the root's origin, of a body that turns about the hinge with 1 rad/s.
    pub sweep: Vec3<T>,
}

impl<T: Lane> LinkPose<T> {
    /// The hinge's axis.
    #[inline(always)]
    pub fn hinge(&self) -> Vec3<T> {
        self.axes[2]
    }

    /// Velocity of the point at `at` when the hinge turns with 1 rad/s.
    #[inline(always)]
    pub fn velocity_at(&self, at: Vec3<T>) -> Vec3<T> {
        cross(self.hinge(), sub(at, self.anchor))
    }
}

impl<T: Lane, const L: usize, const J: usize> Kinematics<T, L, J> {
    pub fn zero() -> Self {
        let axes = [zero3(); 3];
        let pose = LinkPose { axes, anchor: zero3(), com: zero3(), sweep: zero3() };
        Self { root: axes, root_com: zero3(), links: [[pose; J]; L] }
    }

    #[inline(always)]
    pub fn update(
        &mut self,
        skeleton: &Skeleton<T, L, J>,
        constants: &Constants<T, L, J>,
        position: &Position<T, L, J>,
    ) {
        self.root = quat_axes(quat_normalize(position.rotation));
        self.root_com = rotate(&self.root, constants.root.com);
        for limb in 0..L {
            let (mut parent, mut anchor) = match skeleton.parents[limb] {
                None => (self.root, zero3()),
                Some(link) => (self.links[0][link].axes, self.links[0][link].anchor),
            };
            for joint in 0..J {
                let (shared, link) = (&skeleton.joints[limb][joint], &constants.links[limb][joint]);
                let pose = &mut self.links[limb][joint];
                anchor = add(anchor, rotate(&parent, link.offset));
                let [x, y, hinge] = if shared.is_aligned { parent } else { turned(&parent, &shared.axes) };
                let (sin, cos) = sin_cos(position.joints[limb][joint] - T::splat(shared.zero));
                let turned_x = scale_add(y, sin, scale(x, cos));
                let turned_y = scale_add(x, -sin, scale(y, cos));
                parent = [turned_x, turned_y, hinge];
                pose.axes = parent;
                pose.anchor = anchor;
                pose.com = add(anchor, rotate(&parent, link.body.com));
                pose.sweep = cross(anchor, hinge);
            }
        }
    }

    /// A vector with its angular entries along the world's axes instead of the root's.
    #[inline(always)]
    pub fn to_world(&self, coords: &Coords<T, L, J>) -> Coords<T, L, J> {
        coords.with_angular(rotate(&self.root, coords.angular()))
    }
}
