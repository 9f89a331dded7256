//! Sums of samples whose light comes back in any order.
//!
//! A path's own ray and its light samples travel apart. So that the picture does not depend on which comes first, a
//! sample has two sums: of what its path runs into, which comes in the order of its vertices, since each follows from the
//! one before; and of what light samples bring, which is added in that order too: what comes early is put aside.
//! `path.rs` adds the same terms in the same order.
//!
//! Invariant: the terms of a sum are added in the order of the path's vertices.

use super::kernel::Kernel;
use super::path::Wave;
use crate::clock::{Room, within};
use crate::color::Rgb;
use crate::permits::lock;
use crate::schedule::{Meter, Piece, WORDS};
use crate::stats::Counters;
use bytemuck::{Pod, Zeroable};
use std::sync::Mutex;
use std::sync::atomic::{AtomicU32, AtomicUsize, Ordering};

/// Bits of a slot that say which sample of its unit it is.
pub(super) const SAMPLE_BITS: u32 = 10;
/// Samples of a unit at most.
pub const UNIT: usize = 1 << SAMPLE_BITS;
/// Units at a time, at most: slots can name more, but each takes a place in a table.
pub const MOST_UNITS: u32 = 1 << 16;
const _: () = assert!(MOST_UNITS as u64 * UNIT as u64 <= 1 << 32, "slots name all samples");

/// Samples whose sums lie in one piece.
const IN_A_PIECE: usize = WORDS * 4 / size_of::<Sums>();
/// Pieces of the sums of a unit of so many samples.
#[must_use]
pub const fn unit_pieces(samples: usize) -> usize {
    samples.div_ceil(IN_A_PIECE)
}

/// Where samples come from and go to; units are counted from zero.
pub trait Film<K: Kernel>: Sync {
    /// Adds the camera paths of `unit` to `wave`, and the weights of their samples to `weights`: [`UNIT`] at most.
    fn start(&self, unit: u32, wave: &mut Wave<K>, weights: &mut Vec<f32>);
    /// Takes the radiance of all samples of `unit`.
    fn finish(&self, unit: u32, radiance: &[Rgb], weights: &[f32], counters: &mut Counters);
}

/// The sums of a sample.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
pub(super) struct Sums {
    /// What its path runs into.
    pub(super) met: Rgb,
    /// What light samples bring.
    direct: Rgb,
    /// Of the sample in its pixel.
    weight: f32,
    /// Light samples that have set out and those that have been added, modulo 2¹⁶.
    sent: u16,
    added: u16,
}

const _: () = assert!(size_of::<Sums>() == 32, "sums fill pieces to the end");

/// A unit on its way.
pub(super) struct Unit {
    pieces: Vec<Piece>,
    samples: usize,
    /// Light samples that came before their turn.
    early: Vec<(u32, u16, Rgb)>,
    /// Rays on their way.
    pub(super) rays: u32,
}

impl Unit {
    /// In `pieces`, of samples of these weights.
    pub(super) fn new(pieces: Vec<Piece>, weights: &[f32]) -> Self {
        let mut unit = Self { pieces, samples: weights.len(), early: Vec::new(), rays: weights.len() as u32 };
        for (&weight, i) in weights.iter().zip(0..) {
            *unit.sums(i) = Sums { weight, ..Sums::zeroed() };
        }
        unit
    }

    pub(super) fn sums(&mut self, sample: u32) -> &mut Sums {
        let sample = sample as usize;
        let sums: &mut [Sums] = bytemuck::cast_slice_mut(&mut self.pieces[sample / IN_A_PIECE][..]);
        &mut sums[sample % IN_A_PIECE]
    }

    /// The number of the light sample of `sample` that sets out now.
    pub(super) fn send(&mut self, sample: u32) -> u16 {
        let sent = &mut self.sums(sample).sent;
        let order = *sent;
        *sent = order.wrapping_add(1);
        order
    }

    /// Adds what light sample `order` of `sample` brings, when those before it have been added.
    pub(super) fn add(&mut self, sample: u32, order: u16, light: Rgb) {
        let sums = self.sums(sample);
        if sums.added != order {
            self.early.push((sample, order, light));
            return;
        }
        sums.direct += light;
        sums.added = order.wrapping_add(1);
        let mut next = sums.added;
        while let Some(at) = self.early.iter().position(|e| e.0 == sample && e.1 == next) {
            let light = self.early.swap_remove(at).2;
            next = next.wrapping_add(1);
            let sums = self.sums(sample);
            sums.direct += light;
            sums.added = next;
        }
    }
}

/// All units of a render, or of a part of it.
pub struct Units<'m> {
    pub(super) units: Vec<Mutex<Option<Unit>>>,
    pub(super) next: AtomicU32,
    /// Gets the pieces of units that are done.
    meter: &'m Meter,
    /// Paths in flight, and the most that have been.
    pub(super) paths: AtomicUsize,
    pub(super) peak_paths: AtomicUsize,
}

impl<'m> Units<'m> {
    /// Bytes of a unit's place in the table.
    pub const PLACE_BYTES: usize = size_of::<Mutex<Option<Unit>>>();

    /// `count` units, at most [`MOST_UNITS`].
    #[must_use]
    pub fn new(count: u32, meter: &'m Meter) -> Self {
        Self {
            units: (0..count).map(|_| Mutex::new(None)).collect(),
            next: AtomicU32::new(0),
            meter,
            paths: AtomicUsize::new(0),
            peak_paths: AtomicUsize::new(0),
        }
    }

    /// Most paths that were in flight at once.
    #[must_use]
    pub fn peak_paths(&self) -> u64 {
        self.peak_paths.load(Ordering::Relaxed) as u64
    }
}

impl Units<'_> {
    /// Counts a ray of the sample `slot` as answered, and lets `add` write down what came of it: nothing that may wait,
    /// since the unit is locked. The last answer of a unit ends it.
    #[inline(always)]
    pub(super) fn answer<K: Kernel>(
        &self,
        slot: u32,
        film: &dyn Film<K>,
        counters: &mut Counters,
        add: impl FnOnce(&mut Unit, u32),
    ) {
        let name = slot >> SAMPLE_BITS;
        let mut place = lock(&self.units[name as usize]);
        let unit = place.as_mut().expect("a unit stays until its last ray is back");
        add(unit, slot % UNIT as u32);
        unit.rays -= 1;
        if unit.rays > 0 {
            return;
        }
        let done = place.take();
        drop(place);
        done.into_iter().for_each(|unit| self.finish(name, unit, film, counters));
    }

    fn finish<K: Kernel>(&self, name: u32, unit: Unit, film: &dyn Film<K>, counters: &mut Counters) {
        within(Room::Film, || {
            let sums = || unit.pieces.iter().flat_map(|piece| bytemuck::cast_slice::<u32, Sums>(&piece[..]));
            let radiance: Vec<Rgb> = sums().take(unit.samples).map(|sums| sums.met + sums.direct).collect();
            let weights: Vec<f32> = sums().take(unit.samples).map(|sums| sums.weight).collect();
            film.finish(name, &radiance, &weights, counters);
            self.meter.give(unit.pieces);
        });
    }
}
