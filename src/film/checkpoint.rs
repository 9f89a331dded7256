//! A film half done as a file, from which a render goes on: what was being rendered, and of each tile how far it is and the
//! sums that it has, to the bit.
//!
//! The file: eight bytes `WEIRSAVE`, a version, the length of the head; the head, JSON; the tiles in their order, each its
//! whole passes, those that it is to reach before anything is decided anew, the samples of a cut pass, and then the sums,
//! the squares where they are kept, and the sums of the cut pass; last a hash of all before (XXH3, 64 bits). Numbers are
//! little-endian, as those of the processors that this is built for.
//!
//! Invariant: a file of that name is whole, or is refused; no memory is taken because a file says so.

use super::FilmBuffer;
use super::kept::PASS;
use super::replace::try_replace_file;
use crate::error::{Error, Location, Result};
use crate::open::open_regular;
use serde::{Deserialize, Serialize};
use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom, Write};
use std::path::Path;
use xxhash_rust::xxh3::Xxh3;

const MAGIC: [u8; 8] = *b"WEIRSAVE";
const VERSION: u32 = 1;
/// Of a head; ours are below 2 KB.
const MOST_HEAD_BYTES: u64 = 1 << 16;

/// What is said of a film before its tiles.
#[derive(Serialize, Deserialize)]
struct Head {
    /// Whatever the picture depends on, by name, but for how many samples it has.
    identity: Vec<(String, String)>,
    /// Whether squares are kept.
    squares: bool,
}

/// What was read of a checkpoint, beside the film.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Checkpoint {
    /// Samples of all pixels together.
    pub samples: u64,
    /// Passes that each tile was on its way to.
    pub targets: Vec<u32>,
}

/// A writer that hashes.
struct Hashing<W> {
    out: W,
    hash: Xxh3,
}

impl<W: Write> Hashing<W> {
    fn put(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.hash.update(bytes);
        self.out.write_all(bytes)
    }

    fn put_floats<const N: usize>(&mut self, values: &[[f32; N]]) -> io::Result<()> {
        self.put(bytemuck::cast_slice(values.as_flattened()))
    }
}

const _: () = assert!(cfg!(target_endian = "little"), "sums are written as they lie in memory");

/// Writes `film` as `path`, whole or not at all. Tiles may go on meanwhile, but not beyond `targets`.
///
/// # Errors
/// [`Error::Io`] with `path`.
pub fn save(path: &Path, film: &FilmBuffer, identity: &[(String, String)], targets: &[u32]) -> Result<()> {
    let head = Head { identity: identity.to_vec(), squares: film.keeps.squares };
    let head = serde_json::to_vec(&head).expect("plain data");
    let write = |out: &mut io::BufWriter<File>| -> io::Result<()> {
        let mut out = Hashing { out, hash: Xxh3::new() };
        out.put(&MAGIC)?;
        out.put(&VERSION.to_le_bytes())?;
        out.put(&(head.len() as u32).to_le_bytes())?;
        out.put(&head)?;
        for (i, target) in (0..film.tile_count()).zip(targets) {
            // A copy, since a disk may be slow and the tile is wanted.
            let (passes, cut, sums, squares, cut_sums) = {
                let tile = film.tile(i);
                let (cut, squares, cut_sums) = match &tile.kept {
                    Some(kept) => (kept.cut_samples, kept.squares.clone(), kept.cut.clone()),
                    None => Default::default(),
                };
                (tile.passes, cut, tile.sums.clone(), squares, cut_sums)
            };
            [passes, *target, cut].iter().try_for_each(|n| out.put(&n.to_le_bytes()))?;
            out.put_floats(&sums)?;
            out.put_floats(&squares)?;
            out.put_floats(&cut_sums)?;
        }
        let hash = out.hash.digest();
        out.out.write_all(&hash.to_le_bytes())
    };
    try_replace_file(path, write).map_err(|e| Error::io(path, e))
}

