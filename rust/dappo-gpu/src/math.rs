//! Vectors, symmetric matrices, rotations and sines, inside a kernel.

use cubecl::prelude::*;

/// A 3-vector.
#[derive(CubeType, CubeTypeMut, Clone, Copy)]
pub struct V3<F: Float> {
    pub x: F,
    pub y: F,
    pub z: F,
}

/// A symmetric 3 × 3 matrix.
#[derive(CubeType, CubeTypeMut, Clone, Copy)]
pub struct Sym3<F: Float> {
    pub xx: F,
    pub yy: F,
    pub zz: F,
    pub xy: F,
    pub xz: F,
    pub yz: F,
}

/// The axes of a frame.
#[derive(CubeType, CubeTypeMut, Clone, Copy)]
pub struct Axes<F: Float> {
    pub x: V3<F>,
    pub y: V3<F>,
    pub z: V3<F>,
}

/// A quaternion.
#[derive(CubeType, CubeTypeMut, Clone, Copy)]
pub struct Quat<F: Float> {
    pub w: F,
    pub v: V3<F>,
}

/// Sine and cosine of an angle.
#[derive(CubeType, CubeTypeMut, Clone, Copy)]
pub struct SinCos<F: Float> {
    pub sin: F,
    pub cos: F,
}

/// Lets structures be used twice in a kernel, as their `Copy` promises: the derive macro forgets it.
macro_rules! copied_in_kernels {
    ($($expand:ident),*) => { $(
        impl<F: Float> Clone for $expand<F> {
            fn clone(&self) -> Self { *self }
        }
        impl<F: Float> Copy for $expand<F> {}
        impl<F: Float> DerefExpand for $expand<F> {
            type Target = Self;
            fn __expand_deref_method(&self, _: &Scope) -> Self { *self }
        }
    )* };
    (plain: $($expand:ident),*) => { $(
        impl Clone for $expand {
            fn clone(&self) -> Self { *self }
        }
        impl Copy for $expand {}
        impl DerefExpand for $expand {
            type Target = Self;
            fn __expand_deref_method(&self, _: &Scope) -> Self { *self }
        }
    )* };
}
pub(crate) use copied_in_kernels;

copied_in_kernels!(V3Expand, Sym3Expand, AxesExpand, QuatExpand, SinCosExpand);

macro_rules! operators {
    ($($ty:ident: $trait:ident $method:ident $rhs:ty;)*) => { $(
        impl<F: Float> core::ops::$trait<$rhs> for $ty<F> {
            type Output = Self;
            // Not called: the macros of CubeCL replace operators by the methods of these names.
            fn $method(self, rhs: $rhs) -> Self { Self::$method(self, rhs) }
        }
    )* };
}
operators! {
    V3: Add add V3<F>;
    V3: Sub sub V3<F>;
    V3: Mul mul F;
    Sym3: Add add Sym3<F>;
}

#[cube]
impl<F: Float> V3<F> {
    pub fn new(x: F, y: F, z: F) -> V3<F> {
        V3::<F> { x, y, z }
    }

    pub fn zero() -> V3<F> {
        V3::<F> { x: lit::<F>(0.0), y: lit::<F>(0.0), z: lit::<F>(0.0) }
    }

    pub fn add(self, o: V3<F>) -> V3<F> {
        V3::<F> { x: self.x + o.x, y: self.y + o.y, z: self.z + o.z }
    }

    pub fn sub(self, o: V3<F>) -> V3<F> {
        V3::<F> { x: self.x - o.x, y: self.y - o.y, z: self.z - o.z }
    }

    pub fn mul(self, k: F) -> V3<F> {
        V3::<F> { x: self.x * k, y: self.y * k, z: self.z * k }
    }

    /// self · k + o.
    pub fn times_plus(self, k: F, o: V3<F>) -> V3<F> {
        V3::<F> { x: fma(self.x, k, o.x), y: fma(self.y, k, o.y), z: fma(self.z, k, o.z) }
    }

    pub fn dot(self, o: V3<F>) -> F {
        fma(self.z, o.z, fma(self.y, o.y, self.x * o.x))
    }

