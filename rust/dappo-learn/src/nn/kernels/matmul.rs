//! A safe face for the `gemm` crate: products of row-major f32 matrices on one thread.

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

    /// Views every row of `columns` numbers that begins at a multiple of `stride`; `data` ends with the last row.
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

    /// The transpose as a row-major matrix of its own, which products read faster.
    pub fn to_transposed(self) -> Vec<f32> {
        let transpose = self.transposed();
        let at = |row: usize, column: usize| {
            self.data[column * self.row_stride.unsigned_abs() + row * self.column_stride.unsigned_abs()]
        };
        (0..transpose.rows)
            .flat_map(|row| (0..transpose.columns).map(move |column| at(row, column)))
            .collect()
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
pub fn matmul(out: &mut [f32], destination: Destination, a: Matrix<'_>, b: Matrix<'_>) {
    matmul_strided(out, b.columns, destination, a, b);
}

/// The same with rows of `out` that begin `stride` numbers apart; those between two rows stay as they are.
pub fn matmul_strided(
    out: &mut [f32],
    stride: usize,
    destination: Destination,
    a: Matrix<'_>,
    b: Matrix<'_>,
) {
    assert_eq!(a.columns, b.rows, "inner dimensions of a product");
    assert_eq!(out.len(), strided_length(a.rows, b.columns, stride), "size of a product");
    // SAFETY: the constructors of `Matrix` checked that the last number of the last row exists, and a
    // transpose exchanges rows with columns and their strides together, so every index that gemm forms
    // lies inside `a` and `b`; the assertion above says the same of `out`, which is borrowed mutably and
    // so overlaps neither.
    unsafe {
        gemm::gemm(
            a.rows,
            b.columns,
            a.columns,
            out.as_mut_ptr(),
            1,
            stride.cast_signed(),
            destination == Destination::Accumulate,
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
        let mut out = vec![f32::NAN; 4];
        matmul(&mut out, Destination::Overwrite, a, b); // a @ b
        assert_eq!(out, [10.0, 13.0, 28.0, 40.0]);
        matmul(&mut out, Destination::Accumulate, a, a.transposed()); // += a @ a.T
        assert_eq!(out, [15.0, 27.0, 42.0, 90.0]);
        assert_eq!(a.to_transposed(), [0.0, 3.0, 1.0, 4.0, 2.0, 5.0]); // a.T
        let mut out = vec![f32::NAN; 9];
        matmul(&mut out, Destination::Overwrite, b, b.transposed()); // b @ b.T
        assert_eq!(out, [1.0, 3.0, 5.0, 3.0, 13.0, 23.0, 5.0, 23.0, 41.0]);
    }
    #[test]
    fn strided_products_equal_numpy_and_leave_the_gaps_alone() {
        // a = np.arange(6.).reshape(3, 2); a[::2, :1] @ a[:1]
        let values: Vec<f32> = (0..6_u8).map(f32::from).collect();
        let a = Matrix::strided(&values[..5], 2, 1, 4);
        let mut out = vec![9.0; 5];
        matmul_strided(&mut out, 3, Destination::Overwrite, a, Matrix::new(&values[..2], 1, 2));
        assert_eq!(out, [0.0, 0.0, 9.0, 0.0, 4.0]);
    }
}
