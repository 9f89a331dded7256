//! Evaluates texture expressions at a point: constants, images, and the nodes that combine them.
//! Depth of the expression is bounded by the scene file (a texture names earlier ones only), so
//! recursion ends.

use super::{Footprint, Sampler, TextureStore, random_bits};
use crate::color::Rgb;
use crate::error::{Error, Result};
use crate::prepare::{KnownTexture, known_textures, mix};
use crate::scene::{Mapping, Texture, TextureFilter, TextureId};
use glam::{DVec3, Vec2, Vec3};
use std::f32::consts::PI;

/// Where a texture is asked for.
#[derive(Clone, Copy, Debug)]
pub struct TextureCoordinates {
    /// Surface parameters.
    pub uv: Vec2,
    /// World-space position.
    pub p: Vec3,
    /// Unit shading normal.
    pub n: Vec3,
    /// Axes of the footprint in units of `uv`; zero asks for the finest level.
    pub duv_dx: Vec2,
    /// The other.
    pub duv_dy: Vec2,
    /// The same axes in world space.
    pub dp_dx: Vec3,
    /// The other.
    pub dp_dy: Vec3,
    /// Names the pixel and the sample, for filters that choose at random. They do not where there is
    /// no footprint, so who gives none may give anything.
    pub key: u32,
}

impl TextureCoordinates {
    /// A place without a footprint.
    #[inline(always)]
    #[must_use]
    pub fn at(uv: Vec2, p: Vec3, n: Vec3) -> Self {
        let (duv, dp) = (Vec2::ZERO, Vec3::ZERO);
        Self { uv, p, n, duv_dx: duv, duv_dy: duv, dp_dx: dp, dp_dy: dp, key: 0 }
    }
}

/// The textures of a scene with the images they read.
pub struct Textures {
    nodes: Vec<Texture>,
    known: Vec<KnownTexture>,
    store: TextureStore,
}

impl Textures {
    /// Takes over the scene's texture table and its loaded images; `filter` is what all of them use,
    /// whatever the scene says.
    ///
    /// # Errors
    /// [`Error::Usage`] for an expression of more than [`Texture::MAX_NODES`].
    pub fn new(mut nodes: Vec<Texture>, store: TextureStore, filter: Option<TextureFilter>) -> Result<Self> {
        if let Some(asked) = filter {
            for node in &mut nodes {
                if let Texture::Image { filter, .. } = node {
                    *filter = asked;
                }
            }
        }
        let known = known_textures(&nodes);
        if let Some((i, known)) = known.iter().enumerate().find(|(_, k)| k.nodes > Texture::MAX_NODES) {
            return Err(Error::Usage(format!(
                "texture {i} of the scene is made of {} others; {} at most",
                known.nodes,
                Texture::MAX_NODES
            )));
        }
        Ok(Self { nodes, known, store })
    }

    /// The images.
    #[must_use]
    pub fn store(&self) -> &TextureStore {
        &self.store
    }

    /// The value if it is the same everywhere.
    #[must_use]
    pub fn constant(&self, id: TextureId) -> Option<Rgb> {
        self.known[id.index()].constant
    }

    /// Whether any image below this texture filters over a footprint.
    #[must_use]
    pub fn wants_footprint(&self, id: TextureId) -> bool {
        self.known[id.index()].wants_footprint
    }

    /// Whether anything below this texture looks at surface parameters, and not at the position alone.
    #[must_use]
    pub fn reads_uv(&self, id: TextureId) -> bool {
        let node = &self.nodes[id.index()];
        let own = match node {
            Texture::Image { mapping, .. }
            | Texture::Checkerboard { mapping, .. }
            | Texture::Bilerp { mapping, .. } => matches!(mapping, Mapping::Uv { .. }),
            _ => false,
        };
        own || node.parts().into_iter().flatten().any(|part| self.reads_uv(part))
    }

    /// The texture's value; a float is grey.
    #[inline(never)]
    #[must_use]
    pub fn eval(&self, id: TextureId, at: &TextureCoordinates) -> Rgb {
        self.eval_here(id, at)
    }

