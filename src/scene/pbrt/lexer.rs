//! Tokens of the scene language out of bytes: words, quoted strings, brackets, comments. Keeps a
//! position that only moves forward, so that line and column cost one pass over the file in all.
//! Never copies a token; a string with escapes is decoded by [`Lexer::text`].

use super::number::{parse_f64, parse_i64};
use super::source::Source;
use crate::error::{Error, Location, Result};
use std::borrow::Cow;
use std::cell::Cell;

/// What a token is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    /// A directive, a number, `true`, `false`.
    Word,
    /// A quoted string; `bytes` is what stands between the quotes, escapes and all.
    Quoted,
    /// `[`
    Open,
    /// `]`
    Close,
}

/// A token and where it starts.
#[derive(Clone, Copy, Debug)]
pub(super) struct Token<'a> {
    pub(super) kind: Kind,
    pub(super) bytes: &'a [u8],
    pub(super) start: usize,
}

/// Where the last location was computed: the next one counts on from here.
#[derive(Clone, Copy)]
struct Mark {
    offset: usize,
    line: u32,
    column: u32,
}

const FIRST: Mark = Mark { offset: 0, line: 1, column: 1 };

/// Reads one file's text from front to back.
pub(super) struct Lexer<'a> {
    source: &'a Source,
    data: &'a [u8],
    pos: usize,
    mark: Cell<Mark>,
}

impl<'a> Lexer<'a> {
    pub(super) fn new(source: &'a Source) -> Self {
        Self { source, data: &source.data, pos: 0, mark: Cell::new(FIRST) }
    }

    /// Line and column of a byte offset.
    pub(super) fn location(&self, offset: usize) -> Location {
        let mut mark = self.mark.get();
        if offset < mark.offset {
            mark = FIRST;
        }
        let passed = &self.data[mark.offset..offset.min(self.data.len())];
        match passed.iter().rposition(|&b| b == b'\n') {
            Some(last) => {
                let lines = passed.iter().filter(|&&b| b == b'\n').count();
                mark.line = mark.line.saturating_add(u32::try_from(lines).unwrap_or(u32::MAX));
                mark.column = 1u32.saturating_add(characters(&passed[last + 1..]));
            }
            None => mark.column = mark.column.saturating_add(characters(passed)),
        }
        mark.offset = offset;
        self.mark.set(mark);
        Location { file: self.source.path.clone(), line: mark.line, column: mark.column }
    }

    /// An error at a byte offset.
    pub(super) fn error(&self, offset: usize, message: impl Into<String>) -> Error {
        Error::at(&self.location(offset), message)
    }

    /// Skips white space and comments.
    #[inline]
    fn skip_blank(&mut self) {
        while let Some(&b) = self.data.get(self.pos) {
            match b {
                b' ' | b'\n' | b'\t' | b'\r' => self.pos += 1,
                b'#' => {
                    let rest = &self.data[self.pos..];
                    self.pos += rest.iter().position(|&b| b == b'\n' || b == b'\r').unwrap_or(rest.len());
                }
                _ => return,
            }
        }
    }

    /// The first byte of the next token.
    #[inline]
    pub(super) fn peek(&mut self) -> Option<u8> {
        self.skip_blank();
        self.data.get(self.pos).copied()
    }

    /// Where the lexer stands.
    pub(super) fn position(&self) -> usize {
        self.pos
    }

    /// Where the next token starts (or the file ends).
    pub(super) fn next_start(&mut self) -> usize {
        self.skip_blank();
        self.pos
    }

