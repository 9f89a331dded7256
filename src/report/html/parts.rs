//! What sections are made of: figures, numbers, tables.
//!
//! Invariant: a number that is keyed is the one that stands in the JSON under that pointer, digit by digit.

use crate::report::escape::escape;
use serde::Serialize;
use serde_json::Value;
use std::fmt::Write;

/// Rows of a table of numbers, at most; of more, every n-th.
const ROWS: usize = 4096;

/// `value` as the JSON has it.
pub(in crate::report) fn exact(value: &impl Serialize) -> String {
    serde_json::to_string(value).expect("plain data")
}

/// A number that stands in the JSON under `pointer`, in words for people.
pub(in crate::report) fn number(pointer: &str, value: &impl Serialize, shown: &str) -> String {
    let value = escape(&exact(value));
    let (pointer, shown) = (escape(pointer), escape(shown));
    format!("<data data-key=\"{pointer}\" value=\"{value}\" title=\"{value}\">{shown}</data>")
}

/// A chart with its title and what is to be said of it; `inside` is markup.
pub(in crate::report) fn figure(id: &str, title: &str, said: &str, inside: &str) -> String {
    let said = if said.is_empty() { String::new() } else { format!("<small>{}</small>", escape(said)) };
    format!(
        "<figure class=\"chart\" id=\"{id}\"><figcaption>{}{said}</figcaption>{inside}</figure>\n",
        escape(title)
    )
}

/// The sentence in a chart's place.
pub(in crate::report) fn absent(id: &str, why: &str) -> String {
    format!("<p class=\"absent\" id=\"{id}\">{}</p>\n", escape(why))
}

/// Around an SVG, which may be wider than the screen.
pub(in crate::report) fn drawing(svg: &str) -> String {
    format!("<div class=\"drawing\">{svg}</div>")
}

/// What the colours of stacked parts mean.
pub(in crate::report) fn key(of: &[(&str, &str)]) -> String {
    let items: String = of
        .iter()
        .map(|(colour, text)| {
            let swatch = format!("<svg viewBox=\"0 0 10 10\" aria-hidden=\"true\"><rect class=\"{colour}\" width=\"10\" height=\"10\"/></svg>");
            format!("<li>{swatch}{}</li>", escape(text))
        })
        .collect();
    format!("<ul class=\"key\">{items}</ul>")
}

/// Columns: the name in the JSON and what people call it.
pub(in crate::report) type Columns<'a> = &'a [(&'a str, &'a str)];

/// A table of `list`, which stands in the JSON under `pointer`: each number as it stands there.
pub(in crate::report) fn numbers<T: Serialize>(
    title: &str,
    pointer: &str,
    list: &[T],
    columns: Columns<'_>,
) -> String {
    let every = list.len().div_ceil(ROWS).max(1);
    let rows = list.iter().enumerate().step_by(every).map(|(i, row)| (Some(format!("{pointer}/{i}")), row));
    let left_out = if every > 1 { format!(", one row in {every}") } else { String::new() };
    table(&format!("{title}{left_out}"), rows, columns)
}

/// A table of rows; each with its pointer where it has one.
pub(in crate::report) fn table<T: Serialize>(
    title: &str,
    rows: impl Iterator<Item = (Option<String>, T)>,
    columns: Columns<'_>,
) -> String {
    let mut out =
        format!("<details><summary>{}</summary><div class=\"table\"><table><thead><tr>", escape(title));
    for (field, heading) in columns {
        let _ = write!(out, "<th data-field=\"{field}\">{}</th>", escape(heading));
    }
    out += "</tr></thead><tbody>\n";
    for (pointer, row) in rows {
        let row = serde_json::to_value(row).expect("plain data");
        out += &pointer.map_or("<tr>".to_owned(), |p| format!("<tr data-row=\"{}\">", escape(&p)));
        for (field, _) in columns {
            let text = match row.pointer(&format!("/{field}")) {
                Some(Value::String(text)) => escape(text),
                Some(Value::Null) | None => String::new(),
                Some(value) => escape(&value.to_string()),
            };
            let _ = write!(out, "<td>{text}</td>");
        }
        out += "</tr>\n";
    }
    out + "</tbody></table></div></details>"
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn tables_have_the_numbers_of_the_json_and_not_too_many_rows() {
        let list: Vec<Value> =
            (0..9000).map(|i| json!({"at_s": 0.1 * f64::from(i), "name": "<b>"})).collect();
        let text = numbers("Times", "/a/b", &list, &[("at_s", "time"), ("name", "who"), ("none", "")]);
        assert!(text.contains("one row in 3"), "{}", &text[..200]);
        assert!(text.contains(
            "<tr data-row=\"/a/b/3\"><td>0.30000000000000004</td><td>&lt;b&gt;</td><td></td></tr>"
        ));
        assert_eq!(text.matches("data-row").count(), 3000);
        assert!(!numbers("Times", "/a", &list[..10], &[]).contains("one row in"));
    }

    #[test]
    fn keyed_numbers_are_exact() {
        let text = number("/time/parse_s", &0.095_392_09, "0.095 s");
        assert_eq!(
            text,
            "<data data-key=\"/time/parse_s\" value=\"0.09539209\" title=\"0.09539209\">0.095 s</data>"
        );
        assert_eq!(exact(&u64::MAX), "18446744073709551615");
    }
}
