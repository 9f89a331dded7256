//! Traversal of the wide form: eight boxes at a time, children nearest first.
//!
//! Invariant: the same arithmetic as [`Query::inside`], lane by lane.

use super::plain::{Leaves, MAX_DEPTH};
use super::query::{Query, SLACK, Work};
use super::tree::{Child, WIDTH, Wide};
use crate::math::prefetch;
use std::arch::x86_64::*;
use std::mem::MaybeUninit;

/// All but one child of every node on the way down wait at most.
const STACK: usize = MAX_DEPTH * (WIDTH - 1) + 1;

/// A child that waits: the distance to its box in the upper half, so that comparing compares distances; the
/// child in the lower.
#[inline(always)]
fn waiting(near: f32, child: Child) -> u64 {
    u64::from(near.to_bits()) << 32 | u64::from(child.0)
}

#[inline(always)]
fn load(planes: &[f32; WIDTH]) -> __m256 {
    // SAFETY: reads the eight floats of the array, no alignment asked for; inlined only where AVX is.
    unsafe { _mm256_loadu_ps(planes.as_ptr()) }
}

#[inline(always)]
fn pop(stack: &[MaybeUninit<u64>; STACK], height: usize) -> u64 {
    // SAFETY: entries below the height that was reached have been written.
    unsafe { stack[height].assume_init() }
}

/// A query in all lanes, for eight boxes at a time.
pub(super) struct WideQuery {
    inverse: [__m256; 3],
    near: [__m256; 3],
    far: [__m256; 3],
    t_min: __m256,
    slack: __m256,
    /// By axis the side that the ray enters through; the other is the one that it leaves through.
    enter: [usize; 3],
}

impl WideQuery {
    #[inline]
    #[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
    pub(super) fn new(query: &Query) -> Self {
        let all = |v: f32| _mm256_set1_ps(v);
        Self {
            inverse: query.inverse.map(all),
            near: query.near.map(all),
            far: query.far.map(all),
            t_min: all(query.t_min),
            slack: all(SLACK),
            enter: [0, 1, 2].map(|k| 2 * k + query.negative[k]),
        }
    }

    /// [`Query::inside`] of eight boxes, whose planes `plane` has in the order of [`Wide`]'s: where the ray enters each, and
    /// a bit for each that it is inside of anywhere.
    #[inline]
    #[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
    pub(super) fn inside(&self, plane: impl Fn(usize) -> __m256, t_max: f32) -> (__m256, u32) {
        let Self { inverse, enter, .. } = self;
        let near = |k: usize| _mm256_fmadd_ps(plane(enter[k]), inverse[k], self.near[k]);
        let far = |k: usize| _mm256_fmadd_ps(plane(enter[k] ^ 1), inverse[k], self.far[k]);
        let near = _mm256_max_ps(_mm256_max_ps(near(0), near(1)), _mm256_max_ps(near(2), self.t_min));
        let far = _mm256_min_ps(_mm256_min_ps(far(0), far(1)), far(2));
        let far = _mm256_min_ps(_mm256_mul_ps(far, self.slack), _mm256_set1_ps(t_max));
        let inside = _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LE_OQ>(near, far));
        (near, inside.cast_unsigned())
    }
}

/// Visits the leaves that `query` meets within `t_max`.
#[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
pub(super) fn traverse<const COUNT: bool, const ORDERED: bool>(
    nodes: &[Wide],
    query: &Query,
    mut t_max: f32,
    work: &mut Work,
    leaves: &mut impl Leaves,
) {
    if nodes.is_empty() {
        return;
    }
    let query = WideQuery::new(query);
    let mut stack = [const { MaybeUninit::<u64>::uninit() }; STACK];
    let mut height = 0;
    let mut at = Child::inner(0);
    let mut distances = [0.0f32; WIDTH];
    let fetch = leaves.prefetcher();
    let touch = |child: Child| {
        if child.is_leaf() {
            let (start, count) = child.run();
            fetch(start, count);
        } else {
            prefetch(nodes.as_ptr().wrapping_add(child.0 as usize), 4);
        }
    };
    'next: loop {
        while !at.is_leaf() {
            let node = &nodes[at.0 as usize];
            if COUNT {
                work.nodes += 1;
            }
            let (near, mut hit) = query.inside(|side| load(&node.planes[side]), t_max);
            if hit == 0 {
                break;
            }
            let first = hit.trailing_zeros() as usize;
            hit &= hit - 1;
            if hit == 0 {
                at = node.children[first & (WIDTH - 1)];
                touch(at);
                continue;
            }
            // SAFETY: writes eight floats to an array of eight.
            unsafe { _mm256_storeu_ps(distances.as_mut_ptr(), near) };
            let key = |i: usize| {
                let child = node.children[i & (WIDTH - 1)];
                touch(child);
                waiting(distances[i & (WIDTH - 1)], child)
            };
            if !ORDERED {
                // Any hit will do.
                at = node.children[first & (WIDTH - 1)];
                touch(at);
                while hit != 0 {
                    stack[height].write(key(hit.trailing_zeros() as usize));
                    height += 1;
                    hit &= hit - 1;
                }
                continue;
            }
            let mut next_key = || {
                let i = hit.trailing_zeros() as usize;
                hit &= hit - 1;
                (key(i), hit == 0)
            };
            let a = key(first);
            let (b, done) = next_key();
            let (a, b) = (a.min(b), a.max(b));
            if done {
                stack[height].write(b);
                height += 1;
                at = Child(a as u32);
                continue;
            }
            let (c, done) = next_key();
            let (b, c) = (b.min(c), b.max(c));
            let (a, b) = (a.min(b), a.max(b));
            if done {
                stack[height].write(c);
                stack[height + 1].write(b);
                height += 2;
                at = Child(a as u32);
                continue;
            }
            let (d, mut done) = next_key();
            let (c, d) = (c.min(d), c.max(d));
            let (b, c) = (b.min(c), b.max(c));
            let (a, b) = (a.min(b), a.max(b));
            let mut nearest = a;
            let bottom = height;
            stack[height].write(d);
            stack[height + 1].write(c);
            stack[height + 2].write(b);
            height += 3;
            while !done {
                let (other, last) = next_key();
                done = last;
                // Farther ones lie below: what is put down sinks to its place.
                let behind = nearest.max(other);
                nearest = nearest.min(other);
                let mut place = height;
                while place > bottom && pop(&stack, place - 1) < behind {
                    stack[place] = stack[place - 1];
                    place -= 1;
                }
                stack[place].write(behind);
                height += 1;
            }
            at = Child(nearest as u32);
        }
        if at.is_leaf() {
            if COUNT {
                work.leaves += 1;
            }
            let (start, count) = at.run();
            t_max = leaves.visit(start, count, t_max);
            if t_max == f32::NEG_INFINITY {
                return;
            }
        }
        while height > 0 {
            height -= 1;
            let entry = pop(&stack, height);
            if f32::from_bits((entry >> 32) as u32) <= t_max {
                at = Child(entry as u32);
                continue 'next;
            }
        }
        return;
    }
}
