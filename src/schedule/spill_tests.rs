//! Known answers of rays in a file: what was written comes back, whatever the disk does every ray is answered once or the
//! work ends, and places are used again.

use super::bag::{Bag, Shelf, Taken};
use super::meter::PIECE_BYTES;
use super::spill::Spill;
use super::tests::{RAYS, run_in};
use super::{Meter, Piece};
use crate::stats::SchedulerStats;
use std::fs::{self, File, OpenOptions};
use std::path::Path;

/// Bytes of tables that are enough for what is done here.
const TABLES: usize = 64 << 10;

fn spill(directory: &Path, bytes: u64) -> Spill {
    Spill::new(directory.to_owned(), bytes, TABLES, 4)
}

fn stats(spill: &Spill) -> SchedulerStats {
    let mut stats = SchedulerStats::default();
    spill.report(&mut stats);
    stats
}

/// Numbers in a bag, wherever they lie.
struct Numbers<'s> {
    bag: Bag<[u32; 3], f32>,
    meter: Meter,
    spill: &'s Spill,
}

impl Numbers<'_> {
    fn push(&mut self, numbers: std::ops::Range<u32>) {
        for n in numbers {
            assert!(self.bag.push(&[n, n + 1, n + 2], &(n as f32), &self.meter), "there is room");
        }
    }

    /// Puts pieces into the file, or back where they were.
    fn spill(&mut self, most: usize) {
        let (pieces, pairs) = self.bag.lift(most);
        let (bytes, full) = self.bag.sizes();
        let first = pairs - (pieces.len() - 1) * full;
        let size = |i: usize| bytes * if i == 0 { first } else { full };
        let chunks: Vec<&[u8]> =
            pieces.iter().enumerate().map(|(i, p)| &bytemuck::cast_slice(&p[..])[..size(i)]).collect();
        match self.spill.write(&[(pairs, chunks)]) {
            Some(runs) => self.bag.add(runs[0], self.spill),
            None => {
                let _ = self.bag.lower(pieces, pairs);
            }
        }
    }

    /// All numbers in order, each of which is whole.
    fn take(&mut self) -> Vec<u32> {
        let mut hand: Vec<Piece> = Meter::apart(4);
        let (mut taken, mut runs) = (Vec::new(), Vec::new());
        let count = self.bag.take(usize::MAX, &mut taken, &mut runs, Some(self.spill));
        let mut numbers = Vec::new();
        let mut add = |taken: &Taken<[u32; 3], f32>| {
            for i in 0..taken.len() {
                let ([a, b, c], x) = taken.get(i);
                assert!(b == a + 1 && c == a + 2 && x == a as f32, "{a} {b} {c} {x}");
                numbers.push(a);
            }
        };
        taken.iter().for_each(&mut add);
        for run in &runs {
            let read = Bag::fetch(run, &mut hand, self.spill).expect("a run has room in a hand");
            read.iter().for_each(&mut add);
            hand.extend(read.into_iter().map(Taken::into_piece));
        }
        assert_eq!(numbers.len(), count);
        assert_eq!(self.bag.len(), 0);
        numbers.sort_unstable();
        numbers
    }
}

#[test]
fn what_was_written_comes_back_and_its_place_is_used_again() {
    let folder = tempfile::tempdir().expect("a folder");
    let spill = spill(folder.path(), 1 << 20);
    let mut numbers = Numbers { bag: Bag::new(), meter: Meter::new(1 << 20), spill: &spill };
    let per_piece = numbers.bag.sizes().1 as u32;
    for round in 0..20 {
        // From one number to several pieces, the last of which is full or not.
        let count = [1, per_piece - 1, per_piece, per_piece + 1, 5 * per_piece + 7][round % 5];
        numbers.push(0..count);
        numbers.spill(1 + round % 4);
        numbers.push(count..count + 10);
        numbers.spill(1);
        numbers.push(count + 10..count + 11);
        assert_eq!(numbers.bag.len(), count as usize + 11);
        assert_eq!(numbers.take(), (0..count + 11).collect::<Vec<_>>(), "round {round}");
    }
    let stats = stats(&spill);
    assert!(stats.spilled_bytes > 20 * 16 && stats.spilled_peak_bytes < 40_000, "{stats:?}");
    assert_eq!(spill.refused().or(spill.lost()), None);
    // Two extents and two runs at a time, of twenty and forty.
    assert!(spill.table_bytes() <= 2 * (20 + 8), "{}", spill.table_bytes());
    assert_eq!(fs::read_dir(folder.path()).expect("ours").count(), 0, "it has a name");
}

