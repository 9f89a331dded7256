//! A filter in front of tobj: OBJ text in, text out that tobj parses without error or panic.
//! Joins continued lines, drops what is not geometry, checks numbers and indices, resolves relative
//! indices, triangulates, numbers the materials. Never changes a number's digits.

use super::material::Library;
use super::{find_file, warn};
use crate::error::{Error, Location, Result};
use crate::scene::{Warning, polygon};
use std::borrow::Cow;
use std::io::{BufRead, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Output made at a time.
const BATCH_BYTES: usize = 1 << 16;
/// Keywords of curves and surfaces that OBJ knows and we do not.
const FREE_FORM: &[&str] = &["curv", "curv2", "surf", "cstype", "bzp", "bsp", "cdc", "cdp", "res", "vp"];

/// Lines with continuations joined, with the number of their first line.
struct Lines<'a> {
    rest: &'a [u8],
    line: u32,
}

impl<'a> Iterator for Lines<'a> {
    type Item = (u32, Cow<'a, [u8]>);

    fn next(&mut self) -> Option<Self::Item> {
        if self.rest.is_empty() {
            return None;
        }
        let first = self.line;
        let mut joined: Option<Vec<u8>> = None;
        loop {
            let end = self.rest.iter().position(|&b| b == b'\n');
            let line = &self.rest[..end.unwrap_or(self.rest.len())];
            self.rest = end.map_or(&[], |e| &self.rest[e + 1..]);
            self.line = self.line.saturating_add(1);
            let line = line.strip_suffix(b"\r").unwrap_or(line);
            let comment = line.trim_ascii_start().starts_with(b"#");
            let Some(part) = line.strip_suffix(b"\\").filter(|_| !comment) else {
                return Some((
                    first,
                    match joined {
                        None => Cow::Borrowed(line),
                        Some(mut all) => {
                            all.extend_from_slice(line);
                            Cow::Owned(all)
                        }
                    },
                ));
            };
            let all = joined.get_or_insert_default();
            all.extend_from_slice(part);
            all.push(b' ');
            if self.rest.is_empty() {
                return Some((first, Cow::Owned(std::mem::take(all))));
            }
        }
    }
}

/// Lines of a text file without its byte order mark.
pub(super) fn lines(bytes: &[u8]) -> impl Iterator<Item = (u32, Cow<'_, [u8]>)> {
    Lines { rest: bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes), line: 1 }
}

/// The keyword and the rest of a line.
pub(super) fn split_keyword(line: &[u8]) -> (&[u8], &[u8]) {
    let line = line.trim_ascii();
    let end = line.iter().position(u8::is_ascii_whitespace).unwrap_or(line.len());
    (&line[..end], line[end..].trim_ascii())
}

/// The material libraries that exist, in order; those that do not are warned of.
pub(super) fn find_libraries(path: &Path, bytes: &[u8], warnings: &mut Vec<Warning>) -> Vec<PathBuf> {
    let folder = path.parent().unwrap_or(Path::new(""));
    let mut found: Vec<PathBuf> = Vec::new();
    let mut asked = std::collections::HashSet::new();
    for (_, line) in lines(bytes) {
        let (keyword, rest) = split_keyword(&line);
        if keyword != b"mtllib" || !asked.insert(rest.to_vec()) || asked.len() > 1000 {
            continue;
        }
        let rest = String::from_utf8_lossy(rest);
        for (name, file) in library_files(&rest, folder) {
            match file {
                Some(file) if found.contains(&file) => {}
                Some(file) => found.push(file),
                None => {
                    let name: String = name.escape_debug().take(200).collect();
                    warn(warnings, path, format!("material library `{name}` is missing; grey stands in"));
                }
            }
        }
    }
    found
}

/// `mtllib` takes several names, yet names with spaces are written unquoted: the longest run of
/// words that is a file wins.
fn library_files(rest: &str, folder: &Path) -> Vec<(String, Option<PathBuf>)> {
    // `\ ` is a space inside a name.
    let words: Vec<&str> = rest.split_whitespace().take(64).collect();
    let mut files = Vec::new();
    let mut i = 0;
    while i < words.len() {
        let run = (i + 1..=words.len()).rev().find_map(|end| {
            let name = words[i..end].join(" ");
            let file =
                find_file(&name, &[folder]).or_else(|| find_file(&name.replace("\\ ", " "), &[folder]))?;
            Some((end, name, file))
        });
        match run {
            Some((end, name, file)) => {
                files.push((name, Some(file)));
                i = end;
            }
            None => {
                files.push((words[i].to_string(), None));
                i += 1;
            }
        }
    }
    files
}

/// The filter; tobj reads from it.
pub(super) struct Cleaner<'a> {
    path: &'a Path,
    lines: Box<dyn Iterator<Item = (u32, Cow<'a, [u8]>)> + 'a>,
    library: &'a Library,
    out: Vec<u8>,
    read: usize,
    positions: Vec<[f32; 3]>,
    uvs: usize,
    normals: usize,
    /// Whether the faces of the current run have (uvs, normals).
    run: Option<(bool, bool)>,
    /// The first error; tobj only learns that reading failed.
    pub(super) error: Option<Error>,
    pub(super) warnings: Vec<Warning>,
}

