//! Light from an image at infinity: its radiance by direction, and directions by its radiance.
//!
//! Invariant: the density is positive wherever the (filtered) radiance is. Texels that are negative
//! or not finite count as black, and are counted. Never loads an image.

use super::distribution::Distribution2d;
use super::octahedral::{sphere_to_square, square_to_sphere};
use crate::color::{Rgb, luminance};
use crate::math::{INV_4PI, Transform, prefetch};
use glam::{DMat3, Mat3, Vec2, Vec3};
use std::f32::consts::{PI, TAU};

/// How the image covers the sphere.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EnvMapping {
    /// Clarberg's equal-area octahedral map of a square image, +z in the middle (pbrt-v4).
    EqualAreaOctahedral,
    /// Latitude and longitude, +z along the upper edge, +x at the left and right edge and +y a
    /// quarter from the left (pbrt-v3).
    LatLong,
}

/// How texels become radiance.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EnvFilter {
    /// The texel hit, as pbrt-v4 does: sampling is then exactly in proportion to luminance.
    Nearest,
    /// Linear between the four nearest texel centres, across the seams of the mapping too.
    Bilinear,
}

/// An image at infinity.
pub struct EnvironmentMap {
    texels: Vec<[f32; 3]>,
    width: usize,
    height: usize,
    mapping: EnvMapping,
    filter: EnvFilter,
    to_world: Mat3,
    to_light: Mat3,
    distribution: Option<Distribution2d>,
    replaced: usize,
}

/// A direction chosen on the map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EnvSample {
    /// Unit direction towards the light, world space.
    pub wi: Vec3,
    /// Radiance from there.
    pub radiance: Rgb,
    /// Density [1/sr].
    pub pdf: f32,
}

impl EnvironmentMap {
    /// From linear texels, row by row from the top. `light_to_world` turns, and may mirror, the
    /// map; its scale has no effect, and a stretch is removed.
    ///
    /// # Errors
    /// One line where the size does not fit the texels or the mapping, or the transform is no use.
    pub fn new(
        mut texels: Vec<[f32; 3]>,
        width: usize,
        height: usize,
        mapping: EnvMapping,
        filter: EnvFilter,
        light_to_world: &Transform,
    ) -> Result<Self, String> {
        let side = 1..=1 << 24;
        let fits = side.contains(&width) && side.contains(&height);
        if !fits || width.checked_mul(height) != Some(texels.len()) {
            let n = texels.len();
            return Err(format!(
                "an environment image of {width} by {height} with {n} texels; expected one texel for each"
            ));
        }
        if mapping == EnvMapping::EqualAreaOctahedral && width != height {
            return Err(format!(
                "an environment image of {width} by {height}; expected a square one in equal-area mapping"
            ));
        }
        let to_world = orthogonal(DMat3::from_mat4(light_to_world.m))
            .ok_or("an environment light's transform is singular; expected a rotation")?
            .as_mat3();
        let mut replaced = 0;
        for texel in &mut texels {
            if texel.iter().any(|c| !(0.0..f32::INFINITY).contains(c)) {
                // One bad channel leaves the others in doubt, but a hole would show more.
                *texel = texel.map(|c| if c > 0.0 && c < f32::INFINITY { c } else { 0.0 });
                replaced += 1;
            }
        }
        let mut map = Self {
            texels,
            width,
            height,
            mapping,
            filter,
            to_world,
            to_light: to_world.transpose(),
            distribution: None,
            replaced,
        };
        let weights = map.weights();
        map.distribution = Distribution2d::new(&weights, width, height);
        Ok(map)
    }

    /// Luminance of the filtered map, averaged over each texel, times the texel's solid angle.
    fn weights(&self) -> Vec<f32> {
        // A maximal texel must not make the sum of 2⁴⁸ of them overflow.
        let lum = |x: i64, y: i64| luminance(self.texel(x, y)).min(1e30);
        let mut weights = Vec::with_capacity(self.texels.len());
        for y in 0..self.height as i64 {
            let area = match self.mapping {
                EnvMapping::EqualAreaOctahedral => 1.0,
                EnvMapping::LatLong => self.row_height(y as usize).1 as f32 * self.height as f32,
            };
            for x in 0..self.width as i64 {
                let value = match self.filter {
                    EnvFilter::Nearest => lum(x, y),
                    // The mean of linear interpolation over a texel is (1, 6, 1)/8 of its row.
                    EnvFilter::Bilinear => {
                        let row = |y: i64| 0.125 * (lum(x - 1, y) + lum(x + 1, y)) + 0.75 * lum(x, y);
                        0.125 * (row(y - 1) + row(y + 1)) + 0.75 * row(y)
                    }
                };
                weights.push(value * area);
            }
        }
        weights
    }