    pub fn cross(self, o: V3<F>) -> V3<F> {
        V3::<F> {
            x: fma(-self.z, o.y, self.y * o.z),
            y: fma(-self.x, o.z, self.z * o.x),
            z: fma(-self.y, o.x, self.x * o.y),
        }
    }
}

#[cube]
impl<F: Float> Sym3<F> {
    pub fn zero() -> Sym3<F> {
        let o = lit::<F>(0.0);
        Sym3::<F> { xx: o, yy: o, zz: o, xy: o, xz: o, yz: o }
    }

    pub fn add(self, o: Sym3<F>) -> Sym3<F> {
        Sym3::<F> {
            xx: self.xx + o.xx,
            yy: self.yy + o.yy,
            zz: self.zz + o.zz,
            xy: self.xy + o.xy,
            xz: self.xz + o.xz,
            yz: self.yz + o.yz,
        }
    }

    pub fn times(self, v: V3<F>) -> V3<F> {
        V3::<F> {
            x: V3::<F>::new(self.xx, self.xy, self.xz).dot(v),
            y: V3::<F>::new(self.xy, self.yy, self.yz).dot(v),
            z: V3::<F>::new(self.xz, self.yz, self.zz).dot(v),
        }
    }

    /// With the inertia about the origin of a point mass at `at`.
    pub fn with_point_mass(self, mass: F, at: V3<F>) -> Sym3<F> {
        let w = at * mass;
        let (xx, yy, zz) = (w.x * at.x, w.y * at.y, w.z * at.z);
        Sym3::<F> {
            xx: self.xx + (yy + zz),
            yy: self.yy + (xx + zz),
            zz: self.zz + (xx + yy),
            xy: fma(-w.x, at.y, self.xy),
            xz: fma(-w.x, at.z, self.xz),
            yz: fma(-w.y, at.z, self.yz),
        }
    }
}

#[cube]
impl<F: Float> Axes<F> {
    /// The world's coordinates of a vector that is given in this frame.
    pub fn rotate(self, v: V3<F>) -> V3<F> {
        self.z.times_plus(v.z, self.y.times_plus(v.y, self.x * v.x))
    }

    /// This frame's coordinates of a vector that is given in the world's.
    pub fn unrotate(self, v: V3<F>) -> V3<F> {
        V3::<F>::new(self.x.dot(v), self.y.dot(v), self.z.dot(v))
    }

    /// The world's axes of a frame that is given in this one.
    pub fn turned(self, o: Axes<F>) -> Axes<F> {
        Axes::<F> { x: self.rotate(o.x), y: self.rotate(o.y), z: self.rotate(o.z) }
    }

    /// R M Rᵀ.
    pub fn rotate_sym(self, m: Sym3<F>) -> Sym3<F> {
        let a = self.rotate(V3::<F>::new(m.xx, m.xy, m.xz));
        let b = self.rotate(V3::<F>::new(m.xy, m.yy, m.yz));
        let c = self.rotate(V3::<F>::new(m.xz, m.yz, m.zz));
        Sym3::<F> {
            xx: fma(c.x, self.z.x, fma(b.x, self.y.x, a.x * self.x.x)),
            yy: fma(c.y, self.z.y, fma(b.y, self.y.y, a.y * self.x.y)),
            zz: fma(c.z, self.z.z, fma(b.z, self.y.z, a.z * self.x.z)),
            xy: fma(c.x, self.z.y, fma(b.x, self.y.y, a.x * self.x.y)),
            xz: fma(c.x, self.z.z, fma(b.x, self.y.z, a.x * self.x.z)),
            yz: fma(c.y, self.z.z, fma(b.y, self.y.z, a.y * self.x.z)),
        }
    }
}

#[cube]
impl<F: Float> Quat<F> {
    pub fn normalized(self) -> Quat<F> {
        let k = lit::<F>(1.0) / fma(self.w, self.w, self.v.dot(self.v)).sqrt();
        Quat::<F> { w: self.w * k, v: self.v * k }
    }

