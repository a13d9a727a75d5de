//! The points of geoms that can touch a floor.

use cubecl::prelude::*;
use dappo_lanes::model::RimPlace;

use crate::math::{Axes, V3, copied_in_kernels, lit};
use crate::shape::SurfaceShape;

/// Where a point touches the floor, from the root's origin.
#[derive(CubeType, Clone, Copy)]
pub struct Touch<F: Float> {
    /// Midway between floor and surface.
    pub at: V3<F>,
    pub distance: F,
    pub touching: bool,
}
copied_in_kernels!(TouchExpand);

/// The lowest point of a sphere around `center`.
#[cube]
pub fn at_center<F: Float>(center: V3<F>, radius: F, height: F, margin: F) -> Touch<F> {
    let distance = height + center.z - radius;
    Touch::<F> {
        at: V3::<F>::new(center.x, center.y, center.z - radius - lit::<F>(0.5) * distance),
        distance,
        touching: distance < margin,
    }
}

/// A point of a surface.
#[cube]
pub fn touch<F: Float>(surface: V3<F>, height: F, margin: F) -> Touch<F> {
    let distance = height + surface.z;
    Touch::<F> {
        at: V3::<F>::new(surface.x, surface.y, fma(lit::<F>(-0.5), distance, surface.z)),
        distance,
        touching: distance < margin,
    }
}

/// A point of a cylinder from its centre, as MuJoCo chooses those that touch a plane (`mjc_PlaneCylinder`).
#[cube]
pub fn rim<F: Float>(cylinder: Axes<F>, size: V3<F>, #[comptime] surface: SurfaceShape) -> V3<F> {
    let zero = lit::<F>(0.0);
    let one = lit::<F>(1.0);
    let place = comptime!(match surface {
        SurfaceShape::Rim(place) => place,
        _ => RimPlace::Lowest,
    });
    // The axis, pointing downwards.
    let axis = cylinder.z * select(zero < cylinder.z.z, -one, one);
    // The steepest way down across the axis; across a vertical one, x.
    let down = V3::<F>::new(axis.z * axis.x, axis.z * axis.y, fma(axis.z, axis.z, -one));
    let square = down.dot(down);
    let vertical = square < lit::<F>(1e-30);
    let factor = select(vertical, one, one / select(vertical, one, square).sqrt()) * size.x;
    let across = V3::<F>::new(
        factor * select(vertical, cylinder.x.x, down.x),
        factor * select(vertical, cylinder.x.y, down.y),
        factor * select(vertical, cylinder.x.z, down.z),
    );
    let end = axis * size.y;
    if comptime!(place == RimPlace::Lowest) {
        across + end
    } else if comptime!(place == RimPlace::OtherEnd) {
        across - end
    } else {
        let sideways = across.cross(end);
        let length = sideways.dot(sideways).sqrt();
        let sign = comptime!(if place == RimPlace::Left { 1.0f64 } else { -1.0f64 });
        let half_side = size.x * lit::<F>(comptime!(sign * 0.5 * 3f64.sqrt()));
        sideways.times_plus(half_side / length, across.times_plus(lit::<F>(-0.5), end))
    }
}

/// The lowest point of an ellipsoid, from its centre.
#[cube]
pub fn lowest<F: Float>(ellipsoid: Axes<F>, size: V3<F>) -> V3<F> {
    // A sphere stretched by the semi-axes: its lowest point lies against the stretched normal.
    let down = V3::<F>::new(-(size.x * ellipsoid.x.z), -(size.y * ellipsoid.y.z), -(size.z * ellipsoid.z.z));
    let inverse = lit::<F>(1.0) / down.dot(down).sqrt();
    ellipsoid.rotate(V3::<F>::new(
        size.x * down.x * inverse,
        size.y * down.y * inverse,
        size.z * down.z * inverse,
    ))
}
