//! Noise by integer hashing, and the little mathematics that scenes need. Invariant: only integer
//! operations and the correctly rounded ones of f32 and f64 (+ − × ÷ √ and floor), so that a seed
//! gives the same bits on every machine. Never calls sin, cos, exp or pow of a library.

/// Mixes `seed` and a lattice point into 32 bits (multiply and xor-shift, as in MurmurHash3's
/// finalizer).
#[inline]
pub(super) fn hash(seed: u32, x: i32, y: i32) -> u32 {
    let a = x.cast_unsigned().wrapping_mul(0x9e37_79b1);
    let b = y.cast_unsigned().wrapping_mul(0x85eb_ca77).rotate_left(15);
    let mut h = seed.wrapping_mul(0x27d4_eb2f) ^ a ^ b.wrapping_mul(0xc2b2_ae3d);
    h = (h ^ h >> 16).wrapping_mul(0x85eb_ca6b);
    h = (h ^ h >> 13).wrapping_mul(0xc2b2_ae35);
    h ^ h >> 16
}

/// Uniform in [0, 1).
#[inline]
pub(super) fn unit(h: u32) -> f32 {
    (h >> 8) as f32 * (1.0 / 16_777_216.0)
}

/// Splits a position into lattice point and fraction.
#[inline]
fn cell(p: f64) -> (i32, f32) {
    let floor = p.floor();
    (floor as i32, (p - floor) as f32)
}

/// Gradient noise in [−1, 1] about 0 with its derivatives by x and y. Lattice cells are units.
pub(super) fn gradient(seed: u32, x: f64, y: f64) -> [f32; 3] {
    let ((ix, fx), (iy, fy)) = (cell(x), cell(y));
    let corner = |i: i32, j: i32| {
        let h = hash(seed, ix.wrapping_add(i), iy.wrapping_add(j));
        // The square of directions, less regular than eight and as cheap.
        let g = [(h & 0xffff) as f32 * (2.0 / 65535.0) - 1.0, (h >> 16) as f32 * (2.0 / 65535.0) - 1.0];
        (g, g[0] * (fx - i as f32) + g[1] * (fy - j as f32))
    };
    let ((ga, a), (gb, b), (gc, c), (gd, d)) = (corner(0, 0), corner(1, 0), corner(0, 1), corner(1, 1));
    let fade = |t: f32| t * t * t * (t * (t * 6.0 - 15.0) + 10.0);
    let slope = |t: f32| 30.0 * t * t * (t - 1.0) * (t - 1.0);
    let (u, v, du, dv) = (fade(fx), fade(fy), slope(fx), slope(fy));
    let twist = a - b - c + d;
    let mix = |k: usize| {
        ga[k] + u * (gb[k] - ga[k]) + v * (gc[k] - ga[k]) + u * v * (ga[k] - gb[k] - gc[k] + gd[k])
    };
    [
        1.25 * (a + u * (b - a) + v * (c - a) + u * v * twist),
        1.25 * (mix(0) + du * (b - a + v * twist)),
        1.25 * (mix(1) + dv * (c - a + u * twist)),
    ]
}

/// A sum of `octaves` of gradient noise, each of twice the frequency and half the height, turned
/// against each other so that lattices do not line up. About [−1, 1].
pub(super) fn fbm(seed: u32, mut x: f64, mut y: f64, octaves: u32) -> f32 {
    let (mut sum, mut height) = (0.0, 0.5);
    for i in 0..octaves {
        sum += height * gradient(seed.wrapping_add(i), x, y)[0];
        height *= 0.5;
        (x, y) = (1.6 * x - 1.2 * y, 1.2 * x + 1.6 * y);
    }
    sum
}

/// Value noise in [0, 1): cheaper, smoother.
pub(super) fn value(seed: u32, x: f64, y: f64) -> f32 {
    let ((ix, fx), (iy, fy)) = (cell(x), cell(y));
    let at = |i: i32, j: i32| unit(hash(seed, ix.wrapping_add(i), iy.wrapping_add(j)));
    let (u, v) = (smooth(fx), smooth(fy));
    lerp(lerp(at(0, 0), at(1, 0), u), lerp(at(0, 1), at(1, 1), u), v)
}

/// Adds `height` × value noise in [−1, 1] along a row of texels: `xs` are positions, ascending, in
/// units, `y` the row's. Cells smaller than about a texel (`step` is a row's height) fade out.
pub(super) fn add_row(
    seed: u32,
    frequency: f32,
    xs: &[f32],
    (y, step): (f32, f32),
    height: f32,
    out: &mut [f32],
) {
    let blur = (1.5 - step * frequency).clamp(0.0, 1.0);
    if blur == 0.0 || xs.len() < 2 {
        return;
    }
    let fy = y * frequency;
    let floor = fy.floor();
    let (iy, v) = (floor as i32, smooth(fy - floor));
    let column = |i: i32| {
        let (a, b) = (unit(hash(seed, i, iy)), unit(hash(seed, i, iy.wrapping_add(1))));
        lerp(a, b, v) * 2.0 - 1.0
    };
    let (mut at, mut left, mut right) = (i32::MIN, 0.0f32, 0.0f32);
    for (k, out) in out.iter_mut().enumerate() {
        let p = xs[k] * frequency;
        let step = if k + 1 < xs.len() { xs[k + 1] - xs[k] } else { xs[k] - xs[k - 1] };
        let fine = 1.5 - step * frequency;
        if fine <= 0.0 {
            continue;
        }
        let floor = p.floor();
        let i = floor as i32;
        if i != at {
            left = if at != i32::MIN && i == at + 1 { right } else { column(i) };
            right = column(i.wrapping_add(1));
            at = i;
        }
        *out += height * blur * fine.min(1.0) * lerp(left, right, smooth(p - floor));
    }
}

