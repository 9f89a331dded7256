//! A world of objects and instances over trees, and the queries of [`Accel`].
//!
//! Invariant: immutable once built; queries allocate nothing. Instances are one level deep: an object is made of
//! geometries.

use super::build::{BuildSettings, build};
use super::collapse::into_blocks;
use super::leaves::{AnyOther, AnyTriangle, NearestOther, NearestTriangle, Triangles};
use super::memory::Frozen;
use super::nodes::{Fma, Form, Nodes, traverse_wide};
use super::outline::Outline;
use super::page::PageView;
use super::part::Part;
use super::primitives::{Reference, grown, triangles};
use super::query::{Best, Met, Query, Work, into_object};
use super::tree::{Block, MAX_STARTS};
use crate::accel::{Accel, Custom, Geometry, Hit, InstanceOf, NONE, PageBox, Pages, Ray};
use crate::error::{Error, Result};
use crate::math::prefetch;
use glam::{Mat4, Vec3};
use std::ops::Range;

/// What one traversal answers: the world's own geometry, or an object's.
pub(super) struct Object<'a> {
    pub(super) geometry: Vec<Geometry<'a>>,
    /// Whether any triangle has an alpha mask.
    pub(super) masked: bool,
    triangles: Nodes,
    pub(super) blocks: Frozen<Block>,
    others: Nodes,
    /// What the leaves of `others` are runs of.
    pub(super) order: Vec<Reference>,
    /// Of pages the geometry, and which they are of its own, by what references call their primitive.
    pages: Vec<(u32, u32)>,
    lo: Vec3,
    hi: Vec3,
}

/// In place of a geometry's index: the primitive is an instance.
pub(super) const INSTANCE: u32 = NONE;
/// In place of a geometry's index: the primitive is a page.
pub(super) const PAGE: u32 = NONE - 1;

/// Lines of a page that every look reads: its head and its first node.
const PAGE_HEAD_LINES: usize = 5;

/// Names of the pages of `geometry`, if it has some.
fn page_names(geometry: &Geometry<'_>) -> Option<Range<u32>> {
    match *geometry {
        Geometry::Pages { first, outlines } => Some(first..first + outlines.len() as u32),
        _ => None,
    }
}

/// An object placed in the world.
struct Placed {
    object: u32,
    to_object: [f32; 12],
    lo: [f32; 3],
    hi: [f32; 3],
}

/// A built world.
pub struct BvhScene<'a> {
    world: Object<'a>,
    objects: Vec<Object<'a>>,
    instances: Vec<Placed>,
    pub(super) custom: &'a dyn Custom,
    /// Where pages come from, if any are asked for.
    pages: Option<&'a dyn Pages>,
    /// Largest coordinate of any tree, without sign.
    reach: f32,
    fma: Option<Fma>,
}

