//! Bad numbers in real files: not a number, infinite, enormous, tiny, negative and none, wherever a scene file, a mesh or
//! an image has one.
//!
//! Invariant: every attempt runs on a thread of its own, so that a hang is seen; the good scene is rendered first.

use super::damage_places::{Neighbours, Place, places, with_mesh, with_sky, with_texels};
use super::{Effort, Row, Table, Tracer};
use crate::support::outcome;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::mpsc;
use std::time::Duration;
use weir::error::Error;
use weir::film::Image;
use weir::scene::pbrt::read_pbrt;

/// A good scene of this kind takes a hundredth of a second; one that needs this long hangs.
const MOST_TIME: Duration = Duration::from_secs(20);

const NUMBERS: [&str; 22] = [
    "nan", "inf", "-inf", "1e999", "-1e999", "3.4e38", "-3.4e38", "1e30", "-1e30", "1e19", "-1e19", "1e10",
    "-1e10", "-1", "0", "-0", "1e-7", "1e-19", "-1e-19", "1e-30", "1e-40", "-1e-45",
];

/// What became of a scene.
enum Became {
    Picture { image: Image, lost: u64 },
    Refused(String),
    Broken(String),
}

fn attempt(path: &Path, tracer: Tracer) -> Became {
    let (send, receive) = mpsc::channel();
    let path = path.to_owned();
    std::thread::spawn(move || {
        let run = || read_pbrt(&path).and_then(|scene| outcome(&scene, &tracer.settings()));
        // Whoever waited may have given up.
        let _ = send.send(catch_unwind(AssertUnwindSafe(run)));
    });
    match receive.recv_timeout(MOST_TIME) {
        Ok(Ok(Ok(outcome))) => {
            Became::Picture { lost: outcome.stats.image.non_finite_samples, image: outcome.image }
        }
        Ok(Ok(Err(e))) => refused(&e),
        Ok(Err(_)) => Became::Broken("a panic".into()),
        Err(_) => Became::Broken(format!("no end within {MOST_TIME:?}")),
    }
}

fn refused(e: &Error) -> Became {
    let text = e.to_string();
    if text.contains('\n') || e.exit_code() != 2 {
        return Became::Broken(format!("exit code {}, {text}", e.exit_code()));
    }
    Became::Refused(text)
}

/// Pixels of the right half.
fn right(image: &Image) -> Vec<[u32; 3]> {
    let half = image.pixels.chunks(image.width as usize).flat_map(|row| &row[row.len() / 2..]);
    half.map(|p| p.map(f32::to_bits)).collect()
}

/// Why what became of a scene is wrong, if it is. With a `huge` number samples may be finite whose sum is not.
fn fault(became: &Became, huge: bool) -> Option<String> {
    match became {
        Became::Broken(why) => Some(why.clone()),
        Became::Refused(_) => None,
        Became::Picture { image, lost: _ } => {
            let pixels = image.non_finite_pixels();
            (pixels > 0 && !huge).then(|| format!("{pixels} pixels are not finite"))
        }
    }
}

/// How many of the neighbours `good` changed, if a picture came of it.
fn changed(became: &Became, good: &[[u32; 3]]) -> Option<usize> {
    let Became::Picture { image, .. } = became else { return None };
    Some(right(image).iter().zip(good).filter(|(a, b)| a != b).count())
}

/// The rows of one group on one backend.
struct Group {
    wrong: Row,
    changed: Row,
    refused: Row,
    lost: Row,
}

impl Group {
    fn new(name: &str, tracer: Tracer) -> Self {
        let row = |what: &str| Row::new(format!("bad numbers in {name}: {what}"), tracer, 0.0, true);
        let counted = |what: &str| Row { bound: None, ..row(what) };
        Self {
            wrong: row("panics, hangs, pixels that are not finite"),
            changed: Row::new(
                format!("bad numbers in {name}: pictures whose pixels changed that do not see it"),
                tracer,
                0.0,
                false,
            ),
            refused: counted("refused in one line"),
            lost: counted("most samples lost and counted in a picture"),
        }
    }

    fn take(&mut self, became: &Became, good: Option<&[[u32; 3]]>, huge: bool, what: impl Fn() -> String) {
        let fault = fault(became, huge);
        if let Some(pixels) = good.and_then(|good| changed(became, good)) {
            self.changed.count(pixels > 0, || format!("{pixels} pixels changed: {}", what()));
        }
        self.wrong.count(fault.is_some(), || format!("{}: {}", fault.unwrap_or_default(), what()));
        self.refused.count(matches!(became, Became::Refused(_)), String::new);
        self.lost
            .measure(if let Became::Picture { lost, .. } = became { *lost as f64 } else { 0.0 }, String::new);
    }

