//! The report as text, and how numbers are written for people.

use super::cache::write_cache;
use crate::stats::{PlanMemory, RenderStats, RoomTimes, SchedulerStats};
use std::io::{self, Write};

/// Seconds, three digits: `0.312 s`, `12.3 s`, `2 min 03 s`, `1 h 05 min`.
#[must_use]
pub fn seconds(seconds: f64) -> String {
    // At a boundary the rounded value decides, so that no 60 s appears.
    if seconds < 0.9995 {
        format!("{seconds:.3} s")
    } else if seconds < 9.995 {
        format!("{seconds:.2} s")
    } else if seconds < 59.95 {
        format!("{seconds:.1} s")
    } else {
        let whole = seconds.round() as u64;
        match (whole / 3600, whole / 60 % 60, whole % 60) {
            (0, minutes, s) => format!("{minutes} min {s:02} s"),
            (hours, minutes, _) => format!("{hours} h {minutes:02} min"),
        }
    }
}

/// Bytes in decimal units, three digits: `999 B`, `1.50 MB`.
#[must_use]
pub fn bytes(bytes: u64) -> String {
    scaled(bytes as f64, &["B", "kB", "MB", "GB", "TB", "PB", "EB"])
}

/// A count or a rate, three digits: `999`, `4.50 M`.
#[must_use]
pub fn count(count: f64) -> String {
    scaled(count, &["", "k", "M", "G", "T", "P", "E"]).trim_end().to_owned()
}

fn scaled(value: f64, units: &[&str]) -> String {
    let (mut value, mut unit) = (value, 0);
    while value >= 999.5 && unit + 1 < units.len() {
        value /= 1000.0;
        unit += 1;
    }
    let digits = match value {
        _ if unit == 0 && value.fract() == 0.0 => 0,
        v if v < 9.995 => 2,
        v if v < 99.95 => 1,
        _ => 0,
    };
    format!("{value:.digits$} {}", units[unit])
}

/// Writes the record of a render for a person to read.
///
/// # Errors
/// Those of `out`.
pub fn write_text(stats: &RenderStats, out: &mut impl Write) -> io::Result<()> {
    let RenderStats {
        weir,
        scene,
        command: _,
        settings,
        plan,
        time,
        image,
        rays,
        memory,
        texture_cache,
        geometry_cache,
        scheduler,
        // A curve is not for text; what it says stands with its cache.
        miss_ratio: _,
        threads,
        busy,
        interrupted,
    } = stats;
    let on_off = |on: bool| if on { "on" } else { "off" };
    // What is as always, or stands in no record of before, is not worth a word.
    let unless = |usual: &str, what: &str, value: &str| match value {
        "" => String::new(),
        value if value == usual => String::new(),
        value => format!(", {what} {value}"),
    };
    let known = |size: Option<u64>| size.map_or("unknown".to_owned(), bytes);
    writeln!(out, "{scene}, rendered by weir {weir}")?;
    if *interrupted {
        writeln!(out, "interrupted before its last sample")?;
    }
    writeln!(
        out,
        "image     {} × {} pixels, {} of {} samples per pixel, {} samples, {} not finite",
        image.width,
        image.height,
        image.spp,
        settings.spp,
        count(image.samples as f64),
        image.non_finite_samples
    )?;
    write_error(stats, out)?;
    writeln!(
        out,
        "settings  backend {}{}, depth {}, roulette {}, seed {}{}{}{}",
        settings.backend,
        if settings.robust { " (robust)" } else { "" },
        settings.max_depth,
        on_off(settings.roulette),
        settings.seed,
        unless("sobol", "sampler", &settings.sampler),
        unless("both", "direct light by", &settings.estimator),
        settings.time_limit_s.map(|s| format!(", at most {}", seconds(s))).unwrap_or_default()
    )?;
    writeln!(
        out,
        "time      {} in all: parse {}, prepare {}, build {}, render {}, write {}",
        seconds(time.total_s),
        seconds(time.parse_s),
        seconds(time.prepare_s),
        seconds(time.build_s),
        seconds(time.render_s),
        seconds(time.write_s)
    )?;
    writeln!(
        out,
        "          first pixel after {}, threads waited {}",
        seconds(time.first_pixel_s),
        seconds(time.stall_s)
    )?;
    write_rooms(&time.rooms, out)?;
    writeln!(out, "threads   {threads}, busy {:.1} %", busy * 100.0)?;
    writeln!(
        out,
        "speed     {} samples/s, {} rays/s",
        count(stats.samples_per_second()),
        count(rays.per_second)
    )?;
    writeln!(
        out,
        "rays      {} closest hit, {} occlusion",
        count(rays.closest as f64),
        count(rays.occluded as f64)
    )?;
    writeln!(
        out,
        "memory    peak {}, of which accounted {}; budget {}",
        known(memory.peak_rss),
        bytes(memory.peak_accounted),
        memory.budget.map_or("none".to_owned(), bytes)
    )?;
    writeln!(
        out,
        "plan      geometry {}, textures {}",
        bytes(plan.bytes.geometry),
        bytes(plan.bytes.textures)
    )?;
    writeln!(
        out,
        "found     geometry {}, textures {}",
        bytes(memory.all_geometry),
        bytes(memory.all_textures)
    )?;
    if memory.budget.is_some() {
        write_division(&plan.memory, "          ", out)?;
    }
    if let Some(last) = memory.moves.last() {
        writeln!(
            out,
            "          {} moves between them; since the last, after {}, pages may take {} and tiles {}",
            memory.moves.len(),
            seconds(last.at_s),
            bytes(last.pages),
            bytes(last.textures)
        )?;
    }
    let words = [("textures", "tile"), ("geometry", "page")];
    for (cache, words) in [texture_cache, geometry_cache].into_iter().zip(words) {
        cache.as_ref().map_or(Ok(()), |cache| write_cache(cache, words, out))?;
    }
    if !plan.kernel.is_empty() {
        writeln!(out, "kernel    {}: {}", plan.kernel, plan.calls)?;
    }
    write_scheduler(scheduler, out)
}

