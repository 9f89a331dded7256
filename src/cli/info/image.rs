//! An image for `weir info`: size, channels, what its values are like, and an EXR's attributes.

use exr::meta::MetaData;
use exr::meta::attribute::{AttributeValue, Text};
use std::collections::HashMap;
use std::fmt::Write;
use std::panic::catch_unwind;
use std::path::Path;
use weir::color::luminance;
use weir::error::Result;
use weir::math::Vec3;
use weir::scene::Encoding;
use weir::texture::{ImageData, Pixels, read_image};

/// Longer texts are cut: some programs store whole scenes in an attribute.
const MAX_TEXT: usize = 200;

/// Describes the image in `path`.
pub(super) fn describe(path: &Path) -> Result<String> {
    // Reads the pixels first: a header alone does not show that a file is whole.
    let image = read_image(path)?;
    let mut out = String::new();
    // Writing to a string cannot fail.
    let _ = write_image(path, &image, &mut out);
    if path.extension().is_some_and(|e| e.eq_ignore_ascii_case("exr")) {
        let _ = write_header(path, &mut out);
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
        let layout = if header.blocks.has_tiles() { "tiles" } else { "scan lines" };
        writeln!(out, "stored      {} in {layout}, {}", names.join(" "), header.compression)?;
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
    let text = String::from_utf8_lossy(text.as_slice());
    let shown = text.chars().take(MAX_TEXT).map(|c| if c.is_control() { ' ' } else { c });
    let cut = if text.chars().nth(MAX_TEXT).is_some() { "..." } else { "" };
    shown.collect::<String>() + cut
}