#[test]
fn what_cannot_be_written_stays_where_it_was() {
    let folder = tempfile::tempdir().expect("a folder");
    fs::write(folder.path().join("file"), "").expect("ours");
    let closed = || File::open("/dev/null").expect("always there");
    for spill in [
        spill(folder.path(), 1 << 20).with_file(closed()),
        // No directory can be made there.
        spill(&folder.path().join("file/below"), 1 << 20),
    ] {
        assert!(spill.is_open());
        let mut numbers = Numbers { bag: Bag::new(), meter: Meter::new(1 << 20), spill: &spill };
        let per_piece = numbers.bag.sizes().1 as u32;
        numbers.push(0..3 * per_piece + 5);
        numbers.spill(2);
        let (pieces, pairs) = numbers.bag.lift(2);
        // Meanwhile others come.
        numbers.push(3 * per_piece + 5..4 * per_piece - 3);
        let _ = numbers.bag.lower(pieces, pairs);
        assert_eq!(numbers.take(), (0..4 * per_piece - 3).collect::<Vec<_>>());
        assert!(!spill.is_open() && spill.refused().is_some_and(|line| line.contains("--cache-dir")));
    }
}

#[test]
fn what_is_read_is_what_was_written_or_it_is_lost() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = folder.path().join("file");
    let open = || {
        let options = OpenOptions::new().read(true).write(true).create(true).truncate(true).open(&at);
        options.expect("ours")
    };
    let damage: [&dyn Fn(); 2] = [&|| drop(open()), &|| {
        let mut bytes = fs::read(&at).expect("ours");
        bytes[40] ^= 1;
        fs::write(&at, bytes).expect("ours");
    }];
    for damage in damage {
        let spill = spill(folder.path(), 1 << 20).with_file(open());
        let mut numbers = Numbers { bag: Bag::new(), meter: Meter::new(1 << 20), spill: &spill };
        numbers.push(0..50);
        numbers.spill(1);
        damage();
        let mut runs = Vec::new();
        numbers.bag.take(1, &mut Vec::new(), &mut runs, Some(&spill));
        let read = Bag::<[u32; 3], f32>::fetch(&runs[0], &mut Meter::apart(4), &spill);
        assert!(read.is_some_and(|read| read.is_empty()));
        assert!(spill.is_lost() && spill.lost().is_some_and(|line| line.contains("no image")));
    }
}

#[test]
fn every_ray_is_answered_once_wherever_it_waits() {
    let folder = tempfile::tempdir().expect("a folder");
    for (threads, bytes, wanted, disk) in [
        (1, 40_000, 20, 64 << 20),
        (4, 40_000, 400, 64 << 20),
        (3, 12_000, 0, 64 << 20),
        (3, 40_000, 50, 256 << 10),
        (2, 0, 50, 64 << 20),
    ] {
        let spill = spill(folder.path(), disk);
        let (answered, tested, peak) = run_in((bytes, Some(&spill)), threads, wanted, None, usize::MAX);
        let stats = stats(&spill);
        let what = format!("{threads} threads, {bytes} bytes, {wanted} voxels, {disk} on disk: {stats:?}");
        assert_eq!((answered, tested), (RAYS, RAYS), "{what}");
        assert!(peak <= bytes, "{what}: {peak} bytes");
        assert!(bytes == 0 || stats.spilled_bytes > 0, "{what}");
        assert!(stats.spilled_peak_bytes <= disk && spill.table_bytes() <= TABLES, "{what}");
        assert_eq!(spill.refused().or(spill.lost()), None, "{what}");
        assert!(spill.is_open() || bytes == 0, "what was read has left its place: {what}");
    }
}

#[test]
fn a_disk_that_refuses_costs_time_and_one_that_loses_ends_it() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = folder.path().join("file");
    fs::write(&at, "").expect("ours");
    let reads = File::open(&at).expect("ours");
    let refusing = spill(folder.path(), 1 << 20).with_file(reads);
    let (answered, tested, _) = run_in((60_000, Some(&refusing)), 3, 50, None, usize::MAX);
    assert_eq!((answered, tested), (RAYS, RAYS));
    assert!(refusing.refused().is_some() && stats(&refusing).spilled_bytes == 0);

    let writes = OpenOptions::new().write(true).open(&at).expect("ours");
    let losing = spill(folder.path(), 1 << 20).with_file(writes);
    let (answered, tested, _) = run_in((60_000, Some(&losing)), 3, 50, None, usize::MAX);
    assert!(losing.is_lost() && (answered < RAYS || tested < RAYS), "{answered}, {tested}");
}

#[test]
fn tables_that_are_full_are_no_more_than_that() {
    let folder = tempfile::tempdir().expect("a folder");
    // Of a handful of runs.
    let table_bytes = 160;
    let spill = Spill::new(folder.path().to_owned(), 1 << 30, table_bytes, 1);
    let (answered, tested, _) = run_in((10 * PIECE_BYTES, Some(&spill)), 3, 50, None, usize::MAX);
    assert_eq!((answered, tested), (RAYS, RAYS));
    assert!(stats(&spill).spilled_bytes > 0 && spill.table_bytes() <= table_bytes);
    assert_eq!(spill.refused().or(spill.lost()), None);
    // So large a file that its tables had no room for runs has fewer extents.
    assert!(Spill::new(folder.path().to_owned(), u64::MAX, 1 << 20, 1).runs_left() > 1000);
    assert!(!Spill::new(folder.path().to_owned(), 1, 1 << 20, 1).is_open(), "less than an extent");
}
