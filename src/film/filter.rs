//! Filter importance sampling: draws the offset of a sample in its pixel in proportion to |f|, so
//! that the estimate of a pixel is Σ w L / Σ w with weights of one size (Ernst et al. 2006; pbrt
//! 4th ed., §8.8). Invariant: a weight is +1, or −1 where the filter is negative. pbrt's own weight
//! f/p differs from that by the constant ∫|f|, which the quotient cancels; a filter without lobes
//! below zero so weighs every sample exactly 1. Never looks at radiance.

use crate::math::{Vec2, sqr};
use crate::scene::Filter;
use std::f32::consts::PI;

/// Cells of the tabulated density per pixel of radius, pbrt's figure.
const CELLS_PER_RADIUS: f32 = 32.0;
/// Bound on the cells of an axis; it bounds memory should a file ask for an absurd radius.
const MAX_CELLS: usize = 4096;
/// Largest f32 below one: a draw of 1 would fall off the table.
const ONE_MINUS_EPSILON: f32 = 1.0 - f32::EPSILON / 2.0;

/// Draws offsets from a pixel's centre in proportion to the absolute value of a filter.
#[derive(Clone, Debug)]
pub struct FilterSampler {
    kind: Kind,
}

#[derive(Clone, Debug)]
enum Kind {
    Box(Vec2),
    Triangle(Vec2),
    /// Every tabulated filter is a product over the axes, and so is the density: two short
    /// tables replace pbrt's table of the plane, with the same map from `u` to the offset.
    Product(Axis, Axis),
}

impl FilterSampler {
    /// Tabulates `filter` where its density has no closed inverse. A filter that is zero at every
    /// cell (a deviation far below a cell) becomes a point at the pixel's centre.
    #[must_use]
    pub fn new(filter: &Filter) -> Self {
        let kind = match *filter {
            Filter::Box { radius } => Kind::Box(Vec2::from(radius)),
            Filter::Triangle { radius } => Kind::Triangle(Vec2::from(radius)),
            Filter::Gaussian { radius, .. }
            | Filter::Mitchell { radius, .. }
            | Filter::Sinc { radius, .. } => {
                let axis = |i: usize| Axis::new(radius[i], |x| evaluate_axis(filter, i, x));
                Kind::Product(axis(0), axis(1))
            }
        };
        Self { kind }
    }

    /// Offset in pixels from the pixel's centre, and its weight (+1 or −1), for `u` in [0,1)².
    #[inline]
    #[must_use]
    pub fn sample(&self, u: Vec2) -> (Vec2, f32) {
        match &self.kind {
            Kind::Box(radius) => ((u * 2.0 - Vec2::ONE) * *radius, 1.0),
            Kind::Triangle(radius) => (Vec2::new(sample_tent(u.x), sample_tent(u.y)) * *radius, 1.0),
            Kind::Product(x, y) => {
                let (dx, sx) = x.sample(u.x);
                let (dy, sy) = y.sample(u.y);
                (Vec2::new(dx, dy), sx * sy)
            }
        }
    }

    /// ∫f / ∫|f|: what the weights average to. 1 unless the filter has lobes below zero.
    #[must_use]
    pub fn mean_weight(&self) -> f32 {
        match &self.kind {
            Kind::Box(_) | Kind::Triangle(_) => 1.0,
            Kind::Product(x, y) => x.mean_sign * y.mean_sign,
        }
    }
}

/// Value of `filter` at an offset in pixels from the pixel's centre (pbrt 4th ed., §8.8).
#[must_use]
pub fn evaluate(filter: &Filter, offset: Vec2) -> f32 {
    evaluate_axis(filter, 0, offset.x) * evaluate_axis(filter, 1, offset.y)
}

/// One factor of the product that every filter here is.
fn evaluate_axis(filter: &Filter, axis: usize, x: f32) -> f32 {
    let x = x.abs();
    let radius = match *filter {
        Filter::Box { radius }
        | Filter::Triangle { radius }
        | Filter::Gaussian { radius, .. }
        | Filter::Mitchell { radius, .. }
        | Filter::Sinc { radius, .. } => radius[axis],
    };
    if x > radius {
        return 0.0;
    }
    match *filter {
        Filter::Box { .. } => 1.0,
        Filter::Triangle { .. } => radius - x,
        Filter::Gaussian { sigma, .. } => (gaussian(x, sigma) - gaussian(radius, sigma)).max(0.0),
        Filter::Mitchell { b, c, .. } => mitchell(2.0 * x / radius, b, c),
        Filter::Sinc { tau, .. } => sinc(x) * sinc(x / tau),
    }
}