impl<'a> BvhScene<'a> {
    /// Builds trees over `world` and `objects`, with `instances` of the latter, on the threads of the current pool.
    ///
    /// # Errors
    /// [`Error::Resource`] when there are more primitives than references reach (half a billion).
    pub fn new(
        world: &[Geometry<'a>],
        objects: &[Vec<Geometry<'a>>],
        instances: &[InstanceOf],
        custom: &'a dyn Custom,
        pages: Option<&'a dyn Pages>,
        form: Form,
    ) -> Result<Self> {
        let form = if form == Form::Wide { Form::best() } else { form };
        let objects: Vec<Object<'a>> =
            objects.iter().map(|o| Object::new(o, Vec::new(), custom, form)).collect::<Result<_>>()?;
        let placed: Vec<Placed> = instances.iter().map(|i| Placed::new(i, &objects)).collect();
        let references = (placed.iter().enumerate())
            .filter_map(|(i, p)| Reference::new(p.lo, p.hi, INSTANCE, u32::try_from(i).ok()?))
            .collect();
        let world = Object::new(world, references, custom, form)?;
        let reach = std::iter::once(&world)
            .chain(&objects)
            .map(|o| o.lo.abs().max(o.hi.abs()).max_element())
            .filter(|r| r.is_finite())
            .fold(0.0, f32::max);
        Ok(Self { world, objects, instances: placed, custom, pages, reach, fma: Fma::detect() })
    }

    /// The nearest hit, counting what it took.
    #[must_use]
    pub fn closest_counted(&self, ray: &Ray, work: &mut Work) -> Hit {
        self.nearest::<true>(ray, work)
    }

    /// Whether anything lies in (t_min, t_max), counting what it took.
    #[must_use]
    pub fn occluded_counted(&self, ray: &Ray, work: &mut Work) -> bool {
        self.any::<true>(ray, work)
    }

    /// The bytes of the world's triangles' tree.
    #[cfg(test)]
    pub(super) fn world_image(&self) -> Vec<u8> {
        [self.world.triangles.image(), bytemuck::cast_slice(self.world.blocks.elements())].concat()
    }

    #[inline(always)]
    fn nearest<const COUNT: bool>(&self, ray: &Ray, work: &mut Work) -> Hit {
        let Some(query) = Query::new(ray, self.reach) else { return Hit::MISS };
        let mut best = Best::before(ray.t_max);
        self.nearest_in::<COUNT>(&self.world, NONE, ray, &query, Part::ALL, &mut best, work);
        best.into_hit()
    }

    #[inline(always)]
    #[expect(clippy::too_many_arguments, reason = "the parts of a query; a record of them costs copies")]
    pub(super) fn nearest_in<const COUNT: bool>(
        &self,
        object: &Object<'a>,
        instance: u32,
        ray: &Ray,
        query: &Query,
        part: Part,
        best: &mut Best,
        work: &mut Work,
    ) {
        if !object.blocks.is_empty() && part.is_first() {
            let blocks = object.blocks.elements();
            let triangles = Triangles { scene: self, object, blocks, page: None, ray, query };
            let mut leaves = NearestTriangle { triangles, instance, best };
            let t_max = leaves.best.hit.t;
            object.triangles.traverse::<COUNT, true>(self.fma, query, t_max, work, &mut leaves);
        }
        if !object.order.is_empty() {
            let mut inner = Work::default();
            let work_inside = &mut inner;
            let mut leaves = NearestOther::<COUNT> {
                scene: self,
                object,
                instance,
                ray,
                query,
                part,
                best,
                work: work_inside,
            };
            let t_max = part.until(leaves.best.hit.t);
            object.others.traverse::<COUNT, true>(self.fma, &part.of(query), t_max, work, &mut leaves);
            work.nodes += inner.nodes;
            work.leaves += inner.leaves;
        }
    }

    #[inline(always)]
    fn any<const COUNT: bool>(&self, ray: &Ray, work: &mut Work) -> bool {
        let Some(query) = Query::new(ray, self.reach) else { return false };
        self.any_in::<COUNT>(&self.world, ray, &query, Part::ALL, work)
    }

    #[inline(always)]
    pub(super) fn any_in<const COUNT: bool>(
        &self,
        object: &Object<'a>,
        ray: &Ray,
        query: &Query,
        part: Part,
        work: &mut Work,
    ) -> bool {
        if !object.blocks.is_empty() && part.is_first() {
            let blocks = object.blocks.elements();
            let triangles = Triangles { scene: self, object, blocks, page: None, ray, query };
            let mut leaves = AnyTriangle { triangles, found: false };
            object.triangles.traverse::<COUNT, false>(self.fma, query, ray.t_max, work, &mut leaves);
            if leaves.found {
                return true;
            }
        }
        if object.order.is_empty() {
            return false;
        }
        let mut inner = Work::default();
        let mut leaves =
            AnyOther::<COUNT> { scene: self, object, ray, query, part, found: false, work: &mut inner };
        let t_max = part.until(ray.t_max);
        object.others.traverse::<COUNT, false>(self.fma, &part.of(query), t_max, work, &mut leaves);
        let found = leaves.found;
        work.nodes += inner.nodes;
        work.leaves += inner.leaves;
        found
    }

    /// Geometry and name of the page `r`, and who has it, if the ray enters one of its parts within `t_max`.
    #[inline(always)]
    fn worth_a_look(
        &self,
        object: &Object<'_>,
        r: &Reference,
        query: &Query,
        t_max: f32,
    ) -> Option<(&'a dyn Pages, (u32, u32))> {
        let (geometry, page) = object.pages[r.primitive as usize];
        let (first, outlines) = object.paged(geometry);
        let meets = outlines[page as usize].meets(self.fma, query, t_max);
        self.pages.filter(|_| meets).map(|pages| (pages, (geometry, first + page)))
    }

    /// Looks into the page `r`, if the ray enters it nearer than the best hit.
    #[inline(never)]
    pub(super) fn nearest_in_page<const COUNT: bool>(
        &self,
        leaves: &mut NearestOther<'_, 'a, COUNT>,
        r: &Reference,
    ) {
        let NearestOther { object, instance, ray, query, best, work, .. } = leaves;
        let Some((pages, page)) = self.worth_a_look(object, r, query, best.hit.t) else { return };
        pages.visit(page.1, &mut |bytes| {
            prefetch(bytes.as_ptr(), PAGE_HEAD_LINES);
            let view = PageView::new(bytes);
            let t_max = best.hit.t;
            let triangles =
                Triangles { scene: self, object, blocks: view.blocks, page: Some(page), ray, query };
            let mut inner = NearestTriangle { triangles, instance: *instance, best };
            traverse_wide::<COUNT, true>(self.fma, view.nodes, query, t_max, work, &mut inner);
        });
    }

    /// Whether anything in the page `r` is nearer than `t_max`.
    #[inline(never)]
    pub(super) fn any_in_page<const COUNT: bool>(
        &self,
        leaves: &mut AnyOther<'_, 'a, COUNT>,
        r: &Reference,
        t_max: f32,
    ) -> bool {
        let AnyOther { object, ray, query, work, .. } = leaves;
        let Some((pages, page)) = self.worth_a_look(object, r, query, t_max) else { return false };
        let mut found = false;
        pages.visit(page.1, &mut |bytes| {
            prefetch(bytes.as_ptr(), PAGE_HEAD_LINES);
            let view = PageView::new(bytes);
            let triangles =
                Triangles { scene: self, object, blocks: view.blocks, page: Some(page), ray, query };
            let mut inner = AnyTriangle { triangles, found: false };
            traverse_wide::<COUNT, false>(self.fma, view.nodes, query, t_max, work, &mut inner);
            found = inner.found;
        });
        found
    }

    /// An instance, the ray in its space and where that enters its box.
    #[inline(always)]
    pub(super) fn enter(
        &self,
        instance: u32,
        ray: &Ray,
        query: &Query,
        t_max: f32,
    ) -> Option<(&Object<'a>, Ray, Query)> {
        let placed = &self.instances[instance as usize];
        let (near, far) = query.inside(placed.lo, placed.hi, t_max);
        if near > far {
            return None;
        }
        let inner = into_object(ray, &placed.to_object, t_max);
        let mut inside = Query::new(&inner, self.reach)?;
        inside.floor = near;
        Some((&self.objects[placed.object as usize], inner, inside))
    }

    #[inline(always)]
    pub(super) fn passes(&self, name: Option<u32>, primitive: u32, met: Met, ray: &Ray) -> bool {
        name.is_some_and(|name| !self.custom.is_opaque(name, primitive, (met.t, met.u, met.v), ray))
    }
}

impl<'a> Object<'a> {
    fn new(
        geometry: &[Geometry<'a>],
        instances: Vec<Reference>,
        custom: &'a dyn Custom,
        form: Form,
    ) -> Result<Self> {
        let mut of_triangles = triangles(geometry);
        let mut order = instances;
        let mut pages = Vec::new();
        for (name, g) in geometry.iter().enumerate() {
            let name = u32::try_from(name).expect("geometries are counted in u32");
            if let Geometry::Pages { outlines, .. } = *g {
                order.extend(outlines.iter().zip(0u32..).filter_map(|(outline, i)| {
                    let primitive = u32::try_from(pages.len()).ok()?;
                    pages.push((name, i));
                    Reference::new(outline.lo, outline.hi, PAGE, primitive)
                }));
            }
            let Geometry::Custom { count, user, .. } = *g else { continue };
            order.extend((0..count).filter_map(|primitive| {
                let (lo, hi) = grown(custom.bounds(user, primitive));
                Reference::new(lo, hi, name, primitive)
            }));
        }
        if of_triangles.len().max(order.len()) >= MAX_STARTS {
            return Err(Error::Resource(format!(
                "{} primitives in one object; the native tree holds up to {MAX_STARTS}",
                of_triangles.len().max(order.len())
            )));
        }
        let mut nodes = build(&mut of_triangles, BuildSettings::TRIANGLES);
        let blocks = into_blocks(&mut nodes, &of_triangles, geometry);
        drop(of_triangles);
        let other_nodes = build(&mut order, BuildSettings::SINGLE);
        // Named in the order in which rays ask, so that what is asked for together lies together.
        let asked = order.iter_mut().filter(|r| r.geometry == PAGE).zip(0u32..);
        let pages = asked.map(|(r, i)| pages[std::mem::replace(&mut r.primitive, i) as usize]).collect();
        let (mut lo, mut hi) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
        for root in nodes.first().into_iter().chain(other_nodes.first()) {
            lo = lo.min(root.lo.into());
            hi = hi.max(root.hi.into());
        }
        let masked = |g: &Geometry<'_>| matches!(g, Geometry::Triangles { alpha: Some(_), .. });
        Ok(Self {
            masked: geometry.iter().any(masked),
            geometry: geometry.to_vec(),
            triangles: Nodes::new(nodes, form),
            blocks,
            others: Nodes::new(other_nodes, form),
            order,
            pages,
            lo,
            hi,
        })
    }

    fn bytes(&self) -> usize {
        self.triangles.bytes()
            + self.others.bytes()
            + self.blocks.bytes()
            + size_of_val(&self.order[..])
            + size_of_val(&self.pages[..])
    }

    /// Name of the first page of `geometry`, which has some, and where the triangles of all of them are.
    #[inline(always)]
    fn paged(&self, geometry: u32) -> (u32, &'a [Outline]) {
        match self.geometry[geometry as usize] {
            Geometry::Pages { first, outlines } => (first, outlines),
            _ => unreachable!("pages are referred to in geometries of pages"),
        }
    }

    #[inline(always)]
    pub(super) fn alpha(&self, geometry: u32) -> Option<u32> {
        match self.geometry[geometry as usize] {
            Geometry::Triangles { alpha, .. } => alpha,
            Geometry::Custom { user, alpha, .. } => alpha.then_some(user),
            Geometry::Pages { .. } => None,
        }
    }
}

impl Placed {
    fn new(instance: &InstanceOf, objects: &[Object<'_>]) -> Self {
        let t = &instance.transform;
        let column = |c: usize, w: f32| [t[3 * c], t[3 * c + 1], t[3 * c + 2], w];
        let to_world =
            Mat4::from_cols_array_2d(&[column(0, 0.0), column(1, 0.0), column(2, 0.0), column(3, 1.0)]);
        let inverse = to_world.as_dmat4().inverse().as_mat4();
        let mut to_object = [0.0; 12];
        for (out, axis) in to_object.chunks_exact_mut(3).zip(inverse.to_cols_array_2d()) {
            out.copy_from_slice(&axis[..3]);
        }
        let object = &objects[instance.object as usize];
        let (mut lo, mut hi) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
        for corner in 0..8 {
            let pick = |bit: i32, a: f32, b: f32| if corner >> bit & 1 == 0 { a } else { b };
            let p = Vec3::new(
                pick(0, object.lo.x, object.hi.x),
                pick(1, object.lo.y, object.hi.y),
                pick(2, object.lo.z, object.hi.z),
            );
            let p = to_world.transform_point3(p);
            lo = lo.min(p);
            hi = hi.max(p);
        }
        let (lo, hi) = grown((lo, hi));
        Self { object: instance.object, to_object, lo, hi }
    }
}

impl Accel for BvhScene<'_> {
    fn closest(&self, ray: &Ray) -> Hit {
        self.nearest::<false>(ray, &mut Work::default())
    }

    fn occluded(&self, ray: &Ray) -> bool {
        self.any::<false>(ray, &mut Work::default())
    }

    fn closest_part(&self, ray: &Ray, from: f32, to: f32, so_far: &Hit) -> Hit {
        let Some(query) = Query::new(ray, self.reach) else { return Hit::MISS };
        let (mut best, mut work) = (Best::after(so_far, ray.t_max), Work::default());
        self.nearest_in::<false>(&self.world, NONE, ray, &query, Part { from, to }, &mut best, &mut work);
        best.into_hit()
    }

    fn occluded_part(&self, ray: &Ray, from: f32, to: f32) -> bool {
        let Some(query) = Query::new(ray, self.reach) else { return false };
        self.any_in::<false>(&self.world, ray, &query, Part { from, to }, &mut Work::default())
    }

    fn pages(&self) -> Vec<PageBox> {
        let mut boxes = Vec::new();
        for r in &self.world.order {
            let (lo, hi) = r.corners();
            let mut add = |pages| boxes.push(PageBox { lo: lo.into(), hi: hi.into(), pages });
            match r.geometry {
                PAGE => {
                    let (geometry, page) = self.world.pages[r.primitive as usize];
                    let page = self.world.paged(geometry).0 + page;
                    add(page..page + 1);
                }
                INSTANCE => {
                    let object = &self.objects[self.instances[r.primitive as usize].object as usize];
                    object.geometry.iter().filter_map(page_names).for_each(&mut add);
                }
                _ => {}
            }
        }
        boxes
    }

    fn bytes(&self) -> u64 {
        let objects: usize = self.objects.iter().map(Object::bytes).sum();
        (self.world.bytes() + objects + size_of_val(&self.instances[..])) as u64
    }

    fn bounds(&self) -> (Vec3, Vec3) {
        (self.world.lo, self.world.hi)
    }
}