/// What threads did while rendering; nothing of a record that does not know.
fn write_rooms(rooms: &RoomTimes, out: &mut impl Write) -> io::Result<()> {
    let spent = rooms.named().into_iter().filter(|(_, _, s)| *s > 0.0);
    let list: Vec<String> = spent.map(|(_, name, s)| format!("{name} {}", seconds(s))).collect();
    if list.is_empty() {
        return Ok(());
    }
    writeln!(out, "rooms     of {} threads: {}", rooms.threads, list.join(", "))
}

/// Where samples are not the same for all pixels, or not all of this render.
fn write_error(stats: &RenderStats, out: &mut impl Write) -> io::Result<()> {
    let (image, settings) = (&stats.image, &stats.settings);
    if let (Some(noise), Some(least), Some(most)) = (settings.noise, image.spp_min, image.spp_max) {
        let mean = image.spp_mean.unwrap_or(0.0);
        writeln!(
            out,
            "noise     {} % asked for: {least} to {most} samples per pixel, {mean:.1} in the mean{}",
            noise * 100.0,
            image.estimated_relmse.map_or(String::new(), |relmse| format!(
                "; estimated relMSE {relmse:.3e}, a relative error of {:.2} %",
                relmse.sqrt() * 100.0
            ))
        )?;
    }
    if image.resumed_samples > 0 {
        writeln!(out, "resumed   {} samples are a checkpoint's", count(image.resumed_samples as f64))?;
    }
    Ok(())
}

/// Writes what each part of a render may take, a line each, after `indent`.
///
/// # Errors
/// Those of `out`.
pub fn write_division(plan: &PlanMemory, indent: &str, out: &mut impl Write) -> io::Result<()> {
    let PlanMemory {
        budget,
        geometry,
        geometry_store,
        textures,
        texture_store,
        rays,
        tables,
        balanced,
        because,
    } = plan;
    let bound = |size: &Option<u64>| size.map_or("no bound".to_owned(), bytes);
    writeln!(out, "{indent}memory       {}: {because}", bound(budget))?;
    writeln!(out, "{indent}geometry     {} ({geometry_store})", bound(geometry))?;
    writeln!(out, "{indent}textures     {} ({texture_store})", bytes(*textures))?;
    writeln!(out, "{indent}rays         {}", if *rays > 0 { bytes(*rays) } else { "none wait".to_owned() })?;
    if *tables > 0 {
        writeln!(out, "{indent}tables       {}", bytes(*tables))?;
    }
    if *balanced {
        writeln!(
            out,
            "{indent}             geometry and textures give each other of theirs while rendering"
        )?;
    }
    Ok(())
}