/// Reads `path` into `film`, which is empty; `None` where there is no such file. A checkpoint that is damaged, or of
/// another render than `identity` says, is an error.
///
/// # Errors
/// [`Error::Input`] with what is wrong, [`Error::Io`].
pub fn load(path: &Path, film: &FilmBuffer, identity: &[(String, String)]) -> Result<Option<Checkpoint>> {
    let refuse = |what: &str| {
        Error::at(&Location::whole(path), format!("{what}; remove it to start anew, or name another output"))
    };
    let file = match open_regular(path) {
        Ok(Some(file)) => file,
        Ok(None) => return Err(refuse("not a regular file")),
        Err(e) if e.kind() == io::ErrorKind::NotFound => return Ok(None),
        Err(e) => return Err(Error::io(path, e)),
    };
    let damaged = || refuse("a checkpoint that is damaged or cut short, or no checkpoint at all");
    // Before it is read: what is longer than any of this film is none.
    if file.metadata().map_err(|e| Error::io(path, e))?.len() > most_bytes(film) {
        return Err(damaged());
    }
    let mut reader = BufReader::with_capacity(1 << 16, file);
    let body = whole_body(&mut reader).map_err(|e| Error::io(path, e))?.ok_or_else(damaged)?;
    reader.seek(SeekFrom::Start(0)).map_err(|e| Error::io(path, e))?;
    let mut reader = reader.take(body);
    let mut start = [0; 16];
    reader.read_exact(&mut start).map_err(|_| damaged())?;
    let word = |at: usize| u32::from_le_bytes([start[at], start[at + 1], start[at + 2], start[at + 3]]);
    if start[..8] != MAGIC {
        return Err(damaged());
    }
    if word(8) != VERSION {
        return Err(refuse(&format!("a checkpoint of form {}, where this program knows {VERSION}", word(8))));
    }
    let head_bytes = u64::from(word(12));
    if head_bytes > MOST_HEAD_BYTES.min(body) {
        return Err(damaged());
    }
    let mut head = vec![0; head_bytes as usize];
    reader.read_exact(&mut head).map_err(|_| damaged())?;
    let head: Head = serde_json::from_slice(&head).map_err(|_| damaged())?;
    if let Some(difference) = difference(&head.identity, identity) {
        return Err(refuse(&format!("a checkpoint of another render: {difference}")));
    }
    if head.squares != film.keeps.squares {
        return Err(damaged());
    }
    let targets = read_tiles(&mut reader, film).map_err(|_| damaged())?;
    if reader.limit() > 0 {
        return Err(damaged());
    }
    Ok(Some(Checkpoint { samples: film.samples(u32::MAX).2, targets }))
}

/// Bytes of the longest checkpoint of `film`.
fn most_bytes(film: &FilmBuffer) -> u64 {
    // The sums, the squares, and the sums of a cut pass; three words a tile.
    let tiles: u64 = (0..film.tile_count()).map(|i| 12 + film.pixels(i) * (16 + 12 + 16)).sum();
    16 + MOST_HEAD_BYTES + tiles + 8
}

/// Bytes before the hash at the end, if that is right.
fn whole_body(reader: &mut BufReader<File>) -> io::Result<Option<u64>> {
    let length = reader.get_ref().metadata()?.len();
    let Some(body) = length.checked_sub(8) else { return Ok(None) };
    let mut hash = Xxh3::new();
    let mut left = body;
    let mut chunk = vec![0; 1 << 16];
    while left > 0 {
        let part = &mut chunk[..left.min(1 << 16) as usize];
        reader.read_exact(part)?;
        hash.update(part);
        left -= part.len() as u64;
    }
    let mut end = [0; 8];
    reader.read_exact(&mut end)?;
    Ok((u64::from_le_bytes(end) == hash.digest()).then_some(body))
}

/// What is otherwise, in words.
fn difference(there: &[(String, String)], here: &[(String, String)]) -> Option<String> {
    if there == here {
        return None;
    }
    let value_there = |name: &str| there.iter().find(|(n, _)| n == name).map(|(_, value)| value);
    for (name, value) in here {
        match value_there(name) {
            Some(other) if other == value => {}
            Some(_) if name == "scene" => return Some("the scene has changed since".to_owned()),
            Some(other) => return Some(format!("its {name} is {other}, not {value}")),
            None => return Some(format!("it has no {name}, and this has {value}")),
        }
    }
    let only_there = there.iter().find(|(name, _)| !here.iter().any(|(n, _)| n == name));
    only_there.map(|(name, value)| format!("it has {name} {value}, and this has none"))
}

fn read_tiles(reader: &mut impl Read, film: &FilmBuffer) -> io::Result<Vec<u32>> {
    let wrong = || io::Error::from(io::ErrorKind::InvalidData);
    let mut targets = Vec::with_capacity(film.tile_count() as usize);
    for i in 0..film.tile_count() {
        let tile = &mut *film.tile(i);
        let [passes, target, cut] = [read_word(reader)?, read_word(reader)?, read_word(reader)?];
        // Samples are counted in u32.
        if cut >= PASS || passes.max(target) >= u32::MAX / PASS {
            return Err(wrong());
        }
        let kept = tile.kept.as_mut().ok_or_else(wrong)?;
        tile.passes = passes;
        read_floats(reader, &mut tile.sums)?;
        read_floats(reader, &mut kept.squares)?;
        if cut > 0 {
            kept.cut = vec![[0.0; 4]; tile.sums.len()].into();
            read_floats(reader, &mut kept.cut)?;
        }
        kept.cut_samples = cut;
        targets.push(target);
    }
    Ok(targets)
}

