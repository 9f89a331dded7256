//! Finds Embree 4.3 or later and tells the linker and the loader where it lies.
//!
//! Invariant: the first of EMBREE_DIR, the system's library directories, and what `make embree` unpacked
//! below the target directory that holds a fit `libembree4.so`; if none does, the build stops with one line
//! that says what to type.
//! Never: downloads, compiles or runs anything, nor looks for Embree when the feature `embree` is off.

use std::env;
use std::fs;
use std::path::{Path, PathBuf};

const LIBRARY: &str = "libembree4.so";

/// Exported since 4.3, which also gave the hit record the size that our declarations have: a library whose
/// symbol table lacks it would read and write records of another size.
const SINCE_4_3: &[u8] = b"\0rtcSetGeometryInstancedScenes\0";

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rerun-if-env-changed=EMBREE_DIR");
    println!("cargo::rerun-if-env-changed=LIBRARY_PATH");
    if env::var_os("CARGO_FEATURE_EMBREE").is_none() {
        return;
    }
    match find() {
        Ok(found) => announce(&found),
        Err(line) => println!("cargo::error={line}"),
    }
}

/// A directory that holds a fit library, and how a binary gets from its own directory to it.
struct Found {
    directory: PathBuf,
    /// Directories from the binary's to the library's, when both lie below the target directory.
    from_profile: Option<PathBuf>,
    /// The system's loader looks there by itself.
    loader_knows: bool,
}

fn find() -> Result<Found, String> {
    if let Some(wish) = env::var_os("EMBREE_DIR").filter(|wish| !wish.is_empty()) {
        let wish = PathBuf::from(wish);
        let places = ["", "lib", "lib64", "lib/x86_64-linux-gnu"].map(|below| wish.join(below));
        let Some(directory) = places.iter().find(|place| place.join(LIBRARY).exists()) else {
            return Err(format!(
                "EMBREE_DIR={} holds no {LIBRARY}, nor does its lib/: unset it and run `make embree`",
                wish.display()
            ));
        };
        fit(directory).map_err(|why| format!("EMBREE_DIR: {why}: unset it and run `make embree`"))?;
        let directory = fs::canonicalize(directory).unwrap_or_else(|_| directory.clone());
        return Ok(Found { directory, from_profile: None, loader_knows: false });
    }
    let mut unfit = String::new();
    for (directory, loader_knows) in system_directories() {
        if !directory.join(LIBRARY).exists() {
            continue;
        }
        match fit(&directory) {
            Ok(()) => return Ok(Found { directory, from_profile: None, loader_knows }),
            Err(why) => unfit = format!("; {why}"),
        }
    }
    unpacked().ok_or_else(|| {
        format!("no Embree 4.3 or later in EMBREE_DIR, the system or the target directory{unfit}: run `make embree`")
    })
}

/// Where a compiler driver would look, and whether the loader looks there too.
fn system_directories() -> Vec<(PathBuf, bool)> {
    if env::var_os("HOST") != env::var_os("TARGET") {
        return Vec::new();
    }
    let wished = env::var_os("LIBRARY_PATH").unwrap_or_default();
    let wished = env::split_paths(&wished).filter(|path| path.is_absolute()).map(|path| (path, false));
    let multiarch = format!("{}-linux-gnu", env::var("CARGO_CFG_TARGET_ARCH").unwrap_or_default());
    let local = ["/usr/local/lib", "/usr/local/lib64"].map(|path| (PathBuf::from(path), false));
    let usual = [Path::new("/usr/lib").join(multiarch), "/usr/lib64".into(), "/usr/lib".into()];
    wished.chain(local).chain(usual.map(|path| (path, true))).collect()
}

/// What `make embree` unpacked, looked for upwards because CARGO_TARGET_DIR, `--target` and `make native`
/// each move the build directory by a level.
fn unpacked() -> Option<Found> {
    let out = PathBuf::from(env::var_os("OUT_DIR")?);
    // OUT_DIR is PROFILE/build/PACKAGE/out.
    let profile = out.ancestors().nth(3)?;
    let mut up = PathBuf::new();
    for above in profile.ancestors().skip(1).take(4) {
        up.push("..");
        let directory = above.join("embree/lib");
        if directory.join(LIBRARY).exists() && fit(&directory).is_ok() {
            let from_profile = Some(up.join("embree/lib"));
            return Some(Found { directory, from_profile, loader_knows: false });
        }
    }
    let directory = PathBuf::from(env::var_os("CARGO_MANIFEST_DIR")?).join("target/embree/lib");
    (directory.join(LIBRARY).exists() && fit(&directory).is_ok()).then_some(Found {
        directory,
        from_profile: None,
        loader_knows: false,
    })
}

/// Whether the library in `directory` has the ABI that `embree4-sys` declares.
fn fit(directory: &Path) -> Result<(), String> {
    let path = directory.join(LIBRARY);
    let bytes = fs::read(&path).map_err(|error| format!("{} cannot be read ({error})", path.display()))?;
    if !contains(&bytes, SINCE_4_3) {
        return Err(format!("{} is older than 4.3", path.display()));
    }
    // Where headers are installed they say how many instance levels the library was built with.
    let above = directory.ancestors().skip(1).take(2);
    for config in above.map(|path| path.join("include/embree4/rtcore_config.h")) {
        let header = fs::read_to_string(&config).unwrap_or_default();
        let levels =
            header.lines().find_map(|line| line.strip_prefix("#define RTC_MAX_INSTANCE_LEVEL_COUNT"));
        if levels.is_some_and(|levels| levels.trim() != "1") {
            return Err(format!("{} has more than one instance level", path.display()));
        }
    }
    Ok(())
}

fn contains(haystack: &[u8], needle: &[u8]) -> bool {
    // Only a few bytes of a library are `needle[1]` after a zero, so the comparison is rarely made.
    haystack.windows(needle.len()).any(|window| window[1] == needle[1] && window == needle)
}

fn announce(found: &Found) {
    let directory = found.directory.display();
    println!("cargo::rerun-if-changed={}", found.directory.join(LIBRARY).display());
    println!("cargo::rustc-link-search=native={directory}");
    if found.loader_knows {
        return;
    }
    // The relative ones come first: they hold when the whole tree moves. Binaries lie in the profile's
    // directory, tests and examples a level below it.
    if let Some(from_profile) = &found.from_profile {
        println!("cargo::rustc-link-arg=-Wl,-rpath,$ORIGIN/{}", from_profile.display());
        println!("cargo::rustc-link-arg=-Wl,-rpath,$ORIGIN/../{}", from_profile.display());
    }
    println!("cargo::rustc-link-arg=-Wl,-rpath,{directory}");
}
