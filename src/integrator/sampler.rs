//! Random numbers keyed by (pixel, sample, set), never drawn in turn: an Owen-scrambled Sobol
//! sequence, four dimensions a set, each set with its own shuffle of the sample index
//! (Burley 2020, "Practical Hash-based Owen Scrambling"; hash by Vegdahl 2021).
//!
//! Invariant: the first 2^k samples of a pixel are, in each set, a scrambled (t, k, 4)-net, and
//! sets and pixels have scrambles of their own, but for chance collisions of 32-bit keys.

/// Direction numbers of the first four Sobol dimensions (Joe and Kuo 2008), as the bit-reversed
/// image of each byte of the bit-reversed index, its highest byte first: one load and one xor a byte
/// give four dimensions at once. Bit-reversed, because the scramble below works from the lowest bit up.
static SOBOL: [[[u32; 4]; 256]; 4] = sobol_tables();

const fn direction(dimension: usize, bit: u32) -> u32 {
    // Initial numbers m and the primitive polynomial's inner coefficients a, degree s.
    if dimension == 0 {
        return 1 << (31 - bit);
    }
    let (s, a, m): (u32, u32, [u32; 3]) = match dimension {
        1 => (1, 0, [1, 0, 0]),
        2 => (2, 1, [1, 3, 0]),
        _ => (3, 1, [1, 3, 1]),
    };
    let mut v = [0u32; 32];
    let mut i = 0;
    while i < 32 {
        if i < s {
            v[i as usize] = m[i as usize] << (31 - i);
        } else {
            let mut x = v[(i - s) as usize] ^ (v[(i - s) as usize] >> s);
            let mut k = 1;
            while k < s {
                if (a >> (s - 1 - k)) & 1 == 1 {
                    x ^= v[(i - k) as usize];
                }
                k += 1;
            }
            v[i as usize] = x;
        }
        i += 1;
    }
    v[bit as usize]
}

const fn sobol_tables() -> [[[u32; 4]; 256]; 4] {
    let mut columns = [[0u32; 4]; 32];
    let mut d = 0;
    while d < 4 {
        let mut bit = 0;
        while bit < 32 {
            columns[bit][d] = direction(d, bit as u32).reverse_bits();
            bit += 1;
        }
        d += 1;
    }
    let mut t = [[[0u32; 4]; 256]; 4];
    let mut byte = 0;
    while byte < 4 {
        let mut value = 0;
        while value < 256 {
            let mut bit = 0;
            while bit < 8 {
                if (value >> (7 - bit)) & 1 == 1 {
                    let mut d = 0;
                    while d < 4 {
                        t[byte][value][d] ^= columns[byte * 8 + bit][d];
                        d += 1;
                    }
                }
                bit += 1;
            }
            value += 1;
        }
        byte += 1;
    }
    t
}

/// Owen scramble of a bit-reversed value: each bit is flipped by a hash of the bits below it.
#[inline(always)]
fn scramble(mut x: u32, seed: u32) -> u32 {
    x ^= x.wrapping_mul(0x3d20_adea);
    x = x.wrapping_add(seed);
    x = x.wrapping_mul((seed >> 16) | 1);
    x ^= x.wrapping_mul(0x0552_6c56);
    x ^ x.wrapping_mul(0x53a2_2864)
}

/// A 32-bit mix with low bias (Wellons 2018).
#[inline(always)]
#[must_use]
pub const fn mix(mut x: u32) -> u32 {
    x ^= x >> 16;
    x = x.wrapping_mul(0x7feb_352d);
    x ^= x >> 15;
    x = x.wrapping_mul(0x846c_a68b);
    x ^ (x >> 16)
}

/// The key of a pixel under a seed.
#[must_use]
pub fn pixel_key(x: u32, y: u32, seed: u64) -> u32 {
    let s = mix(seed as u32 ^ mix((seed >> 32) as u32 ^ 0x9e37_79b9));
    mix(x ^ mix(y ^ s))
}

/// Seeds of the four dimensions of a set, mixed with the set's own.
const LANES: [u32; 4] = [0x68bc_21eb, 0x02e5_be93, 0x967a_889b, 0x368c_c8b7];

/// Seed of a set of a pixel.
#[inline(always)]
fn seed(key: u32, set: u32) -> u32 {
    mix(key.wrapping_add(set.wrapping_mul(0x9e37_79b9)))
}

/// A sample's index in its set, bits reversed. An Owen scramble moves an aligned block of 2^k indices
/// onto another one.
#[inline(always)]
fn shuffle(reversed: u32, seed: u32) -> u32 {
    scramble(reversed, seed)
}

