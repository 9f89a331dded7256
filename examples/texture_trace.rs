//! Replays a trace of filtered texture look-ups through Weir's tile cache and prints one JSON line a
//! pass: `cargo run --release --example texture_trace -- TXDIR CACHE_MB THREADS KIND LOOKUPS
//! [PASSES=2] [COLOURS=FILE]`.
//!
//! The trace, the way its footprints are filtered and the fields are those that another texture
//! system was measured with (`tools/bench-textures.sh`), so that both do the same work: `trace_fnv`
//! must be equal before any speed is compared. With COLOURS, the colour of every look-up of the
//! last pass is written to FILE, three floats each.
//!
//! Environment: READS=direct (past the system's page cache) or READS=system (through it, which keeps
//! what it read); without, as a render reads. OWN=1: Weir's own filters (trilinear; EWA for `aniso`) by
//! the door that shading uses, [`TextureStore::lookup`], in the place of the other system's.

use std::io::Write;
use std::time::Instant;
use weir::error::{Error, Location};
use weir::math::Vec2;
use weir::prepare::ImageNeeds;
use weir::scene::{Encoding, ImageId, ImageSource, TextureFilter};
use weir::stats::thread_cpu_seconds;
use weir::texture::cache::ThreadCache;
use weir::texture::convert::Watch;
use weir::texture::{Caching, Footprint, Probe, Sampler, TextureOptions, TextureStore};

/// Look-ups that are seeded together.
const BLOCK: u64 = 4096;
/// Look-ups of the kind `camera` that stay near each other.
const PATCH: u64 = 64;

#[derive(Clone, Copy)]
struct Lookup {
    texture: u32,
    /// s, t, ds/dx, dt/dx, ds/dy, dt/dy.
    at: [f32; 6],
}

/// xorshift64*, seeded by splitmix64.
struct Random(u64);

impl Random {
    fn new(block: u64) -> Self {
        let mut z = (block + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        Self(z ^ (z >> 31))
    }

    fn bits(&mut self) -> u64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        self.0.wrapping_mul(2_685_821_657_736_338_717)
    }

    fn uniform(&mut self) -> f64 {
        (self.bits() >> 40) as f64 / 16_777_216.0
    }

    fn signed(&mut self) -> f64 {
        2.0 * self.uniform() - 1.0
    }

    fn below(&mut self, n: u64) -> u32 {
        (((self.bits() >> 32) * n) >> 32) as u32
    }

    /// 2^u for u uniform in 0..8, by square roots alone, which round alike everywhere.
    fn width(&mut self) -> f64 {
        let bits = self.bits() >> 53;
        let mut width = (1u64 << (bits >> 8)) as f64;
        let mut root = 2.0f64;
        for bit in (0..8).rev() {
            root = root.sqrt();
            if bits >> bit & 1 == 1 {
                width *= root;
            }
        }
        width
    }
}

fn lookup(texture: u32, s: f64, t: f64, [long, short]: [f64; 2], [c, d]: [f64; 2], side: f64) -> Lookup {
    let at = [s, t, long * c / side, long * d / side, 0.0 - short * d / side, short * c / side];
    Lookup { texture, at: at.map(|x| x as f32) }
}

fn block(kind: &str, number: u64, textures: u64, side: u64, out: &mut Vec<Lookup>) {
    let size = side as f64;
    if kind == "coherent" {
        let pitch = 1u64 << (number % 3);
        let (row, first) = (side / pitch, number / 3 * BLOCK);
        for i in first..first + BLOCK {
            let place = |k: u64| (k as f64 + 0.5) * pitch as f64 / size;
            let width = 1.5 * pitch as f64;
            out.push(lookup(0, place(i % row), place(i / row % row), [width; 2], [1.0, 0.0], size));
        }
        return;
    }
    let mut random = Random::new(number);
    let (mut texture, mut s, mut t, mut width) = (0, 0.0, 0.0, 0.0);
    for i in 0..BLOCK {
        if kind != "camera" || i % PATCH == 0 {
            texture = random.below(textures);
            s = random.uniform();
            t = random.uniform();
            width = random.width();
        } else {
            s += random.signed() * width / size;
            t += random.signed() * width / size;
        }
        let (mut long, mut axis) = (width, [1.0, 0.0]);
        if kind == "aniso" {
            long = width * (1.0 + 15.0 * random.uniform());
            let length2 = loop {
                axis = [random.signed(), random.signed()];
                let length2 = axis[0] * axis[0] + axis[1] * axis[1];
                if (1e-4..=1.0).contains(&length2) {
                    break length2;
                }
            };
            axis = axis.map(|a| a / length2.sqrt());
        }
        out.push(lookup(texture, s, t, [long, width], axis, size));
    }
}

fn fnv(trace: &[Lookup]) -> u64 {
    let bytes = trace
        .iter()
        .flat_map(|l| l.texture.to_le_bytes().into_iter().chain(l.at.into_iter().flat_map(f32::to_le_bytes)));
    bytes.fold(0xcbf2_9ce4_8422_2325, |h, b| (h ^ u64::from(b)).wrapping_mul(0x0100_0000_01b3))
}

