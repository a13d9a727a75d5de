//! Products of row-major f32 matrices on one thread: our own with AVX-512 where columns of the second matrix are next to
//! each other, those of the `gemm` crate otherwise, which chooses its instruction set itself.

use super::Level;
#[cfg(target_arch = "x86_64")]
use super::product::{Place, Product};
#[cfg(target_arch = "x86_64")]
use dappo_sim::simd::Simd;

/// A view of a row-major matrix, or of its transpose.
#[derive(Debug, Clone, Copy)]
pub struct Matrix<'a> {
    data: &'a [f32],
    rows: usize,
    columns: usize,
    row_stride: isize,
    column_stride: isize,
}

impl<'a> Matrix<'a> {
    /// Views `data` as `[rows, columns]`.
    pub fn new(data: &'a [f32], rows: usize, columns: usize) -> Self {
        assert_eq!(data.len(), rows * columns, "a matrix of {rows} × {columns}");
        Self { data, rows, columns, row_stride: columns.cast_signed(), column_stride: 1 }
    }

    /// Views as `[rows, columns]` the rows that begin at multiples of `stride`; `data` ends with the last row.
    pub fn strided(data: &'a [f32], rows: usize, columns: usize, stride: usize) -> Self {
        assert_eq!(
            data.len(),
            strided_length(rows, columns, stride),
            "a strided matrix of {rows} × {columns}"
        );
        Self { data, rows, columns, row_stride: stride.cast_signed(), column_stride: 1 }
    }

    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Number of columns.
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// `count` rows from `first` on.
    pub fn rows_from(self, first: usize, count: usize) -> Self {
        assert!(first + count <= self.rows, "rows {first} to {} of {}", first + count, self.rows);
        let data = &self.data[first * self.row_stride.unsigned_abs()..];
        Self { data, rows: count, ..self }
    }

    /// The transpose as a row-major matrix of its own, `[columns, rows]`, which products read faster.
    pub fn to_transposed(self) -> Vec<f32> {
        if self.rows == 0 {
            return Vec::new();
        }
        let (row_stride, column_stride) = (self.row_stride.unsigned_abs(), self.column_stride.unsigned_abs());
        let mut out = Vec::with_capacity(self.rows * self.columns);
        for column in 0..self.columns {
            out.extend(self.data[column * column_stride..].iter().step_by(row_stride).take(self.rows));
        }
        out
    }

    /// The transpose; nothing is moved.
    pub fn transposed(self) -> Self {
        Self {
            rows: self.columns,
            columns: self.rows,
            row_stride: self.column_stride,
            column_stride: self.row_stride,
            ..self
        }
    }
}

/// What becomes of the old contents of the destination.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Destination {
    /// They are replaced by the product.
    Overwrite,
    /// The product is added to them.
    Accumulate,
}

/// Numbers from the first of the first row to the last of the last row.
fn strided_length(rows: usize, columns: usize, stride: usize) -> usize {
    assert!(stride >= columns, "rows of a matrix must not overlap");
    if rows == 0 { 0 } else { (rows - 1) * stride + columns }
}

/// `out = a · b` or `out += a · b`, with `out` row-major `[a.rows, b.columns]`.
pub fn matmul(level: Level, out: &mut [f32], destination: Destination, a: Matrix<'_>, b: Matrix<'_>) {
    matmul_strided(level, out, b.columns, destination, a, b);
}

