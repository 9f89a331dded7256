//! Divides more centres than memory holds, as [`cut`](crate::accel::bvh::cut) would, until their parts fit.
//!
//! Invariant: parts are the very sets that halving in memory comes by, one after the other, so that the groups into
//! which they are cut at last do not depend on how much memory there is.

use super::scratch::{BLOCK_BYTES, Scratch};
use crate::accel::bvh::{Centre, Spread, left_of};
use crate::texture::convert::Failure;
use bytemuck::{bytes_of, cast_slice, cast_slice_mut};
use std::ops::Range;

/// Keys are counted in so many bins at once.
const BIN_BITS: u32 = 14;

/// Centres in two files.
pub(super) struct Sorter<'a> {
    /// They go from one to the other whenever they are divided.
    pub(super) files: [Scratch; 2],
    /// Triangles of a group.
    pub(super) most: usize,
    /// Bytes of centres, or of their keys, in memory.
    pub(super) room: usize,
    pub(super) stop: &'a (dyn Fn() -> bool + Sync),
}

impl Sorter<'_> {
    /// Calls `take` with the parts of `range` of the file `here`, in order.
    pub(super) fn divide(
        &self,
        here: usize,
        range: Range<u64>,
        spread: &Spread,
        take: &mut dyn FnMut(Vec<Centre>) -> Result<(), Failure>,
    ) -> Result<(), Failure> {
        let count = range.end - range.start;
        if (self.stop)() {
            return Err(Failure::Source(crate::error::Error::Interrupted));
        }
        let Some(left) =
            left_of(count, self.most).filter(|_| count > (self.room / size_of::<Centre>()) as u64)
        else {
            let mut part = vec![Centre::default(); count as usize];
            self.files[here].read(range.start, cast_slice_mut(&mut part))?;
            return take(part);
        };
        let axis = spread.axis();
        let pivot = self.pivot(here, &range, (axis, spread.keys(axis)), left)?;
        let middle = range.start + left;
        let there = 1 - here;
        let mut writers = [range.start, middle].map(|first| self.files[there].writer(first));
        let mut spreads = [Spread::NONE; 2];
        self.files[here].stream::<Failure>(range.clone(), BLOCK_BYTES, |records| {
            for centre in cast_slice::<u8, Centre>(records) {
                let side = usize::from(centre.key(axis) >= pivot);
                spreads[side].add(centre);
                writers[side].push(bytes_of(centre))?;
            }
            Ok(())
        })?;
        for mut writer in writers {
            writer.flush()?;
        }
        self.divide(there, range.start..middle, &spreads[0], take)?;
        self.divide(there, middle..range.end, &spreads[1], take)
    }

    /// The key of `range` that `rank` others are below.
    fn pivot(
        &self,
        here: usize,
        range: &Range<u64>,
        (axis, (mut lo, mut hi)): (usize, (u64, u64)),
        rank: u64,
    ) -> Result<u64, Failure> {
        let (mut before, mut inside) = (0, range.end - range.start);
        // Those from `lo` to `hi`.
        let keys = |lo: u64, hi: u64, see: &mut dyn FnMut(u64)| {
            self.files[here].stream::<Failure>(range.clone(), BLOCK_BYTES, |records| {
                let keys = cast_slice::<u8, Centre>(records).iter().map(|c| c.key(axis));
                keys.filter(|key| (lo..=hi).contains(key)).for_each(&mut *see);
                Ok(())
            })
        };
        while inside > (self.room / size_of::<u64>()) as u64 {
            let shift = (u64::BITS - (hi - lo).leading_zeros()).saturating_sub(BIN_BITS);
            let mut bins = vec![0u64; 1 << BIN_BITS];
            keys(lo, hi, &mut |key| bins[((key - lo) >> shift) as usize] += 1)?;
            let mut bin = 0;
            while before + bins[bin] <= rank {
                before += bins[bin];
                bin += 1;
            }
            inside = bins[bin];
            lo += (bin as u64) << shift;
            hi = hi.min(lo + ((1 << shift) - 1));
        }
        let mut found = Vec::with_capacity(inside as usize);
        keys(lo, hi, &mut |key| found.push(key))?;
        Ok(*found.select_nth_unstable((rank - before) as usize).1)
    }
}
