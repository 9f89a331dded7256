//! Text from a scene, a file name or a command line on its way into a page.
//!
//! Invariant: what comes out is text in an element and in a quoted attribute alike, whatever went in.

use std::fmt::Write;

/// `text` with markup's own characters named, and characters that HTML forbids replaced.
pub(super) fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            '\n' | '\t' => out.push(c),
            // Would turn the direction of what follows: a name could look like another.
            '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}' => {
                let _ = write!(out, "[U+{:04X}]", u32::from(c));
            }
            c if c.is_control() => out.push('\u{fffd}'),
            c => out.push(c),
        }
    }
    out
}

/// At most `most` characters, the middle left out: ends of paths differ, and so do their beginnings.
pub(super) fn shorten(text: &str, most: usize) -> String {
    let count = text.chars().count();
    if count <= most {
        return text.to_owned();
    }
    let kept = most.saturating_sub(1);
    let front = kept / 3;
    let first: String = text.chars().take(front).collect();
    let last: String = text.chars().skip(count - (kept - front)).collect();
    format!("{first}…{last}")
}

/// An argument as a POSIX shell takes it back.
pub(super) fn shell_quoted(argument: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_./,:=+%@".contains(c);
    if !argument.is_empty() && argument.chars().all(plain) {
        return argument.to_owned();
    }
    format!("'{}'", argument.replace('\'', r"'\''"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn markup_becomes_text() {
        assert_eq!(
            escape(r#"</script><img src=x onerror="alert('&')">"#),
            "&lt;/script&gt;&lt;img src=x onerror=&quot;alert(&#39;&amp;&#39;)&quot;&gt;"
        );
        assert_eq!(escape("a\0b\u{1b}[0m\u{7f}"), "a\u{fffd}b\u{fffd}[0m\u{fffd}");
        assert_eq!(escape("gnp.\u{202e}exe"), "gnp.[U+202E]exe");
        assert_eq!(escape("Küche/日本.pbrt"), "Küche/日本.pbrt");
    }

    #[test]
    fn long_names_lose_their_middle() {
        assert_eq!(shorten("a.tx", 10), "a.tx");
        assert_eq!(shorten("0123456789", 10), "0123456789");
        assert_eq!(shorten("0123456789ä", 10), "012…56789ä");
        assert_eq!(shorten("ab", 0), "…");
    }

    #[test]
    fn a_shell_takes_arguments_back() {
        assert_eq!(shell_quoted("a/b-c_1.pbrt"), "a/b-c_1.pbrt");
        assert_eq!(shell_quoted(""), "''");
        assert_eq!(shell_quoted("it's $HOME"), r"'it'\''s $HOME'");
        assert_eq!(shell_quoted("日本"), "'日本'");
    }
}
