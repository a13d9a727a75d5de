//! Where everything is: frames, anchors and centres of mass, along the world's axes and from the root's
//! origin. (Documentation: Computation, "Kinematic tree".)

use crate::constants::{Constants, Skeleton};
use crate::lane::Lane;
use crate::math::{Axes, Vec3, add, cross, rotate, scale, scale_add, sin_cos, sub};
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

#[inline(always)]
pub fn kinematics<T: Lane, const L: usize, const J: usize>(
    skeleton: &Skeleton<T, L, J>,
    constants: &Constants<T, L, J>,
    root: Axes<T>,
    position: &Position<T, L, J>,
) -> Kinematics<T, L, J> {
    let links = std::array::from_fn(|limb| {
        let (mut parent, mut anchor) = (root, [T::zero(); 3]);
        std::array::from_fn(|joint| {
            let (shared, link) = (&skeleton.joints[limb][joint], &constants.links[limb][joint]);
            anchor = add(anchor, rotate(&parent, link.offset));
            let still = shared.axes.map(|axis| rotate(&parent, axis.map(T::splat)));
            let (sin, cos) = sin_cos(position.joints[limb][joint] - T::splat(shared.zero));
            let axes = [
                scale_add(still[1], sin, scale(still[0], cos)),
                scale_add(still[0], -sin, scale(still[1], cos)),
                still[2],
            ];
            parent = axes;
            LinkPose {
                axes,
                anchor,
                com: add(anchor, rotate(&axes, link.body.com)),
                sweep: cross(anchor, axes[2]),
            }
        })
    });
    Kinematics { root, root_com: rotate(&root, constants.root.com), links }
}