/// The unscrambled numbers, bits reversed, of sample `reversed` of a set, which is shuffled to
/// `shuffled`.
#[inline(always)]
fn sobol(reversed: u32, shuffled: u32, seed: u32) -> [u32; 4] {
    let (a, b) = (&SOBOL[0][(shuffled >> 24) as usize], &SOBOL[1][(shuffled >> 16 & 0xff) as usize]);
    let mut x = [a[0] ^ b[0], a[1] ^ b[1], a[2] ^ b[2], a[3] ^ b[3]];
    // Taking the upper half relative to index 0's keeps the first 65536 in the first block, whose
    // images need two table rows instead of four.
    if reversed & 0xffff != 0 {
        let upper = shuffled ^ shuffle(0, seed);
        let (a, b) = (SOBOL[2][(upper >> 8 & 0xff) as usize], SOBOL[3][(upper & 0xff) as usize]);
        for d in 0..4 {
            x[d] ^= a[d] ^ b[d];
        }
    }
    x
}

/// A number in [0, 1) from a bit-reversed value and its scramble's seed.
#[inline(always)]
fn finish(x: u32, seed: u32) -> f32 {
    // Signed conversion is one instruction, and 24 bits are never negative.
    (scramble(x, seed).reverse_bits() >> 8) as i32 as f32 * (1.0 / (1 << 24) as f32)
}

/// A set of one pixel: what all its samples share. Samples are named by their index with its bits
/// reversed, since that is what the scramble works on.
#[derive(Clone, Copy, Debug)]
pub struct Set {
    seed: u32,
    lanes: [u32; 4],
}

impl Set {
    /// Set `set` of the pixel with `key`.
    #[inline(always)]
    #[must_use]
    pub fn new(key: u32, set: u32) -> Self {
        let seed = seed(key, set);
        let mut lanes = LANES;
        for l in &mut lanes {
            *l = mix(seed ^ *l);
        }
        Self { seed, lanes }
    }

    /// The four numbers of a sample.
    #[inline(always)]
    #[must_use]
    pub fn sample(&self, reversed: u32) -> [f32; 4] {
        let x = sobol(reversed, shuffle(reversed, self.seed), self.seed);
        let mut out = [0.0; 4];
        for d in 0..4 {
            out[d] = finish(x[d], self.lanes[d]);
        }
        out
    }
}

/// As [`Set`], two sets at once: those of a path vertex.
#[derive(Clone, Copy, Debug)]
pub struct SetPair {
    key: u32,
    seeds: [u32; 2],
    /// Of each dimension, first set first: one register of eight lanes where the processor has those.
    lanes: [u32; 8],
}

impl SetPair {
    /// `set` and `set + 1` of the pixel with `key`.
    #[inline(always)]
    #[must_use]
    pub fn new(key: u32, set: u32) -> Self {
        let seeds = [seed(key, set), seed(key, set.wrapping_add(1))];
        let mut lanes = [0; 8];
        for (lane, l) in lanes.iter_mut().enumerate() {
            *l = seeds[lane / 4] ^ LANES[lane % 4];
        }
        for l in &mut lanes {
            *l = mix(*l);
        }
        Self { key, seeds, lanes }
    }

    /// Whose sets they are.
    #[inline(always)]
    #[must_use]
    pub fn key(&self) -> u32 {
        self.key
    }
}

/// Numbers of eight samples at once, each of a pixel of its own: both sets of each, in turn.
pub struct Octet {
    reversed: [u32; 8],
    seeds: [[u32; 8]; 2],
    lanes: [[u32; 8]; 8],
}

impl Octet {
    /// Of nobody yet.
    pub const EMPTY: Self = Self { reversed: [0; 8], seeds: [[0; 8]; 2], lanes: [[0; 8]; 8] };

    /// Sample `i` is sample `reversed` of `sets`.
    #[inline(always)]
    pub fn set(&mut self, i: usize, reversed: u32, sets: &SetPair) {
        self.reversed[i] = reversed;
        self.seeds[0][i] = sets.seeds[0];
        self.seeds[1][i] = sets.seeds[1];
        self.lanes[i] = sets.lanes;
    }