/// The two levels that a width asks for, and the coarser one's share, linear in the width.
#[inline(always)]
fn levels(width: f32, top: usize, side: u32) -> (usize, f32) {
    // The first level whose texels are as wide.
    let texels = width * side as f32;
    if texels <= 1.0 {
        return (0, 0.0);
    }
    let coarse = (texels.log2().ceil() as usize).clamp(1, top);
    // What the width is in texels of the coarser level, from a half to one.
    let own = texels / (1u64 << coarse) as f32;
    (coarse - 1, (2.0 * own - 1.0).clamp(0.0, 1.0))
}

struct Replay<'a> {
    store: &'a TextureStore,
    side: u32,
    top: usize,
    aniso: bool,
    own: bool,
    probes: Vec<Probe>,
    bilinear: u64,
}

impl Replay<'_> {
    #[inline(always)]
    fn colour(&mut self, thread: &mut ThreadCache, l: &Lookup) -> [f32; 3] {
        let [s, t, dsdx, dtdx, dsdy, dtdy] = l.at;
        let st = Vec2::new(s, t);
        let id = ImageId(l.texture);
        if self.own {
            let filter = if self.aniso { TextureFilter::Ewa } else { TextureFilter::Trilinear };
            // pbrt's rule for circles is a level coarser than the other system's.
            let scale = if self.aniso { 1.0 } else { 0.5 };
            let (duv_dx, duv_dy) = (scale * Vec2::new(dsdx, -dtdx), scale * Vec2::new(dsdy, -dtdy));
            let footprint = Footprint { duv_dx, duv_dy, random: 0 };
            let sampler = Sampler { filter, ..Sampler::default() };
            return self.store.lookup(id, Vec2::new(s, 1.0 - t), footprint, sampler).to_array();
        }
        self.probes.clear();
        let (fine, share) = if self.aniso {
            let (x, y) = (Vec2::new(dsdx, dtdx), Vec2::new(dsdy, dtdy));
            let (long, short) = if x.length_squared() >= y.length_squared() { (x, y) } else { (y, x) };
            let (major, minor) = (long.length(), short.length());
            let ratio = (major / minor).min(32.0);
            let n = ((2.0 * ratio - 1.0) as i32).max(1);
            // Spread over what the major axis has more than the minor one; a Gaussian over the major axis.
            let reach = long * (1.0 - 1.0 / ratio);
            let scale = 0.5 / (1.0 - 1.0 / ratio).max(1e-6);
            let mut sum = 0.0;
            for i in 0..n {
                let at = (2 * i + 1) as f32 / n as f32 - 1.0;
                let x = at * scale;
                let weight = if n <= 2 { 1.0 } else { (-2.0 * x * x).exp() };
                sum += weight;
                self.probes.push(Probe { st: st + reach * at, weight });
            }
            self.probes.iter_mut().for_each(|p| p.weight /= sum);
            levels(major / ratio, self.top, self.side)
        } else {
            self.probes.push(Probe { st, weight: 1.0 });
            levels(dsdx.abs().max(dsdy.abs()).max(dtdx.abs()).max(dtdy.abs()), self.top, self.side)
        };
        let mut sum = glam::Vec4::ZERO;
        for (level, share) in [(fine, 1.0 - share), (fine + 1, share)] {
            if share > 0.0 {
                self.bilinear += self.probes.len() as u64;
                sum += self.store.probes(id, thread, level, &self.probes) * share;
            }
        }
        [sum.x, sum.y, sum.z]
    }
}

fn open(directory: &str, megabytes: f64, threads: usize, caching: Caching) -> Result<TextureStore, Error> {
    let mut paths: Vec<_> = std::fs::read_dir(directory)
        .map_err(|e| Error::Usage(format!("{directory}: {e}")))?
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter(|path| path.extension().is_some_and(|e| e == "tx"))
        .collect();
    paths.sort();
    let source = |path: std::path::PathBuf| ImageSource {
        at: Location::whole(&path),
        encoding: Encoding::Linear,
        named: false,
        path,
    };
    let sources: Vec<ImageSource> = paths.into_iter().map(source).collect();
    let needs = vec![ImageNeeds { used: true, mip_levels: true, whole: false }; sources.len()];
    let budget = (megabytes * 1_048_576.0) as u64;
    let options = TextureOptions { budget, threads, caching, ..TextureOptions::default() };
    TextureStore::load(&sources, &needs, &options, Watch::nobody())
}

