//! Paths in flight: records that wait in a scheduler's queues, and are shaded when their rays come back.
//!
//! The sums that their light goes to are in `units.rs`.
//!
//! Never decides which ray is traced next.

use super::kernel::Kernel;
use super::path::{Path, Shadow, Wave, World};
use super::units::{Film, SAMPLE_BITS, UNIT, Unit, Units, unit_pieces};
use crate::accel::{Accel, Hit, NONE, Ray};
use crate::clock::{Room, enter};
use crate::color::Rgb;
use crate::permits::lock;
use crate::schedule::{Fresh, PIECE_BYTES, Piece, Sink, Traveller};
use crate::stats::Counters;
use bytemuck::{Pod, Zeroable};
use std::sync::atomic::Ordering;

/// Hits that are sorted and shaded together, at most.
pub const GATHERED: usize = 1 << 13;
/// Hits that are worth being shaded when what comes next lies elsewhere.
const WORTH: usize = 1 << 8;
/// Paths that are shaded at once: they and what they need stay in the second-level cache.
const WAVE: usize = 1 << 10;

/// Bytes that a unit takes at most, if no more light samples wait than paths do.
#[must_use]
pub const fn unit_bytes<K: Kernel>() -> usize {
    unit_pieces(UNIT) * PIECE_BYTES + UNIT * (size_of::<Flight<K>>() + size_of::<Probe>() + size_of::<Hit>())
}

/// Bytes of a hit that waits to be shaded, and of what follows from it.
#[must_use]
pub const fn hit_bytes<K: Kernel>() -> usize {
    size_of::<(Flight<K>, Hit)>() + size_of::<(u64, u32)>() + size_of::<Flight<K>>() + size_of::<Probe>()
}

/// A path and how many scattering events it has had.
#[repr(C, packed)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct Flight<K>
where
    K: Kernel,
{
    path: Path<K>,
    depth: u32,
}

/// A ray that asks whether light comes through: a [`Shadow`] as plain words. Those in a medium never wait.
#[repr(C, packed)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct Probe {
    ray: Ray,
    /// Added where nothing is in the way.
    contribution: Rgb,
    slot: u32,
    /// Which of its sample's light samples it is, modulo 2¹⁶; [`SKY`] for the path's last ray, which asks for the sky.
    order: u32,
}

/// See [`Probe::order`].
const SKY: u32 = u32::MAX;

impl<K: Kernel> Traveller for Flight<K> {
    #[inline(always)]
    fn ray(&self) -> Ray {
        Ray::new(self.path.origin, self.path.direction)
    }
}

impl Traveller for Probe {
    #[inline(always)]
    fn ray(&self) -> Ray {
        self.ray
    }
}

/// Shades what rays meet; a thread's end of a scheduler's queues.
pub struct Shader<'b, 'a, A: ?Sized, K: Kernel> {
    world: &'b World<'a, A>,
    units: &'b Units<'b>,
    film: &'b dyn Film<K>,
    met: Vec<(Flight<K>, Hit)>,
    /// How many are gathered.
    gathered: usize,
    /// Keys of `met` and places in it, to be sorted.
    order: Vec<(u64, u32)>,
    wave: Wave<K>,
    slots: Vec<u32>,
    weights: Vec<f32>,
    counters: &'b mut Counters,
    /// Whether what it is given is of no more use.
    stop: &'b (dyn Fn() -> bool + Sync),
}

impl<'b, 'a, A: Accel + ?Sized, K: Kernel> Shader<'b, 'a, A, K> {
    /// For one thread, which gathers `gathered` hits.
    pub fn new(
        world: &'b World<'a, A>,
        units: &'b Units<'b>,
        film: &'b dyn Film<K>,
        counters: &'b mut Counters,
        gathered: usize,
        stop: &'b (dyn Fn() -> bool + Sync),
    ) -> Self {
        let (met, order) = (Vec::with_capacity(gathered), Vec::with_capacity(gathered));
        Self {
            world,
            units,
            film,
            met,
            gathered,
            order,
            wave: Wave::default(),
            slots: Vec::new(),
            weights: Vec::new(),
            counters,
            stop,
        }
    }