    /// (1 − cosθ at the top, its growth over the row), by the half angle so that rows at the poles
    /// keep their digits.
    #[inline]
    fn row_height(&self, y: usize) -> (f64, f64) {
        let versine = |y: usize| {
            let s = (std::f64::consts::FRAC_PI_2 * y as f64 / self.height as f64).sin();
            2.0 * s * s
        };
        (versine(y), versine(y + 1) - versine(y))
    }

    /// The texel at `x`, `y`, which may lie one beyond the image: the mapping says what is there.
    #[inline]
    fn texel(&self, x: i64, y: i64) -> Rgb {
        let (w, h) = (self.width as i64, self.height as i64);
        let (mut x, mut y) = (x, y);
        match self.mapping {
            EnvMapping::EqualAreaOctahedral => {
                // Each edge is folded in its middle.
                if x < 0 || x >= w {
                    x = if x < 0 { -1 - x } else { 2 * w - 1 - x };
                    y = h - 1 - y;
                }
                if y < 0 || y >= h {
                    y = if y < 0 { -1 - y } else { 2 * h - 1 - y };
                    x = w - 1 - x;
                }
            }
            EnvMapping::LatLong => {
                // Over a pole lies the opposite meridian.
                if y < 0 || y >= h {
                    y = if y < 0 { -1 - y } else { 2 * h - 1 - y };
                    x += w / 2;
                }
                x = x.rem_euclid(w);
            }
        }
        Rgb::from_array(self.texels[y as usize * self.width + x as usize])
    }

    /// The cell and the radiance at a point of the unit square.
    #[inline]
    fn lookup(&self, uv: Vec2) -> Rgb {
        let at = uv * Vec2::new(self.width as f32, self.height as f32);
        if self.filter == EnvFilter::Nearest {
            let x = (at.x as usize).min(self.width - 1);
            let y = (at.y as usize).min(self.height - 1);
            return Rgb::from_array(self.texels[y * self.width + x]);
        }
        let at = at - 0.5;
        let (x, y) = (at.x.floor(), at.y.floor());
        let (tx, ty) = (at.x - x, at.y - y);
        let (x, y) = (x as i64, y as i64);
        let (a, b, c, d) = if x >= 0 && y >= 0 && x + 1 < self.width as i64 && y + 1 < self.height as i64 {
            let i = y as usize * self.width + x as usize;
            let (upper, lower) = (&self.texels[i..i + 2], &self.texels[i + self.width..i + self.width + 2]);
            let get = Rgb::from_array;
            (get(upper[0]), get(upper[1]), get(lower[0]), get(lower[1]))
        } else {
            (self.texel(x, y), self.texel(x + 1, y), self.texel(x, y + 1), self.texel(x + 1, y + 1))
        };
        a.lerp(b, tx).lerp(c.lerp(d, tx), ty)
    }

    /// The point of the unit square in world direction `wi`.
    #[inline]
    fn square(&self, wi: Vec3) -> Vec2 {
        let w = (self.to_light * wi).normalize_or_zero();
        match self.mapping {
            EnvMapping::EqualAreaOctahedral => sphere_to_square(w),
            EnvMapping::LatLong => {
                let phi = w.y.atan2(w.x) / TAU;
                // The arctangent keeps its digits at the poles, where the arccosine of z would not.
                let theta = (w.x * w.x + w.y * w.y).sqrt().atan2(w.z) / PI;
                Vec2::new(if phi < 0.0 { phi + 1.0 } else { phi }, theta)
            }
        }
    }

    /// Radiance from world direction `wi`.
    #[inline]
    #[must_use]
    pub fn radiance(&self, wi: Vec3) -> Rgb {
        self.lookup(self.square(wi))
    }

    /// A hint that a texel will be read, and perhaps its neighbours. One that is not there does no harm.
    #[inline]
    fn soon_at(&self, x: usize, y: usize) {
        prefetch(self.texels.as_ptr().wrapping_add(y * self.width + x), 1);
    }

