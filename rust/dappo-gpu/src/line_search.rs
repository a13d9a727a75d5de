//! Exact line search: Newton's method on the derivative of the cost along a step, kept inside a bracket.

use cubecl::prelude::*;

use crate::coords::across;
use crate::math::{is_double, lit};
use crate::pyramid::edge;
use crate::shape::Shape;
use crate::solver::{Constraints, Rows};

const MAX_LINE_SEARCH: u32 = 50;

/// Where a line search ends.
#[derive(CubeType)]
pub struct Found<F: Float> {
    /// Length in steps.
    pub length: F,
    /// Whether the cost is quadratic along a whole step, which has then arrived at the solution.
    pub exact: bool,
}

/// First and second derivative of the cost along a step, and how many rows are not in the state of its beginning.
#[derive(CubeType, CubeTypeMut)]
struct Slope<F: Float> {
    first: F,
    second: F,
    changed: F,
}

/// Searches along the step whose residuals change by `slopes`, first at 1. `linear` and `square` are the derivatives
/// of the cost without constraints at the beginning.
#[cube]
pub fn search<F: Float>(
    constraints: &Constraints<F>,
    residuals: &Rows<F>,
    slopes: &Rows<F>,
    linear: F,
    square: F,
    decrement: F,
    live: bool,
    #[comptime] shape: Shape,
) -> Found<F> {
    let zero = lit::<F>(0.0);
    let double = is_double::<F>();
    let enough = decrement * lit::<F>(comptime!(if double { 1e-11 } else { 1e-4 }));
    let mut length = lit::<F>(1.0);
    let mut low = zero;
    let mut high = lit::<F>(1e10);
    let mut slope = slope_at::<F>(constraints, residuals, slopes, length, linear, square, shape);
    let exact = slope.changed == zero;
    let mut open = live && !exact && slope.first.abs() > enough;
    let mut tries = 0u32;
    while plane_any(open) && tries < MAX_LINE_SEARCH {
        tries += 1u32;
        if open {
            if slope.first < zero {
                low = length;
            } else {
                high = length;
            }
            let newton = length - slope.first / slope.second;
            length = select(low < newton && newton < high, newton, (low + high) * lit::<F>(0.5));
        }
        slope = slope_at::<F>(constraints, residuals, slopes, length, linear, square, shape);
        open = open && slope.first.abs() > enough;
    }
    Found::<F> { length, exact }
}

#[cube]
fn slope_at<F: Float>(
    constraints: &Constraints<F>,
    residuals: &Rows<F>,
    slopes: &Rows<F>,
    length: F,
    linear: F,
    square: F,
    #[comptime] shape: Shape,
) -> Slope<F> {
    let zero = lit::<F>(0.0);
    let one = lit::<F>(1.0);
    let mut first = zero;
    let mut second = zero;
    let mut changed = zero;
    #[unroll]
    for slot in 0..comptime!(shape.slots) {
        let weight = constraints.contacts.rows[slot].weight;
        if weight > zero {
            let start = residuals.contact(slot);
            let direction = slopes.contact(slot);
            let there = direction.times_plus(length, start);
            #[unroll]
            for k in 0..4usize {
                let r = edge::<F>(there, k);
                let s = edge::<F>(direction, k);
                let pushes = r < zero;
                // Not `!=` between booleans: WGSL has it, CubeCL's CUDA C++ does not.
                let pushed = select(edge::<F>(start, k) < zero, one, zero);
                changed += (select(pushes, one, zero) - pushed).abs();
                let weighted = select(pushes, weight * s, zero);
                first = fma(weighted, r, first);
                second = fma(weighted, s, second);
            }
        }
    }
    #[unroll]
    for joint in 0..comptime!(shape.joints) {
        let weight = constraints.limits[joint].weight;
        let start = residuals.limits[joint];
        let s = slopes.limits[joint];
        let r = fma(s, length, start);
        let pushes = r < zero;
        let pushed = select(start < zero, one, zero);
        let change = (select(pushes, one, zero) - pushed).abs();
        changed += select(weight > zero, change, zero);
        let weighted = select(pushes, weight * s, zero);
        first = fma(weighted, r, first);
        second = fma(weighted, s, second);
        if comptime!(shape.joint[joint].dry_friction) {
            let friction = constraints.friction[joint];
            let start = residuals.friction[joint];
            let s = slopes.friction[joint];
            let r = fma(s, length, start);
            changed += (friction.slips(r) - friction.slips(start)).abs();
            first = fma(friction.gradient(r), s, first);
            second = fma(friction.curvature(r) * s, s, second);
        }
    }
    Slope::<F> {
        first: fma(square, length, linear) + across::<F>(first, shape),
        second: square + across::<F>(second, shape),
        changed: across::<F>(changed, shape),
    }
}