    /// Shades what was met, in the order of depths, surfaces and places on them.
    fn shade(&mut self, fresh: &mut Fresh<Flight<K>, Probe>) {
        enter(Room::Queues);
        self.order.clear();
        let key = |(flight, hit): &(Flight<K>, Hit)| {
            // Where geometry comes and goes, by page; else by triangle, whose neighbours have similar numbers.
            let place = if hit.place == NONE { hit.primitive } else { hit.place };
            u64::from(flight.depth.min(255)) << 56
                | u64::from(hit.geometry & 0xff_ffff) << 32
                | u64::from(place)
        };
        self.order.extend(self.met.iter().zip(0u32..).map(|(met, i)| (key(met), i)));
        self.order.sort_unstable();
        let order = std::mem::take(&mut self.order);
        let mut rest = &order[..];
        while let Some(&(_, first)) = rest.first() {
            let depth_of = |i: u32| self.met[i as usize].0.depth;
            let depth = depth_of(first);
            let count = rest.iter().take(WAVE).take_while(|&&(_, i)| depth_of(i) == depth).count();
            let (wave, others) = rest.split_at(count);
            rest = others;
            if (self.stop)() {
                break;
            }
            self.shade_wave(wave, depth, fresh);
        }
        self.order = order;
        self.met.clear();
    }

    fn shade_wave(&mut self, order: &[(u64, u32)], depth: u32, fresh: &mut Fresh<Flight<K>, Probe>) {
        let Self { world, units, wave, slots, met, counters, film, .. } = self;
        enter(if K::MEDIA && world.has_interfaces { Room::TraceClosest } else { Room::Shade });
        slots.clear();
        wave.paths.clear();
        wave.hits.clear();
        for (&(_, i), local) in order.iter().zip(0u32..) {
            let (Flight { path, .. }, mut hit) = met[i as usize];
            slots.push(path.slot);
            let mut path = Path { slot: local, ..path };
            if K::MEDIA && world.has_interfaces {
                world.pass_interfaces(&mut path, &mut hit, counters);
            }
            wave.paths.push(path);
            wave.hits.push(hit);
        }
        wave.radiance.clear();
        wave.radiance.resize(slots.len(), Rgb::ZERO);
        world.shade_wave(wave, depth);
        // Light is followed through media at once, and a path's last ray is held against what emits.
        let tests = K::MEDIA || depth + 1 >= world.max_depth;
        enter(if tests { Room::TraceOcclusion } else { Room::Queues });

        // Of each path: its light sample, and whether it goes on. Both lists keep the order of paths.
        let (mut paths, mut shadows) = (wave.paths.iter().peekable(), wave.shadows.iter().peekable());
        let mut ended = 0;
        for ((&slot, &found), local) in slots.iter().zip(&wave.radiance).zip(0u32..) {
            let shadow = shadows.next_if(|s| s.slot == local).map(|shadow| Shadow { slot, ..*shadow });
            let path = paths.next_if(|p| p.slot == local).map(|path| Path { slot, ..*path });
            // Before the unit is locked: these trace, which may wait for a disk and for whoever waits for the unit.
            let light = shadow.map(|shadow| world.light_sample(shadow, counters));
            let next = path.map_or(After::End, |path| world.after(path, depth + 1, counters));
            ended += usize::from(!matches!(next, After::Flight(_)));

            units.answer(slot, *film, counters, |unit, sample| {
                unit.sums(sample).met += found;
                if let Some(light) = light {
                    let order = unit.send(sample);
                    match light {
                        LightSample::Known(light) => unit.add(sample, order, light),
                        LightSample::Asks(Shadow { ray, contribution, slot, .. }) => {
                            unit.rays += 1;
                            fresh.tests.push(Probe { ray, contribution, slot, order: order.into() });
                        }
                    }
                }
                match next {
                    After::Flight(flight) => {
                        unit.rays += 1;
                        fresh.paths.push(flight);
                    }
                    After::Sky(probe) => {
                        unit.rays += 1;
                        fresh.tests.push(probe);
                    }
                    After::End => {}
                }
            });
        }
        enter(Room::Queues);
        units.paths.fetch_sub(ended, Ordering::Relaxed);
    }
}