    /// The numbers of the first `count`, those of two calls of [`Set::sample`].
    #[inline(always)]
    pub fn sample(&self, count: usize, numbers: &mut [[f32; 8]; 8]) {
        let mut shuffled = [[0; 8]; 2];
        for (shuffled, seeds) in shuffled.iter_mut().zip(&self.seeds) {
            for i in 0..8 {
                shuffled[i] = shuffle(self.reversed[i], seeds[i]);
            }
        }
        for (i, numbers) in numbers.iter_mut().enumerate().take(count) {
            let [a, b, c, d] = sobol(self.reversed[i], shuffled[0][i], self.seeds[0][i]);
            let [e, f, g, h] = sobol(self.reversed[i], shuffled[1][i], self.seeds[1][i]);
            let x = [a, b, c, d, e, f, g, h];
            let lanes = self.lanes[i];
            let mut out = [0.0; 8];
            for lane in 0..8 {
                out[lane] = finish(x[lane], lanes[lane]);
            }
            *numbers = out;
        }
    }
}

/// The four numbers in [0, 1) of sample `index` of a pixel in dimension set `set`.
#[cfg(test)]
fn sample4(key: u32, index: u32, set: u32) -> [f32; 4] {
    Set::new(key, set).sample(index.reverse_bits())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_sets_of_eight_at_once_are_the_sets() {
        let mut octet = Octet::EMPTY;
        let indices = [0, 1, 77, 65_535, 65_536, 1 << 20, u32::MAX, 4];
        for (i, index) in indices.into_iter().enumerate() {
            octet.set(i, index.reverse_bits(), &SetPair::new(pixel_key(index, 3, 4), 5));
        }
        let mut numbers = [[-1.0; 8]; 8];
        octet.sample(7, &mut numbers);
        for (index, numbers) in indices.into_iter().zip(numbers).take(7) {
            let key = pixel_key(index, 3, 4);
            let both = [sample4(key, index, 5), sample4(key, index, 6)].concat();
            assert_eq!(numbers.as_slice(), both);
        }
        assert_eq!(numbers[7], [-1.0; 8]);
    }

    #[test]
    fn every_set_is_stratified_in_each_dimension() {
        // 256 samples of any set put exactly one point in each of 256 intervals a dimension.
        for set in [0, 1, 7, 100] {
            let mut seen = [[false; 256]; 4];
            for i in 0..256 {
                for (d, u) in sample4(pixel_key(3, 5, 9), i, set).into_iter().enumerate() {
                    let cell = &mut seen[d][(u * 256.0) as usize];
                    assert!(!*cell, "two samples of set {set} in one interval of dimension {d}");
                    *cell = true;
                }
            }
        }
    }

    #[test]
    fn the_first_two_dimensions_are_a_0_2_net() {
        // Every elementary interval of area 1/64 holds exactly one of 64 points.
        for (log_x, log_y) in [(0, 6), (1, 5), (2, 4), (3, 3), (4, 2), (5, 1), (6, 0)] {
            let mut seen = [false; 64];
            for i in 0..64 {
                let u = sample4(pixel_key(1, 2, 3), i, 4);
                let x = (u[0] * (1 << log_x) as f32) as usize;
                let y = (u[1] * (1 << log_y) as f32) as usize;
                let cell = &mut seen[y << log_x | x];
                assert!(!*cell);
                *cell = true;
            }
        }
    }

    #[test]
    fn blocks_beyond_65536_stay_stratified() {
        let mut seen = vec![false; 1 << 10];
        for i in 0..1 << 10 {
            let u = sample4(77, (3 << 16) + i, 2)[3];
            let cell = &mut seen[(u * 1024.0) as usize];
            assert!(!*cell);
            *cell = true;
        }
    }

    #[test]
    fn sets_and_pixels_are_uncorrelated() {
        // Correlation of 4096 pairs: standard error 1/64; five of them is one false alarm in
        // 1.7 million.
        let n = 4096;
        let correlation = |a: &dyn Fn(u32) -> f32, b: &dyn Fn(u32) -> f32| {
            (0..n).map(|i| f64::from((a(i) - 0.5) * (b(i) - 0.5))).sum::<f64>() / f64::from(n) * 12.0
        };
        let k = pixel_key(10, 20, 0);
        for d in 0..4 {
            for e in 0..4 {
                let c = correlation(&|i| sample4(k, i, 0)[d], &|i| sample4(k, i, 1)[e]);
                assert!(c.abs() < 5.0 / 64.0, "sets 0.{d} and 1.{e}: {c}");
                let c = correlation(&|i| sample4(k, i, 0)[d], &|i| sample4(pixel_key(11, 20, 0), i, 0)[e]);
                assert!(c.abs() < 5.0 / 64.0, "pixels, {d} and {e}: {c}");
            }
        }
    }
}
