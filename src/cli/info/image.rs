//! An image for `weir info`: size, channels, what its values are like, how it is stored, and what an
//! EXR's attributes or a TIFF's text say.

use exr::math::RoundingMode;
use exr::meta::attribute::{AttributeValue, LevelMode, Text, TileDescription};
use exr::meta::{BlockDescription, MetaData};
use std::collections::HashMap;
use std::fmt::Write;
use std::panic::catch_unwind;
use std::path::Path;
use tiff::tags::Tag;
use weir::color::luminance;
use weir::error::Result;
use weir::math::Vec3;
use weir::open::open_regular;
use weir::scene::Encoding;
use weir::texture::{ImageData, Pixels, read_image};

/// Longer texts are cut: some programs store whole scenes in an attribute.
const MAX_TEXT: usize = 200;
/// Pixar's tag for what is outside of 0..1.
const PIXAR_WRAP_MODES: Tag = Tag::Unknown(33303);

/// Describes the image in `path`.
pub(super) fn describe(path: &Path) -> Result<String> {
    // Reads the pixels first: a header alone does not show that a file is whole.
    let image = read_image(path)?;
    let mut out = String::new();
    // Writing to a string cannot fail.
    let _ = write_image(path, &image, &mut out);
    if path.extension().is_some_and(|e| e.eq_ignore_ascii_case("exr")) {
        let _ = write_header(path, &mut out);
    } else if let Some(directories) = tiff_directories(path) {
        let _ = write_tiff(&directories, &mut out);
    }
    Ok(out)
}

fn write_image(path: &Path, image: &ImageData, out: &mut String) -> std::fmt::Result {
    let channels = match image.channels {
        1 => "grey",
        2 => "grey and alpha",
        3 => "RGB",
        _ => "RGB and alpha",
    };
    let numbers = match image.pixels {
        Pixels::U8(_) => "8-bit, taken as sRGB",
        Pixels::U16(_) => "16-bit, taken as sRGB",
        Pixels::F16(_) => "half float, linear",
        Pixels::F32(_) => "float, linear",
    };
    writeln!(out, "image       {}", path.display())?;
    writeln!(out, "size        {} x {} pixels", image.width, image.height)?;
    writeln!(out, "channels    {channels}, {numbers}")?;
    let (mut sum, mut finite, mut least, mut most) = (0.0f64, 0u64, f32::INFINITY, f32::NEG_INFINITY);
    let pixels = image.linear_rgb(Encoding::Srgb);
    for pixel in &pixels {
        let l = luminance(Vec3::from(*pixel));
        if pixel.iter().all(|c| c.is_finite()) {
            sum += f64::from(l);
            finite += 1;
            least = least.min(l);
            most = most.max(l);
        }
    }
    if finite > 0 {
        writeln!(out, "luminance   mean {:.6}, from {least:.6} to {most:.6}", sum / finite as f64)?;
    }
    writeln!(out, "not finite  {} pixels", pixels.len() as u64 - finite)
}

/// What a TIFF's directories say: size, tile size if it has tiles, compression, predictor, text, wrap modes.
struct TiffDirectory {
    size: (u32, u32),
    tile: Option<(u32, u32)>,
    compression: u16,
    text: String,
    wrap: String,
}

/// More levels than any image has.
const MAX_DIRECTORIES: usize = 64;

/// `None` for what is no TIFF, or damaged beyond its first image.
fn tiff_directories(path: &Path) -> Option<Vec<TiffDirectory>> {
    let file = std::io::BufReader::new(open_regular(path).ok()??);
    let read = move || {
        let mut decoder = tiff::decoder::Decoder::new(file).ok()?;
        let mut list = Vec::new();
        loop {
            let text = |decoder: &mut tiff::decoder::Decoder<_>, tag| {
                decoder.get_tag_ascii_string(tag).unwrap_or_default()
            };
            list.push(TiffDirectory {
                size: decoder.dimensions().ok()?,
                tile: (decoder.get_chunk_type() == tiff::decoder::ChunkType::Tile)
                    .then(|| decoder.chunk_dimensions()),
                compression: decoder.find_tag_unsigned(Tag::Compression).ok()?.unwrap_or(1),
                text: text(&mut decoder, Tag::ImageDescription),
                wrap: text(&mut decoder, PIXAR_WRAP_MODES),
            });
            if !decoder.more_images() || list.len() == MAX_DIRECTORIES {
                return Some(list);
            }
            decoder.next_image().ok()?;
        }
    };
    catch_unwind(std::panic::AssertUnwindSafe(read)).ok().flatten()
}

