//! Contacts with sliding friction in a pyramid: four edges, each of which costs ½ D r² while it pushes.
//! (Documentation: Computation, "Contact", friction cones.)

use cubecl::prelude::*;

use crate::math::{V3, copied_in_kernels, lit};

/// Derivatives of a contact's cost by its residuals along n, μ t₁ and μ t₂.
#[derive(CubeType, Clone, Copy)]
pub struct Push<F: Float> {
    pub gradient: V3<F>,
    /// Entries 11 and 22 of the Hessian; their sum is nn.
    pub first: F,
    pub second: F,
    /// Entries n1 and n2 of the Hessian.
    pub tilt_first: F,
    pub tilt_second: F,
}
copied_in_kernels!(PushExpand);

/// The residual of one of the edges n ± μ t₁ and n ± μ t₂, from those along n, μ t₁ and μ t₂.
#[cube]
pub fn edge<F: Float>(v: V3<F>, #[comptime] edge: usize) -> F {
    if comptime!(edge == 0) {
        v.x + v.y
    } else if comptime!(edge == 1) {
        v.x - v.y
    } else if comptime!(edge == 2) {
        v.x + v.z
    } else {
        v.x - v.z
    }
}

/// The derivatives at a residual.
#[cube]
pub fn push<F: Float>(weight: F, residual: V3<F>) -> Push<F> {
    let zero = lit::<F>(0.0);
    let r0 = edge::<F>(residual, 0usize);
    let r1 = edge::<F>(residual, 1usize);
    let r2 = edge::<F>(residual, 2usize);
    let r3 = edge::<F>(residual, 3usize);
    let w0 = select(r0 < zero, weight, zero);
    let w1 = select(r1 < zero, weight, zero);
    let w2 = select(r2 < zero, weight, zero);
    let w3 = select(r3 < zero, weight, zero);
    let (f0, f1, f2, f3) = (w0 * r0, w1 * r1, w2 * r2, w3 * r3);
    Push::<F> {
        gradient: V3::<F>::new((f0 + f1) + (f2 + f3), f0 - f1, f2 - f3),
        first: w0 + w1,
        second: w2 + w3,
        tilt_first: w0 - w1,
        tilt_second: w2 - w3,
    }
}