/// 3t² − 2t³.
#[inline]
pub(super) fn smooth(t: f32) -> f32 {
    t * t * (3.0 - 2.0 * t)
}

/// 0 below `a`, 1 above `b`, smooth between.
#[inline]
pub(super) fn smoothstep(a: f32, b: f32, x: f32) -> f32 {
    smooth(((x - a) / (b - a)).clamp(0.0, 1.0))
}

/// From `a` to `b`.
#[inline]
pub(super) fn lerp(a: f32, b: f32, t: f32) -> f32 {
    a + (b - a) * t
}

/// From colour `a` to `b`.
#[inline]
pub(super) fn blend(a: [f32; 3], b: [f32; 3], t: f32) -> [f32; 3] {
    [lerp(a[0], b[0], t), lerp(a[1], b[1], t), lerp(a[2], b[2], t)]
}

/// Cosine and sine of `turns` whole turns, within 1e-8.
pub(super) fn turn(turns: f64) -> [f32; 2] {
    let quarters = turns * 4.0;
    let whole = (quarters + 0.5).floor();
    let t = (quarters - whole) * std::f64::consts::FRAC_PI_2;
    let s = t * t;
    // Taylor's polynomials on [−π/4, π/4].
    let sin = t * (1.0 - s / 6.0 * (1.0 - s / 20.0 * (1.0 - s / 42.0 * (1.0 - s / 72.0))));
    let cos = 1.0 - s / 2.0 * (1.0 - s / 12.0 * (1.0 - s / 30.0 * (1.0 - s / 56.0)));
    let (c, s) = match (whole as i64).rem_euclid(4) {
        0 => (cos, sin),
        1 => (-sin, cos),
        2 => (-cos, -sin),
        _ => (sin, -cos),
    };
    [c as f32, s as f32]
}

/// Cross product.
pub(super) fn cross(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// Of length one; +z for no length.
pub(super) fn normalized(a: [f32; 3]) -> [f32; 3] {
    let length = (a[0] * a[0] + a[1] * a[1] + a[2] * a[2]).sqrt();
    if length > 0.0 { a.map(|c| c / length) } else { [0.0, 0.0, 1.0] }
}

/// `a + t b`.
pub(super) fn along(a: [f32; 3], b: [f32; 3], t: f32) -> [f32; 3] {
    [a[0] + t * b[0], a[1] + t * b[1], a[2] + t * b[2]]
}

/// Numbers in turn (SplitMix64), for what is decided once.
#[derive(Clone)]
pub(super) struct Random(u64);

impl Random {
    /// A sequence of its own for every pair.
    pub(super) fn new(seed: u32, index: u64) -> Self {
        let mut r = Self(u64::from(seed) << 32 ^ index.wrapping_mul(0x9e37_79b9_7f4a_7c15));
        r.bits();
        r
    }

    pub(super) fn bits(&mut self) -> u32 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ self.0 >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        (z >> 32) as u32
    }

    /// In [0, 1).
    pub(super) fn unit(&mut self) -> f32 {
        unit(self.bits())
    }

    /// In [a, b).
    pub(super) fn range(&mut self, a: f32, b: f32) -> f32 {
        lerp(a, b, self.unit())
    }

    /// One of them.
    pub(super) fn pick<T: Copy>(&mut self, of: &[T]) -> T {
        of[(self.unit() * of.len() as f32) as usize]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn turns_are_cosine_and_sine() {
        for k in -40..40 {
            let t = f64::from(k) / 29.0;
            let [c, s] = turn(t);
            let angle = t * std::f64::consts::TAU;
            assert!(
                (f64::from(c) - angle.cos()).abs() < 1e-7 && (f64::from(s) - angle.sin()).abs() < 1e-7,
                "{t}"
            );
        }
    }

    #[test]
    fn derivatives_are_those_of_the_noise() {
        for k in 0..200u32 {
            let (x, y) = (f64::from(k) * 0.173 - 9.0, f64::from(k) * 0.311 - 20.0);
            let d = 1e-4;
            let [_, dx, dy] = gradient(7, x, y);
            let nx = (f64::from(gradient(7, x + d, y)[0]) - f64::from(gradient(7, x - d, y)[0])) / (2.0 * d);
            let ny = (f64::from(gradient(7, x, y + d)[0]) - f64::from(gradient(7, x, y - d)[0])) / (2.0 * d);
            assert!(
                (nx - f64::from(dx)).abs() < 0.02 && (ny - f64::from(dy)).abs() < 0.02,
                "{k}: {nx} {dx} {ny} {dy}"
            );
        }
    }
}