    /// [`Self::eval`], compiled into its caller; for the commonest.
    #[inline(always)]
    #[must_use]
    pub fn eval_here(&self, id: TextureId, at: &TextureCoordinates) -> Rgb {
        match &self.nodes[id.index()] {
            Texture::Constant(c) => *c,
            Texture::Image { image, mapping, filter, wrap, scale, invert, channels } => {
                let (uv, [duv_dx, duv_dy]) = map(mapping, at, true);
                let random = match filter {
                    TextureFilter::Stochastic => random_bits(at.key, at.p, id.0),
                    _ => 0,
                };
                let footprint = Footprint { duv_dx, duv_dy, random };
                let sampler = Sampler { filter: *filter, wrap: *wrap, channels: *channels };
                let value = self.store.lookup(*image, uv, footprint, sampler) * *scale;
                if *invert { (Rgb::ONE - value).max(Rgb::ZERO) } else { value }
            }
            _ => {
                // A copy: what is lent to a call must lie in memory, and `at` need not.
                let at = *at;
                self.eval_node(id, &at)
            }
        }
    }

    #[inline(never)]
    fn eval_node(&self, id: TextureId, at: &TextureCoordinates) -> Rgb {
        match &self.nodes[id.index()] {
            Texture::Constant(_) | Texture::Image { .. } => self.eval(id, at),
            Texture::Scale { texture, scale } => {
                let s = self.eval(*scale, at);
                if s == Rgb::ZERO { Rgb::ZERO } else { self.eval(*texture, at) * s }
            }
            Texture::Mix { a, b, amount } => self.blend(*a, *b, self.eval(*amount, at), at),
            Texture::DirectionMix { a, b, dir } => {
                let amount = at.n.dot(Vec3::from(*dir)).abs();
                self.blend(*b, *a, Rgb::splat(amount), at)
            }
            Texture::Checkerboard { mapping, a, b } => {
                let (uv, [x, y]) = map(mapping, at, true);
                let width = x.abs().max(y.abs());
                // Half-width of the tent over the pixel: pbrt-v4's 1.5 pixels.
                let even = square_wave(uv.x, 1.5 * width.x) * square_wave(uv.y, 1.5 * width.y);
                self.blend(*a, *b, Rgb::splat(0.5 - 0.5 * even), at)
            }
            Texture::Checkerboard3d { world_to_texture, a, b } => {
                let p = world_to_texture.point(at.p).floor();
                let odd = (p.x + p.y + p.z).rem_euclid(2.0) >= 1.0;
                self.eval(if odd { *b } else { *a }, at)
            }
            Texture::Bilerp { mapping, corners } => {
                let (uv, _) = map(mapping, at, false);
                let [v00, v01, v10, v11] = *corners;
                let left = v00 * (1.0 - uv.y) + v01 * uv.y;
                let right = v10 * (1.0 - uv.y) + v11 * uv.y;
                left * (1.0 - uv.x) + right * uv.x
            }
        }
    }

    /// a + amount (b − a), without evaluating what has no share.
    fn blend(&self, a: TextureId, b: TextureId, amount: Rgb, at: &TextureCoordinates) -> Rgb {
        if amount == Rgb::ZERO {
            self.eval(a, at)
        } else if amount == Rgb::ONE {
            self.eval(b, at)
        } else {
            mix(self.eval(a, at), self.eval(b, at), amount)
        }
    }
}

/// Texture coordinates, and the footprint's axes in them if `filtered`.
#[inline(always)]
fn map(mapping: &Mapping, at: &TextureCoordinates, filtered: bool) -> (Vec2, [Vec2; 2]) {
    match mapping {
        Mapping::Uv { scale, delta } => {
            let scale = Vec2::from(*scale);
            (at.uv * scale + Vec2::from(*delta), [at.duv_dx * scale, at.duv_dy * scale])
        }
        other => {
            let (uv, at) = (map_position(other, at.uv, at.p), *at);
            (uv, if filtered { map_footprint(other, uv, &at) } else { [Vec2::ZERO; 2] })
        }
    }
}

