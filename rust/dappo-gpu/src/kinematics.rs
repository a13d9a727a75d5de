//! Where everything is: frames, anchors and centres of mass, along the world's axes and from the root's origin.
//! (Documentation: Computation, "Kinematic tree".)

use cubecl::prelude::*;

use crate::constants::{body, link};
use crate::math::{Axes, Sym3, V3, axes_at, copied_in_kernels, sin_cos, sym3_at, v3_at};
use crate::shape::Shape;

/// The frame of one link, and its mass distribution.
#[derive(CubeType, Clone, Copy)]
pub struct LinkPose<F: Float> {
    /// Axes of the link; the third is the hinge's.
    pub axes: Axes<F>,
    /// Anchor of the hinge.
    pub anchor: V3<F>,
    /// Centre of mass.
    pub com: V3<F>,
    /// Velocity, at the root's origin, of a body that turns about the hinge with 1 rad/s.
    pub sweep: V3<F>,
    /// Inertia about the centre of mass, along the world's axes.
    pub tensor: Sym3<F>,
    pub mass: F,
}
copied_in_kernels!(LinkPoseExpand);

/// The links of this thread's limb, from the root outwards; `limb` is where the thread's constants begin.
#[cube]
pub fn kinematics<F: Float>(
    numbers: &[F],
    limb: usize,
    root: Axes<F>,
    positions: &Array<F>,
    #[comptime] shape: Shape,
) -> Sequence<LinkPose<F>> {
    let mut links = Sequence::<LinkPose<F>>::new();
    #[unroll]
    for joint in 0..comptime!(shape.joints) {
        let at = limb + comptime!(shape.link(joint));
        // No mutable variables here: a structure holds the variable itself, not its value at the time.
        let inner = comptime!(joint.wrapping_sub(1));
        let parent = if comptime!(joint == 0) { root } else { links[inner].axes };
        let origin = if comptime!(joint == 0) { V3::<F>::zero() } else { links[inner].anchor };
        let anchor = origin + parent.rotate(v3_at::<F>(numbers, at + link::OFFSET));
        let rest = if comptime!(shape.joint[joint].aligned) {
            parent
        } else {
            parent.turned(axes_at::<F>(numbers, at + link::AXES))
        };
        let turn = sin_cos::<F>(positions[joint] - numbers[at + link::ZERO]);
        let axes = Axes::<F> {
            x: rest.y.times_plus(turn.sin, rest.x * turn.cos),
            y: rest.x.times_plus(-turn.sin, rest.y * turn.cos),
            z: rest.z,
        };
        let mass = at + link::BODY;
        links.push(LinkPose::<F> {
            axes,
            anchor,
            com: anchor + axes.rotate(v3_at::<F>(numbers, mass + body::COM)),
            sweep: anchor.cross(rest.z),
            tensor: axes.rotate_sym(sym3_at::<F>(numbers, mass + body::TENSOR)),
            mass: numbers[mass + body::MASS],
        });
    }
    links
}
