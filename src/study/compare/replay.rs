//! One ray again: what each voice says of it, and everything that it may hit.

use super::arbiter::{Arbiter, Name, Shapes};
use super::backends::Backends;
use super::bounds::Voice;
use super::outcome::{Answer, ray_text};
use super::verdict::Verdict;
use crate::accel::{Accel, Hit, NONE, Ray};
use crate::error::Result;
use crate::render::Control;
use crate::render::stage::{Stage, effective_film, pool};
use crate::scene::SceneDescription;
use crate::settings::RenderSettings;
use std::fmt::Write;

/// Candidates that are printed.
const MOST: usize = 16;

/// A text for a person about `ray`, and whether the backends agree or what keeps them apart is explained.
///
/// # Errors
/// As rendering.
pub fn replay(
    scene: &SceneDescription,
    settings: &RenderSettings,
    ray: &Ray,
    control: &Control<'_>,
) -> Result<(String, bool)> {
    let (pool, threads) = pool(settings)?;
    let film = effective_film(scene, settings)?;
    let (stage, ..) = pool.install(|| Stage::load(scene, &film, settings, threads, control))?;
    let (world, objects, instances) = stage.geometry.for_backend();
    let shapes = Shapes { world, objects, instances, custom: &stage.geometry };
    let backends = Backends::new(&shapes, &pool, threads, true, 0)?;
    let _attached = stage.textures.store().attach();
    Ok(describe(&shapes, &backends, ray))
}

fn describe(shapes: &Shapes<'_>, backends: &Backends<'_>, ray: &Ray) -> (String, bool) {
    let mut text = format!("ray            {}\n", ray_text(ray));
    let native = backends.native.closest(ray);
    let embree = backends.embree.as_ref().map(|e| (&*e.1, Voice::Embree, "embree"));
    let robust = backends.robust.as_ref().map(|e| (&**e, Voice::EmbreeRobust, "embree robust"));
    let mut fine = true;
    // Writing to a string cannot fail.
    let mut say = |name: &str, hit: &Hit, occluded: bool| {
        let answer = Answer::of(hit).map_or("miss".to_owned(), |a| a.to_string());
        let _ = writeln!(text, "{name:<14} {answer}; {}", if occluded { "occluded" } else { "free" });
    };
    say("native", &native, backends.native.occluded(ray));
    let others: Vec<_> = embree.into_iter().chain(robust).collect();
    let hits: Vec<Hit> = others.iter().map(|(accel, ..)| accel.closest(ray)).collect();
    for ((accel, _, name), hit) in others.iter().zip(&hits) {
        say(name, hit, accel.occluded(ray));
    }
    let voices: Vec<Voice> =
        if others.is_empty() { vec![Voice::Native] } else { others.iter().map(|o| o.1).collect() };
    for (i, voice) in voices.iter().enumerate() {
        let arbiter = Arbiter::new(shapes, [Voice::Native, *voice]);
        let other = hits.get(i).unwrap_or(&native);
        let judgement = arbiter.judge(ray, [&native, other]);
        let name = others.get(i).map_or("native alone", |o| o.2);
        let reason = judgement.reason.map_or("no difference", |r| r.name());
        fine &= judgement.reason.is_none_or(|r| r.is_explained());
        let _ = writeln!(text, "arbiter, {name}: {reason}");
        let found = arbiter.gather(ray, [&native, other]);
        for c in found.iter().take(MOST) {
            let place =
                if c.name.instance() == NONE { String::new() } else { format!("{}/", c.name.instance()) };
            let Name { geometry, primitive, .. } = c.name;
            let _ = writeln!(
                text,
                "  {place}{geometry}/{primitive}: t {:e}; native {}; {name} {}",
                c.t,
                may(c.may[0].as_ref()),
                may(c.may[1].as_ref())
            );
        }
        if found.len() > MOST {
            let _ = writeln!(text, "  and {} more", found.len() - MOST);
        }
    }
    (text, fine)
}

fn may(verdict: Option<&Verdict>) -> String {
    match verdict {
        None => "cannot hit".to_owned(),
        Some(Verdict { lo, hi, doubt: None }) => format!("hits in [{lo:e}, {hi:e}]"),
        Some(Verdict { lo, hi, doubt: Some(doubt) }) => {
            format!("may hit in [{lo:e}, {hi:e}] ({})", format!("{doubt:?}").to_lowercase())
        }
    }
}