    fn rows(self) -> impl Iterator<Item = Row> {
        // Of some groups the neighbours see it all.
        [self.wrong, self.changed, self.refused, self.lost].into_iter().filter(|row| row.tried > 0)
    }
}

/// 4×4 colours as a PFM.
fn write_pfm(path: &Path, value: impl Fn(usize) -> f32) {
    let mut bytes = b"PF\n4 4\n-1.0\n".to_vec();
    bytes.extend((0..48).flat_map(|i| value(i).to_le_bytes()));
    std::fs::write(path, bytes).expect("writable");
}

/// Two triangles in the left half, as binary PLY with normals and uvs; one number of one vertex is replaced.
fn write_ply(path: &Path, column: usize, value: f32) {
    let mut bytes = b"ply\nformat binary_little_endian 1.0\nelement vertex 4\n".to_vec();
    for name in ["x", "y", "z", "nx", "ny", "nz", "u", "v"] {
        bytes.extend(format!("property float {name}\n").bytes());
    }
    bytes.extend(b"element face 2\nproperty list uchar int vertex_indices\nend_header\n");
    for (i, (x, y)) in [(-1.9f32, -0.9), (-1.1, -0.9), (-1.1, 0.9), (-1.9, 0.9)].into_iter().enumerate() {
        let mut vertex = [x, y, 1.0, 0.0, 0.0, -1.0, (x + 1.9) / 0.8, (y + 0.9) / 1.8];
        if i == 2 {
            vertex[column] = value;
        }
        bytes.extend(vertex.iter().flat_map(|v| v.to_le_bytes()));
    }
    for face in [[0i32, 1, 2], [0, 2, 3]] {
        bytes.push(3);
        bytes.extend(face.iter().flat_map(|v| v.to_le_bytes()));
    }
    std::fs::write(path, bytes).expect("writable");
}

/// Bits of numbers that text cannot say.
const BITS: [f32; 12] = [
    f32::NAN,
    f32::INFINITY,
    f32::NEG_INFINITY,
    f32::MAX,
    f32::MIN,
    1e30,
    -1e30,
    -1.0,
    -0.0,
    1e-30,
    f32::MIN_POSITIVE / 2.0,
    1e-45,
];

/// Whether a few of them add up to more than f32 holds.
fn is_huge(value: f32) -> bool {
    value.is_finite() && value.abs() > 1e37
}

const TEXTURED: [&str; 3] = [
    "Texture \"t\" \"spectrum\" \"imagemap\" \"string filename\" \"bad.pfm\" \"string filter\" \"FILTER\"\n\
     Material \"diffuse\" \"texture reflectance\" \"t\"",
    "Texture \"t\" \"float\" \"imagemap\" \"string filename\" \"bad.pfm\" \"string filter\" \"FILTER\"\n\
     Material \"conductor\" \"texture roughness\" \"t\"",
    "Texture \"t\" \"float\" \"imagemap\" \"string filename\" \"bad.pfm\" \"string filter\" \"FILTER\"\n\
     MakeNamedMaterial \"a\" \"string type\" \"diffuse\"\nMakeNamedMaterial \"b\" \"string type\" \"dielectric\"\n\
     Material \"mix\" \"string materials\" [ \"a\" \"b\" ] \"texture amount\" \"t\"",
];

struct Folder {
    _dir: tempfile::TempDir,
    at: PathBuf,
}

impl Folder {
    fn new() -> Self {
        let dir = tempfile::tempdir().expect("a temporary folder");
        let at = dir.path().to_owned();
        write_pfm(&at.join("good.pfm"), |i| 0.1 + i as f32 * 0.01);
        Self { _dir: dir, at }
    }

    fn attempt(&self, text: &str, tracer: Tracer) -> Became {
        let path = self.at.join("scene.pbrt");
        std::fs::write(&path, text).expect("writable");
        attempt(&path, tracer)
    }

    /// The neighbours of a good scene.
    fn good(&self, text: &str, tracer: Tracer) -> Vec<[u32; 3]> {
        match self.attempt(text, tracer) {
            Became::Picture { image, lost: 0 } => {
                assert!(right(&image).iter().any(|p| f32::from_bits(p[0]) > 0.0), "black:\n{text}");
                right(&image)
            }
            Became::Picture { lost, .. } => panic!("{lost} samples lost:\n{text}"),
            Became::Refused(why) | Became::Broken(why) => panic!("{why}:\n{text}"),
        }
    }

    fn try_place(
        &self,
        place: &Place,
        numbers: impl Iterator<Item = &'static str>,
        tracer: Tracer,
        group: &mut Group,
    ) {
        let good = self.good(&place.text.replace('@', place.good), tracer);
        for number in numbers {
            let apart = match place.neighbours {
                Neighbours::Apart => true,
                Neighbours::Touched => false,
                Neighbours::ApartBelowZero => number.starts_with('-') && number.len() > 2,
            };
            let text = place.text.replace('@', number);
            let became = self.attempt(&text, tracer);
            group.take(&became, apart.then_some(&good), number.contains("3.4e38"), || {
                let at = place.text.find('@').expect("a place");
                let line = place.text[..at].matches('\n').count();
                format!("@ = {number} in `{}`", place.text.lines().nth(line).unwrap_or_default())
            });
        }
    }
}