/// The same with rows of `out` that begin `stride` numbers apart; those between two rows stay as they are.
pub fn matmul_strided(
    level: Level,
    out: &mut [f32],
    stride: usize,
    destination: Destination,
    a: Matrix<'_>,
    b: Matrix<'_>,
) {
    assert_eq!(a.columns, b.rows, "inner dimensions of a product");
    assert_eq!(out.len(), strided_length(a.rows, b.columns, stride), "size of a product");
    let accumulate = destination == Destination::Accumulate;
    #[cfg(target_arch = "x86_64")]
    if level.simd() == Simd::Avx512 && b.column_stride == 1 {
        let place = |matrix: Matrix<'_>| Place {
            first: matrix.data.as_ptr(),
            row_stride: matrix.row_stride.unsigned_abs(),
            column_stride: matrix.column_stride.unsigned_abs(),
        };
        let product = Product {
            rows: a.rows,
            inner: a.columns,
            columns: b.columns,
            accumulate,
            a: place(a),
            b: place(b),
            out: Place { first: out.as_mut_ptr(), row_stride: stride, column_stride: 1 },
        };
        // SAFETY: a `Level` of this kind exists only if the machine reported AVX-512 F, and every such machine has FMA.
        // The constructors of `Matrix` checked that the last number of the last row exists, and a transpose exchanges
        // rows with columns and their strides together; the assertion above ensures the same for `out`, which is borrowed
        // mutably and so overlaps neither.
        unsafe { product.run() };
        return;
    }
    // SAFETY: as above, every index that gemm forms lies inside `a`, `b` and `out`, and `out` overlaps neither.
    unsafe {
        gemm::gemm(
            a.rows,
            b.columns,
            a.columns,
            out.as_mut_ptr(),
            1,
            stride.cast_signed(),
            accumulate,
            a.data.as_ptr(),
            a.column_stride,
            a.row_stride,
            b.data.as_ptr(),
            b.column_stride,
            b.row_stride,
            1.0,
            1.0,
            false,
            false,
            false,
            gemm::Parallelism::None,
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn products_of_matrices_and_transposes_equal_numpy() {
        // a = np.arange(6.).reshape(2, 3); b = np.arange(6.).reshape(3, 2)
        let values: Vec<f32> = (0..6_u8).map(f32::from).collect();
        let (a, b) = (Matrix::new(&values, 2, 3), Matrix::new(&values, 3, 2));
        assert_eq!(a.to_transposed(), [0.0, 3.0, 1.0, 4.0, 2.0, 5.0]); // a.T
        for level in Level::available() {
            let mut out = vec![f32::NAN; 4];
            matmul(level, &mut out, Destination::Overwrite, a, b); // a @ b
            assert_eq!(out, [10.0, 13.0, 28.0, 40.0]);
            matmul(level, &mut out, Destination::Accumulate, a, a.transposed()); // += a @ a.T
            assert_eq!(out, [15.0, 27.0, 42.0, 90.0]);
            let mut out = vec![f32::NAN; 9];
            matmul(level, &mut out, Destination::Overwrite, b, b.transposed()); // b @ b.T
            assert_eq!(out, [1.0, 3.0, 5.0, 3.0, 13.0, 23.0, 5.0, 23.0, 41.0]);
        }
    }

    #[test]
    fn strided_products_equal_numpy_and_leave_the_gaps_alone() {
        // a = np.arange(6.).reshape(3, 2); a[::2, :1] @ a[:1]
        let values: Vec<f32> = (0..6_u8).map(f32::from).collect();
        let a = Matrix::strided(&values[..5], 2, 1, 4);
        for level in Level::available() {
            let mut out = vec![9.0; 5];
            matmul_strided(level, &mut out, 3, Destination::Overwrite, a, Matrix::new(&values[..2], 1, 2));
            assert_eq!(out, [0.0, 0.0, 9.0, 0.0, 4.0]);
        }
    }

    /// Products of whole numbers, which no order of summation rounds, with every number of rows and columns
    /// that are left over next to full tiles, and long inner dimensions; what lies behind the destination
    /// stays as it is.
    #[test]
    fn products_of_every_shape_equal_their_definition_and_write_nothing_else() {
        let number = |index: usize| ((index * 7 + 3) % 11) as f32 - 5.0;
        let short = (1..=17)
            .flat_map(|rows| (1..=81).step_by(4).map(move |columns| (rows, rows * 3 % 8 + 1, columns)));
        let long = [127, 128, 129, 256, 300].map(|inner| (9, inner, 20));
        for (rows, inner, columns) in short.chain(long) {
            let a: Vec<f32> = (0..rows * inner).map(number).collect();
            let b: Vec<f32> = (0..inner * columns).map(|index| number(index + 5)).collect();
            let at = |row: usize, column: usize| -> f32 {
                (0..inner).map(|step| a[row * inner + step] * b[step * columns + column]).sum()
            };
            let expected: Vec<f32> =
                (0..rows * columns).map(|i| 1.0 + at(i / columns, i % columns)).collect();
            let (a, b) = (Matrix::new(&a, rows, inner), Matrix::new(&b, inner, columns));
            let transposed = a.to_transposed();
            for level in Level::available() {
                for a in [a, Matrix::new(&transposed, inner, rows).transposed()] {
                    let mut out = vec![1.0; rows * columns + 64];
                    matmul(level, &mut out[..rows * columns], Destination::Accumulate, a, b);
                    assert_eq!(out[..rows * columns], expected, "{level:?} {rows} {inner} {columns}");
                    assert_eq!(out[rows * columns..], [1.0; 64], "{level:?} {rows} {inner} {columns}");
                }
            }
        }
    }
}