/// A light sample: what it brings, or the ray that finds out.
enum LightSample<K: Kernel> {
    Known(Rgb),
    Asks(Shadow<K>),
}

/// What follows a path's vertex.
enum After<K: Kernel> {
    Flight(Flight<K>),
    /// Only the sky is left to be seen.
    Sky(Probe),
    End,
}

impl<A: Accel + ?Sized> World<'_, A> {
    /// Through media and past interfaces light is followed at once.
    fn light_sample<K: Kernel>(&self, shadow: Shadow<K>, counters: &mut Counters) -> LightSample<K> {
        counters.occluded += 1;
        if K::MEDIA && (self.has_interfaces || K::medium(shadow.medium) != NONE) {
            LightSample::Known(shadow.contribution * self.transmitted(&shadow, counters))
        } else {
            LightSample::Asks(shadow)
        }
    }

    /// What becomes of `path` after `depth` scattering events. The last ray of a path can only find emission
    /// ([`World::last_step`]).
    fn after<K: Kernel>(&self, path: Path<K>, depth: u32, counters: &mut Counters) -> After<K> {
        if depth < self.max_depth || (K::MEDIA && self.has_interfaces) || self.may_emit(&path, counters) {
            counters.closest += 1;
            return After::Flight(Flight { path, depth });
        }
        if !self.lights.has_background() {
            return After::End;
        }
        let mut contribution = Rgb::ZERO;
        self.add_background(&path, &mut contribution);
        counters.occluded += 1;
        let ray = Ray::new(path.origin, path.direction);
        After::Sky(Probe { ray, contribution, slot: path.slot, order: SKY })
    }
}

impl<A: Accel + ?Sized, K: Kernel> Sink<Flight<K>, Probe> for Shader<'_, '_, A, K> {
    fn begin(&mut self, pieces: Vec<Piece>, fresh: &mut Fresh<Flight<K>, Probe>) -> Option<Vec<Piece>> {
        let count = self.units.units.len() as u32;
        let taken = self
            .units
            .next
            .fetch_update(Ordering::Relaxed, Ordering::Relaxed, |next| (next < count).then_some(next + 1));
        let Ok(unit) = taken else { return Some(pieces) };
        enter(Room::Camera);
        self.weights.clear();
        self.wave.paths.clear();
        self.film.start(unit, &mut self.wave, &mut self.weights);
        let paths = self.wave.paths.len();
        self.counters.closest += paths as u64;
        let now = self.units.paths.fetch_add(paths, Ordering::Relaxed) + paths;
        self.units.peak_paths.fetch_max(now, Ordering::Relaxed);
        *lock(&self.units.units[unit as usize]) = Some(Unit::new(pieces, &self.weights));
        let flights = self.wave.paths.drain(..).map(|path| {
            let slot = unit << SAMPLE_BITS | path.slot;
            Flight { path: Path { slot, ..path }, depth: 0 }
        });
        fresh.paths.extend(flights);
        None
    }

    #[inline(always)]
    fn hit(&mut self, path: Flight<K>, hit: Hit, fresh: &mut Fresh<Flight<K>, Probe>) {
        self.met.push((path, hit));
        if self.met.len() == self.gathered {
            self.shade(fresh);
        }
    }

    #[inline(always)]
    fn seen(&mut self, probe: Probe, occluded: bool) {
        let Probe { contribution, slot, order, .. } = probe;
        self.units.answer(slot, self.film, self.counters, |unit, sample| {
            if order != SKY {
                // Not left out where something is in the way: what is infinite shows in every schedule.
                let transmitted = if occluded { Rgb::ZERO } else { Rgb::ONE };
                unit.add(sample, order as u16, contribution * transmitted);
            } else if !occluded {
                unit.sums(sample).met += contribution;
            }
        });
    }

    fn settle(&mut self, all: bool, fresh: &mut Fresh<Flight<K>, Probe>) -> bool {
        let enough = if all { 1 } else { WORTH };
        let works = self.met.len() >= enough;
        if works {
            self.shade(fresh);
        }
        works
    }
}
