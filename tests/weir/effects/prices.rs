//! What each effect costs, in instructions counted by valgrind: the table of `docs/effects.md`.
//!
//! Invariant: instructions are those of rendering alone, with traversal and without; one thread, no roulette, so that
//! all runs trace the same paths.
//! Never holds a duration against another.

use super::{Effect, SCENES, images};
use crate::support::Frame;
use std::collections::HashMap;
use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use weir::integrator::flight::{Flight, Probe};
use weir::integrator::kernel as kernels;
use weir::integrator::path::Path as Carried;
use weir::prepare::KernelName;

/// Instructions a sample.
#[derive(Clone, Copy)]
struct Count {
    all: f64,
    /// Outside Embree's library.
    outside: f64,
}

fn has_valgrind() -> bool {
    Command::new("valgrind").arg("--version").output().is_ok_and(|out| out.status.success())
}

/// All that threads do.
const RENDERING: &str = "*render::job*crew*";
/// Paths alone: builds of tests have no function of the other's name.
const PATHS: &str = "*path::World*run_avx2*";

/// The program that is measured: of a release build where `make effects` names one.
fn weir() -> PathBuf {
    std::env::var_os("WEIR_MEASURED").map_or_else(|| env!("CARGO_BIN_EXE_weir").into(), PathBuf::from)
}

#[cfg(target_arch = "x86_64")]
fn has_avx2() -> bool {
    std::arch::is_x86_feature_detected!("avx2")
}

#[cfg(not(target_arch = "x86_64"))]
fn has_avx2() -> bool {
    false
}