fn read_word(reader: &mut impl Read) -> io::Result<u32> {
    let mut bytes = [0; 4];
    reader.read_exact(&mut bytes)?;
    Ok(u32::from_le_bytes(bytes))
}

fn read_floats<const N: usize>(reader: &mut impl Read, values: &mut [[f32; N]]) -> io::Result<()> {
    reader.read_exact(bytemuck::cast_slice_mut(values.as_flattened_mut()))
}

#[cfg(test)]
mod tests {
    use super::super::{Keeps, Progress};
    use super::*;

    fn identity(seed: u32) -> Vec<(String, String)> {
        vec![("seed".to_owned(), seed.to_string())]
    }

    /// An odd film with a cut pass, and one like it that is empty.
    fn films() -> (FilmBuffer, FilmBuffer) {
        let keeps = Keeps { cut: true, squares: true };
        let new = || FilmBuffer::keeping([3, 1, 14, 11], keeps);
        let film = new();
        for i in 0..film.tile_count() {
            let [x0, y0, x1, y1] = film.rectangle(i);
            let sums: Vec<_> =
                (0..(x1 - x0) * (y1 - y0)).map(|k| [k as f32 * 0.1, 1e-30, -2.0, 16.0]).collect();
            assert!(film.add(i, 0, None, &sums) && film.add(i, 1, Some(3), &sums));
        }
        (film, new())
    }

    #[test]
    fn a_film_comes_back_to_the_bit() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("a.weir");
        let (film, back) = films();
        assert_eq!(load(&path, &back, &identity(1)).expect("no error"), None);
        save(&path, &film, &identity(1), &[7, 8, 9, 10]).expect("writable");
        let loaded = load(&path, &back, &identity(1)).expect("whole").expect("there");
        assert_eq!(loaded, Checkpoint { samples: 19 * 110, targets: vec![7, 8, 9, 10] });
        assert_eq!(film.resolve(), back.resolve());
        assert_eq!(back.progress(2), Progress { passes: 1, cut: 3 });
        assert_eq!(
            film.tile(1).kept.as_ref().map(|k| &k.squares),
            back.tile(1).kept.as_ref().map(|k| &k.squares)
        );
        let refused = load(&path, &films().1, &identity(2)).expect_err("another seed").to_string();
        assert!(refused.contains("its seed is 1, not 2"), "{refused}");
    }

    #[test]
    fn whatever_byte_is_wrong_it_is_refused() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("a.weir");
        let (film, _) = films();
        save(&path, &film, &identity(1), &[7, 8, 9, 10]).expect("writable");
        let bytes = std::fs::read(&path).expect("just written");
        let refused = |bytes: &[u8]| {
            std::fs::write(&path, bytes).expect("writable");
            let error = load(&path, &films().1, &identity(1)).expect_err("damaged");
            assert_eq!(error.exit_code(), 2, "{error}");
        };
        for at in (0..bytes.len()).step_by(17) {
            let mut bytes = bytes.clone();
            bytes[at] ^= 0x10;
            refused(&bytes);
        }
        [0, 1, 7, 8, 20, bytes.len() - 1].into_iter().for_each(|length| refused(&bytes[..length]));
        // Whole by its hash, but not by what it holds.
        let sealed = |bytes: &[u8]| {
            let mut hash = Xxh3::new();
            hash.update(bytes);
            [bytes, &hash.digest().to_le_bytes()].concat()
        };
        let body = &bytes[..bytes.len() - 8];
        refused(&sealed(&body[..body.len() - 4]));
        refused(&sealed(&[body, &[0; 4]].concat()));
        refused(&sealed(b"WEIRSAVE\x01\0\0\0\xff\xff\0\0{}"));
        refused(&sealed(b""));
        // Longer than any, and not there: refused before it is read.
        std::fs::File::create(&path).and_then(|file| file.set_len(1 << 40)).expect("a file with a hole");
        let error = load(&path, &films().1, &identity(1)).expect_err("no checkpoint");
        assert!(error.to_string().contains("no checkpoint at all"), "{error}");
    }
}
