//! Bytes of a file through one buffer, with a count of lines and bytes for error messages.
//! Never holds more than the buffer; never seeks.

use crate::error::{Error, Location, Result};
use crate::open::open_regular;
use flate2::bufread::MultiGzDecoder;
use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Fits the second-level cache, so that each column's loop reads from there.
pub(super) const BUFFER_BYTES: usize = 256 << 10;
/// No number is longer; a longer token is not PLY.
const MAX_TOKEN_BYTES: usize = 128;

pub(super) struct Stream {
    path: PathBuf,
    reader: Box<dyn Read>,
    /// Bytes in the whole file; `None` when it is compressed.
    total: Option<u64>,
    buffer: Vec<u8>,
    start: usize,
    end: usize,
    /// Bytes before `buffer[start]`.
    offset: u64,
    /// Line of `buffer[start]`, from 1; counted in headers and ascii only.
    line: u32,
    /// Errors name lines, not byte offsets.
    pub(super) text: bool,
}

impl Stream {
    pub(super) fn open(path: &Path) -> Result<Self> {
        Self::open_with(path, BUFFER_BYTES)
    }

    /// Through a buffer of so many bytes, which holds the longest token at least.
    pub(super) fn open_with(path: &Path, buffer_bytes: usize) -> Result<Self> {
        let io = |e| Error::io(path, e);
        let Some(file) = open_regular(path).map_err(io)? else {
            return Err(Error::file(path, "not a regular file; a PLY file is needed"));
        };
        let bytes = file.metadata().map_err(io)?.len();
        let zipped = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("gz"));
        let reader: Box<dyn Read> =
            if zipped { Box::new(MultiGzDecoder::new(BufReader::new(file))) } else { Box::new(file) };
        Ok(Self {
            path: path.to_path_buf(),
            reader,
            total: (!zipped).then_some(bytes),
            buffer: vec![0; buffer_bytes.max(MAX_TOKEN_BYTES)],
            start: 0,
            end: 0,
            offset: 0,
            line: 1,
            text: true,
        })
    }

    pub(super) fn bytes_left(&self) -> Option<u64> {
        self.total.map(|t| t.saturating_sub(self.offset))
    }

    /// An error here: at this line of text, or at this byte of binary data.
    pub(super) fn error(&self, message: impl AsRef<str>) -> Error {
        if self.text {
            self.error_at_line(self.line, message.as_ref())
        } else {
            Error::file(&self.path, format!("{} (byte {})", message.as_ref(), self.offset))
        }
    }

    pub(super) fn error_at_line(&self, line: u32, message: impl Into<String>) -> Error {
        let at = Location { file: Arc::from(self.path.as_path()), line, column: 0 };
        Error::Input { at, message: message.into() }
    }

    /// Everything buffered, at least `n` bytes of it unless the file ends first.
    pub(super) fn fill(&mut self, n: usize) -> Result<&[u8]> {
        debug_assert!(n <= self.buffer.len());
        if self.end - self.start < n {
            self.buffer.copy_within(self.start..self.end, 0);
            (self.start, self.end) = (0, self.end - self.start);
            while self.end < n {
                match self.reader.read(&mut self.buffer[self.end..]) {
                    Ok(0) => break,
                    Ok(k) => self.end += k,
                    Err(e) if e.kind() == std::io::ErrorKind::Interrupted => {}
                    Err(e)
                        if matches!(
                            e.kind(),
                            std::io::ErrorKind::InvalidInput
                                | std::io::ErrorKind::InvalidData
                                | std::io::ErrorKind::UnexpectedEof
                        ) =>
                    {
                        return Err(Error::file(&self.path, format!("damaged gzip data: {e}")));
                    }
                    Err(e) => return Err(Error::io(&self.path, e)),
                }
            }
        }
        Ok(&self.buffer[self.start..self.end])
    }

    pub(super) fn consume(&mut self, n: usize) {
        debug_assert!(n <= self.end - self.start);
        self.start += n;
        self.offset += n as u64;
    }

    /// Exactly `n` bytes, consumed by the caller's next call of `consume`.
    pub(super) fn need(&mut self, n: usize) -> Result<&[u8]> {
        if self.fill(n)?.len() < n {
            return Err(self.error("the file ends in the middle of its data"));
        }
        Ok(&self.buffer[self.start..self.start + n])
    }

    pub(super) fn skip(&mut self, mut n: u64) -> Result<()> {
        while n > 0 {
            let have = self.fill(1)?.len() as u64;
            if have == 0 {
                return Err(self.error("the file ends in the middle of its data"));
            }
            let step = have.min(n);
            self.consume(step as usize);
            n -= step;
        }
        Ok(())
    }

    /// The line up to `ending`, which is consumed too.
    pub(super) fn header_line(&mut self, ending: &[u8]) -> Result<String> {
        let mut n = 256;
        loop {
            let have = self.fill(n)?;
            if let Some(i) = have.windows(ending.len()).position(|w| w == ending) {
                let line = String::from_utf8_lossy(&have[..i]).into_owned();
                self.consume(i + ending.len());
                self.line += 1;
                return Ok(line);
            }
            if have.len() < n || n == self.buffer.len() {
                return Err(self.error("the header has no `end_header` line"));
            }
            n = (n * 2).min(self.buffer.len());
        }
    }

    /// The next run of bytes without blanks, handed to `f`; counts lines on the way.
    pub(super) fn token<T>(&mut self, f: impl FnOnce(&[u8]) -> Option<T>) -> Result<T> {
        loop {
            let have = self.fill(MAX_TOKEN_BYTES + 1)?;
            if have.is_empty() {
                return Err(self.error("the file ends where a number is expected"));
            }
            let blank = have.iter().take_while(|b| b.is_ascii_whitespace()).count();
            let lines = have[..blank].iter().filter(|&&b| b == b'\n').count();
            self.line = self.line.saturating_add(lines as u32);
            self.consume(blank);
            let have = self.fill(MAX_TOKEN_BYTES + 1)?;
            let len = have.iter().position(u8::is_ascii_whitespace).unwrap_or(have.len());
            if len == 0 {
                continue;
            }
            if len > MAX_TOKEN_BYTES {
                return Err(self.error("a word too long to be a number"));
            }
            let Some(value) = f(&have[..len]) else {
                let word = String::from_utf8_lossy(&have[..len.min(24)]).escape_debug().to_string();
                return Err(self.error(format!("`{word}` where a number is expected")));
            };
            self.consume(len);
            return Ok(value);
        }
    }
}
