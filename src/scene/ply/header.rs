//! The header of a PLY file: which elements, with which properties, in which format.

use super::stream::Stream;
use crate::error::Result;

/// More than any exporter writes; a longer header is damage.
const MAX_LINES: u32 = 4096;
const MAX_PROPERTIES: usize = 256;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Format {
    Ascii,
    Little,
    Big,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Scalar {
    fn parse(word: &str) -> Option<Self> {
        Some(match word {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }

    pub(super) fn bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    fn is_float(self) -> bool {
        matches!(self, Self::F32 | Self::F64)
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Type {
    Scalar(Scalar),
    List { count: Scalar, item: Scalar },
}

#[derive(Clone, Debug)]
pub(super) struct Property {
    pub(super) name: String,
    pub(super) kind: Type,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Vertex,
    Face,
    Other,
}

#[derive(Clone, Debug)]
pub(super) struct Element {
    pub(super) name: String,
    pub(super) kind: Kind,
    pub(super) count: u64,
    pub(super) properties: Vec<Property>,
    /// Where it is declared.
    pub(super) line: u32,
}

#[derive(Clone, Debug)]
pub(super) struct Header {
    pub(super) format: Format,
    pub(super) elements: Vec<Element>,
}

impl Header {
    /// Bytes that a record takes at the very least (lists empty).
    pub(super) fn least_record_bytes(&self, e: &Element) -> usize {
        e.properties
            .iter()
            .map(|p| match (self.format, p.kind) {
                // A digit and a blank; the last number of a file may do without the blank, and
                // taking one byte keeps the bound true for it.
                (Format::Ascii, _) => 1,
                (_, Type::Scalar(s)) => s.bytes(),
                (_, Type::List { count, .. }) => count.bytes(),
            })
            .sum::<usize>()
            .max(1)
    }
}

impl Element {
    /// Bytes of a binary record when it has no list.
    pub(super) fn fixed_bytes(&self) -> Option<usize> {
        self.properties
            .iter()
            .map(|p| match p.kind {
                Type::Scalar(s) => Some(s.bytes()),
                Type::List { .. } => None,
            })
            .sum()
    }

    pub(super) fn find(&self, names: &[&str]) -> Option<usize> {
        self.properties.iter().position(|p| names.contains(&p.name.as_str()))
    }
}

/// Reads up to and including `end_header`.
pub(super) fn read(stream: &mut Stream) -> Result<Header> {
    let ending: &[u8] = match stream.fill(5)? {
        [] => return Err(stream.error("the file is empty; a PLY file begins with `ply`")),
        [b'p', b'l', b'y', b'\r', b'\n', ..] => b"\r\n",
        [b'p', b'l', b'y', b'\r', ..] => b"\r",
        [b'p', b'l', b'y', ..] => b"\n",
        _ => return Err(stream.error("not a PLY file: its first line is not `ply`")),
    };
    if stream.header_line(ending)?.trim() != "ply" {
        return Err(stream.error_at_line(1, "not a PLY file: its first line is not `ply`"));
    }
    let mut format = None;
    let mut elements: Vec<Element> = Vec::new();
    let mut line = 1;
    loop {
        let text = stream.header_line(ending)?;
        line += 1;
        let error = |message: String| Err(stream.error_at_line(line, message));
        if line > MAX_LINES {
            return error(format!("the header has more than {MAX_LINES} lines"));
        }
        let words: Vec<&str> = text.split_ascii_whitespace().collect();
        match words[..] {
            // The last is a line of Blender 2.4's exporter, which forgot the word `comment`.
            [] | ["comment" | "obj_info", ..] | ["Created", "by", ..] => {}
            ["format", kind, version] => {
                format = match kind {
                    "ascii" => Some(Format::Ascii),
                    "binary_little_endian" => Some(Format::Little),
                    "binary_big_endian" => Some(Format::Big),
                    _ => {
                        return error(
                            "unknown format; ascii, binary_little_endian or binary_big_endian is needed"
                                .into(),
                        );
                    }
                };
                if version != "1.0" {
                    return error("PLY has only version 1.0".into());
                }
            }
            ["element", name, count] => {
                let Ok(count) = count.parse::<u64>() else {
                    return error(format!("element {name}: `{count}` is not a count"));
                };
                let kind = match name {
                    "vertex" => Kind::Vertex,
                    "face" => Kind::Face,
                    _ => Kind::Other,
                };
                if kind == Kind::Vertex && count > u64::from(u32::MAX) {
                    return error(format!("{count} vertices; at most {} fit", u32::MAX));
                }
                elements.push(Element { name: name.into(), kind, count, properties: Vec::new(), line });
            }
            ["property", ref rest @ ..] => {
                let Some(element) = elements.last_mut() else {
                    return error("a property before any element".into());
                };
                let (kind, name) = match *rest {
                    ["list", count, item, name] => (
                        Scalar::parse(count)
                            .filter(|c| !c.is_float())
                            .zip(Scalar::parse(item))
                            .map(|(count, item)| Type::List { count, item }),
                        name,
                    ),
                    [kind, name] => (Scalar::parse(kind).map(Type::Scalar), name),
                    _ => {
                        return error(
                            "a property is `property TYPE NAME` or `property list TYPE TYPE NAME`".into(),
                        );
                    }
                };
                let Some(kind) = kind else {
                    return error(format!(
                        "property {name}: unknown type; char, uchar, short, ushort, int, uint, float or \
                         double is needed (an integer for a list's count)"
                    ));
                };
                if element.properties.len() == MAX_PROPERTIES {
                    return error(format!("more than {MAX_PROPERTIES} properties in one element"));
                }
                element.properties.push(Property { name: name.into(), kind });
            }
            ["end_header"] => break,
            _ => {
                let word: String = words[0].chars().take(24).collect();
                return error(format!(
                    "`{}` where format, element, property, comment or end_header is expected",
                    word.escape_debug()
                ));
            }
        }
    }
    let Some(format) = format else {
        return Err(stream.error_at_line(line, "the header has no `format` line"));
    };
    stream.text = format == Format::Ascii;
    Ok(Header { format, elements })
}
