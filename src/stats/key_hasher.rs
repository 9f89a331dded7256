//! A hasher for keys that we make ourselves of small numbers: one multiplication (Fibonacci hashing,
//! Knuth), with the high bits in the low ones too, since tables take buckets from those and tags from
//! the others. Not for keys that come from outside.

use std::hash::{BuildHasherDefault, Hasher};

/// Hashes a `u64`.
#[derive(Default)]
pub struct KeyHasher(u64);

/// For tables of `u64` keys.
pub type KeyBuildHasher = BuildHasherDefault<KeyHasher>;

/// The hash of one key.
#[inline(always)]
#[must_use]
pub fn spread(key: u64) -> u64 {
    let h = key.wrapping_mul(0x9e37_79b9_7f4a_7c15);
    h ^ (h >> 32)
}

impl Hasher for KeyHasher {
    fn finish(&self) -> u64 {
        self.0
    }
    fn write(&mut self, bytes: &[u8]) {
        bytes.iter().for_each(|&b| self.write_u64(u64::from(b)));
    }
    #[inline(always)]
    fn write_u64(&mut self, key: u64) {
        self.0 = spread(self.0 ^ key);
    }
}