/// **What must hold.** Whatever number a file gives: an end within seconds, and either a picture or one line and exit
/// code 2. A picture has no pixel that is not finite (samples that are not are counted and black; only of numbers beyond
/// 1e37 may a pixel's finite samples add up to infinity, and such pixels are counted and warned of), and
/// pixels that do not see the bad thing are those of the good scene, bit for bit.
///
/// **Why.** There is no rounding to bound: a pixel that sees nothing of a number computes nothing with it. The scenes
/// keep it so: one light, which shines along the orthographic camera's rays, and paths of one edge. (Embree's test of a
/// triangle with a corner 1e10 away is off by more than the scene is wide, so that one is met where it is not: of Embree,
/// changed pictures are counted.)
pub(super) fn bad_numbers(effort: Effort) -> Table {
    let mut table = Table::default();
    let folder = Folder::new();
    let places = places();
    let mut names: Vec<&str> = places.iter().map(|p| p.group).collect();
    names.dedup();
    for tracer in Tracer::TWO {
        for name in &names {
            let mut group = Group::new(name, tracer);
            for (i, place) in places.iter().enumerate().filter(|(_, p)| p.group == *name) {
                // In the quick form each place gets some, and each number some places.
                let step = effort.of(6, 1);
                folder.try_place(place, NUMBERS.into_iter().skip(i % step).step_by(step), tracer, &mut group);
            }
            table.extend(group.rows());
        }
        let mut group = Group::new("a binary mesh", tracer);
        let textured = TEXTURED[0].replace("bad.pfm", "good.pfm").replace("FILTER", "ewa");
        for material in ["Material \"diffuse\"", &textured] {
            let text = with_mesh("bad.ply", material);
            for column in 0..8 {
                write_ply(&folder.at.join("bad.ply"), 1, 0.9);
                let good = folder.good(&text, tracer);
                // To the right is where the neighbours are.
                for value in BITS.into_iter().filter(|v| column != 0 || *v < 0.0) {
                    write_ply(&folder.at.join("bad.ply"), column, value);
                    let became = folder.attempt(&text, tracer);
                    group.take(&became, Some(&good), is_huge(value), || {
                        format!("column {column} is {value:e}")
                    });
                }
            }
        }
        table.extend(group.rows());
        let mut group = Group::new("texels", tracer);
        for (subject, filter) in
            TEXTURED.iter().flat_map(|s| ["point", "bilinear", "trilinear", "ewa"].map(|f| (s, f)))
        {
            let text = with_texels(filter, subject);
            write_pfm(&folder.at.join("bad.pfm"), |_| 0.5);
            let good = folder.good(&text, tracer);
            for value in BITS {
                write_pfm(&folder.at.join("bad.pfm"), |i| if i % 5 == 1 { value } else { 0.5 });
                let became = folder.attempt(&text, tracer);
                group.take(&became, Some(&good), is_huge(value), || {
                    format!("a texel is {value:e} in {subject} by {filter}")
                });
            }
        }
        for value in BITS {
            write_pfm(&folder.at.join("bad.pfm"), |i| if i % 5 == 1 { value } else { 0.5 });
            group.take(&folder.attempt(&with_sky(), tracer), None, is_huge(value), || {
                format!("a texel of the sky is {value:e}")
            });
        }
        table.extend(group.rows());
    }
    table
}

#[test]
fn bad_numbers_are_refused_or_harmless() {
    bad_numbers(Effort::Quick).assert_holds();
}

/// The test above must be able to fail: what does change the neighbours is seen.
#[test]
fn a_changed_neighbour_is_found() {
    let folder = Folder::new();
    let all = places();
    let place = all.iter().find(|p| p.group == "materials").expect("a place");
    let text = place.text.replace('@', place.good);
    let good = folder.good(&text, Tracer::Native);
    assert_eq!(changed(&folder.attempt(&text, Tracer::Native), &good), Some(0));
    let other = text.replace("[ .6 .5 .4 ]", "[ .6 .5 .40001 ]");
    assert!(changed(&folder.attempt(&other, Tracer::Native), &good) > Some(0));
    assert!(fault(&Became::Broken(String::new()), true).is_some());
    let bright = text.replace("to\" [ 0 0 0 ]", "to\" [ 0 0 0 ] \"float scale\" 3e38 \"rgb L\" [ 9 9 9 ]");
    assert!(matches!(folder.attempt(&bright, Tracer::Native), Became::Picture { lost: 1.., .. }));
}