    /// A hint that [`Self::radiance`] will be asked about `wi`, and [`Self::pdf`] if it is `weighted`.
    #[inline]
    pub fn soon(&self, wi: Vec3, weighted: bool) {
        let at = self.square(wi) * Vec2::new(self.width as f32, self.height as f32);
        let (x, y) = (at.x as usize, at.y as usize);
        self.soon_at(x, y);
        if let Some(distribution) = self.distribution.as_ref().filter(|_| weighted) {
            distribution.soon_at(x, y);
        }
    }

    /// A hint that `u` will be [sampled](Self::sample).
    #[inline]
    pub fn soon_sampled(&self, u: Vec2) {
        self.distribution.iter().for_each(|d| d.soon(u));
    }

    /// A hint that the radiance of what `u` samples will be read, to follow [`Self::soon_sampled`] in some nanoseconds.
    #[inline]
    pub fn soon_seen(&self, u: Vec2) {
        let Some(distribution) = &self.distribution else { return };
        let cell = distribution.sample(u);
        self.soon_at(cell.x, cell.y);
    }

    /// A direction in proportion to luminance. `None` where the map is black.
    #[inline]
    #[must_use]
    pub fn sample(&self, u: Vec2) -> Option<EnvSample> {
        let cell = self.distribution.as_ref()?.sample(u);
        let size = Vec2::new(self.width as f32, self.height as f32);
        let mut uv = (Vec2::new(cell.x as f32, cell.y as f32) + cell.offset) / size;
        let (w, pdf) = match self.mapping {
            EnvMapping::EqualAreaOctahedral => {
                (square_to_sphere(uv), cell.probability * (size.x * size.y) * INV_4PI)
            }
            EnvMapping::LatLong => {
                // Uniform in solid angle within the cell, so that poles are nothing special.
                let (top, height) = self.row_height(cell.y);
                let versine = top + f64::from(cell.offset.y) * height;
                let sin = (versine * (2.0 - versine)).max(0.0).sqrt();
                uv.y = (sin.atan2(1.0 - versine) / std::f64::consts::PI) as f32;
                let (s, c) = (TAU * uv.x).sin_cos();
                let w = Vec3::new(sin as f32 * c, sin as f32 * s, (1.0 - versine) as f32);
                (w, cell.probability * size.x / (TAU * height as f32))
            }
        };
        Some(EnvSample { wi: self.to_world * w, radiance: self.lookup(uv), pdf })
    }

    /// Density [1/sr] with which [`EnvironmentMap::sample`] chooses `wi`.
    #[inline]
    #[must_use]
    pub fn pdf(&self, wi: Vec3) -> f32 {
        let Some(distribution) = &self.distribution else { return 0.0 };
        let uv = self.square(wi);
        let x = ((uv.x * self.width as f32) as usize).min(self.width - 1);
        let y = ((uv.y * self.height as f32) as usize).min(self.height - 1);
        let probability = distribution.probability(x, y);
        match self.mapping {
            EnvMapping::EqualAreaOctahedral => {
                probability * (self.width as f32 * self.height as f32) * INV_4PI
            }
            EnvMapping::LatLong => probability * self.width as f32 / (TAU * self.row_height(y).1 as f32),
        }
    }

    /// Irradiance on a surface with unit world normal `n`, all of the map unoccluded; texel by texel.
    #[must_use]
    pub fn irradiance(&self, n: Vec3) -> Rgb {
        self.integrate(|w| w.dot(n).max(0.0))
    }

    /// Radiance averaged over all directions.
    #[must_use]
    pub fn mean_radiance(&self) -> Rgb {
        self.integrate(|_| INV_4PI)
    }

    fn integrate(&self, f: impl Fn(Vec3) -> f32) -> Rgb {
        let mut sum = glam::DVec3::ZERO;
        for y in 0..self.height {
            let (top, height) = self.row_height(y);
            for x in 0..self.width {
                let uv =
                    Vec2::new((x as f32 + 0.5) / self.width as f32, (y as f32 + 0.5) / self.height as f32);
                let (w, omega) = match self.mapping {
                    EnvMapping::EqualAreaOctahedral => {
                        (square_to_sphere(uv), 4.0 * std::f64::consts::PI / self.texels.len() as f64)
                    }
                    EnvMapping::LatLong => {
                        let z = 1.0 - (top + 0.5 * height);
                        let r = (1.0 - z * z).max(0.0).sqrt() as f32;
                        let (s, c) = (TAU * uv.x).sin_cos();
                        (
                            Vec3::new(r * c, r * s, z as f32),
                            height * std::f64::consts::TAU / self.width as f64,
                        )
                    }
                };
                let texel = Rgb::from_array(self.texels[y * self.width + x]).as_dvec3();
                sum += texel * (f64::from(f(self.to_world * w)) * omega);
            }
        }
        sum.as_vec3()
    }