fn write_scheduler(stats: &SchedulerStats, out: &mut impl Write) -> io::Result<()> {
    if stats.name.is_empty() {
        return Ok(());
    }
    writeln!(out, "scheduler {}: {}", stats.name, stats.because)?;
    writeln!(
        out,
        "          {} batches, at most {} paths in flight",
        count(stats.batches as f64),
        count(stats.paths_in_flight_peak as f64)
    )?;
    if stats.ray_memory > 0 {
        let (peak, allowed) = (bytes(stats.ray_memory_peak), bytes(stats.ray_memory));
        writeln!(out, "          rays that wait took {peak} of {allowed}")?;
    }
    if stats.ray_disk > 0 {
        writeln!(
            out,
            "          {} of rays went to a file, at most {} of {} at once; writing took {}, reading {}",
            bytes(stats.spilled_bytes),
            bytes(stats.spilled_peak_bytes),
            bytes(stats.ray_disk),
            seconds(stats.spill_write_s),
            seconds(stats.spill_read_s)
        )?;
    }
    if stats.voxels > 0 {
        let [x, y, z] = stats.grid;
        writeln!(
            out,
            "          {} voxels of {x} × {y} × {z} hold geometry; {} visits, {} rays a visit",
            count(stats.voxels as f64),
            count(stats.voxel_visits as f64),
            count(stats.rays_per_visit)
        )?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn text(stats: &RenderStats) -> String {
        let mut out = Vec::new();
        write_text(stats, &mut out).expect("memory");
        String::from_utf8(out).expect("text")
    }

    #[test]
    fn numbers_for_people() {
        for (value, text) in [
            (0.0, "0.000 s"),
            (0.3124, "0.312 s"),
            (0.9999, "1.00 s"),
            (12.34, "12.3 s"),
            (59.99, "1 min 00 s"),
            (123.4, "2 min 03 s"),
            (3900.0, "1 h 05 min"),
        ] {
            assert_eq!(seconds(value), text);
        }
        for (value, text) in [
            (0, "0 B"),
            (999, "999 B"),
            (1000, "1.00 kB"),
            (1_500_000, "1.50 MB"),
            (999_999, "1.00 MB"),
            (u64::MAX, "18.4 EB"),
        ] {
            assert_eq!(bytes(value), text);
        }
        for (value, text) in
            [(0.0, "0"), (12.5, "12.5"), (999.0, "999"), (4.5e6, "4.50 M"), (123_400.0, "123 k")]
        {
            assert_eq!(count(value), text);
        }
    }

    #[test]
    fn a_scheduler_is_told_of_when_it_has_a_name() {
        let mut stats = RenderStats::default();
        stats.scheduler.voxels = 211;
        assert!(!text(&stats).contains("scheduler"));
        let scheduler = &mut stats.scheduler;
        scheduler.name = "voxel".to_owned();
        scheduler.because = "pages come and go".to_owned();
        (scheduler.batches, scheduler.paths_in_flight_peak, scheduler.grid) = (3, 900_000, [8, 4, 2]);
        (scheduler.voxel_visits, scheduler.rays_per_visit) = (1200, 4560.0);
        (scheduler.ray_memory, scheduler.ray_memory_peak) = (256_000_000, 201_000_000);
        (scheduler.ray_disk, scheduler.spilled_bytes, scheduler.spilled_peak_bytes) =
            (4_000_000_000, 70_000_000, 8_000_000);
        (scheduler.spill_write_s, scheduler.spill_read_s) = (0.25, 1.5);
        let text = text(&stats);
        for needed in [
            "70.0 MB of rays went to a file, at most 8.00 MB of 4.00 GB at once; writing took 0.250 s, reading 1.50 s",
            "scheduler voxel: pages come and go\n",
            "3 batches, at most 900 k paths in flight",
            "took 201 MB of 256 MB",
            "211 voxels of 8 × 4 × 2 hold geometry; 1.20 k visits, 4.56 k rays a visit",
        ] {
            assert!(text.contains(needed), "{needed} is missing in:\n{text}");
        }
    }

    #[test]
    fn the_report_names_every_room() {
        let mut stats = RenderStats { scene: "a.pbrt".to_owned(), busy: 0.985, ..RenderStats::default() };
        stats.memory.peak_rss = Some(210_000_000);
        assert!(!text(&stats).contains("rooms"), "a record of before");
        stats.time.rooms = RoomTimes { threads: 2, shade_s: 1.5, idle_s: 0.25, ..RoomTimes::default() };
        stats.rays.per_second = 12.3e6;
        (stats.settings.sampler, stats.settings.estimator) = ("sobol".to_owned(), "lights".to_owned());
        let text = text(&stats);
        for needed in [
            "a.pbrt",
            "busy 98.5 %",
            "peak 210 MB",
            "12.3 M rays/s",
            "budget none",
            "rooms     of 2 threads: shading 1.50 s, idle 0.250 s\n",
            "seed 0, direct light by lights\n",
        ] {
            assert!(text.contains(needed), "{needed} is missing in:\n{text}");
        }
        assert!(!text.contains("interrupted"));
    }
}
