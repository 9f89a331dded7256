//! Holds the order of imports that the design states: a room is imported only by rooms to its right.
//! Reads the text of `src`, so that a path written in full counts as an import too.

use std::fs;
use std::path::{Path, PathBuf};

/// Left is imported by right.
const ORDER: [&str; 22] = [
    "math",
    "color",
    "error",
    "open",
    "replace",
    "clock",
    "permits",
    "settings",
    "stats",
    "scene",
    "prepare",
    "texture",
    "accel",
    "geometry",
    "schedule",
    "integrator",
    "film",
    "report",
    "render",
    "study",
    "cli",
    "main",
];

/// Rooms that are planned and not built yet.
const TO_COME: [&str; 0] = [];

fn place(room: &str) -> Option<usize> {
    ORDER.iter().position(|r| *r == room)
}

fn source() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("src")
}

fn files(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).expect("a readable folder") {
        let path = entry.expect("a readable entry").path();
        if path.is_dir() {
            files(&path, found);
        } else if path.extension().is_some_and(|e| e == "rs") {
            found.push(path);
        }
    }
}

/// The first path segment below `src`, without its extension.
fn room_of(file: &Path) -> String {
    let inside = file.strip_prefix(source()).expect("below src");
    let first = inside.iter().next().expect("a file").to_string_lossy();
    first.strip_suffix(".rs").unwrap_or(&first).to_owned()
}

/// Rooms that a line of code names after `crate::` (or, in the program, `weir::`); a comment names none.
fn rooms_in(line: &str) -> Vec<String> {
    let code = line.split("//").next().unwrap_or_default();
    let mut rooms = Vec::new();
    for root in ["crate::", "weir::"] {
        for (at, _) in code.match_indices(root) {
            let before = code[..at].chars().next_back();
            if before.is_some_and(|c| c.is_alphanumeric() || c == '_' || c == ':') {
                continue;
            }
            let rest = &code[at + root.len()..];
            let name: String = rest.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect();
            rooms.push(if rest.starts_with('{') { "{".to_owned() } else { name });
        }
    }
    rooms
}

/// Every import of `text`, a file of `room`, that goes against the order: `line: import`.
fn against_order(room: &str, text: &str) -> Vec<String> {
    let own = place(room);
    let wrong = |other: &str| match (own, place(other)) {
        (Some(own), Some(other)) => other > own,
        _ => true,
    };
    text.lines()
        .enumerate()
        .flat_map(|(i, line)| rooms_in(line).into_iter().map(move |other| (i + 1, other)))
        .filter(|(_, other)| wrong(other))
        .map(|(line, other)| format!("{line}: {room} imports {other}"))
        .collect()
}

#[test]
fn rooms_are_imported_from_the_right_only() {
    let mut list = Vec::new();
    files(&source(), &mut list);
    list.sort();
    assert!(list.len() > 50, "{list:?}");
    let mut wrong = Vec::new();
    for file in &list {
        let room = room_of(file);
        if room == "lib" {
            continue;
        }
        let text = fs::read_to_string(file).expect("a readable file");
        let name = file.strip_prefix(source()).expect("below src").display();
        wrong.extend(against_order(&room, &text).into_iter().map(|w| format!("src/{name}:{w}")));
    }
    assert!(wrong.is_empty(), "against the order {ORDER:?}:\n{}", wrong.join("\n"));
}

#[test]
fn every_room_has_a_place_in_the_order() {
    for entry in fs::read_dir(source()).expect("a readable folder") {
        let name = entry.expect("a readable entry").file_name().to_string_lossy().into_owned();
        let room = name.strip_suffix(".rs").unwrap_or(&name);
        if room != "lib" && !name.ends_with(".md") {
            assert!(place(room).is_some(), "src/{name} has no place in the order {ORDER:?}");
        }
    }
    for room in ORDER {
        let exists = source().join(room).is_dir() || source().join(format!("{room}.rs")).is_file();
        assert!(exists != TO_COME.contains(&room), "{room}: bring TO_COME up to date");
    }
}

/// The test above must be able to fail.
#[test]
fn a_wrong_import_is_found() {
    assert_eq!(against_order("scene", "use crate::texture::read_image;"), ["1: scene imports texture"]);
    assert_eq!(
        against_order("scene", "\nlet x = crate::film::f(crate::math::g());"),
        ["2: scene imports film"]
    );
    assert_eq!(against_order("scene", "use crate::{math, film};"), ["1: scene imports {"]);
    assert_eq!(against_order("film", "use crate::texture::read_image;"), [""; 0]);
    assert_eq!(against_order("scene", "/// [`crate::texture::read_image`]"), [""; 0]);
    assert_eq!(against_order("report", "use weir::render::Progress;"), ["1: report imports render"]);
}
