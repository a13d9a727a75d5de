//! Arrow matrices: symmetric matrices over [`Coords`] in which limbs couple with the root and with the trunk, but
//! not with each other. The mass matrix has this form, and floor contacts and joint limits keep it.

use crate::coords::Coords;
use crate::lane::Lane;

/// A symmetric matrix: the root's 6 × 6 block, and for each joint its coupling with the root, with the joints of
/// the trunk (limb 0) and with those of its limb. Only the lower triangles of the blocks are used.
#[derive(Clone, Copy)]
pub struct Arrow<T, const L: usize, const J: usize, const W: usize> {
    pub root: [[T; 6]; 6],
    pub coupling: [[[T; 6]; J]; L],
    /// 0 for the trunk itself.
    pub trunk: [[[T; W]; J]; L],
    pub limbs: [[[T; J]; J]; L],
}

impl<T: Lane, const L: usize, const J: usize, const W: usize> Arrow<T, L, J, W> {
    #[inline(always)]
    pub fn zero() -> Self {
        let zero = T::zero();
        Self {
            root: [[zero; 6]; 6],
            coupling: [[[zero; 6]; J]; L],
            trunk: [[[zero; W]; J]; L],
            limbs: [[[zero; J]; J]; L],
        }
    }

    /// The matrix times a vector.
    #[inline(always)]
    pub fn mul(&self, x: &Coords<T, L, J>) -> Coords<T, L, J> {
        let mut y = Coords::zero();
        for i in 0..6 {
            for j in 0..6 {
                let entry = if j <= i { self.root[i][j] } else { self.root[j][i] };
                y.root[i] = entry.mul_add(x.root[j], y.root[i]);
            }
        }
        for limb in 0..L {
            for joint in 0..J {
                let coupling = &self.coupling[limb][joint];
                let mut sum = T::zero();
                for i in 0..6 {
                    y.root[i] = coupling[i].mul_add(x.limbs[limb][joint], y.root[i]);
                    sum = coupling[i].mul_add(x.root[i], sum);
                }
                for other in 0..J {
                    let entry = self.limbs[limb][joint.max(other)][joint.min(other)];
                    sum = entry.mul_add(x.limbs[limb][other], sum);
                }
                // The trunk is the first limb, so that its sums are there already.
                for i in 0..W {
                    let entry = self.trunk[limb][joint][i];
                    y.limbs[0][i] = entry.mul_add(x.limbs[limb][joint], y.limbs[0][i]);
                    sum = entry.mul_add(x.limbs[0][i], sum);
                }
                y.limbs[limb][joint] = sum;
            }
        }
        y
    }

    /// Solves matrix · x = right for a positive definite matrix, which its factorisation replaces; `x` comes as
    /// the right side.
    ///
    /// L D Lᵀ, which eliminates the joints of each limb from the outermost inwards, the trunk last, and then the
    /// root, as MuJoCo does (documentation: Computation, "General framework"): no zero of the arrow fills up.
    #[inline(always)]
    pub fn solve(&mut self, x: &mut Coords<T, L, J>) {
        for limb in (0..L).rev() {
            self.eliminate(limb, x);
        }
        self.substitute(x);
    }

    /// Takes over the root's block of another matrix.
    #[inline(always)]
    pub fn set_root(&mut self, other: &Self) {
        for i in 0..6 {
            for j in 0..i + 1 {
                self.root[i][j] = other.root[i][j];
            }
        }
    }

    /// Takes over the entries of a limb of another matrix.
    #[inline(always)]
    pub fn set_limb(&mut self, limb: usize, other: &Self) {
        for joint in 0..J {
            for inner in 0..joint + 1 {
                self.limbs[limb][joint][inner] = other.limbs[limb][joint][inner];
            }
            for i in 0..6 {
                self.coupling[limb][joint][i] = other.coupling[limb][joint][i];
            }
            for i in 0..W {
                self.trunk[limb][joint][i] = other.trunk[limb][joint][i];
            }
        }
    }

    /// Eliminates the joints of a limb. The blocks of the root and of the trunk and their right sides may still be
    /// incomplete.
    #[inline(always)]
    pub fn eliminate(&mut self, limb: usize, x: &mut Coords<T, L, J>) {
        let (block, coupling) = (&mut self.limbs[limb], &mut self.coupling[limb]);
        let trunk = &mut self.trunk[limb];
        let y = &mut x.limbs[limb];
        for joint in (0..J).rev() {
            let inverse = T::of(1.0) / block[joint][joint];
            block[joint][joint] = inverse;
            for inner in 0..joint {
                let factor = block[joint][inner] * inverse;
                for k in 0..inner + 1 {
                    block[inner][k] = factor.neg_mul_add(block[joint][k], block[inner][k]);
                }
                for i in 0..6 {
                    coupling[inner][i] = factor.neg_mul_add(coupling[joint][i], coupling[inner][i]);
                }
                for i in 0..W {
                    trunk[inner][i] = factor.neg_mul_add(trunk[joint][i], trunk[inner][i]);
                }
                y[inner] = factor.neg_mul_add(y[joint], y[inner]);
            }
        }
        if W > 0 && limb > 0 {
            self.reduce_trunk(limb, x);
        }
        self.reduce_root(limb, x);
    }

