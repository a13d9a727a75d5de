//! Products of small matrices with AVX-512.
//!
//! Matrices of a few hundred rows and columns are in cache already, where copying them into panels, as libraries for
//! matrices of any size do, takes a tenth of the time. Here a tile of the destination stays in registers while the
//! inner dimension passes by.

use std::arch::x86_64::{
    __m512, __mmask16, _mm512_add_ps, _mm512_fmadd_ps, _mm512_loadu_ps, _mm512_mask_storeu_ps,
    _mm512_maskz_loadu_ps, _mm512_set1_ps, _mm512_setzero_ps,
};

/// Numbers in a register.
const LANES: usize = 16;
/// Steps of the inner dimension that are taken before the next: rows of both matrices then stay in cache until every
/// tile has seen them.
const STEPS: usize = 128;

/// Where a matrix begins and how far apart its rows and its columns are.
#[derive(Clone, Copy)]
pub(super) struct Place<T> {
    pub first: T,
    pub row_stride: usize,
    pub column_stride: usize,
}

/// A product `out = a · b`, or `out += a · b`; columns of `b` and `out` are next to each other.
#[derive(Clone, Copy)]
pub(super) struct Product {
    pub rows: usize,
    pub inner: usize,
    pub columns: usize,
    pub accumulate: bool,
    pub a: Place<*const f32>,
    pub b: Place<*const f32>,
    pub out: Place<*mut f32>,
}

impl Product {
    /// Computes the product.
    ///
    /// # Safety
    /// Every number of the three matrices must exist, and `out` must overlap neither of the others.
    #[target_feature(enable = "avx512f,fma")]
    pub unsafe fn run(mut self) {
        let all = self.inner;
        self.inner = all.min(STEPS);
        // SAFETY: the pieces of the inner dimension are parts of what the caller promises to exist.
        unsafe {
            self.piece();
            for done in (STEPS..all).step_by(STEPS) {
                self.a.first = self.a.first.add(STEPS * self.a.column_stride);
                self.b.first = self.b.first.add(STEPS * self.b.row_stride);
                self.inner = STEPS.min(all - done);
                self.accumulate = true;
                self.piece();
            }
        }
    }

    /// Computes the product of a piece of the inner dimension, three registers of columns at a time.
    #[target_feature(enable = "avx512f,fma")]
    unsafe fn piece(self) {
        let mut column = 0;
        while column < self.columns {
            // SAFETY: these columns exist in `b` and `out`, as the caller promises.
            unsafe {
                column += match (self.columns - column).div_ceil(LANES) {
                    1 => self.strip::<1>(column),
                    2 | 4 => self.strip::<2>(column),
                    _ => self.strip::<3>(column),
                };
            }
        }
    }

    /// Computes `REGISTERS` registers of columns from `column` on, and returns how many columns that may be.
    #[target_feature(enable = "avx512f,fma")]
    unsafe fn strip<const REGISTERS: usize>(self, column: usize) -> usize {
        let last = (self.columns - column - (REGISTERS - 1) * LANES).min(LANES);
        let mask = __mmask16::MAX >> (LANES - last);
        let mut row = 0;
        while row < self.rows {
            // SAFETY: these rows exist in `a` and `out`, as the caller promises.
            unsafe {
                row += match self.rows - row {
                    8.. => self.tile::<8, REGISTERS>(row, column, mask),
                    4.. => self.tile::<4, REGISTERS>(row, column, mask),
                    2.. => self.tile::<2, REGISTERS>(row, column, mask),
                    _ => self.tile::<1, REGISTERS>(row, column, mask),
                };
            }
        }
        REGISTERS * LANES
    }

    /// Computes a tile whose last register has the columns of `mask`, and returns its number of rows.
    #[inline]
    #[target_feature(enable = "avx512f,fma")]
    unsafe fn tile<const ROWS: usize, const REGISTERS: usize>(
        self,
        row: usize,
        column: usize,
        mask: __mmask16,
    ) -> usize {
        let mask_of = |register: usize| if register + 1 == REGISTERS { mask } else { __mmask16::MAX };
        let mut sums = [[_mm512_setzero_ps(); REGISTERS]; ROWS];
        // SAFETY: rows, columns and steps of the inner dimension stay inside of what the caller promises to exist;
        // columns behind the last one are masked.
        unsafe {
            let a = self.a.first.add(row * self.a.row_stride);
            let b = self.b.first.add(column);
            for step in 0..self.inner {
                let mut of_b = [_mm512_setzero_ps(); REGISTERS];
                for (register, of_b) in of_b.iter_mut().enumerate() {
                    *of_b = load(b.add(step * self.b.row_stride + register * LANES), mask_of(register));
                }
                for (row, sums) in sums.iter_mut().enumerate() {
                    let of_a = *a.add(row * self.a.row_stride + step * self.a.column_stride);
                    for (sum, of_b) in sums.iter_mut().zip(of_b) {
                        *sum = _mm512_fmadd_ps(_mm512_set1_ps(of_a), of_b, *sum);
                    }
                }
            }
            for (index, sums) in sums.iter().enumerate() {
                let out = self.out.first.add((row + index) * self.out.row_stride + column);
                for (register, sum) in sums.iter().enumerate() {
                    let (out, mask) = (out.add(register * LANES), mask_of(register));
                    let before = if self.accumulate { load(out, mask) } else { _mm512_setzero_ps() };
                    _mm512_mask_storeu_ps(out, mask, _mm512_add_ps(before, *sum));
                }
            }
        }
        ROWS
    }
}

/// The numbers of `mask`, and 0 elsewhere.
#[inline]
#[target_feature(enable = "avx512f")]
unsafe fn load(from: *const f32, mask: __mmask16) -> __m512 {
    // SAFETY: the caller promises that the numbers of `mask` exist; others are not read.
    unsafe { if mask == __mmask16::MAX { _mm512_loadu_ps(from) } else { _mm512_maskz_loadu_ps(mask, from) } }
}