fn gaussian(x: f32, sigma: f32) -> f32 {
    (-0.5 * sqr(x / sigma)).exp() / (sigma * (2.0 * PI).sqrt())
}

/// Mitchell and Netravali 1988, eq. 8, for x in [0, 2].
fn mitchell(x: f32, b: f32, c: f32) -> f32 {
    let cubic = if x < 1.0 {
        ((12.0 - 9.0 * b - 6.0 * c) * x + (-18.0 + 12.0 * b + 6.0 * c)) * x * x + (6.0 - 2.0 * b)
    } else {
        (((-b - 6.0 * c) * x + (6.0 * b + 30.0 * c)) * x + (-12.0 * b - 48.0 * c)) * x + (8.0 * b + 24.0 * c)
    };
    cubic / 6.0
}

/// sin(πx)/(πx).
fn sinc(x: f32) -> f32 {
    let t = PI * x;
    // Below this the quotient rounds to 1, and 0/0 is out of reach.
    if t.abs() < 1e-4 { 1.0 } else { t.sin() / t }
}

/// Inverse of the distribution of 1 − |x| on [−1, 1].
#[inline(always)]
fn sample_tent(u: f32) -> f32 {
    if u < 0.5 { (2.0 * u).sqrt() - 1.0 } else { 1.0 - (2.0 - 2.0 * u).max(0.0).sqrt() }
}

/// A step of one axis' distribution.
#[derive(Clone, Copy, Debug)]
struct Cell {
    /// Probability of everything to the left.
    below: f32,
    /// Left edge.
    left: f32,
    /// Pixels per unit of probability.
    slope: f32,
    /// Sign of the filter at the centre.
    sign: f32,
}

const _: () = assert!(size_of::<Cell>() == 16, "four cells a cache line");

/// Piecewise constant density of one axis.
#[derive(Clone, Debug)]
struct Axis {
    cells: Vec<Cell>,
    /// For each of as many equal parts of [0,1): the cell that holds the part's lower end. A draw
    /// then walks a step or two where a bisection would take six.
    guide: Vec<u16>,
    mean_sign: f32,
}

impl Axis {
    fn new(radius: f32, f: impl Fn(f32) -> f32) -> Self {
        // `as` saturates, and sends NaN to 0: any radius gives a table of bounded length.
        let count = ((CELLS_PER_RADIUS * radius) as usize).clamp(1, MAX_CELLS);
        let width = 2.0 * f64::from(radius) / count as f64;
        let left = |i: usize| -f64::from(radius) + i as f64 * width;
        let values: Vec<f64> = (0..count).map(|i| f64::from(f((left(i) + 0.5 * width) as f32))).collect();
        let sum: f64 = values.iter().map(|v| v.abs()).sum();
        if !(sum > 0.0 && sum.is_finite()) {
            let centre = Cell { below: 0.0, left: 0.0, slope: 0.0, sign: 1.0 };
            return Self { cells: vec![centre], guide: vec![0], mean_sign: 1.0 };
        }
        let mut cells = Vec::with_capacity(count);
        let mut below = 0.0;
        for (i, &value) in values.iter().enumerate() {
            let probability = value.abs() / sum;
            cells.push(Cell {
                below: below as f32,
                left: left(i) as f32,
                slope: if probability > 0.0 { (width / probability) as f32 } else { 0.0 },
                sign: if value < 0.0 { -1.0 } else { 1.0 },
            });
            below += probability;
        }
        let parts = (2 * count).next_power_of_two();
        let guide = (0..parts).map(|part| {
            let u = part as f32 / parts as f32;
            // Below MAX_CELLS, so below u16::MAX.
            (cells.partition_point(|cell| cell.below <= u) - 1) as u16
        });
        let guide = guide.collect();
        Self { cells, guide, mean_sign: (values.iter().sum::<f64>() / sum) as f32 }
    }