    /// The next token; `None` at the end of the file.
    pub(super) fn next(&mut self) -> Result<Option<Token<'a>>> {
        let Some(first) = self.peek() else { return Ok(None) };
        let start = self.pos;
        let (kind, bytes) = match first {
            b'[' | b']' => {
                self.pos += 1;
                let kind = if first == b'[' { Kind::Open } else { Kind::Close };
                (kind, &self.data[start..self.pos])
            }
            b'"' => (Kind::Quoted, self.quoted(start)?),
            _ => {
                let rest = &self.data[start..];
                self.pos += rest.iter().position(|&b| ends_word(b)).unwrap_or(rest.len());
                (Kind::Word, &self.data[start..self.pos])
            }
        };
        Ok(Some(Token { kind, bytes, start }))
    }

    fn quoted(&mut self, start: usize) -> Result<&'a [u8]> {
        let mut pos = start + 1;
        loop {
            match self.data.get(pos) {
                Some(b'"') => break,
                Some(b'\\') => pos += 2,
                Some(b'\n') | None => {
                    return Err(self.error(start, "the string has no end on its line; close it with \""));
                }
                Some(_) => pos += 1,
            }
        }
        self.pos = pos + 1;
        Ok(&self.data[start + 1..pos])
    }

    /// The next token, or an error that says what was wanted.
    pub(super) fn require(&mut self, wanted: &str) -> Result<Token<'a>> {
        match self.next()? {
            Some(token) => Ok(token),
            None => Err(self.error(self.data.len(), format!("the file ends here; {wanted} is missing"))),
        }
    }

    /// The next token as a quoted string's text.
    pub(super) fn require_string(&mut self, wanted: &str) -> Result<Cow<'a, str>> {
        let token = self.require(wanted)?;
        if token.kind != Kind::Quoted {
            return Err(self.error(
                token.start,
                format!("found {} where {wanted} should be; put it in double quotes", shown(token.bytes)),
            ));
        }
        self.text(&token)
    }

    /// The text of a quoted token, escapes decoded.
    pub(super) fn text(&self, token: &Token<'a>) -> Result<Cow<'a, str>> {
        if !token.bytes.contains(&b'\\') {
            return Ok(String::from_utf8_lossy(token.bytes));
        }
        let mut out = Vec::with_capacity(token.bytes.len());
        let mut bytes = token.bytes.iter().enumerate();
        while let Some((i, &b)) = bytes.next() {
            if b != b'\\' {
                out.push(b);
                continue;
            }
            out.push(match bytes.next().map(|(_, &e)| e) {
                Some(b'b') => 8,
                Some(b'f') => 12,
                Some(b'n') => b'\n',
                Some(b'r') => b'\r',
                Some(b't') => b'\t',
                Some(e @ (b'\\' | b'\'' | b'"')) => e,
                _ => {
                    return Err(self.error(
                        token.start + 1 + i,
                        r#"unknown escape in a string; escapes are \b \f \n \r \t \\ \' \""#,
                    ));
                }
            });
        }
        Ok(Cow::Owned(String::from_utf8_lossy(&out).into_owned()))
    }

    /// A finite number at the next token; `wanted` names it in the error.
    #[inline]
    pub(super) fn number(&mut self, wanted: &str) -> Result<f64> {
        self.skip_blank();
        if let Some((value, end)) = parse_f64(self.data, self.pos)
            && self.data.get(end).is_none_or(|&b| ends_word(b))
        {
            // f32 is what the scene keeps; beyond it, a number is a slip of the pen.
            if (value as f32).is_finite() {
                self.pos = end;
                return Ok(value);
            }
            return Err(self.error(self.pos, "the number is out of range; the largest is 3.4e38"));
        }
        Err(self.not_a(wanted))
    }

    /// A 32-bit integer at the next token.
    #[inline]
    pub(super) fn integer(&mut self) -> Result<i32> {
        self.skip_blank();
        if let Some((value, end)) = parse_i64(self.data, self.pos)
            && self.data.get(end).is_none_or(|&b| ends_word(b))
        {
            return match i32::try_from(value) {
                Ok(v) => {
                    self.pos = end;
                    Ok(v)
                }
                Err(_) => Err(self.error(self.pos, "the integer is out of range; 32 bits hold it at most")),
            };
        }
        Err(self.not_a("an integer"))
    }

    fn not_a(&self, wanted: &str) -> Error {
        let rest = &self.data[self.pos..];
        let end = match rest.first() {
            Some(b'"') => {
                rest.iter().skip(1).position(|&b| b == b'"' || b == b'\n').map_or(rest.len(), |p| p + 2)
            }
            Some(b'[' | b']') => 1,
            _ => rest.iter().position(|&b| ends_word(b)).unwrap_or(rest.len()),
        };
        let found = &rest[..end.min(rest.len())];
        if found.is_empty() {
            return self.error(self.pos, format!("the file ends where {wanted} should be"));
        }
        self.error(self.pos, format!("found {} where {wanted} should be", shown(found)))
    }

    /// Consumes `byte` if it is next.
    pub(super) fn eat(&mut self, byte: u8) -> bool {
        let found = self.peek() == Some(byte);
        self.pos += usize::from(found);
        found
    }
}