/// A corner of a face, counted from 0.
type Corner = (usize, Option<usize>, Option<usize>);

impl<'a> Cleaner<'a> {
    pub(super) fn new(path: &'a Path, bytes: &'a [u8], library: &'a Library) -> Self {
        let error = match bytes {
            [0xff, 0xfe, ..] | [0xfe, 0xff, ..] => Some("UTF-16 text; save it as UTF-8"),
            _ if bytes.iter().take(1 << 16).any(|&b| b == 0) => Some("binary data, not an OBJ file"),
            _ => None,
        };
        Self {
            path,
            lines: Box::new(lines(bytes)),
            library,
            // tobj asks for the library when it meets this line.
            out: b"mtllib materials\n".to_vec(),
            read: 0,
            positions: Vec::new(),
            uvs: 0,
            normals: 0,
            run: None,
            error: error.map(|e| Error::file(path, e)),
            warnings: Vec::new(),
        }
    }

    /// The materials as tobj is to see them: named by number. The last is for unknown names.
    pub(super) fn material_numbers(&self) -> (Vec<tobj::Material>, std::collections::HashMap<String, usize>) {
        let count = self.library.len() + 1;
        let materials =
            (0..count).map(|i| tobj::Material { name: i.to_string(), ..Default::default() }).collect();
        (materials, (0..count).map(|i| (i.to_string(), i)).collect())
    }

    fn fail(&self, line: u32, text: &[u8], word: &[u8], message: impl Into<String>) -> Error {
        // `word` is a part of `text`: its column follows from where it lies.
        let column = (word.as_ptr() as usize).checked_sub(text.as_ptr() as usize).filter(|&c| c < text.len());
        let column = column.map_or(0, |c| String::from_utf8_lossy(&text[..c]).chars().count() as u32 + 1);
        Error::Input { at: Location { file: Arc::from(self.path), line, column }, message: message.into() }
    }

    fn line(&mut self, number: u32, text: &[u8]) -> Result<()> {
        let (keyword, _) = split_keyword(text);
        match keyword {
            b"v" => {
                let [x, y, z] = self.numbers(number, text, 3, 3)?;
                self.positions.push([x, y, z]);
            }
            b"vt" => {
                self.numbers(number, text, 1, 2)?;
                self.uvs += 1;
            }
            b"vn" => {
                self.numbers(number, text, 3, 3)?;
                self.normals += 1;
            }
            b"f" | b"fo" => self.face(number, text)?,
            b"usemtl" => {
                let (_, rest) = split_keyword(text);
                let name = String::from_utf8_lossy(rest);
                let found = self.library.find(&name);
                if found.is_none() && !name.is_empty() {
                    let name: String = name.escape_debug().take(100).collect();
                    let message = format!("material `{name}` is unknown; grey stands in");
                    warn(&mut self.warnings, self.path, message);
                }
                let k = found.unwrap_or(self.library.len());
                self.out.extend_from_slice(format!("usemtl {k}\n").as_bytes());
            }
            _ if FREE_FORM.iter().any(|k| k.as_bytes() == keyword) => {
                let message = "free-form curves and surfaces are not supported and left out";
                warn(&mut self.warnings, self.path, message);
            }
            // Names, smoothing groups, lines, points and what others have added say nothing here.
            _ => {}
        }
        Ok(())
    }

    /// Checks `least` to `most` numbers and writes them out (missing ones as 0).
    fn numbers(&mut self, number: u32, text: &[u8], least: usize, most: usize) -> Result<[f32; 3]> {
        let mut values = [0.0; 3];
        let mut n = 0;
        let mut words = words(text);
        let keyword = words.next().unwrap_or(b"");
        let start = self.out.len();
        self.out.extend_from_slice(keyword);
        for word in words.take(most) {
            let value = std::str::from_utf8(word).ok().and_then(|w| w.parse::<f32>().ok());
            let Some(value) = value.filter(|v| v.is_finite()) else {
                self.out.truncate(start);
                let shown = String::from_utf8_lossy(word).escape_debug().take(24).collect::<String>();
                return Err(self.fail(
                    number,
                    text,
                    word,
                    format!("`{shown}` where a finite number is needed"),
                ));
            };
            values[n] = value;
            n += 1;
            self.out.push(b' ');
            self.out.extend_from_slice(word);
        }
        if n < least {
            self.out.truncate(start);
            let keyword = String::from_utf8_lossy(keyword).into_owned();
            return Err(self.fail(
                number,
                text,
                text,
                format!("`{keyword}` needs {least} numbers, found {n}"),
            ));
        }
        for _ in n..most {
            self.out.extend_from_slice(b" 0");
        }
        self.out.push(b'\n');
        Ok(values)
    }

