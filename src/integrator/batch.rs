//! Many paths that go through the scene together, one edge at a time, in whatever order a scheduler answers their rays.
//!
//! In a phase the rays of all paths are traced, and with them the light samples of the phase before. What a path meets is
//! shaded when its thread has met enough that lies together. So that the picture does not depend on
//! which comes first, what light samples bring is added to a path's sum at once, and what its own ray finds when the
//! phase ends: the order in which `path.rs` adds them too.
//!
//! Invariant: the same terms are added to the same sums in the same order as by `path.rs`.
//! Never decides which ray is traced next.

use super::blocks::{Blocks, Filling, Writer};
use super::path::{Path, Shadow, Wave, World};
use crate::accel::{Accel, Hit, NONE, Ray};
use crate::color::Rgb;
use crate::schedule::{Rays, Sink, TEST};
use crate::stats::Counters;
use std::ops::Range;
use std::sync::atomic::{AtomicU32, Ordering};

/// In the name of a [`TEST`]: it asks whether the sky is open, not whether a light is seen.
const SKY: u32 = 1 << 30;

/// Hits that are sorted and shaded together.
const GATHERED: usize = 1 << 13;

/// Paths that are shaded at once: they and what they need stay in the second-level cache.
const WAVE: usize = 1 << 10;

/// In place of a light sample's medium: what is in its way is known.
const KNOWN: u32 = NONE - 1;

/// Bytes that a path in flight takes, with all that belongs to it but its places in queues: its state and its light
/// sample, before and after a phase, its sums and its weight.
pub const PATH_BYTES: usize = 2 * (size_of::<Path>() + size_of::<Shadow>()) + 2 * size_of::<Rgb>() + 4;

/// Sums by slot, which threads write side by side: never two the same slot at once.
struct Sums(Vec<[AtomicU32; 3]>);

impl Sums {
    fn new(count: usize) -> Self {
        Self((0..count).map(|_| [const { AtomicU32::new(0) }; 3]).collect())
    }

    #[inline(always)]
    fn get(&self, slot: usize) -> Rgb {
        Rgb::from_array(self.0[slot].each_ref().map(|v| f32::from_bits(v.load(Ordering::Relaxed))))
    }

    #[inline(always)]
    fn set(&self, slot: usize, value: Rgb) {
        for (place, v) in self.0[slot].iter().zip(value.to_array()) {
            place.store(v.to_bits(), Ordering::Relaxed);
        }
    }
}

/// Paths in flight between two phases.
pub struct Batch {
    paths: Blocks<Path>,
    shadows: Blocks<Shadow>,
    /// Light samples of the sky, which nothing but the sky's openness is left to ask of.
    skies: Blocks<Shadow>,
    /// Radiance by slot.
    sums: Sums,
    /// What this phase's own rays found, by slot.
    found: Sums,
}

/// What the threads of a phase fill.
pub struct Next {
    paths: Filling<Path>,
    shadows: Filling<Shadow>,
    skies: Filling<Shadow>,
}

impl Next {
    /// Nothing yet.
    #[must_use]
    #[expect(clippy::new_without_default, reason = "made in one place")]
    pub fn new() -> Self {
        Self { paths: Filling::new(), shadows: Filling::new(), skies: Filling::new() }
    }
}

/// Writes camera paths into a batch that begins.
pub struct Beginning<'n>(Writer<'n, Path>);

impl<'n> Beginning<'n> {
    /// For one thread.
    #[must_use]
    pub fn new(next: &'n Next) -> Self {
        Self(Writer::new(&next.paths))
    }

    /// Adds the paths that [`World::start`] has put into `wave`, whose slots begin at `slot`.
    pub fn add(&mut self, wave: &mut Wave, slot: u32) {
        for path in wave.paths.drain(..) {
            self.0.push(Path { slot: slot + path.slot, ..path });
        }
    }
}

