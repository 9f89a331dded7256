//! PFM from its last row to its first, which is the image's from the top.

use super::{Decode, Give, Shape, check_sides};
use crate::error::{Error, Result};
use crate::texture::image_io::Pixels;
use crate::texture::open::open_regular;
use crate::texture::pfm::{Header, header};
use crate::texture::rules::Depth;
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::Path;

/// No header is longer.
const HEADER_BYTES: u64 = 1 << 12;

pub(super) fn open(path: &Path, file: BufReader<File>, file_bytes: u64) -> Result<(Shape, Box<dyn Decode>)> {
    let mut start = Vec::new();
    file.take(HEADER_BYTES).read_to_end(&mut start).map_err(|e| Error::io(path, e))?;
    let header = header(path, &start)?;
    let Header { width, height, channels, .. } = header;
    check_sides(path, width, height)?;
    header.check_length(path, file_bytes)?;
    let shape = Shape { width, height, channels: channels as u8, depth: Depth::F32 };
    Ok((shape, Box::new(header)))
}

impl Decode for Header {
    fn decode(&self, path: &Path, shape: &Shape, give: Give<'_>) -> Result<()> {
        let io = |e| Error::io(path, e);
        let mut file = open_regular(path)?;
        let row_bytes = shape.row_numbers() * 4;
        let mut bytes = Vec::new();
        let mut left = shape.height;
        while left > 0 {
            let rows = left.min(shape.band_rows());
            left -= rows;
            file.seek(SeekFrom::Start(self.start as u64 + u64::from(left) * row_bytes as u64)).map_err(io)?;
            bytes.resize(rows as usize * row_bytes, 0);
            file.read_exact(&mut bytes).map_err(io)?;
            let mut pixels = Vec::with_capacity(rows as usize * shape.row_numbers());
            for line in bytes.chunks_exact(row_bytes).rev() {
                pixels.extend(self.numbers(line));
            }
            if !give(Pixels::F32(pixels)) {
                return Ok(());
            }
        }
        Ok(())
    }
}
