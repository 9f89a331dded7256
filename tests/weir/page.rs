//! What tests ask of pages: that their numbers are those of a record, and that a browser finds nothing wrong.
//!
//! Never: needs a browser; where there is none, says that it was left out.

use serde_json::Value;
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

pub(crate) fn unescaped(text: &str) -> String {
    let names = [("&lt;", "<"), ("&gt;", ">"), ("&quot;", "\""), ("&#39;", "'"), ("&amp;", "&")];
    names.iter().fold(text.to_owned(), |text, (name, c)| text.replace(name, c))
}

/// Text between `open` and `close`, every time.
pub(crate) fn all<'a>(text: &'a str, open: &str, close: &str) -> Vec<&'a str> {
    text.split(open).skip(1).map(|rest| rest.split(close).next().unwrap_or_default()).collect()
}

/// Every number of the page that names its place in the record is the one that stands there; how many they are.
pub(crate) fn numbers_hold(page: &str, record: &Value) -> (usize, usize) {
    let keyed: Vec<(&str, &str)> = all(page, "<data data-key=\"", "\" title")
        .into_iter()
        .map(|number| number.split_once("\" value=\"").expect("a key and a value"))
        .collect();
    for (pointer, value) in &keyed {
        let there =
            record.pointer(&unescaped(pointer)).unwrap_or_else(|| panic!("{pointer} is in no record"));
        assert_eq!(unescaped(value), there.to_string(), "{pointer}");
    }
    let mut rows = 0;
    for table in all(page, "<table><thead>", "</table>") {
        let fields = all(table, "data-field=\"", "\"");
        for row in all(table, "<tr data-row=\"", "</tr>") {
            let (pointer, cells) = row.split_once("\">").expect("a pointer and cells");
            let cells = all(cells, "<td>", "</td>");
            assert_eq!(cells.len(), fields.len(), "{pointer}");
            for (field, cell) in fields.iter().zip(cells) {
                let there = match record.pointer(&format!("{}/{field}", unescaped(pointer))) {
                    Some(Value::String(text)) => text.clone(),
                    Some(Value::Null) => String::new(),
                    Some(value) => value.to_string(),
                    None => panic!("{pointer}/{field} is in no record"),
                };
                assert_eq!(unescaped(cell), there, "{pointer}/{field}");
            }
            rows += 1;
        }
    }
    (keyed.len(), rows)
}

/// A browser, by the names it goes by.
fn browser() -> Option<PathBuf> {
    let path = std::env::var_os("PATH").unwrap_or_default();
    let folders: Vec<PathBuf> = std::env::split_paths(&path).collect();
    let names = ["chromium", "chromium-browser", "google-chrome"];
    names.iter().flat_map(|name| folders.iter().map(move |f| f.join(name))).find(|program| program.is_file())
}

/// The document as the browser has it, and what pages said on its console; `None` where it did not come up.
pub(crate) fn opened(browser: &Path, at: &Path, page: &str) -> Option<(String, Vec<String>)> {
    let profile = tempfile::tempdir().expect("a temporary directory");
    // Files, not pipes: nobody reads while it is waited for.
    let (dom, log) = (at.join("dom.txt"), at.join("log.txt"));
    let mut child = Command::new(browser)
        .args(
            "--headless --no-sandbox --disable-gpu --no-first-run --disable-background-networking".split(' '),
        )
        .args(["--enable-logging=stderr", "--dump-dom"])
        .arg(format!("--user-data-dir={}", profile.path().display()))
        .arg(format!("file://{}", at.join(page).display()))
        .stdin(Stdio::null())
        .stdout(File::create(&dom).expect("writable"))
        .stderr(File::create(&log).expect("writable"))
        .spawn()
        .ok()?;
    let start = Instant::now();
    let ended = loop {
        match child.try_wait().expect("our child") {
            Some(status) => break status.success(),
            None if start.elapsed() > Duration::from_secs(60) => {
                let _ = child.kill();
                let _ = child.wait();
                break false;
            }
            None => sleep(Duration::from_millis(50)),
        }
    };
    let read = |path: &Path| String::from_utf8_lossy(&fs::read(path).expect("there")).into_owned();
    let said = read(&log).lines().filter(|line| line.contains("CONSOLE")).map(str::to_owned).collect();
    ended.then(|| (read(&dom), said))
}

/// A browser that comes up and tells of what is wrong, which makes its silence worth something; tried in the folder `at`.
pub(crate) fn browser_that_tells(at: &Path) -> Option<PathBuf> {
    let Some(browser) = browser() else {
        eprintln!("left out: no chromium, chromium-browser or google-chrome in PATH to open the page with");
        return None;
    };
    fs::write(at.join("wrong.html"), "<p id=wrong>x<script>throw new Error('expected')</script>")
        .expect("writable");
    match opened(&browser, at, "wrong.html") {
        Some((dom, said)) if dom.contains("id=\"wrong\"") => {
            assert!(!said.is_empty(), "it hides errors");
            Some(browser)
        }
        _ => {
            eprintln!("left out: {} does not come up here", browser.display());
            None
        }
    }
}