impl Batch {
    /// Of what `next` has got, with slots for `count` paths.
    #[must_use]
    pub fn new(next: Next, count: usize) -> Self {
        let Next { paths, shadows, skies } = next;
        Self {
            paths: paths.finish(),
            shadows: shadows.finish(),
            skies: skies.finish(),
            sums: Sums::new(count),
            found: Sums::new(count),
        }
    }

    /// Whether every path has ended.
    #[must_use]
    pub fn is_done(&self) -> bool {
        self.paths.is_empty() && self.shadows.is_empty() && self.skies.is_empty()
    }

    /// Bytes of it.
    #[must_use]
    pub fn bytes(&self) -> usize {
        let sums = 2 * self.sums.0.len() * size_of::<Rgb>();
        self.paths.bytes() + self.shadows.bytes() + self.skies.bytes() + sums
    }

    /// Names of the rays of this phase.
    #[must_use]
    pub fn requests(&self) -> Vec<Range<u32>> {
        let tests = self.shadows.names(TEST).chain(self.skies.names(TEST | SKY));
        self.paths.names(0).chain(tests).collect()
    }

    /// Adds the rays of this phase to `counters`.
    pub fn count(&self, counters: &mut Counters) {
        counters.closest += self.paths.len() as u64;
        counters.occluded += (self.shadows.len() + self.skies.len()) as u64;
    }

    /// The next phase, when this one's rays have been answered. What they found is added in ranges of slots, by as many
    /// threads as call [`Batch::settle`] before.
    #[must_use]
    pub fn turn(self, next: Next) -> Self {
        let Next { paths, shadows, skies } = next;
        Self { paths: paths.finish(), shadows: shadows.finish(), skies: skies.finish(), ..self }
    }

    /// Slots.
    #[must_use]
    pub fn slots(&self) -> usize {
        self.sums.0.len()
    }

    /// Adds what rays found to the sums of `slots`; once for each slot and phase, when all rays are answered.
    pub fn settle(&self, slots: Range<usize>) {
        for slot in slots {
            let found = self.found.get(slot);
            if found != Rgb::ZERO {
                self.sums.set(slot, self.sums.get(slot) + found);
                self.found.set(slot, Rgb::ZERO);
            }
        }
    }

    /// The radiance of `slot`.
    #[inline]
    #[must_use]
    pub fn radiance(&self, slot: usize) -> Rgb {
        self.sums.get(slot)
    }
}

impl Rays for Batch {
    #[inline(always)]
    fn ray(&self, name: u32) -> Ray {
        if name & TEST == 0 {
            let path = self.paths.get(name);
            return Ray::new(path.origin, path.direction);
        }
        let tests = if name & SKY == 0 { &self.shadows } else { &self.skies };
        tests.get(name & !(TEST | SKY)).ray
    }
}

/// A thread's part of a phase: shades what its rays meet.
pub struct Shader<'b, 'a, A: ?Sized> {
    world: &'b World<'a, A>,
    batch: &'b Batch,
    depth: u32,
    met: Vec<(u32, Hit)>,
    /// Keys of `met` and places in it, to be sorted.
    order: Vec<(u64, u32)>,
    wave: Wave,
    slots: Vec<u32>,
    paths: Writer<'b, Path>,
    shadows: Writer<'b, Shadow>,
    skies: Writer<'b, Shadow>,
    counters: &'b mut Counters,
}

impl<'b, 'a, A: Accel + ?Sized> Shader<'b, 'a, A> {
    /// Of the phase in which paths have had `depth` scattering events.
    pub fn new(
        world: &'b World<'a, A>,
        batch: &'b Batch,
        next: &'b Next,
        depth: u32,
        counters: &'b mut Counters,
    ) -> Self {
        Self {
            world,
            batch,
            depth,
            met: Vec::with_capacity(GATHERED),
            order: Vec::with_capacity(GATHERED),
            wave: Wave::default(),
            slots: Vec::new(),
            paths: Writer::new(&next.paths),
            shadows: Writer::new(&next.shadows),
            skies: Writer::new(&next.skies),
            counters,
        }
    }