    pub fn times(self, o: Quat<F>) -> Quat<F> {
        Quat::<F> {
            w: self.w * o.w - self.v.dot(o.v),
            v: self.v.times_plus(o.w, o.v * self.w) + self.v.cross(o.v),
        }
    }

    /// The axes of the frame that a unit quaternion turns the world's axes into.
    pub fn axes(self) -> Axes<F> {
        let (w, x, y, z) = (self.w, self.v.x, self.v.y, self.v.z);
        let (one, two) = (lit::<F>(1.0), lit::<F>(2.0));
        Axes::<F> {
            x: V3::<F>::new(one - two * (y * y + z * z), two * (x * y + w * z), two * (x * z - w * y)),
            y: V3::<F>::new(two * (x * y - w * z), one - two * (x * x + z * z), two * (y * z + w * x)),
            z: V3::<F>::new(two * (x * z + w * y), two * (y * z - w * x), one - two * (x * x + y * y)),
        }
    }
}

/// A constant of the kernel's number type, exact in f64 too.
#[cube]
pub fn lit<F: Float>(#[comptime] value: f64) -> F {
    intrinsic!(|scope| { F::elem_type(scope).constant(value.into()).into() })
}

/// Three neighbouring numbers of a buffer.
#[cube]
pub fn v3_at<F: Float>(numbers: &[F], at: usize) -> V3<F> {
    V3::<F>::new(numbers[at], numbers[at + 1], numbers[at + 2])
}

/// Nine neighbouring numbers of a buffer.
#[cube]
pub fn axes_at<F: Float>(numbers: &[F], at: usize) -> Axes<F> {
    Axes::<F> { x: v3_at::<F>(numbers, at), y: v3_at::<F>(numbers, at + 3), z: v3_at::<F>(numbers, at + 6) }
}

/// Six neighbouring numbers of a buffer.
#[cube]
pub fn sym3_at<F: Float>(numbers: &[F], at: usize) -> Sym3<F> {
    Sym3::<F> {
        xx: numbers[at],
        yy: numbers[at + 1],
        zz: numbers[at + 2],
        xy: numbers[at + 3],
        xz: numbers[at + 4],
        yz: numbers[at + 5],
    }
}

/// Sine and cosine by polynomials: a GPU's own are good to 5e-4 only by Vulkan's specification, and WGSL has
/// none for f64. Cody–Waite reduction by π/2.
#[cube]
pub fn sin_cos<F: Float>(angle: F) -> SinCos<F> {
    let quarter = (angle * lit::<F>(std::f64::consts::FRAC_2_PI)).round();
    let double = is_double::<F>();
    let high = if comptime!(double) {
        lit::<F>(std::f64::consts::FRAC_PI_2)
    } else {
        lit::<F>(1.570_796_370_506_286_6)
    };
    let low = if comptime!(double) {
        lit::<F>(6.123_233_995_736_766e-17)
    } else {
        lit::<F>(-4.371_139_000_186_241e-8)
    };
    let r = fma(-quarter, low, fma(-quarter, high, angle));
    let z = r * r;
    let s = fma(polynomial::<F>(z, comptime!(sine_terms(double))) * z, r, r);
    let c = polynomial::<F>(z, comptime!(cosine_terms(double)));
    let turn = quarter - lit::<F>(4.0) * (quarter * lit::<F>(0.25)).round();
    let size = turn.abs();
    let odd = size > lit::<F>(0.5) && size < lit::<F>(1.5);
    let half = size > lit::<F>(1.5);
    let backwards = odd && turn < lit::<F>(0.0);
    let forwards = odd && turn > lit::<F>(0.0);
    let sine = select(odd, c, s);
    let cosine = select(odd, s, c);
    SinCos::<F> {
        sin: select(half || backwards, -sine, sine),
        cos: select(half || forwards, -cosine, cosine),
    }
}

/// Whether the kernel's number type is f64.
#[cube]
pub fn is_double<F: Float>() -> comptime_type!(bool) {
    intrinsic!(|scope| { F::__expand_size(scope) == 8 })
}

