//! What a converted file says about where it came from, and a hash of a file's bytes to say it with.
//! XXH3 with 128 bits: two different files share one by chance with probability 2⁻¹²⁸, and only
//! someone who wants to fool their own cache can make them.
//!
//! Invariant: the text is `weir:` keys without blanks in their values, so that it can be split at
//! blanks. Never reads more than a megabyte at a time.

use super::Watch;
use crate::error::{Error, Result};
use crate::scene::Encoding;
use crate::texture::open::open_regular;
use std::io::Read;
use std::path::Path;
use std::time::{Duration, SystemTime};
use xxhash_rust::xxh3::Xxh3;

/// Changes whenever the same source would be written as other texels.
pub const VERSION: u32 = 1;
const CHUNK_BYTES: usize = 1 << 20;

/// Hash of all bytes of `path`, as 32 hexadecimal digits.
///
/// # Errors
/// [`Error::Io`] when it cannot be read; [`Error::Input`] when it is no regular file.
pub fn of_file(path: &Path) -> Result<String> {
    of_file_watched(path, Watch::nobody())
}

/// [`of_file`] that can be given up; counts nothing.
pub(crate) fn of_file_watched(path: &Path, watch: Watch<'_>) -> Result<String> {
    let io = |e| Error::io(path, e);
    let mut file = open_regular(path)?;
    let mut hash = Xxh3::new();
    let mut chunk = vec![0; CHUNK_BYTES];
    loop {
        watch.check()?;
        match file.read(&mut chunk) {
            Ok(0) => return Ok(format!("{:032x}", hash.digest128())),
            Ok(n) => hash.update(&chunk[..n]),
            Err(e) if e.kind() == std::io::ErrorKind::Interrupted => {}
            Err(e) => return Err(io(e)),
        }
    }
}

/// What changes when a file does: enough to notice a change by honest means.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stamp {
    bytes: u64,
    modified: Option<SystemTime>,
    /// Device, inode, and seconds and nanoseconds of the last change of either; 0 elsewhere than Unix.
    node: [i64; 4],
}

impl Stamp {
    /// Of the file `path` now.
    ///
    /// # Errors
    /// [`Error::Io`] when there is none.
    pub fn of(path: &Path) -> Result<Self> {
        let meta = std::fs::metadata(path).map_err(|e| Error::io(path, e))?;
        #[cfg(unix)]
        let node = {
            use std::os::unix::fs::MetadataExt;
            [meta.dev() as i64, meta.ino() as i64, meta.ctime(), meta.ctime_nsec()]
        };
        #[cfg(not(unix))]
        let node = [0; 4];
        Ok(Self { bytes: meta.len(), modified: meta.modified().ok(), node })
    }

    /// Whether the file `path` still has this stamp.
    ///
    /// # Errors
    /// [`Error::Input`] when it has changed, [`Error::Io`] when it is gone.
    pub fn check(&self, path: &Path) -> Result<()> {
        if Self::of(path)? == *self {
            return Ok(());
        }
        Err(Error::file(path, "the file changed while it was read; try again when it is at rest"))
    }

    /// As one word; `None` where the system does not say enough to know the file again.
    pub(crate) fn text(&self) -> Option<String> {
        let [device, inode, seconds, nanoseconds] = self.node;
        let modified = self.modified?.duration_since(SystemTime::UNIX_EPOCH).ok()?.as_nanos();
        (inode != 0).then(|| format!("{}:{modified}:{device}:{inode}:{seconds}:{nanoseconds}", self.bytes))
    }

    /// Whether the last change lies at least `ago` in the past.
    pub(crate) fn settled(&self, ago: Duration) -> bool {
        let [_, _, seconds, _] = self.node;
        let changed = SystemTime::UNIX_EPOCH + Duration::from_secs(seconds.try_into().unwrap_or(0));
        let since = |t: SystemTime| SystemTime::now().duration_since(t).is_ok_and(|d| d > ago);
        since(changed) && self.modified.is_some_and(since)
    }
}

/// `srgb`, `linear` or `gamma:2.2`, as the command line takes them.
#[must_use]
pub fn encoding_name(encoding: Encoding) -> String {
    match encoding {
        Encoding::Srgb => "srgb".to_owned(),
        Encoding::Linear => "linear".to_owned(),
        Encoding::Gamma(g) => format!("gamma:{g}"),
    }
}

/// As a file's text has it: a gamma is its number alone.
pub(crate) fn encoding_text(encoding: Encoding) -> String {
    match encoding {
        Encoding::Gamma(g) => g.to_string(),
        named => encoding_name(named),
    }
}

/// The text for a file whose numbers are to be read as `kept`, made of the source `hash`, whose
/// numbers were read as `read`.
pub(super) fn description(hash: &str, read: Encoding, kept: Encoding) -> String {
    let (read, kept) = (encoding_text(read), encoding_text(kept));
    format!("weir:encoding={kept} weir:source={hash} weir:read={read} weir:version={VERSION}")
}

/// The value of `key` in such a text: `value(text, "weir:encoding")`.
#[must_use]
pub fn value<'a>(text: &'a str, key: &str) -> Option<&'a str> {
    text.split(' ').find_map(|part| part.strip_prefix(key)?.strip_prefix('='))
}

/// Reverses [`encoding_name`].
#[must_use]
pub fn encoding_from_name(name: &str) -> Option<Encoding> {
    match name {
        "srgb" => Some(Encoding::Srgb),
        "linear" => Some(Encoding::Linear),
        _ => {
            let g: f32 = name.strip_prefix("gamma:")?.parse().ok()?;
            (g.is_finite() && g > 0.0).then_some(Encoding::Gamma(g))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_hash_is_the_published_one() {
        let directory = tempfile::tempdir().expect("a temporary directory");
        let path = directory.path().join("empty");
        std::fs::write(&path, b"").expect("write");
        // XXH3_128 of nothing, seed 0 (xxHash's own sanity vectors).
        assert_eq!(of_file(&path).expect("read"), "99aa06d3014798d86001c324468d497f");
        let long: Vec<u8> = (0..3 * CHUNK_BYTES + 17).map(|i| ((i * 31) >> 3) as u8).collect();
        std::fs::write(&path, &long).expect("write");
        let whole = xxhash_rust::xxh3::xxh3_128(&long);
        assert_eq!(of_file(&path).expect("read"), format!("{whole:032x}"));
    }

    #[test]
    fn texts_and_names_come_back() {
        for encoding in [Encoding::Srgb, Encoding::Linear, Encoding::Gamma(2.2), Encoding::Gamma(0.4545)] {
            assert_eq!(encoding_from_name(&encoding_name(encoding)), Some(encoding));
            let text = description("abc", encoding, Encoding::Linear);
            assert_eq!(value(&text, "weir:source"), Some("abc"));
            assert_eq!(value(&text, "weir:encoding"), Some("linear"));
            assert_eq!(value(&text, "weir:read"), Some(&*encoding_text(encoding)));
            assert_eq!(value(&text, "weir:enc"), None);
        }
        for bad in ["", "gamma", "gamma:", "gamma:0", "gamma:inf", "gamma:-1", "sRGB"] {
            assert_eq!(encoding_from_name(bad), None, "{bad}");
        }
    }
}