    fn face(&mut self, number: u32, text: &[u8]) -> Result<()> {
        let mut corners: Vec<Corner> = Vec::with_capacity(4);
        for word in words(text).skip(1) {
            let corner = self.corner(number, text, word)?;
            if let Some(what) = corner.1 {
                let message = format!("faces name {what} that do not exist; they go without");
                warn(&mut self.warnings, self.path, message);
            }
            corners.push(corner.0);
        }
        if corners.len() < 3 {
            let message = "faces of fewer than three corners are left out";
            warn(&mut self.warnings, self.path, message);
            return Ok(());
        }
        let kind = (corners.iter().all(|c| c.1.is_some()), corners.iter().all(|c| c.2.is_some()));
        if self.run.is_some_and(|run| run != kind) {
            // A new group, so that all vertices of a mesh have the same columns.
            self.out.extend_from_slice(b"g next\n");
        }
        self.run = Some(kind);
        let mut triangles = vec![[0, 1, 2]];
        if corners.len() > 3 {
            let points: Vec<[f32; 3]> = corners.iter().map(|c| self.positions[c.0]).collect();
            triangles.clear();
            polygon::triangulate(&points, &mut triangles);
        }
        for t in triangles {
            let t = t.map(|i| corners[i as usize]);
            if t[0].0 == t[1].0 || t[1].0 == t[2].0 || t[2].0 == t[0].0 {
                continue;
            }
            self.out.push(b'f');
            for (v, vt, vn) in t {
                // Writing to memory cannot fail.
                let _ = match (vt.filter(|_| kind.0), vn.filter(|_| kind.1)) {
                    (Some(vt), Some(vn)) => write!(self.out, " {}/{}/{}", v + 1, vt + 1, vn + 1),
                    (Some(vt), None) => write!(self.out, " {}/{}", v + 1, vt + 1),
                    (None, Some(vn)) => write!(self.out, " {}//{}", v + 1, vn + 1),
                    (None, None) => write!(self.out, " {}", v + 1),
                };
            }
            self.out.push(b'\n');
        }
        Ok(())
    }

    /// The corner, and which of its attributes it names in vain. Only a vertex is indispensable.
    fn corner(&self, number: u32, text: &[u8], word: &[u8]) -> Result<(Corner, Option<&'static str>)> {
        let counts = [self.positions.len(), self.uvs, self.normals];
        let mut found = [None; 3];
        let mut missing = None;
        for (k, part) in word.split(|&b| b == b'/').enumerate() {
            let bad = |message: String| Err(self.fail(number, text, word, message));
            let shown = || String::from_utf8_lossy(word).escape_debug().take(24).collect::<String>();
            if k == 3 {
                return bad(format!("`{}` where v, v/vt, v//vn or v/vt/vn is needed", shown()));
            }
            if part.is_empty() && k > 0 {
                continue;
            }
            let Some(i) = std::str::from_utf8(part).ok().and_then(|p| p.parse::<i64>().ok()) else {
                return bad(format!("`{}` where v, v/vt, v//vn or v/vt/vn is needed", shown()));
            };
            let count = counts[k] as i64;
            let index = if i < 0 { i.checked_add(count).unwrap_or(-1) } else { i - 1 };
            if !(0..count).contains(&index) {
                if k > 0 {
                    missing = Some(["texture coordinates", "normals"][k - 1]);
                    continue;
                }
                return bad(format!("`{}` names vertex {i} of {count} so far, counted from 1", shown()));
            }
            found[k] = Some(index as usize);
        }
        match found {
            [Some(v), vt, vn] => Ok(((v, vt, vn), missing)),
            _ => Err(self.fail(number, text, word, "a corner without a vertex")),
        }
    }
}

/// Words up to a comment.
fn words(text: &[u8]) -> impl Iterator<Item = &[u8]> {
    text.split(|b| b.is_ascii_whitespace()).filter(|w| !w.is_empty()).take_while(|w| w[0] != b'#')
}

impl Read for Cleaner<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        let have = self.fill_buf()?;
        let n = have.len().min(buffer.len());
        buffer[..n].copy_from_slice(&have[..n]);
        self.consume(n);
        Ok(n)
    }
}

impl BufRead for Cleaner<'_> {
    fn fill_buf(&mut self) -> std::io::Result<&[u8]> {
        if self.read == self.out.len() {
            self.out.clear();
            self.read = 0;
            while self.out.len() < BATCH_BYTES && self.error.is_none() {
                let Some((number, text)) = self.lines.next() else { break };
                if let Err(error) = self.line(number, &text) {
                    self.error = Some(error);
                }
            }
        }
        if self.error.is_some() {
            return Err(std::io::Error::other("the OBJ file is damaged"));
        }
        Ok(&self.out[self.read..])
    }

    fn consume(&mut self, n: usize) {
        self.read += n;
    }
}
