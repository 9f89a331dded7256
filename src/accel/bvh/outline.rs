//! What stays of a page while it is away: its box, and coarse boxes of its parts, so that fewer rays have to look into it.
//!
//! Planes are in 254ths of the page's box, rounded outwards: `lo + plane · scale` in one operation, then the same
//! arithmetic as for any box.
//!
//! Invariant: a ray that enters a node of the page's tree enters the part that holds it, as computed.

use super::collapse::open;
use super::nodes::Fma;
use super::query::Query;
use super::tree::{Node, WIDTH};
#[cfg(target_arch = "x86_64")]
use super::wide::WideQuery;
use bytemuck::{Pod, Zeroable};

/// Eights of parts: ARCHITECTURE.md says what each spares.
const GROUPS: usize = 2;

/// Planes of eight boxes, in the order of [`Wide`](super::tree::Wide)'s.
type Planes = [[u8; WIDTH]; 6];
const UNUSED: Planes =
    [[u8::MAX; WIDTH], [0; WIDTH], [u8::MAX; WIDTH], [0; WIDTH], [u8::MAX; WIDTH], [0; WIDTH]];

/// The box of a page, and boxes of its parts.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct Outline {
    /// Least corner.
    pub lo: [f32; 3],
    /// Greatest corner.
    pub hi: [f32; 3],
    /// Those that are not used are turned inside out.
    parts: [Planes; GROUPS],
}

/// Planes a box is divided by: two fewer than there are numbers, so that the last lies outside however it is rounded.
const STEPS: f32 = 254.0;

/// Of planes along one axis.
#[inline(always)]
fn scale(lo: f32, hi: f32) -> f32 {
    // Of flat boxes, too, and of those whose size is denormal.
    ((hi - lo) * (1.0 / STEPS)).max(f32::MIN_POSITIVE)
}

/// Where the plane `number` is.
fn plane(number: u8, lo: f32, scale: f32) -> f32 {
    f32::from(number).mul_add(scale, lo)
}

impl Outline {
    /// Of a page whose tree has `nodes`; of none, a box that nothing enters.
    pub(super) fn new(nodes: &[Node]) -> Self {
        let Some(&Node { lo, hi, .. }) = nodes.first() else {
            return Self { lo: [f32::INFINITY; 3], hi: [f32::NEG_INFINITY; 3], parts: [UNUSED; GROUPS] };
        };
        let (children, count) = open::<{ WIDTH * GROUPS }>(nodes, 0);
        let mut parts = [UNUSED; GROUPS];
        for (slot, &child) in children[..count].iter().enumerate() {
            let planes = &mut parts[slot / WIDTH];
            let node = &nodes[child];
            for axis in 0..3 {
                let scale = scale(lo[axis], hi[axis]);
                let plane = |number: u8| plane(number, lo[axis], scale);
                let at = |v: f32| (v - lo[axis]) / scale;
                // Casts keep to the numbers that there are.
                let mut below = at(node.lo[axis]) as u8;
                while below > 0 && plane(below) > node.lo[axis] {
                    below -= 1;
                }
                let mut above = at(node.hi[axis]).ceil() as u8;
                while above < u8::MAX && plane(above) < node.hi[axis] {
                    above += 1;
                }
                planes[2 * axis][slot % WIDTH] = below;
                planes[2 * axis + 1][slot % WIDTH] = above;
            }
        }
        Self { lo, hi, parts }
    }

    /// A box of one part.
    #[cfg(test)]
    pub(super) fn whole([lo, hi]: [[f32; 3]; 2]) -> Self {
        Self::new(&[Node { lo, next: 0, hi, count_axis: 1 << 2 }])
    }

    /// Whether `query` enters one of the parts within `t_max`.
    #[inline(always)]
    pub(super) fn meets(&self, fma: Option<Fma>, query: &Query, t_max: f32) -> bool {
        #[cfg(target_arch = "x86_64")]
        if fma.is_some() {
            // SAFETY: `Fma` is made only where every feature has been found.
            return unsafe { self.meets_eights(query, t_max) };
        }
        #[cfg(not(target_arch = "x86_64"))]
        let _ = fma;
        self.meets_one_by_one(query, t_max)
    }

    /// The box of the part in `slot`.
    fn part(&self, slot: usize) -> [[f32; 3]; 2] {
        let planes = &self.parts[slot / WIDTH];
        [0, 1].map(|upper| {
            [0, 1, 2].map(|axis| {
                let (lo, hi) = (self.lo[axis], self.hi[axis]);
                plane(planes[2 * axis + upper][slot % WIDTH], lo, scale(lo, hi))
            })
        })
    }

    /// [`Self::meets`], for any processor.
    fn meets_one_by_one(&self, query: &Query, t_max: f32) -> bool {
        (0..WIDTH * GROUPS).any(|slot| {
            let [lo, hi] = self.part(slot);
            let (near, far) = query.inside(lo, hi, t_max);
            near <= far
        })
    }

