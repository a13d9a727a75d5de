//! Softness of constraints. (Documentation: Modeling, "Solver parameters".)

use cubecl::prelude::*;

use crate::constants::softness;
use crate::math::lit;

/// Impedance d(r) at a violation r ≥ 0, of the softness whose numbers begin at `at` (solimp).
#[cube]
pub fn impedance<F: Float>(numbers: &[F], at: usize, violation: F, #[comptime] power: u8) -> F {
    let one = lit::<F>(1.0);
    let x = min(violation * numbers[at + softness::INVERSE_WIDTH], one);
    let y = if comptime!(power == 1) {
        x
    } else {
        let midpoint = numbers[at + softness::MIDPOINT];
        let rest = one - x;
        let below = x * raised::<F>(x, power) / raised::<F>(midpoint, power);
        let above = one - rest * raised::<F>(rest, power) / raised::<F>(one - midpoint, power);
        select(x < midpoint, below, above)
    };
    fma(y, numbers[at + softness::SPAN], numbers[at + softness::LOWEST])
}

/// x to the power of one less than `power`.
#[cube]
fn raised<F: Float>(x: F, #[comptime] power: u8) -> F {
    let mut product = x;
    #[unroll]
    for _i in 2..comptime!(usize::from(power)) {
        product *= x;
    }
    product
}