/// Counts what rendering `effect`'s scene takes with `force`d effects.
fn count(effect: &Effect, force: &str, frame: Frame, what: &str, folder: &Path) -> Count {
    let scene = folder.join("scene.pbrt");
    fs::write(&scene, effect.text(frame)).expect("writable");
    let out = folder.join("callgrind.out");
    let mut command = Command::new("valgrind");
    command
        .arg("--tool=callgrind")
        .arg(format!("--toggle-collect={what}"))
        .arg(format!("--callgrind-out-file={}", out.display()))
        .arg(weir())
        .arg(&scene)
        .args(["--threads", "1", "--roulette", "off", "--quiet", "-o"])
        .arg(folder.join("image.exr"));
    if !force.is_empty() {
        command.args(["--force-effects", force]);
    }
    let output = command.output().expect("valgrind runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let by_object = by_object(&fs::read_to_string(&out).expect("what valgrind has counted"));
    let embree: u64 = by_object.iter().filter(|(name, _)| name.contains("embree")).map(|(_, n)| n).sum();
    let all: u64 = by_object.values().sum();
    assert!(all > embree, "no instruction was counted");
    let samples = f64::from(frame.size.0 * frame.size.1 * frame.spp);
    Count { all: all as f64 / samples, outside: (all - embree) as f64 / samples }
}

/// Instructions by the file that they are in. The format is in valgrind's manual, "Callgrind Format Specification".
fn by_object(text: &str) -> HashMap<String, u64> {
    let mut names: HashMap<&str, String> = HashMap::new();
    let mut counts: HashMap<String, u64> = HashMap::new();
    let (mut object, mut of_a_call) = (String::new(), false);
    for line in text.lines() {
        if let Some(named) = line.strip_prefix("ob=").or_else(|| line.strip_prefix("cob=")) {
            let (id, name) = named.split_once(' ').unwrap_or((named, ""));
            if !name.is_empty() {
                names.insert(id, name.to_owned());
            }
            if line.starts_with('o') {
                object = names.get(id).cloned().unwrap_or_default();
            }
        } else if line.starts_with("calls=") {
            of_a_call = true;
        } else if line.starts_with(|c: char| c.is_ascii_digit() || "+-*".contains(c)) {
            // What a call costs is told again where it is spent.
            let cost = line.split(' ').nth(1).and_then(|n| n.parse().ok()).unwrap_or(0);
            *counts.entry(object.clone()).or_default() += if of_a_call { 0 } else { cost };
            of_a_call = false;
        }
    }
    counts
}

/// Bytes of a path, of one that waits, and of a path that waits with its light sample and what it has met.
fn bytes(kernel: KernelName) -> (usize, usize) {
    fn of<K: kernels::Kernel>() -> (usize, usize) {
        let hit = size_of::<weir::accel::Hit>();
        (size_of::<Carried<K>>(), size_of::<Flight<K>>() + size_of::<Probe>() + hit)
    }
    match kernel {
        KernelName::Diffuse => of::<kernels::Diffuse>(),
        KernelName::Solid => of::<kernels::Solid>(),
        KernelName::Textured => of::<kernels::Textured>(),
        KernelName::General => of::<kernels::General>(),
    }
}

fn per_cent(part: f64, whole: f64) -> f64 {
    100.0 * (part / whole - 1.0)
}

/// The plain scene with each effect in its own kernel and in the general one.
fn table(frame: Frame, effects: &[Effect], what: &str) -> String {
    let folder = tempfile::tempdir().expect("a folder");
    images(folder.path());
    let mut lines = String::new();
    let mut plain = None;
    for effect in effects {
        let own = count(effect, "", frame, what, folder.path());
        let general = count(effect, "all", frame, what, folder.path());
        let base = *plain.get_or_insert(own);
        // What the plain scene would pay if it asked for the effect in vain.
        let asked = if effect.name == "plain" || effect.name.contains(' ') {
            base
        } else {
            count(&effects[0], effect.name, frame, what, folder.path())
        };
        let (path, waiting) = bytes(effect.kernel);
        let _ = writeln!(
            lines,
            "| {} | {} | {path} | {waiting} | {:.0} | {:.0} | {:+.0} | {:+.0} | {:.1} % | {:.1} % |",
            effect.name.replace('_', " "),
            effect.kernel.name(),
            own.all,
            own.outside,
            own.outside - base.outside,
            asked.outside - base.outside,
            per_cent(own.all, general.all),
            per_cent(own.outside, general.outside),
        );
        // Nobody pays for what nobody asks for.
        assert!(own.outside <= general.outside, "{}: {} and {}", effect.name, own.outside, general.outside);
    }
    lines
}

/// What the first line says of all instructions, traversal included.
fn saved(lines: &str) -> f64 {
    let cell = lines.split('|').nth(9).expect("a column");
    cell.trim().trim_end_matches(" %").parse().expect("a number")
}

/// `make effects` puts this into `docs/effects.md`, from the line of the table's head on.
#[test]
#[ignore = "half a minute a line under valgrind; `make effects`"]
fn effects_table() {
    assert!(has_valgrind(), "valgrind counts the instructions, and is not here");
    let lines = table(Frame { size: (32, 32), spp: 16, max_depth: 5 }, &SCENES, RENDERING);
    assert!(saved(&lines) <= -15.0, "the plain kernel against the general one: {lines}");
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/effects.md");
    let text = fs::read_to_string(&file).expect("docs/effects.md");
    let head =
        text.rfind("|--:|").and_then(|at| Some(at + text[at..].find('\n')? + 1)).expect("a table's head");
    let rest = text[head..].find("\n\n").map_or("", |at| &text[head + at + 1..]);
    fs::write(&file, format!("{}{lines}{rest}", &text[..head])).expect("writable");
    print!("{lines}");
}

#[test]
fn the_plain_kernel_takes_fewer_instructions_than_the_general_one() {
    if !has_valgrind() || !has_avx2() {
        eprintln!(
            "left out: valgrind counts the instructions of a kernel for AVX2, one of which is not here"
        );
        return;
    }
    let lines = table(Frame { size: (16, 16), spp: 16, max_depth: 5 }, &SCENES[..1], PATHS);
    assert!(saved(&lines) < 0.0, "{lines}");
}