fn write_tiff(directories: &[TiffDirectory], out: &mut String) -> std::fmt::Result {
    let Some(first) = directories.first() else { return Ok(()) };
    let layout = match first.tile {
        Some((w, h)) => format!("tiles of {w} x {h}"),
        None => "strips".to_owned(),
    };
    let compression = match first.compression {
        1 => "not compressed".to_owned(),
        5 => "LZW".to_owned(),
        8 | 32946 => "zip".to_owned(),
        other => format!("compression {other}"),
    };
    writeln!(out, "stored      {layout}, {compression}")?;
    // Halves, rounded down, are levels; other images of a file are not.
    let halved = |l: usize, size: (u32, u32)| {
        let half = |n: u32| n.checked_shr(l as u32).unwrap_or(0).max(1);
        size == (half(first.size.0), half(first.size.1))
    };
    if directories.len() > 1 && directories.iter().enumerate().all(|(l, d)| halved(l, d.size)) {
        writeln!(out, "levels      {}", directories.len())?;
    } else if directories.len() > 1 {
        writeln!(out, "images      {}", directories.len())?;
    }
    for (name, text) in [("wrap", &first.wrap), ("says", &first.text)] {
        if !text.is_empty() {
            writeln!(out, "{name:<10}  {}", shown(text))?;
        }
    }
    Ok(())
}

/// Whatever the header says beyond the pixels. They were read, so it is sound; should the library
/// find fault with it all the same, the pixels have been described.
fn write_header(path: &Path, out: &mut String) -> std::fmt::Result {
    let Ok(Ok(meta)) = catch_unwind(|| MetaData::read_from_file(path, false)) else {
        return Ok(());
    };
    for (i, header) in meta.headers.iter().enumerate() {
        if meta.headers.len() > 1 {
            let name = header.own_attributes.layer_name.as_ref().map(Text::to_string).unwrap_or_default();
            writeln!(out, "part {i}      {name}")?;
        }
        let names: Vec<String> = header.channels.list.iter().map(|c| c.name.to_string()).collect();
        let display = header.shared_attributes.display_window;
        let position = header.own_attributes.layer_position;
        let layout = match header.blocks {
            BlockDescription::ScanLines => "scan lines".to_owned(),
            BlockDescription::Tiles(t) => format!("tiles of {} x {}", t.tile_size.0, t.tile_size.1),
        };
        writeln!(out, "stored      {} in {layout}, {}", names.join(" "), header.compression)?;
        if let BlockDescription::Tiles(TileDescription {
            level_mode: LevelMode::MipMap, rounding_mode, ..
        }) = header.blocks
        {
            let side = header.layer_size.0.max(header.layer_size.1).max(1);
            let levels = match rounding_mode {
                RoundingMode::Down => side.ilog2() + 1,
                RoundingMode::Up => side.next_power_of_two().ilog2() + 1,
            };
            writeln!(out, "levels      {levels}")?;
        }
        if let Some(wrap) = &header.own_attributes.wrap_mode_name {
            writeln!(out, "wrap        {}", clean(wrap))?;
        }
        if let Some(comments) = &header.own_attributes.comments {
            writeln!(out, "says        {}", clean(comments))?;
        }
        writeln!(
            out,
            "window      {} x {} at {},{} of {} x {} at {},{}",
            header.layer_size.0,
            header.layer_size.1,
            position.0,
            position.1,
            display.size.0,
            display.size.1,
            display.position.0,
            display.position.1
        )?;
        if let Some(software) = &header.own_attributes.software_name {
            writeln!(out, "software    {}", clean(software))?;
        }
        write_attributes(&header.shared_attributes.other, out)?;
        write_attributes(&header.own_attributes.other, out)?;
    }
    Ok(())
}

fn write_attributes(attributes: &HashMap<Text, AttributeValue>, out: &mut String) -> std::fmt::Result {
    let mut lines: Vec<String> = attributes
        .iter()
        .filter_map(|(name, value)| {
            let value = match value {
                AttributeValue::Text(text) => clean(text),
                AttributeValue::F64(x) => x.to_string(),
                AttributeValue::F32(x) => x.to_string(),
                AttributeValue::I32(x) => x.to_string(),
                _ => return None,
            };
            Some(format!("  {} = {value}", clean(name)))
        })
        .collect();
    lines.sort();
    lines.iter().try_for_each(|line| writeln!(out, "{line}"))
}

/// Text of a file, fit for a terminal: UTF-8, one line, no escape sequences, of bounded length.
fn clean(text: &Text) -> String {
    shown(&String::from_utf8_lossy(text.as_slice()))
}

fn shown(text: &str) -> String {
    let shown = text.chars().take(MAX_TEXT).map(|c| if c.is_control() { ' ' } else { c });
    let cut = if text.chars().nth(MAX_TEXT).is_some() { "..." } else { "" };
    shown.collect::<String>() + cut
}