    /// Shades what is left.
    pub fn finish(mut self) {
        self.shade();
    }

    /// Shades what was met, in the order of surfaces and places on them.
    fn shade(&mut self) {
        self.order.clear();
        let key = |hit: &Hit| {
            // Where geometry comes and goes, by page; else by triangle, whose neighbours have similar numbers.
            let place = if hit.place == NONE { hit.primitive } else { hit.place };
            u64::from(hit.geometry) << 32 | u64::from(place)
        };
        self.order.extend(self.met.iter().zip(0u32..).map(|((_, hit), i)| (key(hit), i)));
        self.order.sort_unstable();
        let order = std::mem::take(&mut self.order);
        for wave in order.chunks(WAVE) {
            self.shade_wave(wave);
        }
        self.order = order;
        self.met.clear();
    }

    fn shade_wave(&mut self, order: &[(u64, u32)]) {
        let Self { world, batch, wave, slots, .. } = self;
        slots.clear();
        wave.paths.clear();
        wave.hits.clear();
        for (&(_, i), local) in order.iter().zip(0u32..) {
            let (name, mut hit) = self.met[i as usize];
            let path = batch.paths.get(name);
            slots.push(path.slot);
            let mut path = Path { slot: local, ..*path };
            if world.has_interfaces {
                world.pass_interfaces(&mut path, &mut hit, self.counters);
            }
            wave.paths.push(path);
            wave.hits.push(hit);
        }
        wave.radiance.clear();
        wave.radiance.resize(slots.len(), Rgb::ZERO);
        world.shade_wave(wave, self.depth);
        for (&slot, &found) in slots.iter().zip(&wave.radiance) {
            if found != Rgb::ZERO {
                batch.found.set(slot as usize, found);
            }
        }
        for shadow in &wave.shadows {
            let mut shadow = Shadow { slot: slots[shadow.slot as usize], ..*shadow };
            if world.has_interfaces || shadow.medium != NONE {
                shadow.contribution *= world.transmitted(&shadow, self.counters);
                shadow.medium = KNOWN;
            }
            self.shadows.push(shadow);
        }
        let last = self.depth + 1 == world.max_depth;
        for path in &wave.paths {
            let path = Path { slot: slots[path.slot as usize], ..*path };
            if last && !world.has_interfaces {
                // The last ray of a path can only find emission (`World::last_step`).
                if world.may_emit(&path, self.counters) {
                    self.paths.push(path);
                } else if world.lights.has_background() {
                    let mut contribution = Rgb::ZERO;
                    world.add_background(&path, &mut contribution);
                    let ray = Ray::new(path.origin, path.direction);
                    self.skies.push(Shadow { ray, contribution, slot: path.slot, medium: NONE });
                }
            } else {
                self.paths.push(path);
            }
        }
    }
}

impl<A: Accel + ?Sized> Sink for Shader<'_, '_, A> {
    #[inline(always)]
    fn hit(&mut self, name: u32, hit: Hit) {
        self.met.push((name, hit));
        if self.met.len() == GATHERED {
            self.shade();
        }
    }

    #[inline(always)]
    fn seen(&mut self, name: u32, occluded: bool) {
        let batch = self.batch;
        if name & SKY != 0 {
            if !occluded {
                let sky = batch.skies.get(name & !SKY);
                batch.found.set(sky.slot as usize, sky.contribution);
            }
            return;
        }
        let shadow = batch.shadows.get(name);
        // Not left out where something is in the way: what is infinite shows in both schedules.
        let transmitted = if occluded && shadow.medium != KNOWN { Rgb::ZERO } else { Rgb::ONE };
        let slot = shadow.slot as usize;
        batch.sums.set(slot, batch.sums.get(slot) + shadow.contribution * transmitted);
    }

    fn settle(&mut self) {
        if self.met.len() >= WAVE {
            self.shade();
        }
    }
}
