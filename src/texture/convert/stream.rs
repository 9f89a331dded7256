//! Mip levels of an image whose rows arrive from the top, a few at a time. A level hands its rows
//! out in rows of tiles and makes the next level's rows as soon as theirs are there.
//!
//! Invariant: a level holds at most one row of tiles and the two rows that the next level may still
//! ask for, so that all levels together hold less than 2·(64 + 2) rows of the finest. Every texel is
//! what `pyramid::build` would have made of the whole image. Never sees a file.

use super::{TILE, TileRow, TileSink};
use crate::texture::pyramid::{Taps, filter_row, sizes, taps};
use crate::texture::texels::Texel;
use glam::Vec4;
use rayon::prelude::*;
use std::io;

/// One level under way.
struct Lane<T> {
    width: u32,
    height: u32,
    /// Rows `first..end()`.
    texels: Vec<T>,
    first: u32,
    /// Rows that have been handed out.
    emitted: u32,
    /// Rows of the next level that have been made.
    made: u32,
    /// How the next level's columns and rows come from this one's.
    columns: Vec<Taps>,
    rows: Vec<Taps>,
}

impl<T: Texel> Lane<T> {
    fn end(&self) -> u32 {
        self.first + (self.texels.len() / self.width as usize) as u32
    }

    /// Rows that still fit before a row of tiles is whole.
    fn room(&self) -> u32 {
        (self.height - self.emitted).min(TILE) - (self.end() - self.emitted)
    }

    /// Rows of the next level that can be made now.
    fn ready(&self) -> u32 {
        let end = self.end();
        let rest = &self.rows[self.made as usize..];
        rest.iter().take_while(|row| row.end() <= end).count() as u32
    }

    /// Forgets what nobody will ask for.
    fn trim(&mut self) {
        let wanted = self.rows.get(self.made as usize).map_or(self.emitted, |row| row.first);
        let keep = wanted.min(self.emitted).clamp(self.first, self.end());
        self.texels.drain(..(keep - self.first) as usize * self.width as usize);
        self.first = keep;
    }
}

/// All levels of an image, finest first.
pub(super) struct Pyramid<'a, T, E> {
    lanes: Vec<Lane<T>>,
    table: &'a [f32; 256],
    encode: E,
    sink: &'a mut dyn TileSink,
}

impl<'a, T: Texel, E: Fn(Vec4) -> T + Sync> Pyramid<'a, T, E> {
    /// `table` and `encode` as for `pyramid::build`.
    pub(super) fn new(
        width: u32,
        height: u32,
        table: &'a [f32; 256],
        encode: E,
        sink: &'a mut dyn TileSink,
    ) -> Self {
        let sizes = sizes(width, height);
        let lanes = sizes.iter().enumerate().map(|(l, &(width, height))| {
            let next = sizes.get(l + 1);
            Lane {
                width,
                height,
                texels: Vec::new(),
                first: 0,
                emitted: 0,
                made: 0,
                columns: next.map_or_else(Vec::new, |&(w, _)| taps(width, w)),
                rows: next.map_or_else(Vec::new, |&(_, h)| taps(height, h)),
            }
        });
        Self { lanes: lanes.collect(), table, encode, sink }
    }

    /// Takes the next rows of the finest level: `numbers` has `n` for each texel.
    pub(super) fn push<S: Sync>(
        &mut self,
        numbers: &[S],
        n: usize,
        convert: &(impl Fn(&[S]) -> T + Sync),
    ) -> io::Result<()> {
        let row = self.lanes[0].width as usize * n;
        let mut rest = numbers;
        while !rest.is_empty() {
            let lane = &mut self.lanes[0];
            let (now, later) = rest.split_at(rest.len().min(lane.room() as usize * row));
            rest = later;
            lane.append(now.len() / row, |y, line| {
                let from = now[y * row..][..row].chunks_exact(n);
                line.iter_mut().zip(from).for_each(|(texel, numbers)| *texel = convert(numbers));
            });
            if lane.room() == 0 {
                self.settle(0)?;
            }
        }
        Ok(())
    }

    /// Whether every row of every level has been handed out.
    pub(super) fn complete(&self) -> bool {
        self.lanes.iter().all(|lane| lane.emitted == lane.height)
    }

    /// Hands out the row of tiles of level `l` that has become whole, and makes what follows from it.
    fn settle(&mut self, l: usize) -> io::Result<()> {
        let lane = &mut self.lanes[l];
        let skip = (lane.emitted - lane.first) as usize * lane.width as usize;
        let texels = &lane.texels[skip..];
        let row = lane.emitted / TILE;
        let tiles =
            TileRow { texels: bytemuck::cast_slice(texels), stride: size_of::<T>(), width: lane.width };
        self.sink.tile_row(l, row, &tiles)?;
        lane.emitted = lane.end();
        while l + 1 < self.lanes.len() {
            let (fine, coarse) = self.lanes.split_at_mut(l + 1);
            let (fine, coarse) = (&mut fine[l], &mut coarse[0]);
            let count = fine.ready().min(coarse.room());
            if count == 0 {
                break;
            }
            let (table, encode) = (self.table, &self.encode);
            let rows = &fine.rows[fine.made as usize..];
            let width = fine.width as usize;
            coarse.append(count as usize, |y, line| {
                let row = &rows[y];
                let start = (row.first - fine.first) as usize * width;
                let texel = |x: u32, dy: u32| fine.texels[start + dy as usize * width + x as usize];
                filter_row(line, &fine.columns, row, texel, table, encode);
            });
            fine.made += count;
            if coarse.room() == 0 {
                self.settle(l + 1)?;
            }
        }
        self.lanes[l].trim();
        Ok(())
    }
}

impl<T: Texel> Lane<T> {
    /// Appends `count` rows, each filled by `fill(y, row)`, y from 0; rows in parallel.
    fn append(&mut self, count: usize, fill: impl Fn(usize, &mut [T]) + Sync) {
        let (old, width) = (self.texels.len(), self.width as usize);
        self.texels.resize(old + count * width, T::zeroed());
        // Rows of a small level are not worth another thread.
        let least = (4096 / width).max(1);
        self.texels[old..]
            .par_chunks_exact_mut(width)
            .with_min_len(least)
            .enumerate()
            .for_each(|(y, line)| fill(y, line));
    }
}
