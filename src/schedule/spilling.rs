//! What the queues do when memory for rays is full: the longest go to the file, so that there is room for others.
//!
//! Invariant: no ray is in two places, and none in no place but while it is written: then it counts as waiting, and nobody
//! can take it. No lock but the writers' is held during a write, and whoever waits for that has lent its permit.

use super::bag::Shelf;
use super::meter::Piece;
use super::queues::{Queue, Queues};
use super::spill::{EXTENT_PIECES, Spill};
use super::{Meter, Traveller};
use crate::clock::Room;
use crate::permits::{self, lock};
use std::cmp::Reverse;
use std::sync::atomic::Ordering;

/// The part of memory for rays that is made free at once.
const PART: usize = 8;

/// Pieces of one list, on their way into the file.
struct Part {
    voxel: usize,
    list: usize,
    pieces: Vec<Piece>,
    pairs: usize,
    /// Bytes of a pair, and pairs in a full piece.
    sizes: (usize, usize),
}

impl Part {
    /// The bytes of its pairs. All pieces but the first are full.
    fn chunks(&self) -> Vec<&[u8]> {
        let (bytes, full) = self.sizes;
        let first = self.pairs - (self.pieces.len() - 1) * full;
        let size = |i: usize| bytes * if i == 0 { first } else { full };
        self.pieces.iter().enumerate().map(|(i, p)| &bytemuck::cast_slice(&p[..])[..size(i)]).collect()
    }
}

impl<P: Traveller, T: Traveller> Queue<P, T> {
    fn lists(&mut self) -> [&mut dyn Shelf; 3] {
        [&mut self.open, &mut self.met, &mut self.tests]
    }
}

impl<P: Traveller, T: Traveller> Queues<'_, P, T> {
    /// Bytes for each voxel that are needed while rays go to a file.
    pub(super) const CHOICE_BYTES: usize = size_of::<(bool, Reverse<usize>, u32)>();

    /// Makes room in memory for rays, if that can be done; whether there may be some.
    pub(super) fn make_room(&self) -> bool {
        let Some(spill) = self.room.spill.filter(|spill| spill.is_open()) else { return false };
        permits::lend(Room::Queues, || {
            let _writer = lock(&spill.writer);
            // Another may have made some while this thread waited.
            self.room.rays.has_room(1) || self.write_out(spill, self.room.rays)
        })
    }

    /// Writes lists until a part of memory is free; whether anything was written.
    fn write_out(&self, spill: &Spill, meter: &Meter) -> bool {
        let active: Vec<u32> = lock(&self.state).active.iter().map(|&(voxel, _)| voxel).collect();
        let mut longest: Vec<(bool, Reverse<usize>, u32)> = Vec::with_capacity(self.queues.len());
        for (queue, voxel) in self.queues.iter().zip(0u32..) {
            let pieces: usize = lock(queue).lists().iter().map(|list| list.pieces()).sum();
            if pieces > 0 {
                // Rays of voxels that are being run are wanted at once.
                longest.push((active.contains(&voxel), Reverse(pieces), voxel));
            }
        }
        longest.sort_unstable();
        let goal = (meter.limit() / PART).max(1);
        let mut batch = Batch { parts: Vec::new(), pieces: 0, runs_left: spill.runs_left() };
        let mut written = 0;
        for &(_, _, voxel) in &longest {
            for list in 0..3 {
                while self.lift(voxel as usize, list, spill, &mut batch) {
                    if batch.pieces == EXTENT_PIECES {
                        match self.flush(spill, meter, &mut batch) {
                            0 => return written > 0,
                            pieces => written += pieces,
                        }
                    }
                    if written + batch.pieces >= goal {
                        return written + self.flush(spill, meter, &mut batch) > 0;
                    }
                }
            }
        }
        written + self.flush(spill, meter, &mut batch) > 0
    }

    /// Takes what has room in `batch` from a list; whether that was anything.
    fn lift(&self, voxel: usize, list: usize, spill: &Spill, batch: &mut Batch) -> bool {
        if batch.runs_left == 0 {
            return false;
        }
        let most = (EXTENT_PIECES - batch.pieces).min(spill.run_pieces());
        let mut queue = lock(&self.queues[voxel]);
        let from = &mut queue.lists()[list];
        let sizes = from.sizes();
        let (pieces, pairs) = from.lift(most);
        // Until they are there again nobody can take them.
        self.lengths[voxel].store(queue.len(), Ordering::Relaxed);
        if pieces.is_empty() {
            return false;
        }
        batch.pieces += pieces.len();
        batch.runs_left -= 1;
        batch.parts.push(Part { voxel, list, pieces, pairs, sizes });
        true
    }

    /// Writes `batch`, or puts back what it has; how many pieces of memory are free now.
    fn flush(&self, spill: &Spill, meter: &Meter, batch: &mut Batch) -> usize {
        let parts = std::mem::take(&mut batch.parts);
        let pieces = std::mem::take(&mut batch.pieces);
        if parts.is_empty() {
            return 0;
        }
        let texts: Vec<_> = parts.iter().map(|part| (part.pairs, part.chunks())).collect();
        let runs = spill.write(&texts);
        let done = runs.is_some();
        let mut runs = runs.unwrap_or_default().into_iter();
        for part in parts {
            let mut queue = lock(&self.queues[part.voxel]);
            let list = &mut queue.lists()[part.list];
            let free = match runs.next() {
                Some(run) => {
                    list.add(run, spill);
                    part.pieces
                }
                None => list.lower(part.pieces, part.pairs).into_iter().collect(),
            };
            self.lengths[part.voxel].store(queue.len(), Ordering::Relaxed);
            drop(queue);
            meter.give(free);
        }
        self.wake();
        if done { pieces } else { 0 }
    }
}

/// What is written together.
struct Batch {
    parts: Vec<Part>,
    pieces: usize,
    /// Runs that the file's tables have room for, beside these.
    runs_left: usize,
}