    /// How many texels were negative or not finite.
    #[must_use]
    pub fn replaced(&self) -> usize {
        self.replaced
    }

    /// Memory held.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        size_of_val(&self.texels[..]) as u64 + self.distribution.as_ref().map_or(0, Distribution2d::bytes)
    }

    /// Memory that a map of this size holds where anything shines.
    #[must_use]
    pub fn bytes_for(width: u64, height: u64) -> u64 {
        size_of::<[f32; 3]>() as u64 * width * height + Distribution2d::bytes_for(width, height)
    }
}

/// The orthogonal matrix next to `m`: Newton's iteration for the polar decomposition (Higham
/// 1986); `None` for a singular one.
fn orthogonal(mut m: DMat3) -> Option<DMat3> {
    let scale = m.determinant().abs().cbrt();
    if !(scale > 0.0 && scale.is_finite()) {
        return None;
    }
    m *= 1.0 / scale;
    for _ in 0..32 {
        m = (m + m.inverse().transpose()) * 0.5;
    }
    m.is_finite().then_some(m)
}

#[cfg(test)]
mod tests {
    use super::super::testing::{Rng, check_directions};
    use super::*;
    use glam::DMat4;

    fn image(w: usize, h: usize, seed: u64) -> Vec<[f32; 3]> {
        let mut rng = Rng::new(seed);
        let mut channel = || if rng.f32() < 0.3 { 0.0 } else { rng.f32().powi(4) };
        let mut texels: Vec<[f32; 3]> = (0..w * h).map(|_| [channel(), channel(), channel()]).collect();
        texels[w + 2] = [30.0, 20.0, 10.0];
        texels
    }

    fn turned() -> Transform {
        let m = DMat4::from_rotation_x(0.7) * DMat4::from_scale(glam::DVec3::new(-2.0, 2.0, 2.0));
        Transform::from_matrix(m).expect("invertible")
    }

    const KINDS: [(EnvMapping, usize, usize); 2] =
        [(EnvMapping::EqualAreaOctahedral, 12, 12), (EnvMapping::LatLong, 22, 11)];

    #[test]
    fn directions_follow_the_density_which_covers_the_radiance() {
        for (mapping, w, h) in KINDS {
            for filter in [EnvFilter::Nearest, EnvFilter::Bilinear] {
                let map =
                    EnvironmentMap::new(image(w, h, 3), w, h, mapping, filter, &turned()).expect("fits");
                let name = format!("{mapping:?} {filter:?}");
                let mut rng = Rng::new(8);
                let mut differ = 0;
                for _ in 0..20_000 {
                    let s = map.sample(rng.vec2()).expect("not black");
                    assert!((s.wi.length() - 1.0).abs() < 1e-5);
                    // Rounding may carry a direction over a texel's edge, rarely.
                    let off = (map.pdf(s.wi) / s.pdf - 1.0).abs() > 1e-4;
                    let off = off || (map.radiance(s.wi) - s.radiance).abs().max_element() > 1e-3;
                    differ += usize::from(off);
                    let wi = rng.direction();
                    assert!(map.radiance(wi) == Rgb::ZERO || map.pdf(wi) > 0.0, "{name} {wi}");
                }
                assert!(differ <= 20, "{name}: {differ}");
                check_directions(
                    &name,
                    Vec3::new(0.2, -0.3, 0.9),
                    |u| map.sample(u).map(|s| s.wi),
                    |w| map.pdf(w),
                );
            }
        }
    }