/// A word ends at white space, a quote or a bracket (pbrt's rule: a `#` inside belongs to it).
#[inline(always)]
fn ends_word(b: u8) -> bool {
    matches!(b, b' ' | b'\n' | b'\t' | b'\r' | b'"' | b'[' | b']')
}

/// Bytes as a message shows them: short, printable.
pub(super) fn shown(bytes: &[u8]) -> String {
    let text = String::from_utf8_lossy(&bytes[..bytes.len().min(48)]);
    let clean: String = text.chars().map(|c| if c.is_control() { '\u{fffd}' } else { c }).collect();
    if bytes.len() > 48 { format!("{clean}...") } else { clean }
}

fn characters(bytes: &[u8]) -> u32 {
    let n = bytes.iter().filter(|&&b| b & 0xc0 != 0x80).count();
    u32::try_from(n).unwrap_or(u32::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    fn source(text: &str) -> Source {
        Source::new(Path::new("t.pbrt"), text.as_bytes().to_vec()).expect("no byte order mark")
    }

    #[test]
    fn tokens_and_places() {
        let s = source("Shape \"a b\"[1 -2.5]#x ] \"\n  é \"q\\\"\\n\" true");
        let mut lx = Lexer::new(&s);
        let mut seen = Vec::new();
        while let Some(t) = lx.next().expect("well formed") {
            let at = lx.location(t.start);
            seen.push((t.kind, String::from_utf8_lossy(t.bytes).into_owned(), at.line, at.column));
        }
        let want = [
            (Kind::Word, "Shape", 1, 1),
            (Kind::Quoted, "a b", 1, 7),
            (Kind::Open, "[", 1, 12),
            (Kind::Word, "1", 1, 13),
            (Kind::Word, "-2.5", 1, 15),
            (Kind::Close, "]", 1, 19),
            (Kind::Word, "é", 2, 3),
            (Kind::Quoted, "q\\\"\\n", 2, 5),
            (Kind::Word, "true", 2, 13),
        ];
        let want: Vec<_> = want.iter().map(|&(k, t, l, c)| (k, t.to_owned(), l, c)).collect();
        assert_eq!(seen, want);
    }

    #[test]
    fn escapes_decode_and_bad_ones_are_named() {
        let s = source(r#""a\tb\"c" "\q""#);
        let mut lx = Lexer::new(&s);
        assert_eq!(lx.require_string("x").expect("escapes"), "a\tb\"c");
        let e = lx.require_string("x").expect_err("\\q");
        assert!(e.to_string().starts_with("t.pbrt:1:12: unknown escape"), "{e}");
    }

    #[test]
    fn errors_have_places() {
        let cases = [
            ("\"abc\n\"", "t.pbrt:1:1: the string has no end"),
            ("  \"abc\\", "t.pbrt:1:3: the string has no end"),
        ];
        for (text, start) in cases {
            let s = source(text);
            let e = Lexer::new(&s).next().expect_err(text);
            assert!(e.to_string().starts_with(start), "{e}");
        }
        let s = source("1 2x 1e39 99999999999 1.5");
        let mut lx = Lexer::new(&s);
        assert_eq!(lx.number("a number").expect("1"), 1.0);
        let e = lx.number("a number").expect_err("2x").to_string();
        assert_eq!(e, "t.pbrt:1:3: found 2x where a number should be");
        lx.next().expect("skips the bad word");
        assert!(
            lx.number("a number")
                .expect_err("range")
                .to_string()
                .contains(":1:6: the number is out of range")
        );
        lx.next().expect("skips the bad word");
        assert!(lx.integer().expect_err("range").to_string().contains(":1:11: the integer is out of range"));
        lx.next().expect("skips the bad word");
        assert!(lx.integer().expect_err("1.5").to_string().contains("found 1.5 where an integer should be"));
    }

    #[test]
    fn a_place_before_the_mark_is_counted_again() {
        let s = source("a\nbb\nccc");
        let lx = Lexer::new(&s);
        assert_eq!((lx.location(6).line, lx.location(6).column), (3, 2));
        assert_eq!((lx.location(3).line, lx.location(3).column), (2, 2));
    }
}
