//! What a look at a file's header tells of an image before it is loaded.
//!
//! Invariant: the bytes of an image that is decoded as a whole are never fewer than it will take.
//! Never decodes an image, never decides whether it is copied.

use crate::error::{Error, Result};
use crate::prepare::ImageNeeds;
use crate::scene::{Encoding, ImageSource};
use crate::texture::cache::least_budget;
use crate::texture::convert::fingerprint::encoding_name;
use crate::texture::image_io;
use crate::texture::tiled::{FilePool, TiledFile};
use crate::texture::tiles::TiledImage;
use std::sync::Arc;

/// An image that is not loaded yet.
pub(super) enum Found {
    Unused,
    Tiled {
        file: Box<TiledFile>,
        /// Alpha says nothing.
        opaque: bool,
    },
    /// Decoded as a whole, this many bytes; `may_tile` unless something reads it as a whole anyway.
    Plain {
        bytes: u64,
        /// Of one texel, at most.
        texel_bytes: usize,
        may_tile: bool,
        /// How its integers are read: a tiled file says it whichever way it is read.
        encoding: Encoding,
    },
}

impl Found {
    /// Bytes when it is decoded as a whole; 0 for what is not.
    pub(super) fn bytes(&self) -> u64 {
        if let Self::Plain { bytes, .. } = self { *bytes } else { 0 }
    }
}

/// Bytes of images that are decoded as a whole.
pub(super) fn whole_bytes(found: &[Found]) -> u64 {
    found.iter().map(Found::bytes).fold(0, u64::saturating_add)
}

/// An error about an image, at the place of the scene that asked for it; but nobody there is to blame
/// for want of memory, or for an end that a person asked for.
pub(super) fn placed(source: &ImageSource) -> impl Fn(Error) -> Error {
    move |e| match e {
        Error::Resource(_) | Error::Interrupted => e,
        e => Error::at(&source.at, format!("image {e}")),
    }
}

/// Looks at one file; with a line that a person should read, if there is one.
pub(super) fn find(
    source: &ImageSource,
    need: ImageNeeds,
    files: &Arc<FilePool>,
) -> Result<(Found, Option<String>)> {
    if !need.used {
        return Ok((Found::Unused, None));
    }
    let tiled = match TiledFile::open(&source.path, source.encoding, files) {
        // Whoever reads it as a whole says whether that can be done.
        Err(_) if need.whole => None,
        tiled => tiled.map_err(placed(source))?,
    };
    let own = tiled.as_ref().and_then(TiledFile::named);
    let mut note = None;
    let mut encoding = own.unwrap_or(source.encoding);
    if source.named {
        encoding = source.encoding;
        note = own.filter(|own| *own != encoding).map(|own| contradiction(source, own));
    }
    if let Some(mut file) = tiled
        && !need.whole
        && TiledImage::is_complete(&file)
    {
        if source.named {
            file.impose(encoding);
        }
        let opaque = file.is_opaque();
        return Ok((Found::Tiled { file: Box::new(file), opaque }, note));
    }
    let kept = image_io::kept(&source.path).map_err(placed(source))?;
    let bytes = kept.as_ref().map_or(0, |kept| kept.bytes(need.mip_levels));
    let texel_bytes = kept.map_or(0, |kept| kept.texel_bytes() as usize);
    Ok((Found::Plain { bytes, texel_bytes, may_tile: !need.whole, encoding }, note))
}

fn contradiction(source: &ImageSource, own: Encoding) -> String {
    let (asked, own) = (encoding_name(source.encoding), encoding_name(own));
    let ImageSource { path, at, .. } = source;
    format!(
        "{at}: image {}: its levels were made as {own}, and the scene reads it as {asked}; make it again with --encoding {asked}",
        path.display()
    )
}

/// What tiles of `found` need at least, with `threads` that look up at once.
pub(super) fn tile_room(found: &[Found], threads: usize) -> u64 {
    let tile =
        |found: &Found| if let Found::Tiled { file, .. } = found { Some(file.tile_bytes()) } else { None };
    found.iter().filter_map(tile).max().map_or(0, |tile| least_budget(tile, threads))
}

/// `whole` bytes of the budget go to images that cannot be had tile by tile, or are in memory anyway;
/// `room` is what tiles need beside them.
pub(super) fn too_small(budget: u64, threads: usize, whole: u64, room: u64) -> Error {
    let least = whole.saturating_add(room);
    let what = match (whole, room) {
        (_, 0) => format!("images that are needed whole take {least} (--texture-memory {least})"),
        (0, _) => {
            format!("{threads} threads need at least {least} (--texture-memory {least}), two tiles each")
        }
        _ => format!(
            "{threads} threads need at least {least} (--texture-memory {least}), two tiles each beside {whole} bytes of images in memory"
        ),
    };
    Error::Usage(format!("a texture memory of {budget} bytes is too small: {what}"))
}