/// The footprint's axes by differences of the mapping.
#[inline(never)]
fn map_footprint(mapping: &Mapping, uv: Vec2, at: &TextureCoordinates) -> [Vec2; 2] {
    [at.dp_dx, at.dp_dy].map(|dp| {
        let d = map_position(mapping, at.uv, at.p + dp) - uv;
        match mapping {
            // Azimuths jump by 1 where they begin.
            Mapping::Spherical { .. } => Vec2::new(d.x, d.y - d.y.round()),
            Mapping::Cylindrical { .. } => Vec2::new(d.x - d.x.round(), d.y),
            Mapping::Uv { .. } | Mapping::Planar { .. } => d,
        }
    })
}

#[inline(never)]
fn map_position(mapping: &Mapping, uv: Vec2, p: Vec3) -> Vec2 {
    let around = |p: Vec3| {
        let phi = p.y.atan2(p.x);
        (if phi < 0.0 { phi + 2.0 * PI } else { phi }) / (2.0 * PI)
    };
    match mapping {
        Mapping::Uv { scale, delta } => uv * Vec2::from(*scale) + Vec2::from(*delta),
        Mapping::Spherical { world_to_texture } => {
            let p = world_to_texture.point(p);
            let theta = p.truncate().length().atan2(p.z);
            // pbrt-v4: s is the polar angle, t the azimuth.
            Vec2::new(theta / PI, around(p))
        }
        Mapping::Cylindrical { world_to_texture } => {
            let p = world_to_texture.point(p);
            Vec2::new(around(p), p.z)
        }
        Mapping::Planar { world_to_texture, v1, v2, delta } => {
            let p = world_to_texture.point_f64(p.as_dvec3());
            let axis = |v: &[f32; 3]| Vec3::from(*v).as_dvec3();
            let along = |v: DVec3| p.dot(v);
            Vec2::new(along(axis(v1)) as f32, along(axis(v2)) as f32) + Vec2::from(*delta)
        }
    }
}

/// The wave that is +1 on [2k, 2k+1) and −1 on [2k+1, 2k+2), under a tent of half-width `r`.
fn square_wave(x: f32, r: f32) -> f32 {
    let side = |x: f32| if (x * 0.5).fract().rem_euclid(1.0) < 0.5 { 1.0 } else { -1.0 };
    if r <= 0.0 || (x - r).floor() == (x + r).floor() {
        return side(x);
    }
    // Its second integral is periodic but for a linear part that the second difference removes.
    let second = |x: f32| {
        let y = x * 0.5 - (x * 0.5).floor();
        // ∫∫ over one period of length 2: s²/2 up to the middle, then 1/2 + ... symmetrical.
        let s = 2.0 * y;
        let whole = (x * 0.5).floor();
        whole + if s < 1.0 { 0.5 * s * s } else { 0.5 + (s - 1.0) - 0.5 * (s - 1.0) * (s - 1.0) }
    };
    (second(x + r) - 2.0 * second(x) + second(x - r)) / (r * r)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn square_wave_is_the_tent_average_of_a_square_wave() {
        for (x, r) in [(0.25f32, 0.5f32), (0.9, 0.3), (1.0, 0.2), (-0.7, 1.3), (3.4, 2.2)] {
            let n = 200_000;
            let mut sum = 0.0f64;
            for i in 0..n {
                let s = (f64::from(i) + 0.5) / f64::from(n) * 2.0 - 1.0;
                let at = f64::from(x) + s * f64::from(r);
                let wave = if (at * 0.5 - (at * 0.5).floor()) < 0.5 { 1.0 } else { -1.0 };
                sum += wave * (1.0 - s.abs()) * 2.0 / f64::from(n);
            }
            let got = f64::from(square_wave(x, r));
            assert!((got - sum).abs() < 1e-4, "x {x}, r {r}: {got} against {sum}");
        }
        assert_eq!(square_wave(0.5, 0.0), 1.0);
        assert_eq!(square_wave(1.5, 0.1), -1.0);
        assert_eq!(square_wave(-0.5, 0.0), -1.0);
    }
}