    /// [`Self::meets`], eight at a time.
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
    fn meets_eights(&self, query: &Query, t_max: f32) -> bool {
        use std::arch::x86_64::*;
        let all = |v: f32| _mm256_set1_ps(v);
        let query = WideQuery::new(query);
        let los = self.lo.map(all);
        let scales = [0, 1, 2].map(|axis| all(scale(self.lo[axis], self.hi[axis])));
        self.parts.iter().any(|planes| {
            let plane = |side: usize| {
                let numbers = _mm_cvtsi64_si128(i64::from_le_bytes(planes[side]));
                let numbers = _mm256_cvtepi32_ps(_mm256_cvtepu8_epi32(numbers));
                _mm256_fmadd_ps(numbers, scales[side / 2], los[side / 2])
            };
            query.inside(plane, t_max).1 != 0
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::accel::Ray;
    use glam::Vec3;
    use proptest::prelude::*;

    /// A tree of one level: a root over `boxes`.
    fn tree(boxes: &[[[f32; 3]; 2]]) -> Vec<Node> {
        let leaf = |&[lo, hi]: &[[f32; 3]; 2]| Node { lo, next: 0, hi, count_axis: 1 << 2 };
        if let [one] = boxes {
            return vec![leaf(one)];
        }
        let (left, right) = boxes.split_at(boxes.len() / 2);
        let (left, right) = (tree(left), tree(right));
        let (a, b) = (left[0], right[0]);
        let lo = [0, 1, 2].map(|k| a.lo[k].min(b.lo[k]));
        let hi = [0, 1, 2].map(|k| a.hi[k].max(b.hi[k]));
        let moved = |by: usize| {
            move |n: Node| if n.count() == 0 { Node { next: n.next + by as u32, ..n } } else { n }
        };
        let mut all = vec![Node { lo, next: 1 + left.len() as u32, hi, count_axis: 0 }];
        let from = 1 + left.len();
        all.extend(left.into_iter().map(moved(1)));
        all.extend(right.into_iter().map(moved(from)));
        all
    }

    fn boxes() -> impl Strategy<Value = Vec<[[f32; 3]; 2]>> {
        let size = (-44i32..60, -44i32..60).prop_map(|(away, across)| (2f32.powi(away), 2f32.powi(across)));
        let corner = || prop::array::uniform3(-1.0f32..1.0);
        let some = prop::collection::vec((corner(), corner()), 1..60);
        (size, some, corner(), 0..3usize, any::<bool>()).prop_map(|((away, across), some, at, axis, flat)| {
            let place = |p: [f32; 3]| {
                [0, 1, 2].map(|k| at[k] * away + if flat && k == axis { 0.0 } else { p[k] * across })
            };
            let one = |(a, b): ([f32; 3], [f32; 3])| {
                let (a, b) = (place(a), place(b));
                [[0, 1, 2].map(|k| a[k].min(b[k])), [0, 1, 2].map(|k| a[k].max(b[k]))]
            };
            some.into_iter().map(one).collect()
        })
    }

    proptest! {
        /// Parts contain what they stand for, exactly; rounding is monotone, so that a ray that enters a box enters its part.
        #[test]
        fn parts_contain_their_nodes_and_both_ways_of_testing_agree(
            boxes in boxes(),
            aims in prop::collection::vec((any::<prop::sample::Index>(), prop::array::uniform6(0.0f32..1.0), -6i32..6), 60),
        ) {
            let nodes = tree(&boxes);
            let outline = Outline::new(&nodes);
            let (children, count) = open::<{ WIDTH * GROUPS }>(&nodes, 0);
            for (slot, &child) in children[..count].iter().enumerate() {
                let [from, to] = outline.part(slot);
                for axis in 0..3 {
                    prop_assert!(from[axis] <= nodes[child].lo[axis] && nodes[child].hi[axis] <= to[axis]);
                }
            }
            let (lo, hi) = (Vec3::from(outline.lo), Vec3::from(outline.hi));
            let reach = lo.abs().max(hi.abs()).max_element();
            for (which, [a, b, c, d, e, f], back) in aims {
                let [from, to] = boxes[which.index(boxes.len())].map(Vec3::from);
                let target = from + Vec3::new(a, b, c).round() * (to - from);
                let origin = lo + Vec3::new(d, e, f) * (hi - lo) * 2f32.powi(back);
                let ray = Ray::new(origin, target - origin);
                let Some(query) = Query::new(&ray, reach) else { continue };
                for t_max in [f32::INFINITY, 1.0] {
                    let entered = boxes.iter().any(|&[lo, hi]| {
                        let (near, far) = query.inside(lo, hi, t_max);
                        near <= far
                    });
                    let slow = outline.meets_one_by_one(&query, t_max);
                    prop_assert!(!entered || slow, "{ray:?}");
                    let fast = outline.meets(Fma::detect(), &query, t_max);
                    prop_assert_eq!(fast, slow);
                }
            }
        }
    }

    #[test]
    fn a_ray_between_parts_enters_none() {
        // Two posts with a gap, and a ray through it.
        let boxes = [[[0.0; 3], [1.0; 3]], [[9.0, 0.0, 0.0], [10.0, 1.0, 1.0]]];
        let outline = Outline::new(&tree(&boxes));
        for (x, enters) in [(0.5, true), (1.1, false), (5.0, false), (8.9, false), (9.5, true)] {
            let query = Query::new(&Ray::new(Vec3::new(x, 0.5, -3.0), Vec3::Z), 10.0).expect("a ray");
            assert_eq!(outline.meets(Fma::detect(), &query, 9.0), enters, "at {x}");
            assert!(!outline.meets(Fma::detect(), &query, 2.9), "too far");
        }
    }
}
