//! `weir compare`: Embree against the native hierarchy, hit by hit, and how fast each is.

use crate::cli::progress::Bar;
use crate::cli::render::note_warnings;
use crate::cli::{End, check_apart, check_not_input, interrupt, note, print, values};
use clap::Args;
use std::fmt::Write;
use std::path::PathBuf;
use weir::accel::Ray;
use weir::error::{Error, Result};
use weir::film::replace::{check_replaceable, replace_with_bytes};
use weir::film::write::{check_writable, write_image};
use weir::render::Control;
use weir::report::bytes;
use weir::scene;
use weir::settings::RenderSettings;
use weir::study::compare::{self, Comparison, Kind, Query, Rate};

const EXAMPLES: &str = "\
Examples:
  weir compare scene.pbrt
  weir compare scene.pbrt --rays 3M --json compare.json -o where.png
  weir compare scene.pbrt --robust           Embree's robust mode too
  weir compare scene.pbrt --rounds 0         hits only, no rates
  weir compare scene.pbrt --ray 0,1,-5,0.1,0,1    what each says of one ray

Rays are those of the scene's own paths (camera, bounce, shadow), and a quarter more aimed at vertices, edges, faces
of boxes and slivers. Each goes through both; a third voice in f64 says who is right where they differ, by bounds
on the rounding of each one's triangle test.

  same          one primitive at distances within the bounds, or both miss; `within bound` are those of them whose
                distances differ in some bit
  ties          two primitives at one distance within the bounds; the native rule is the least
                (instance, geometry, primitive)
  explained     rounding may give either answer (edge, range, grazing, ...), or Embree alone is wrong (embree_...)
  unexplained   everything else, and every native answer beyond its bound

-o draws where: orange for what is explained, red for what is not.

Exit codes: 0 nothing is unexplained; 1 something is; 2 bad usage or bad input; 3 out of a resource.";

/// Options of `weir compare`.
#[derive(Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Options {
    /// Scene: .pbrt, .pbrt.gz, .obj or .ply
    scene: PathBuf,
    /// Rays of paths, a third each of camera, bounce and shadow; a quarter more are aimed
    #[arg(long, value_name = "N", default_value = "1M", value_parser = values::amount, allow_negative_numbers = true)]
    rays: u64,
    /// Write everything as JSON
    #[arg(long, value_name = "FILE.json")]
    json: Option<PathBuf>,
    /// Draw where they differ: .exr, .png or .pfm; the rays of all pixels are compared too
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Compare Embree's robust mode too
    #[arg(long)]
    robust: bool,
    /// Rounds in which rates are measured; 0 measures none
    #[arg(long, value_name = "N", default_value_t = 5, allow_negative_numbers = true)]
    rounds: u32,
    /// Disagreements to list
    #[arg(long, value_name = "N", default_value_t = 10, allow_negative_numbers = true)]
    worst: usize,
    /// Only say what each voice says of this ray: ox,oy,oz,dx,dy,dz or ox,oy,oz,dx,dy,dz,tmin,tmax
    #[arg(long, value_name = "RAY", value_parser = compare::parse_ray, allow_hyphen_values = true)]
    ray: Option<Ray>,
    /// Seed of the paths and of the aimed rays
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    seed: Option<u64>,
    /// Threads of what is done on all; all processors if not given
    #[arg(long, value_name = "N", value_parser = values::threads, allow_negative_numbers = true)]
    threads: Option<usize>,
    /// Size of the whole image in pixels
    #[arg(long, value_name = "WxH", value_parser = values::size, allow_hyphen_values = true)]
    size: Option<(u32, u32)>,
    /// Window that paths start in, in pixels; x1 and y1 are the first outside
    #[arg(long, value_name = "x0,y0,x1,y1", value_parser = values::crop, allow_hyphen_values = true)]
    crop: Option<[u32; 4]>,
    /// Scattering events of a path
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    max_depth: Option<u32>,
    /// Print nothing but errors
    #[arg(short, long)]
    quiet: bool,
}

/// Most rays: what is recorded takes 32 bytes each.
const MOST_RAYS: u64 = 1 << 27;

/// Runs the command.
pub(crate) fn run(options: &Options) -> Result<End> {
    let mut named = options.output.iter().chain(&options.json);
    named.try_for_each(|path| check_not_input(path, &options.scene, "scene"))?;
    if let (Some(image), Some(json)) = (&options.output, &options.json) {
        check_apart(image, json)?;
    }
    options.output.iter().try_for_each(|path| check_writable(path))?;
    options.json.iter().try_for_each(|path| check_replaceable(path))?;
    if options.rays > MOST_RAYS {
        return Err(Error::Usage(format!("--rays: at most {MOST_RAYS} are possible")));
    }
    let scene = scene::load(&options.scene)?;
    if !options.quiet {
        note_warnings(&scene);
    }
    let bar = Bar::new(!options.quiet, None);
    interrupt::listen(bar.handle());
    let control =
        Control { cancel: &interrupt::CANCEL, progress: &|progress| bar.update(progress), watch: None };
    let settings = RenderSettings {
        size: options.size,
        crop: options.crop,
        max_depth: options.max_depth,
        seed: options.seed,
        threads: options.threads,
        ..RenderSettings::default()
    };
    if let Some(ray) = &options.ray {
        let replayed = compare::replay(&scene, &settings, ray, &control);
        bar.clear();
        let (text, fine) = replayed?;
        print(&text)?;
        return Ok(if fine { End::Done } else { End::Negative });
    }
    let what = compare::Options {
        settings,
        rays: options.rays as usize,
        robust: options.robust,
        rounds: options.rounds,
        worst: options.worst,
        picture: options.output.is_some(),
    };
    let compared = compare::compare(&scene, &what, &control);
    bar.clear();
    let (comparison, picture) = compared?;
    if let (Some(path), Some(image)) = (&options.output, &picture) {
        write_image(path, image, &[])?;
    }
    if let Some(path) = &options.json {
        let mut json = serde_json::to_string_pretty(&comparison).expect("a record of plain data");
        json.push('\n');
        replace_with_bytes(path, json.as_bytes())?;
    }
    if !options.quiet {
        if comparison.embree.is_none() {
            note("this Weir has no Embree: the native answers are held against the f64 arbiter alone");
        }
        let mut text = String::new();
        // Writing to a string cannot fail.
        let _ = write_text(&comparison, &mut text);
        print(&text)?;
    }
    Ok(if comparison.hits.unexplained > 0 { End::Negative } else { End::Done })
}

