//! What happens at the leaves of a traversal: triangles, primitives of their own, instances and pages are asked.
//!
//! Invariant: of hits at one distance the smallest name counts, whichever leaf comes first.

use super::page;
use super::part::Part;
use super::plain::Leaves;
use super::primitives::Reference;
use super::query::{Best, Met, Query, Work};
use super::scene::{BvhScene, INSTANCE, Object, PAGE};
use super::tree::{Block, LANES};
use super::triangle::{candidates, candidates_and_hits, intersect};
use crate::accel::{Geometry, Hit, NONE, Ray};
use crate::math::prefetch;

/// Triangles of a tree or of a page, and the ray that meets them.
pub(super) struct Triangles<'s, 'a> {
    pub(super) scene: &'s BvhScene<'a>,
    pub(super) object: &'s Object<'a>,
    pub(super) blocks: &'s [Block],
    /// Where they are a page's: the geometry that it belongs to, and its name.
    pub(super) page: Option<(u32, u32)>,
    pub(super) ray: &'s Ray,
    pub(super) query: &'s Query,
}

impl<'s, 'a> Triangles<'s, 'a> {
    #[inline(always)]
    fn prefetcher(&self) -> impl Fn(usize, usize) + use<'s, 'a> {
        let blocks = self.blocks;
        move |start, count| prefetch(blocks.as_ptr().wrapping_add(start), 3 * count)
    }

    /// The geometry of the triangle in lane `lane` of block `at`, and its place.
    #[inline(always)]
    fn name(&self, at: usize, lane: usize) -> (u32, u32) {
        match self.page {
            None => (self.blocks[at].geometry[lane], NONE),
            Some((geometry, page)) => (geometry, page::place(page, at * LANES + lane)),
        }
    }

    /// Whether any has an alpha mask; paged ones have none.
    #[inline(always)]
    fn masked(&self) -> bool {
        self.page.is_none() && self.object.masked
    }

    #[inline(always)]
    fn passes(&self, geometry: u32, primitive: u32, met: Met) -> bool {
        self.scene.passes(self.object.alpha(geometry), primitive, met, self.ray)
    }
}

pub(super) struct NearestTriangle<'s, 'a> {
    pub(super) triangles: Triangles<'s, 'a>,
    pub(super) instance: u32,
    pub(super) best: &'s mut Best,
}

impl<'s, 'a> Leaves for NearestTriangle<'s, 'a> {
    #[inline(always)]
    fn prefetcher(&self) -> impl Fn(usize, usize) + use<'s, 'a> {
        self.triangles.prefetcher()
    }

    #[inline(always)]
    fn visit(&mut self, start: usize, count: usize, _: f32) -> f32 {
        let Self { triangles, instance, best } = self;
        for (at, block) in (start..).zip(&triangles.blocks[start..start + count]) {
            let mut lanes = candidates(triangles.query, block);
            while lanes != 0 {
                let lane = lanes.trailing_zeros() as usize;
                lanes &= lanes - 1;
                let Some(met) = intersect(triangles.query, block, lane) else { continue };
                let primitive = block.primitive[lane];
                let (geometry, place) = triangles.name(at, lane);
                if !best.is_beaten_by(met.t, *instance, geometry, primitive)
                    || triangles.passes(geometry, primitive, met)
                {
                    continue;
                }
                let Met { t, u, v } = met;
                best.take(Hit { t, u, v, geometry, primitive, instance: *instance, place });
            }
        }
        best.hit.t
    }
}

pub(super) struct AnyTriangle<'s, 'a> {
    pub(super) triangles: Triangles<'s, 'a>,
    pub(super) found: bool,
}

impl<'s, 'a> Leaves for AnyTriangle<'s, 'a> {
    #[inline(always)]
    fn prefetcher(&self) -> impl Fn(usize, usize) + use<'s, 'a> {
        self.triangles.prefetcher()
    }

    #[inline(always)]
    fn visit(&mut self, start: usize, count: usize, t_max: f32) -> f32 {
        let Self { triangles, found } = self;
        for (at, block) in (start..).zip(&triangles.blocks[start..start + count]) {
            let (mut lanes, hits) = candidates_and_hits(triangles.query, block, t_max);
            if hits != 0 && !triangles.masked() {
                *found = true;
                return f32::NEG_INFINITY;
            }
            while lanes != 0 {
                let lane = lanes.trailing_zeros() as usize;
                lanes &= lanes - 1;
                let Some(met) = intersect(triangles.query, block, lane) else { continue };
                let (geometry, _) = triangles.name(at, lane);
                if met.t < t_max && !triangles.passes(geometry, block.primitive[lane], met) {
                    *found = true;
                    return f32::NEG_INFINITY;
                }
            }
        }
        t_max
    }
}

