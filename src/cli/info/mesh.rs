//! A PLY mesh for `weir info`, and how many faces a PLY file claims.

use flate2::read::MultiGzDecoder;
use std::fmt::Write;
use std::io::Read;
use std::path::Path;
use weir::error::Result;
use weir::open::open_regular;
use weir::scene::ply::read_ply;

/// Longer than headers are.
const MAX_HEADER_BYTES: u64 = 64 << 10;

/// Describes the mesh in `path`.
pub(super) fn describe(path: &Path) -> Result<String> {
    let mesh = read_ply(path)?;
    let mut out = String::new();
    // Writing to a string cannot fail.
    let _ = (|| {
        writeln!(out, "mesh       {}", path.display())?;
        if let Some(header) = Header::read(path) {
            let elements: Vec<String> =
                header.elements.iter().map(|(name, count)| format!("{count} {name}")).collect();
            writeln!(out, "format     {}: {}", header.format, elements.join(", "))?;
        }
        writeln!(out, "vertices   {}", mesh.positions.len())?;
        writeln!(out, "triangles  {}", mesh.indices.len())?;
        let with = [(!mesh.normals.is_empty(), "normals"), (!mesh.uvs.is_empty(), "texture coordinates")];
        let with: Vec<&str> = with.iter().filter(|(has, _)| *has).map(|(_, name)| *name).collect();
        writeln!(
            out,
            "with       {}",
            if with.is_empty() { "positions only".to_owned() } else { with.join(", ") }
        )?;
        let (mut low, mut high) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
        for p in &mesh.positions {
            for i in 0..3 {
                low[i] = low[i].min(p[i]);
                high[i] = high[i].max(p[i]);
            }
        }
        writeln!(out, "bounds     {low:?} to {high:?}")
    })();
    Ok(out)
}

/// Faces that the header of the PLY file `path` claims; `None` when it has no readable header.
pub(super) fn face_count(path: &Path) -> Option<u64> {
    Header::read(path)?.elements.into_iter().find(|(name, _)| name == "face").map(|(_, count)| count)
}

struct Header {
    format: String,
    elements: Vec<(String, u64)>,
}

impl Header {
    /// Only what is to be shown: `read_ply` judges.
    fn read(path: &Path) -> Option<Self> {
        let file = open_regular(path).ok()??;
        let mut bytes = Vec::new();
        let is_gzip = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("gz"));
        if is_gzip {
            MultiGzDecoder::new(file).take(MAX_HEADER_BYTES).read_to_end(&mut bytes).ok()?;
        } else {
            file.take(MAX_HEADER_BYTES).read_to_end(&mut bytes).ok()?;
        }
        let end = bytes.windows(10).position(|w| w == b"end_header")?;
        let text = String::from_utf8_lossy(&bytes[..end]);
        let mut header = Self { format: String::new(), elements: Vec::new() };
        for line in text.lines() {
            let mut words = line.split_ascii_whitespace();
            match (words.next(), words.next(), words.next()) {
                (Some("format"), Some(format), _) => format.clone_into(&mut header.format),
                (Some("element"), Some(name), Some(count)) => {
                    header.elements.push((name.to_owned(), count.parse().ok()?));
                }
                _ => {}
            }
        }
        Some(header)
    }
}
