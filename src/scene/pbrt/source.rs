//! Scene text from disk: plain or gzip, whole in memory while it is read. Bounded: a file that
//! is no regular file, or that unpacks to more than [`MAX_TEXT_BYTES`] or beyond
//! [`MAX_GZIP_RATIO`], is an error. Never follows an `Include`: the reader does.

use crate::error::{Error, Location, Result};
use crate::open::open_regular;
use std::io::Read;
use std::path::Path;
use std::sync::Arc;

/// Scene text of one file, unpacked.
pub(super) const MAX_TEXT_BYTES: u64 = 16 << 30;
/// Scene text over packed bytes; text of one repeated line reaches some 200, a bomb 1000.
pub(super) const MAX_GZIP_RATIO: u64 = 400;
/// A packed file may unpack to this much whatever its ratio.
const FREE_GZIP_BYTES: u64 = 16 << 20;

/// The text of one file.
pub(super) struct Source {
    /// As the user would find it.
    pub(super) path: Arc<Path>,
    /// UTF-8 in principle; bytes beyond ASCII matter only inside strings.
    pub(super) data: Vec<u8>,
}

impl Source {
    /// Reads `path`; `asked` is where the file was asked for, for the error (the file itself when
    /// it is the scene).
    pub(super) fn read(path: &Path, asked: Option<&Location>) -> Result<Self> {
        let whole = Location::whole(path);
        let fail = |what: String| Error::at(asked.unwrap_or(&whole), what);
        let shown = path.display();
        let io = |e: std::io::Error| match asked {
            Some(at) => Error::at(at, format!("cannot read \"{shown}\" ({e}); name a readable file")),
            None => Error::io(path, e),
        };
        let Some(file) = open_regular(path).map_err(io)? else {
            return Err(fail(format!("\"{shown}\" is no regular file; name a scene file")));
        };
        if file.metadata().map_err(io)?.len() > MAX_TEXT_BYTES {
            return Err(fail(format!("\"{shown}\" is larger than {} GiB; split it", MAX_TEXT_BYTES >> 30)));
        }
        let mut data = Vec::new();
        // The file may grow while it is read: the bound holds for what comes, not for what was said.
        file.take(MAX_TEXT_BYTES + 1).read_to_end(&mut data).map_err(io)?;
        if data.starts_with(&[0x1f, 0x8b]) {
            data = unpack(&data).map_err(|why| fail(format!("\"{shown}\": {why}")))?;
        }
        Self::new(path, data)
    }

    /// From bytes; refuses UTF-16, skips a UTF-8 byte order mark.
    pub(super) fn new(path: &Path, mut data: Vec<u8>) -> Result<Self> {
        if data.starts_with(&[0xfe, 0xff]) || data.starts_with(&[0xff, 0xfe]) {
            return Err(Error::file(path, "the file is UTF-16; save it as UTF-8"));
        }
        if data.starts_with(&[0xef, 0xbb, 0xbf]) {
            data.drain(..3);
        }
        Ok(Self { path: Arc::from(path), data })
    }
}

fn unpack(packed: &[u8]) -> std::result::Result<Vec<u8>, String> {
    let bound = FREE_GZIP_BYTES.max(packed.len() as u64 * MAX_GZIP_RATIO).min(MAX_TEXT_BYTES);
    let mut text = Vec::new();
    flate2::read::MultiGzDecoder::new(packed)
        .take(bound + 1)
        .read_to_end(&mut text)
        .map_err(|e| format!("damaged gzip data ({e}); pack the file again"))?;
    if text.len() as u64 > bound {
        return Err(format!("unpacks to more than {bound} bytes; unpack it with gunzip if that is meant"));
    }
    Ok(text)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;

    fn pack(text: &[u8]) -> Vec<u8> {
        let mut e = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::best());
        e.write_all(text).expect("a Vec takes every byte");
        e.finish().expect("a Vec takes every byte")
    }

    #[test]
    fn gzip_comes_back_and_a_bomb_does_not() {
        assert_eq!(unpack(&pack(b"WorldBegin")).as_deref(), Ok(&b"WorldBegin"[..]));
        let small = vec![b' '; FREE_GZIP_BYTES as usize];
        assert_eq!(unpack(&pack(&small)).map(|t| t.len()), Ok(small.len()));
        let bomb = pack(&vec![b' '; 8 * FREE_GZIP_BYTES as usize]);
        assert!(unpack(&bomb).expect_err("a ratio near 1000").contains("unpacks to more than"));
        let mut damaged = pack(b"WorldBegin WorldBegin");
        damaged.truncate(14);
        assert!(unpack(&damaged).expect_err("cut").contains("damaged gzip"));
    }

    #[test]
    fn byte_order_marks() {
        let path = Path::new("x.pbrt");
        assert_eq!(Source::new(path, b"\xef\xbb\xbfA".to_vec()).expect("UTF-8").data, b"A");
        assert!(Source::new(path, b"\xff\xfeA\0".to_vec()).is_err());
    }

    #[test]
    fn a_directory_is_no_scene() {
        assert!(Source::read(Path::new("/"), None).is_err());
    }
}