/// A primitive that intersects itself, held to its own box as triangles are.
#[inline(always)]
fn meet_custom(
    scene: &BvhScene<'_>,
    object: &Object<'_>,
    reference: &Reference,
    ray: &Ray,
    query: &Query,
    t_max: f32,
) -> Option<Met> {
    let Geometry::Custom { user, .. } = object.geometry[reference.geometry as usize] else {
        unreachable!("triangles have a tree of their own")
    };
    // A hit at the very distance of the best may have the smaller name.
    let within = Ray { t_max: t_max.next_up(), ..*ray };
    let (t, u, v) = scene.custom.intersect(user, reference.primitive, &within)?;
    let (lo, hi) = reference.corners();
    let (near, _) = query.inside(lo, hi, f32::INFINITY);
    let met = Met { t: t.max(near).max(query.floor), u, v };
    (!scene.passes(object.alpha(reference.geometry), reference.primitive, met, ray)).then_some(met)
}

/// Of what is no triangle: one a leaf, mostly.
#[inline(always)]
fn prefetcher(order: &[Reference]) -> impl Fn(usize, usize) + use<> {
    let order = order.as_ptr();
    move |start, _| prefetch(order.wrapping_add(start), 1)
}

pub(super) struct NearestOther<'s, 'a, const COUNT: bool> {
    pub(super) scene: &'s BvhScene<'a>,
    pub(super) object: &'s Object<'a>,
    pub(super) instance: u32,
    pub(super) ray: &'s Ray,
    pub(super) query: &'s Query,
    pub(super) part: Part,
    pub(super) best: &'s mut Best,
    pub(super) work: &'s mut Work,
}

impl<'s, 'a, const COUNT: bool> Leaves for NearestOther<'s, 'a, COUNT> {
    #[inline(always)]
    fn prefetcher(&self) -> impl Fn(usize, usize) + use<'s, 'a, COUNT> {
        prefetcher(&self.object.order)
    }

    fn visit(&mut self, start: usize, count: usize, _: f32) -> f32 {
        for r in &self.object.order[start..start + count] {
            let t_max = self.best.hit.t;
            if !self.part.has(r, self.query) {
                continue;
            }
            if r.geometry == PAGE {
                self.scene.nearest_in_page::<COUNT>(self, r);
                continue;
            }
            if r.geometry == INSTANCE {
                if let Some((object, ray, query)) = self.scene.enter(r.primitive, self.ray, self.query, t_max)
                {
                    let (best, work) = (&mut *self.best, &mut *self.work);
                    self.scene.nearest_in::<COUNT>(object, r.primitive, &ray, &query, Part::ALL, best, work);
                }
                continue;
            }
            let Some(met) = meet_custom(self.scene, self.object, r, self.ray, self.query, t_max) else {
                continue;
            };
            let Met { t, u, v } = met;
            if self.best.is_beaten_by(t, self.instance, r.geometry, r.primitive) {
                let (geometry, primitive) = (r.geometry, r.primitive);
                self.best.take(Hit { t, u, v, geometry, primitive, instance: self.instance, place: NONE });
            }
        }
        self.part.until(self.best.hit.t)
    }
}

pub(super) struct AnyOther<'s, 'a, const COUNT: bool> {
    pub(super) scene: &'s BvhScene<'a>,
    pub(super) object: &'s Object<'a>,
    pub(super) ray: &'s Ray,
    pub(super) query: &'s Query,
    pub(super) part: Part,
    pub(super) found: bool,
    pub(super) work: &'s mut Work,
}

impl<'s, 'a, const COUNT: bool> Leaves for AnyOther<'s, 'a, COUNT> {
    #[inline(always)]
    fn prefetcher(&self) -> impl Fn(usize, usize) + use<'s, 'a, COUNT> {
        prefetcher(&self.object.order)
    }

    fn visit(&mut self, start: usize, count: usize, until: f32) -> f32 {
        // What is entered in a part may be hit behind it.
        let t_max = self.ray.t_max;
        for r in &self.object.order[start..start + count] {
            if !self.part.has(r, self.query) {
                continue;
            }
            self.found = if r.geometry == PAGE {
                self.scene.any_in_page::<COUNT>(self, r, t_max)
            } else if r.geometry == INSTANCE {
                self.scene.enter(r.primitive, self.ray, self.query, t_max).is_some_and(
                    |(object, ray, query)| {
                        self.scene.any_in::<COUNT>(object, &ray, &query, Part::ALL, self.work)
                    },
                )
            } else {
                meet_custom(self.scene, self.object, r, self.ray, self.query, t_max)
                    .is_some_and(|m| m.t < t_max)
            };
            if self.found {
                return f32::NEG_INFINITY;
            }
        }
        until
    }
}