    #[test]
    fn seams_and_poles_are_continuous_when_filtered() {
        for (mapping, w, h) in KINDS {
            let map = EnvironmentMap::new(image(w, h, 5), w, h, mapping, EnvFilter::Bilinear, &turned());
            let map = map.expect("fits");
            let mut rng = Rng::new(12);
            for i in 0..20_000 {
                let mut a = rng.direction();
                // Near the axes and their planes, where the maps fold; a step of 1e-4 across.
                a[i % 3] *= 1e-5;
                if i % 2 == 0 {
                    a[(i + 1) % 3] *= 1e-5;
                }
                let a = (map.to_world * a).normalize();
                let b = (a + rng.direction() * 1e-4).normalize();
                // A LatLong pole row is a fan: neighbours differ by the whole turn, unlike its texels'
                // distance; only the octahedral map is continuous there.
                let pole = (map.to_light * a).z.abs() > 0.97 && mapping == EnvMapping::LatLong;
                let jump = (map.radiance(a) - map.radiance(b)).abs().max_element();
                assert!(pole || jump < 0.1, "{mapping:?} {a}: {jump}");
            }
        }
    }

    #[test]
    fn a_constant_map_is_constant_and_sends_pi() {
        for (mapping, w, h) in KINDS {
            let map =
                EnvironmentMap::new(vec![[2.0; 3]; w * h], w, h, mapping, EnvFilter::Bilinear, &turned());
            let map = map.expect("fits");
            let mut rng = Rng::new(1);
            for _ in 0..1000 {
                let s = map.sample(rng.vec2()).expect("not black");
                assert!((s.pdf / INV_4PI - 1.0).abs() < 1e-5 && (s.radiance - 2.0).length() < 1e-5);
            }
            assert!((map.mean_radiance() - 2.0).abs().max_element() < 1e-5);
            assert!((map.irradiance(Vec3::new(0.6, 0.0, 0.8)).x / (2.0 * PI) - 1.0).abs() < 0.01);
        }
    }

    #[test]
    fn the_brightest_texel_stands_where_the_mapping_says() {
        let mut texels = vec![[0.0; 3]; 64 * 32];
        // A quarter from the left, near the upper edge's equator line: +y.
        texels[15 * 64 + 16] = [1.0; 3];
        let id = Transform::IDENTITY;
        let map =
            EnvironmentMap::new(texels, 64, 32, EnvMapping::LatLong, EnvFilter::Nearest, &id).expect("fits");
        assert!(map.sample(Vec2::splat(0.5)).expect("light").wi.dot(Vec3::Y) > 0.99);
        let mut texels = vec![[0.0; 3]; 32 * 32];
        texels[16 * 32 + 31] = [1.0; 3];
        let mapping = EnvMapping::EqualAreaOctahedral;
        let map = EnvironmentMap::new(texels, 32, 32, mapping, EnvFilter::Nearest, &id).expect("fits");
        assert!(map.sample(Vec2::splat(0.5)).expect("light").wi.dot(Vec3::X) > 0.99);
    }

    #[test]
    fn damaged_images_are_mended_or_refused() {
        let id = Transform::IDENTITY;
        let new = |t: Vec<[f32; 3]>, w, h, m| EnvironmentMap::new(t, w, h, m, EnvFilter::Bilinear, &id);
        let octahedral = EnvMapping::EqualAreaOctahedral;
        let bad = vec![[f32::NAN, 1.0, 1.0], [-1.0, 0.0, 0.0], [f32::INFINITY; 3], [1.0; 3]];
        let map = new(bad, 2, 2, octahedral).expect("mended");
        assert_eq!(map.replaced(), 3);
        assert!(map.sample(Vec2::ZERO).is_some_and(|s| s.radiance.is_finite() && s.pdf > 0.0));
        let black = new(vec![[0.0; 3]], 1, 1, octahedral).expect("black is an image");
        assert_eq!((black.sample(Vec2::ZERO), black.pdf(Vec3::X)), (None, 0.0));
        let huge = new(vec![[f32::MAX; 3]; 4], 2, 2, octahedral).expect("finite");
        assert!(huge.sample(Vec2::splat(0.9)).is_some_and(|s| (s.pdf / INV_4PI - 1.0).abs() < 1e-4));
        for e in [
            new(vec![[1.0; 3]; 2], 2, 1, octahedral).err(),
            new(vec![[1.0; 3]; 2], 2, 2, octahedral).err(),
            new(Vec::new(), 0, 0, EnvMapping::LatLong).err(),
        ] {
            assert!(e.is_some_and(|e| e.contains("expected") && !e.contains('\n')));
        }
    }
}