fn sine_terms(double: bool) -> Vec<f64> {
    let all = [
        -1.0 / 1_307_674_368_000.0,
        1.0 / 6_227_020_800.0,
        -1.0 / 39_916_800.0,
        1.0 / 362_880.0,
        -1.0 / 5_040.0,
        1.0 / 120.0,
        -1.0 / 6.0,
    ];
    if double { all.to_vec() } else { all[3..].to_vec() }
}

fn cosine_terms(double: bool) -> Vec<f64> {
    let all = [
        1.0 / 20_922_789_888_000.0,
        -1.0 / 87_178_291_200.0,
        1.0 / 479_001_600.0,
        -1.0 / 3_628_800.0,
        1.0 / 40_320.0,
        -1.0 / 720.0,
        1.0 / 24.0,
        -0.5,
        1.0,
    ];
    if double { all.to_vec() } else { all[4..].to_vec() }
}

/// Horner's scheme, the highest power first.
#[cube]
pub fn polynomial<F: Float>(x: F, #[comptime] terms: Vec<f64>) -> F {
    let mut sum = lit::<F>(comptime!(terms[0]));
    #[unroll]
    for i in 1..comptime!(terms.len()) {
        sum = fma(sum, x, lit::<F>(comptime!(terms[i])));
    }
    sum
}

/// e^x for x ≤ 0, as sines are computed; below e^−80 it is 0.
#[cube]
pub fn exponential<F: Float>(x: F) -> F {
    let double = is_double::<F>();
    let tiny = x < lit::<F>(-80.0);
    let x = select(tiny, lit::<F>(0.0), x);
    let halvings = (x * lit::<F>(-std::f64::consts::LOG2_E)).round();
    let high = if comptime!(double) { lit::<F>(0.693_147_180_369_123_8) } else { lit::<F>(0.693_359_375) };
    let low =
        if comptime!(double) { lit::<F>(1.908_214_929_270_587_7e-10) } else { lit::<F>(-2.121_944_4e-4) };
    let rest = fma(halvings, low, fma(halvings, high, x));
    let mut product = polynomial::<F>(rest, comptime!(exponential_terms(double)));
    let count = u32::cast_from(halvings);
    #[unroll]
    for bit in 0..7u32 {
        let is_set = (count >> comptime!(bit)) & 1u32 == 1u32;
        product *= select(is_set, lit::<F>(comptime!((-f64::from(1u32 << bit)).exp2())), lit::<F>(1.0));
    }
    select(tiny, lit::<F>(0.0), product)
}

/// ln x for 2⁻⁵⁴ < x ≤ 1.
#[cube]
pub fn natural_logarithm<F: Float>(x: F) -> F {
    let mut reduced = x;
    let mut doublings = lit::<F>(0.0);
    #[unroll]
    for step in 0..6u32 {
        // x < 2^−32, 2^−16, …, 2^−1.
        let power = comptime!(f64::from(32u32 >> step));
        let is_small = reduced < lit::<F>(comptime!((-power).exp2()));
        reduced *= select(is_small, lit::<F>(comptime!(power.exp2())), lit::<F>(1.0));
        doublings += select(is_small, lit::<F>(power), lit::<F>(0.0));
    }
    // ln x = 2 artanh((x − 1) / (x + 1)), between −1/3 and 0.
    let ratio = (reduced - lit::<F>(1.0)) / (reduced + lit::<F>(1.0));
    let double = is_double::<F>();
    let series = polynomial::<F>(ratio * ratio, comptime!(artanh_terms(double)));
    fma(doublings, lit::<F>(-std::f64::consts::LN_2), lit::<F>(2.0) * ratio * series)
}

/// 1/n!, the highest power first.
fn exponential_terms(double: bool) -> Vec<f64> {
    let mut terms = vec![1.0];
    for n in 1..=if double { 14 } else { 7 } {
        terms.push(terms[n - 1] / n as f64);
    }
    terms.reverse();
    terms
}

/// 1/(2n + 1), the highest power first.
fn artanh_terms(double: bool) -> Vec<f64> {
    (0..if double { 17 } else { 8 }).rev().map(|n| 1.0 / f64::from(2 * n + 1)).collect()
}