fn write_text(c: &Comparison, out: &mut String) -> std::fmt::Result {
    let r = &c.rays;
    let all = r.camera + r.bounce + r.shadow + r.aimed + r.pixel;
    writeln!(out, "scene          {} primitives, {} instances", c.primitives, c.instances)?;
    write!(
        out,
        "rays           {} camera, {} bounce, {} shadow, {} aimed",
        r.camera, r.bounce, r.shadow, r.aimed
    )?;
    writeln!(out, "{}", if r.pixel > 0 { format!(", {} pixel", r.pixel) } else { String::new() })?;
    let percent = |n: u64| n as f64 / all.max(1) as f64 * 100.0;
    let hits = |out: &mut String, h: &compare::Hits| {
        writeln!(
            out,
            "same           {} ({:.4} %), of them {} within bound",
            h.same,
            percent(h.same),
            h.within_bound
        )?;
        writeln!(out, "ties           {} ({:.4} %)", h.ties, percent(h.ties))?;
        writeln!(out, "explained      {} ({:.4} %)", h.explained, percent(h.explained))?;
        writeln!(out, "unexplained    {}", h.unexplained)?;
        for (reason, count) in &h.reasons {
            writeln!(out, "  {reason:<24} {count}")?;
        }
        writeln!(
            out,
            "through what is closed: native {}, Embree {}; occlusion checked {}, audited {}",
            h.native_misses_through_closed_mesh,
            h.embree_misses_through_closed_mesh,
            h.occlusion_checked,
            h.audited
        )
    };
    hits(out, &c.hits)?;
    if let Some(robust) = &c.robust {
        writeln!(out, "\nrobust Embree")?;
        hits(out, robust)?;
    }
    if !c.worst.is_empty() {
        writeln!(out, "\nworst (again: weir compare {} --ray RAY)", c.scene)?;
    }
    for w in &c.worst {
        let answer = |a: &Option<compare::Answer>| a.map_or("miss".to_owned(), |a| a.to_string());
        writeln!(
            out,
            "  {} {}",
            if w.explained { w.reason.to_owned() } else { w.reason.to_uppercase() },
            w.ray
        )?;
        writeln!(out, "    native {}; embree {}", answer(&w.answers.native), answer(&w.answers.embree))?;
    }
    write_cost(c, out)
}

fn write_cost(c: &Comparison, out: &mut String) -> std::fmt::Result {
    writeln!(out, "\n               build [s]   1 thread   bytes      a primitive   nodes, leaves a ray")?;
    for (name, b) in [("native", Some(&c.native)), ("embree", c.embree.as_ref())] {
        let Some(b) = b else { continue };
        let (build, one, size, each) = (b.build_s, b.build_1_thread_s, bytes(b.bytes), b.bytes_per_triangle);
        write!(out, "  {name:<12} {build:<11.4} {one:<10.4} {size:<10} {each:<13.1}")?;
        match (b.nodes_per_ray, b.leaves_per_ray) {
            (Some(nodes), Some(leaves)) => writeln!(out, " {nodes:.1}, {leaves:.1}")?,
            _ => writeln!(out, " unknown")?,
        }
    }
    if c.rates.is_empty() {
        return Ok(());
    }
    let head = ["native", "embree", "native/embree", "robust", "native/robust"];
    write!(out, "\nMrays/s                             threads")?;
    head.iter().try_for_each(|h| write!(out, " {h:>13}"))?;
    writeln!(out)?;
    c.rates.iter().try_for_each(|rate| write_rate(rate, out))?;
    if let Some(ratios) = &c.native_over_embree {
        let number = |x: Option<f64>| x.map_or("-".to_owned(), |x| format!("{x:.3}"));
        writeln!(
            out,
            "\nnative/embree: closest {}, occluded {}, build {:.3} ({:.3} on one thread), bytes {:.3}",
            number(ratios.closest),
            number(ratios.occluded),
            ratios.build,
            ratios.build_1_thread,
            ratios.bytes
        )?;
    }
    Ok(())
}

fn write_rate(r: &Rate, out: &mut String) -> std::fmt::Result {
    let kind = match r.kind {
        Kind::Camera => "camera",
        Kind::Bounce => "bounce",
        Kind::Shadow => "shadow",
        Kind::Aimed => "aimed",
        Kind::Pixel => "pixel",
    };
    let query = match r.query {
        Query::Closest => "closest",
        Query::Occluded => "occluded",
    };
    let name = format!("{query} {kind}{}", if r.shuffled { ", shuffled" } else { "" });
    let number = |x: Option<f64>| x.map_or("-".to_owned(), |x| format!("{x:.3}"));
    write!(out, "  {name:<33} {:>7}", r.threads)?;
    let columns =
        [Some(r.native), r.embree, r.native_over_embree, r.embree_robust, r.native_over_embree_robust];
    columns.iter().try_for_each(|&x| write!(out, " {:>13}", number(x)))?;
    writeln!(out)
}