    #[inline(always)]
    fn sample(&self, u: f32) -> (f32, f32) {
        let u = u.min(ONE_MINUS_EPSILON);
        let part = (u * self.guide.len() as f32) as usize;
        let mut i = usize::from(self.guide[part]);
        // Cells of no probability share `below` with the next and are walked over.
        while i + 1 < self.cells.len() && self.cells[i + 1].below <= u {
            i += 1;
        }
        let cell = self.cells[i];
        (cell.left + (u - cell.below) * cell.slope, cell.sign)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FILTERS: [(Filter, &str); 7] = [
        (Filter::Box { radius: [0.5, 0.5] }, "box"),
        (Filter::Triangle { radius: [2.0, 1.0] }, "triangle"),
        (Filter::Gaussian { radius: [1.5, 1.5], sigma: 0.5 }, "gaussian"),
        (Filter::Gaussian { radius: [2.0, 1.0], sigma: 1.0 }, "wide gaussian"),
        (Filter::Mitchell { radius: [2.0, 2.0], b: 1.0 / 3.0, c: 1.0 / 3.0 }, "mitchell"),
        (Filter::Sinc { radius: [4.0, 4.0], tau: 3.0 }, "sinc"),
        (Filter::Sinc { radius: [2.0, 3.0], tau: 2.0 }, "narrow sinc"),
    ];

    fn radius(filter: &Filter) -> [f32; 2] {
        match *filter {
            Filter::Box { radius }
            | Filter::Triangle { radius }
            | Filter::Gaussian { radius, .. }
            | Filter::Mitchell { radius, .. }
            | Filter::Sinc { radius, .. } => radius,
        }
    }

    /// PCG32 (O'Neill 2014): chi-squared asks for independent draws, which a low-discrepancy
    /// sequence is not.
    struct Pcg(u64);
    impl Pcg {
        fn next(&mut self) -> f32 {
            self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            let word = (((self.0 >> 18) ^ self.0) >> 27) as u32;
            let bits = word.rotate_right((self.0 >> 59) as u32);
            (bits >> 8) as f32 / (1u32 << 24) as f32
        }
    }

    /// ∫ g over one axis' interval, midpoint rule.
    fn integrate(from: f64, to: f64, g: impl Fn(f32) -> f64) -> f64 {
        const STEPS: usize = 4000;
        let width = (to - from) / STEPS as f64;
        (0..STEPS).map(|i| g((from + (i as f64 + 0.5) * width) as f32)).sum::<f64>() * width
    }

    /// Chi-squared over a 16×16 grid against |f| itself, not its table. False alarm: 1e-6 a
    /// filter by Wilson and Hilferty's normal approximation (z = 4.75).
    #[test]
    fn samples_follow_the_absolute_value() {
        const BINS: usize = 16;
        const DRAWS: usize = 400_000;
        for (filter, name) in &FILTERS {
            let sampler = FilterSampler::new(filter);
            let r = radius(filter);
            let mut counts = [[0u32; BINS]; BINS];
            let mut random = Pcg(7);
            for _ in 0..DRAWS {
                let (p, _) = sampler.sample(Vec2::new(random.next(), random.next()));
                assert!(p.x.abs() <= r[0] * 1.000_001 && p.y.abs() <= r[1] * 1.000_001, "{name}: {p}");
                let bin = |x: f32, r: f32| (((x + r) / (2.0 * r) * BINS as f32) as usize).min(BINS - 1);
                counts[bin(p.y, r[1])][bin(p.x, r[0])] += 1;
            }
            let mass = |axis: usize| -> Vec<f64> {
                let r64 = f64::from(r[axis]);
                let edge = |i: usize| -r64 + 2.0 * r64 * i as f64 / BINS as f64;
                let parts: Vec<f64> = (0..BINS)
                    .map(|i| integrate(edge(i), edge(i + 1), |x| evaluate_axis(filter, axis, x).abs().into()))
                    .collect();
                let sum: f64 = parts.iter().sum();
                parts.into_iter().map(|p| p / sum).collect()
            };
            let (mx, my) = (mass(0), mass(1));
            let (mut chi2, mut cells, mut rest_expected, mut rest_seen) = (0.0, 0.0, 0.0, 0.0);
            for y in 0..BINS {
                for x in 0..BINS {
                    let expected = mx[x] * my[y] * DRAWS as f64;
                    let seen = f64::from(counts[y][x]);
                    if expected < 8.0 {
                        rest_expected += expected;
                        rest_seen += seen;
                    } else {
                        chi2 += (seen - expected).powi(2) / expected;
                        cells += 1.0;
                    }
                }
            }
            if rest_expected > 8.0 {
                chi2 += (rest_seen - rest_expected).powi(2) / rest_expected;
                cells += 1.0;
            }
            let dof: f64 = cells - 1.0;
            let k = 2.0 / (9.0 * dof);
            let z = ((chi2 / dof).cbrt() - (1.0 - k)) / k.sqrt();
            assert!(z < 4.75, "{name}: chi-squared {chi2:.1} with {dof} degrees of freedom (z {z:.2})");
        }
    }

    #[test]
    fn weights_average_to_the_integral_over_the_absolute_integral() {
        for (filter, name) in &FILTERS {
            let sampler = FilterSampler::new(filter);
            let r = radius(filter);
            let mut expected = 1.0;
            for (axis, radius) in r.into_iter().enumerate() {
                let r64 = f64::from(radius);
                let value = |x: f32| f64::from(evaluate_axis(filter, axis, x));
                expected *= integrate(-r64, r64, value) / integrate(-r64, r64, |x| value(x).abs());
            }
            // The table's own error: a sign change inside a cell, at most 1e-3 of the whole.
            assert!((f64::from(sampler.mean_weight()) - expected).abs() < 1e-3, "{name}");
            const SIDE: u32 = 2048;
            let mut sum = 0.0;
            for i in 0..SIDE * SIDE {
                let u = Vec2::new((i % SIDE) as f32 + 0.5, (i / SIDE) as f32 + 0.5) / SIDE as f32;
                let (_, weight) = sampler.sample(u);
                assert!(weight.abs() == 1.0, "{name}");
                sum += f64::from(weight);
            }
            // A change of sign may move by half a stratum, which moves the mean by 1/2048; an axis of
            // the sinc has up to six.
            assert!((sum / f64::from(SIDE * SIDE) - expected).abs() < 6e-3, "{name}");
        }
    }

    #[test]
    fn integrals_are_the_known_ones() {
        let integral = |filter: &Filter, axis: usize| {
            let r = f64::from(radius(filter)[axis]);
            integrate(-r, r, |x| f64::from(evaluate_axis(filter, axis, x)))
        };
        let near = |a: f64, b: f64| assert!((a - b).abs() < 1e-5, "{a} is not {b}");
        near(integral(&Filter::Box { radius: [0.5, 0.5] }, 0), 1.0);
        near(integral(&Filter::Triangle { radius: [2.0, 1.0] }, 0), 4.0);
        // erf(3/√2) − 3 G(1.5).
        near(integral(&Filter::default(), 0), 0.970_709_1);
        // Mitchell and Netravali's family integrates to one on [−2, 2] for every B and C.
        for (b, c) in [(1.0 / 3.0, 1.0 / 3.0), (1.0, 0.0), (0.0, 0.5)] {
            near(integral(&Filter::Mitchell { radius: [2.0, 2.0], b, c }, 0), 1.0);
            near(integral(&Filter::Mitchell { radius: [1.0, 3.0], b, c }, 1), 1.5);
        }
        assert_eq!(evaluate(&Filter::Sinc { radius: [4.0, 4.0], tau: 3.0 }, Vec2::ZERO), 1.0);
        assert!(evaluate(&Filter::Sinc { radius: [4.0, 4.0], tau: 3.0 }, Vec2::new(1.0, 0.0)).abs() < 1e-6);
        assert_eq!(evaluate(&Filter::default(), Vec2::new(1.6, 0.0)), 0.0);
    }

    /// Variances in closed form: r²/3 and r²/6, by a 512-point midpoint rule.
    #[test]
    fn box_and_triangle_have_their_variances() {
        const N: usize = 512;
        for (filter, expected) in [
            (Filter::Box { radius: [0.5, 0.5] }, 0.25 / 3.0),
            (Filter::Triangle { radius: [2.0, 1.0] }, 4.0 / 6.0),
        ] {
            let sampler = FilterSampler::new(&filter);
            let variance: f64 = (0..N)
                .map(|i| {
                    let (p, _) = sampler.sample(Vec2::new((i as f32 + 0.5) / N as f32, 0.5));
                    f64::from(p.x).powi(2)
                })
                .sum::<f64>()
                / N as f64;
            assert!((variance - expected).abs() < 1e-3, "{variance} is not {expected}");
        }
    }

    #[test]
    fn odd_parameters_stay_finite_and_bounded() {
        let nan = f32::NAN;
        for filter in [
            Filter::Gaussian { radius: [1.5, 1.5], sigma: 1e-9 },
            Filter::Gaussian { radius: [1.5, 1.5], sigma: 0.0 },
            Filter::Gaussian { radius: [0.0, 1e30], sigma: 0.5 },
            Filter::Mitchell { radius: [0.01, 0.01], b: 0.0, c: 0.0 },
            Filter::Mitchell { radius: [2.0, 2.0], b: nan, c: 0.0 },
            Filter::Sinc { radius: [nan, 4.0], tau: 0.0 },
        ] {
            let sampler = FilterSampler::new(&filter);
            for u in [0.0, 0.25, 0.5, ONE_MINUS_EPSILON, 1.0] {
                let (p, weight) = sampler.sample(Vec2::splat(u));
                assert!(p.is_finite() && weight.abs() == 1.0, "{filter:?} at {u}: {p}");
            }
        }
        let point = FilterSampler::new(&Filter::Gaussian { radius: [1.5, 1.5], sigma: 1e-9 });
        assert_eq!(point.sample(Vec2::splat(0.9)).0, Vec2::ZERO);
    }
}
