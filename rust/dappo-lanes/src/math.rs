//! Vectors, symmetric matrices and sines over lanes.

use crate::lane::Lane;

/// A 3-vector in every lane.
pub type Vec3<T> = [T; 3];

/// A symmetric 3 × 3 matrix in every lane: xx, yy, zz, xy, xz, yz.
pub type Sym3<T> = [T; 6];

/// Three vectors: the axes of a frame.
pub type Axes<T> = [Vec3<T>; 3];

#[inline(always)]
pub fn zero3<T: Lane>() -> Vec3<T> {
    [T::zero(); 3]
}

/// The same vector in every lane.
#[inline(always)]
pub fn splat3<T: Lane>(v: [T::Scalar; 3]) -> Vec3<T> {
    [T::splat(v[0]), T::splat(v[1]), T::splat(v[2])]
}

#[inline(always)]
pub fn add<T: Lane>(a: Vec3<T>, b: Vec3<T>) -> Vec3<T> {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

#[inline(always)]
pub fn sub<T: Lane>(a: Vec3<T>, b: Vec3<T>) -> Vec3<T> {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

#[inline(always)]
pub fn negate<T: Lane>(a: Vec3<T>) -> Vec3<T> {
    [-a[0], -a[1], -a[2]]
}

/// `yes` where the mask is true, `no` elsewhere.
#[inline(always)]
pub fn select3<T: Lane>(mask: T::Mask, yes: Vec3<T>, no: Vec3<T>) -> Vec3<T> {
    [T::select(mask, yes[0], no[0]), T::select(mask, yes[1], no[1]), T::select(mask, yes[2], no[2])]
}

#[inline(always)]
pub fn scale<T: Lane>(a: Vec3<T>, factor: T) -> Vec3<T> {
    [a[0] * factor, a[1] * factor, a[2] * factor]
}

/// a · factor + b.
#[inline(always)]
pub fn scale_add<T: Lane>(a: Vec3<T>, factor: T, b: Vec3<T>) -> Vec3<T> {
    [a[0].mul_add(factor, b[0]), a[1].mul_add(factor, b[1]), a[2].mul_add(factor, b[2])]
}

#[inline(always)]
pub fn dot<T: Lane>(a: Vec3<T>, b: Vec3<T>) -> T {
    a[2].mul_add(b[2], a[1].mul_add(b[1], a[0] * b[0]))
}

#[inline(always)]
pub fn cross<T: Lane>(a: Vec3<T>, b: Vec3<T>) -> Vec3<T> {
    [
        a[2].neg_mul_add(b[1], a[1] * b[2]),
        a[0].neg_mul_add(b[2], a[2] * b[0]),
        a[1].neg_mul_add(b[0], a[0] * b[1]),
    ]
}

/// The world's coordinates of a vector that is given in a frame.
#[inline(always)]
pub fn rotate<T: Lane>(axes: &Axes<T>, v: Vec3<T>) -> Vec3<T> {
    scale_add(axes[2], v[2], scale_add(axes[1], v[1], scale(axes[0], v[0])))
}

/// Axes that are given in a frame, in the world's coordinates.
#[inline(always)]
pub fn turned<T: Lane>(axes: &Axes<T>, inner: &[[T::Scalar; 3]; 3]) -> Axes<T> {
    [rotate(axes, splat3(inner[0])), rotate(axes, splat3(inner[1])), rotate(axes, splat3(inner[2]))]
}

/// The frame's coordinates of a vector that is given in the world's.
#[inline(always)]
pub fn unrotate<T: Lane>(axes: &Axes<T>, v: Vec3<T>) -> Vec3<T> {
    [dot(axes[0], v), dot(axes[1], v), dot(axes[2], v)]
}

/// The three rows of a symmetric matrix.
#[inline(always)]
pub fn rows<T: Lane>(m: &Sym3<T>) -> Axes<T> {
    [[m[0], m[3], m[4]], [m[3], m[1], m[5]], [m[4], m[5], m[2]]]
}

#[inline(always)]
pub fn sym_mul<T: Lane>(m: &Sym3<T>, v: Vec3<T>) -> Vec3<T> {
    let rows = rows(m);
    [dot(rows[0], v), dot(rows[1], v), dot(rows[2], v)]
}

/// R M Rᵀ: a symmetric matrix given in a frame, in the world's coordinates.
#[inline(always)]
pub fn sym_rotate<T: Lane>(axes: &Axes<T>, m: &Sym3<T>) -> Sym3<T> {
    let rows = rows(m);
    let half = [rotate(axes, rows[0]), rotate(axes, rows[1]), rotate(axes, rows[2])];
    [
        half_dot(&half, axes, 0, 0),
        half_dot(&half, axes, 1, 1),
        half_dot(&half, axes, 2, 2),
        half_dot(&half, axes, 0, 1),
        half_dot(&half, axes, 0, 2),
        half_dot(&half, axes, 1, 2),
    ]
}

/// Entry (i, j) of Σ aₖ bₖᵀ.
#[inline(always)]
fn half_dot<T: Lane>(a: &Axes<T>, b: &Axes<T>, i: usize, j: usize) -> T {
    a[2][i].mul_add(b[2][j], a[1][i].mul_add(b[1][j], a[0][i] * b[0][j]))
}

/// Adds the inertia about the origin of a point mass at `at`: m (|at|² 1 − at atᵀ).
#[inline(always)]
pub fn add_point_mass<T: Lane>(m: &mut Sym3<T>, mass: T, at: Vec3<T>) {
    let weighted = scale(at, mass);
    let (xx, yy, zz) = (weighted[0] * at[0], weighted[1] * at[1], weighted[2] * at[2]);
    m[0] += yy + zz;
    m[1] += xx + zz;
    m[2] += xx + yy;
    m[3] = weighted[0].neg_mul_add(at[1], m[3]);
    m[4] = weighted[0].neg_mul_add(at[2], m[4]);
    m[5] = weighted[1].neg_mul_add(at[2], m[5]);
}

/// Sine and cosine: reduction by the nearest multiple of π/2 (Cody and Waite, with fused
/// multiply-adds), then Taylor
/// polynomials on [−π/4, π/4].
#[inline(always)]
pub fn sin_cos<T: Lane>(x: T) -> (T, T) {
    let quarter = (x * T::of(std::f64::consts::FRAC_2_PI)).round();
    // π/2 in two parts: the nearest number of the format and the rest.
    let (high, low) = if T::DOUBLE {
        (std::f64::consts::FRAC_PI_2, 6.123_233_995_736_766e-17)
    } else {
        (1.570_796_370_506_286_6, -4.371_139_000_186_241e-8)
    };
    let r = quarter.neg_mul_add(T::of(low), quarter.neg_mul_add(T::of(high), x));
    let (s, c) = sin_cos_polynomials(r);

    // quarter mod 4, in {−2, …, 2}: ±1 swaps sine and cosine, ±2 negates both.
    let turn = quarter - (quarter * T::of(0.25)).round() * T::of(4.0);
    let size = turn.abs();
    let odd = T::of(0.5).lt(size) & size.lt(T::of(1.5));
    let half = T::of(1.5).lt(size);
    let backwards = odd & turn.lt(T::zero());
    let forwards = odd & !backwards;
    let (sine, cosine) = (T::select(odd, c, s), T::select(odd, s, c));
    (T::select(half | backwards, -sine, sine), T::select(half | forwards, -cosine, cosine))
}

#[inline(always)]
fn sin_cos_polynomials<T: Lane>(r: T) -> (T, T) {
    let square = r * r;
    // 1/n! with alternating signs, the highest power first.
    let (sine, cosine): (&[f64], &[f64]) = if T::DOUBLE {
        (
            &[
                -1.0 / 1_307_674_368_000.0,
                1.0 / 6_227_020_800.0,
                -1.0 / 39_916_800.0,
                1.0 / 362_880.0,
                -1.0 / 5_040.0,
                1.0 / 120.0,
                -1.0 / 6.0,
            ],
            &[
                1.0 / 20_922_789_888_000.0,
                -1.0 / 87_178_291_200.0,
                1.0 / 479_001_600.0,
                -1.0 / 3_628_800.0,
                1.0 / 40_320.0,
                -1.0 / 720.0,
                1.0 / 24.0,
                -0.5,
                1.0,
            ],
        )
    } else {
        (
            &[1.0 / 362_880.0, -1.0 / 5_040.0, 1.0 / 120.0, -1.0 / 6.0],
            &[1.0 / 40_320.0, -1.0 / 720.0, 1.0 / 24.0, -0.5, 1.0],
        )
    };
    let s = polynomial(square, sine) * square;
    (s.mul_add(r, r), polynomial(square, cosine))
}

/// Horner's scheme, the highest power first.
#[inline(always)]
pub fn polynomial<T: Lane>(x: T, coefficients: &[f64]) -> T {
    let mut sum = T::of(coefficients[0]);
    for &coefficient in &coefficients[1..] {
        sum = sum.mul_add(x, T::of(coefficient));
    }
    sum
}

/// Product of two quaternions (w, x, y, z).
#[inline(always)]
pub fn quat_mul<T: Lane>(a: [T; 4], b: [T; 4]) -> [T; 4] {
    let (va, vb) = ([a[1], a[2], a[3]], [b[1], b[2], b[3]]);
    let v = add(scale_add(va, b[0], scale(vb, a[0])), cross(va, vb));
    [a[0] * b[0] - dot(va, vb), v[0], v[1], v[2]]
}

/// A quaternion of length 1.
#[inline(always)]
pub fn quat_normalize<T: Lane>(q: [T; 4]) -> [T; 4] {
    let square = q[3].mul_add(q[3], q[2].mul_add(q[2], q[1].mul_add(q[1], q[0] * q[0])));
    let inverse = T::of(1.0) / square.sqrt();
    [q[0] * inverse, q[1] * inverse, q[2] * inverse, q[3] * inverse]
}

/// The axes of the frame that a unit quaternion turns the world's axes into.
#[inline(always)]
pub fn quat_axes<T: Lane>([w, x, y, z]: [T; 4]) -> Axes<T> {
    let (one, two) = (T::of(1.0), T::of(2.0));
    [
        [one - two * (y * y + z * z), two * (x * y + w * z), two * (x * z - w * y)],
        [two * (x * y - w * z), one - two * (x * x + z * z), two * (y * z + w * x)],
        [two * (x * z + w * y), two * (y * z - w * x), one - two * (x * x + y * y)],
    ]
}