fn run() -> Result<(), Error> {
    let arguments: Vec<String> = std::env::args().collect();
    let usage = || {
        Error::Usage(
            "texture_trace TXDIR CACHE_MB THREADS coherent|camera|incoherent|aniso LOOKUPS [PASSES] [COLOURS]".into(),
        )
    };
    let text = |i: usize| arguments.get(i).map(String::as_str).ok_or_else(usage);
    let number = |i: usize| text(i)?.parse::<f64>().map_err(|_| usage());
    let (directory, megabytes, threads) = (text(1)?, number(2)?, (number(3)? as usize).max(1));
    let (kind, blocks) = (text(4)?, (number(5)? as u64).div_ceil(BLOCK).max(1));
    let passes = if arguments.len() > 6 { number(6)? as u32 } else { 2 };
    let caching = match std::env::var("READS").as_deref() {
        Err(_) => Caching::Borrow,
        Ok("direct") => Caching::Direct,
        Ok("system") => Caching::System,
        Ok(other) => return Err(Error::Usage(format!("READS={other}: direct or system"))),
    };
    let store = open(directory, megabytes, threads, caching)?;
    let (cache, names) = store.cache().ok_or_else(usage)?;
    let textures = names.len() as u64;
    let (side, _) = store.size(ImageId(0)).ok_or_else(usage)?;

    let mut trace = Vec::with_capacity((blocks * BLOCK) as usize);
    (0..blocks).for_each(|b| block(kind, b, textures, u64::from(side), &mut trace));
    let hash = fnv(&trace);
    let own = std::env::var_os("OWN").is_some();
    let mut before = cache.counts().total();
    for pass in 0..passes {
        let start = Instant::now();
        let work = |k: usize| {
            let cpu = thread_cpu_seconds().unwrap_or(0.0);
            let piece = |k: usize| (blocks * k as u64 / threads as u64 * BLOCK) as usize;
            let mut thread: ThreadCache = ThreadCache::new(cache);
            let attached = own.then(|| store.attach());
            let mut replay = Replay {
                store: &store,
                side,
                top: side.ilog2() as usize,
                aniso: kind == "aniso",
                own,
                probes: Vec::with_capacity(64),
                bilinear: 0,
            };
            let mut sum = [0.0f64; 3];
            for l in &trace[piece(k)..piece(k + 1)] {
                let colour = replay.colour(&mut thread, l);
                sum.iter_mut().zip(colour).for_each(|(s, c)| *s += f64::from(c));
            }
            thread.finish(cache);
            drop(attached);
            (sum, replay.bilinear, thread_cpu_seconds().unwrap_or(0.0) - cpu)
        };
        let work = &work;
        let mut results = vec![];
        std::thread::scope(|scope| {
            let others: Vec<_> = (1..threads).map(|k| scope.spawn(move || work(k))).collect();
            results.push(work(0));
            results.extend(others.into_iter().map(|t| t.join().expect("look-ups do not panic")));
        });
        let wall = start.elapsed().as_secs_f64();
        let cpu: f64 = results.iter().map(|r| r.2).sum();
        let probes: u64 = results.iter().map(|r| r.1).sum();
        let n = trace.len() as f64;
        let mean: Vec<f64> = (0..3).map(|c| results.iter().map(|r| r.0[c]).sum::<f64>() / n).collect();
        let after = cache.counts().total();
        let line = serde_json::json!({
            "weir": env!("CARGO_PKG_VERSION"), "kind": kind, "pass": if pass == 0 { "cold" } else { "warm" },
            "threads": threads, "cache_mb": megabytes, "lookups": trace.len(), "wall_s": wall, "cpu_s": cpu,
            "mlookups_per_s": n / wall * 1e-6, "mlookups_per_cpu_s": n / cpu * 1e-6, "mean_rgb": mean,
            "trace_fnv": format!("{hash:016x}"), "tiles_created": after.reads() - before.reads(),
            "redundant_tiles": after.misses_capacity - before.misses_capacity,
            "bytes_read": after.bytes_loaded - before.bytes_loaded, "bilinear_probes": probes,
            "find_tile_calls": after.lookups - before.lookups,
            "micro_misses": (after.lookups - after.micro_hits) - (before.lookups - before.micro_hits),
            "main_misses": after.misses() - before.misses(), "peak": cache.peak(),
            "fileio_s": (after.read_ns - before.read_ns) as f64 * 1e-9,
        });
        println!("{line}");
        before = after;
    }
    if let Some(path) = arguments.get(7) {
        let mut replay = Replay {
            store: &store,
            side,
            top: side.ilog2() as usize,
            aniso: kind == "aniso",
            own,
            probes: vec![],
            bilinear: 0,
        };
        let mut thread: ThreadCache = ThreadCache::new(cache);
        let mut bytes = Vec::with_capacity(trace.len() * 12);
        for l in &trace {
            bytes.extend(replay.colour(&mut thread, l).into_iter().flat_map(f32::to_le_bytes));
        }
        let file = std::fs::File::create(path).map_err(|e| Error::Usage(format!("{path}: {e}")))?;
        (&file).write_all(&bytes).map_err(|e| Error::Usage(format!("{path}: {e}")))?;
    }
    Ok(())
}

fn main() -> std::process::ExitCode {
    match run() {
        Ok(()) => std::process::ExitCode::SUCCESS,
        Err(e) => {
            eprintln!("{e}");
            std::process::ExitCode::from(2)
        }
    }
}
