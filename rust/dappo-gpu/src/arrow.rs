//! Arrow matrices: symmetric matrices over [`Coords`] in which limbs couple with the root but not with each other. The
//! mass matrix has this form, and floor contacts and joint limits keep it.

use cubecl::prelude::*;

use crate::coords::{Coords, across};
use crate::math::lit;
use crate::shape::{Shape, lower};

/// A symmetric matrix: lower triangles of the root's 6 × 6 block and of the limb's block, and the coupling of each
/// joint with the root.
#[derive(CubeType)]
pub struct Arrow<F: Float> {
    /// [21]
    pub root: Array<F>,
    /// [joints · 6]
    pub coupling: Array<F>,
    /// [joints (joints + 1) / 2]
    pub block: Array<F>,
}

#[cube]
impl<F: Float> Arrow<F> {
    pub fn room(#[comptime] shape: Shape) -> Arrow<F> {
        Arrow::<F> {
            root: Array::<F>::new(21usize),
            coupling: Array::<F>::new(comptime!(6 * shape.joints)),
            block: Array::<F>::new(comptime!(shape.block())),
        }
    }

    /// Takes over the limb's entries of another matrix; the root's block becomes zero.
    pub fn set_limb(&mut self, other: &Arrow<F>, #[comptime] shape: Shape) {
        #[unroll]
        for i in 0..21usize {
            self.root[i] = lit::<F>(0.0);
        }
        #[unroll]
        for i in 0..comptime!(6 * shape.joints) {
            self.coupling[i] = other.coupling[i];
        }
        #[unroll]
        for i in 0..comptime!(shape.block()) {
            self.block[i] = other.block[i];
        }
    }

    /// out ← self · x.
    pub fn times(&self, x: &Coords<F>, out: &mut Coords<F>, #[comptime] shape: Shape) {
        #[unroll]
        for i in 0..6usize {
            let mut limb = lit::<F>(0.0);
            #[unroll]
            for k in 0..comptime!(shape.joints) {
                limb = fma(self.coupling[comptime!(6 * k + i)], x.limb[k], limb);
            }
            let mut sum = across::<F>(limb, shape);
            #[unroll]
            for j in 0..6usize {
                sum = fma(self.root[comptime!(lower(i, j))], x.root[j], sum);
            }
            out.root[i] = sum;
        }
        #[unroll]
        for joint in 0..comptime!(shape.joints) {
            let mut sum = lit::<F>(0.0);
            #[unroll]
            for i in 0..6usize {
                sum = fma(self.coupling[comptime!(6 * joint + i)], x.root[i], sum);
            }
            #[unroll]
            for other in 0..comptime!(shape.joints) {
                sum = fma(self.block[comptime!(lower(joint, other))], x.limb[other], sum);
            }
            out.limb[joint] = sum;
        }
    }

    /// x ← (matrix with `base` added to the root's block)⁻¹ · x, of a positive definite matrix which its
    /// factorisation replaces. The root's block is this thread's share of a sum over the threads of the world.
    ///
    /// L D Lᵀ, which eliminates the joints of each limb from the outermost inwards and then the root, as MuJoCo
    /// does (documentation: Computation, "General framework"): no zero of the arrow fills up.
    pub fn solve(&mut self, base: &Array<F>, x: &mut Coords<F>, #[comptime] shape: Shape) {
        let mut share = Array::<F>::new(6usize);
        #[unroll]
        for i in 0..6usize {
            share[i] = lit::<F>(0.0);
        }
        self.eliminate(&mut share, x, shape);
        #[unroll]
        for i in 0..21usize {
            self.root[i] = base[i] + across::<F>(self.root[i], shape);
        }
        #[unroll]
        for i in 0..6usize {
            x.root[i] += across::<F>(share[i], shape);
        }
        solve_dense::<F>(&mut self.root, &mut x.root);
        #[unroll]
        for joint in 0..comptime!(shape.joints) {
            let mut sum = x.limb[joint];
            #[unroll]
            for i in 0..6usize {
                sum = fma(-self.coupling[comptime!(6 * joint + i)], x.root[i], sum);
            }
            #[unroll]
            for inner in 0..joint {
                sum = fma(-self.block[comptime!(lower(joint, inner))], x.limb[inner], sum);
            }
            // The pivots were replaced by their inverses.
            x.limb[joint] = sum * self.block[comptime!(lower(joint, joint))];
        }
    }

    /// Eliminates the joints of the limb; `share` becomes what that adds to the root's right side.
    fn eliminate(&mut self, share: &mut Array<F>, x: &mut Coords<F>, #[comptime] shape: Shape) {
        #[unroll]
        for back in 0..comptime!(shape.joints) {
            let joint = comptime!(shape.joints - 1 - back);
            let pivot = comptime!(lower(joint, joint));
            let inverse = lit::<F>(1.0) / self.block[pivot];
            self.block[pivot] = inverse;
            #[unroll]
            for inner in 0..joint {
                let factor = self.block[comptime!(lower(joint, inner))] * inverse;
                #[unroll]
                for k in 0..comptime!(inner + 1) {
                    let at = comptime!(lower(inner, k));
                    self.block[at] = fma(-factor, self.block[comptime!(lower(joint, k))], self.block[at]);
                }
                #[unroll]
                for i in 0..6usize {
                    let at = comptime!(6 * inner + i);
                    self.coupling[at] =
                        fma(-factor, self.coupling[comptime!(6 * joint + i)], self.coupling[at]);
                }
                x.limb[inner] = fma(-factor, x.limb[joint], x.limb[inner]);
            }
            #[unroll]
            for i in 0..6usize {
                let factor = self.coupling[comptime!(6 * joint + i)] * inverse;
                share[i] = fma(-factor, x.limb[joint], share[i]);
                #[unroll]
                for j in 0..comptime!(i + 1) {
                    let at = comptime!(lower(i, j));
                    self.root[at] = fma(-factor, self.coupling[comptime!(6 * joint + j)], self.root[at]);
                }
            }
        }
    }
}

/// Solves the root's dense 6 × 6 system; `x` comes as the right side.
#[cube]
fn solve_dense<F: Float>(m: &mut Array<F>, x: &mut Array<F>) {
    #[unroll]
    for pivot in 0..6usize {
        let inverse = lit::<F>(1.0) / m[comptime!(lower(pivot, pivot))];
        m[comptime!(lower(pivot, pivot))] = inverse;
        #[unroll]
        for i in comptime!(pivot + 1)..6usize {
            let factor = m[comptime!(lower(i, pivot))] * inverse;
            #[unroll]
            for j in comptime!(pivot + 1)..comptime!(i + 1) {
                m[comptime!(lower(i, j))] =
                    fma(-factor, m[comptime!(lower(j, pivot))], m[comptime!(lower(i, j))]);
            }
            x[i] = fma(-factor, x[pivot], x[i]);
        }
    }
    #[unroll]
    for back in 0..6usize {
        let i = comptime!(5 - back);
        let mut sum = x[i];
        #[unroll]
        for j in comptime!(i + 1)..6usize {
            sum = fma(-m[comptime!(lower(j, i))], x[j], sum);
        }
        x[i] = sum * m[comptime!(lower(i, i))];
    }
}