    /// Changes the trunk's block, its coupling with the root and its right side by what a limb that has been
    /// eliminated leaves.
    #[inline(always)]
    fn reduce_trunk(&mut self, limb: usize, x: &mut Coords<T, L, J>) {
        let ([trunk_block, ..], blocks) = self.limbs.split_at_mut(1) else { return };
        let ([trunk_coupling, ..], couplings) = self.coupling.split_at_mut(1) else { return };
        let (block, coupling, own) = (&blocks[limb - 1], &couplings[limb - 1], &self.trunk[limb]);
        let y = x.limbs[limb];
        for i in 0..W {
            let mut factors = [T::zero(); J];
            for joint in 0..J {
                factors[joint] = own[joint][i] * block[joint][joint];
                x.limbs[0][i] = factors[joint].neg_mul_add(y[joint], x.limbs[0][i]);
            }
            for j in 0..i + 1 {
                for joint in 0..J {
                    trunk_block[i][j] = factors[joint].neg_mul_add(own[joint][j], trunk_block[i][j]);
                }
            }
            for j in 0..6 {
                for joint in 0..J {
                    trunk_coupling[i][j] =
                        factors[joint].neg_mul_add(coupling[joint][j], trunk_coupling[i][j]);
                }
            }
        }
    }

    /// Changes the root's block and its right side by what a limb that has been eliminated leaves.
    #[inline(always)]
    fn reduce_root(&mut self, limb: usize, x: &mut Coords<T, L, J>) {
        let (root, block, coupling) = (&mut self.root, &self.limbs[limb], &self.coupling[limb]);
        // All joints at once, so that every entry of the root is loaded and stored only once.
        let y = x.limbs[limb];
        for i in 0..6 {
            let mut factors = [T::zero(); J];
            for joint in 0..J {
                factors[joint] = coupling[joint][i] * block[joint][joint];
                x.root[i] = factors[joint].neg_mul_add(y[joint], x.root[i]);
            }
            for j in 0..i + 1 {
                let mut entry = root[i][j];
                for joint in 0..J {
                    entry = factors[joint].neg_mul_add(coupling[joint][j], entry);
                }
                root[i][j] = entry;
            }
        }
    }

    /// Solves for the root and then for the limbs, all of which have been eliminated.
    #[inline(always)]
    pub fn substitute(&mut self, x: &mut Coords<T, L, J>) {
        solve_dense(&mut self.root, &mut x.root);
        for limb in 0..L {
            for joint in 0..J {
                let mut sum = x.limbs[limb][joint];
                for i in 0..6 {
                    sum = self.coupling[limb][joint][i].neg_mul_add(x.root[i], sum);
                }
                for i in 0..W {
                    sum = self.trunk[limb][joint][i].neg_mul_add(x.limbs[0][i], sum);
                }
                for inner in 0..joint {
                    sum = self.limbs[limb][joint][inner].neg_mul_add(x.limbs[limb][inner], sum);
                }
                // The pivots were replaced by their inverses.
                x.limbs[limb][joint] = sum * self.limbs[limb][joint][joint];
            }
        }
    }
}

/// Solves the root's dense 6 × 6 system; `x` comes as the right side.
#[inline(always)]
fn solve_dense<T: Lane>(matrix: &mut [[T; 6]; 6], x: &mut [T; 6]) {
    for pivot in 0..6 {
        let inverse = T::of(1.0) / matrix[pivot][pivot];
        matrix[pivot][pivot] = inverse;
        for i in pivot + 1..6 {
            let factor = matrix[i][pivot] * inverse;
            for j in pivot + 1..i + 1 {
                matrix[i][j] = factor.neg_mul_add(matrix[j][pivot], matrix[i][j]);
            }
            x[i] = factor.neg_mul_add(x[pivot], x[i]);
        }
    }
    for i in (0..6).rev() {
        let mut sum = x[i];
        for j in i + 1..6 {
            sum = matrix[j][i].neg_mul_add(x[j], sum);
        }
        x[i] = sum * matrix[i][i];
    }
}
