//! A picture of where the backends differ: red where nothing accounts for it, orange where something does, over the scene
//! in the light of a lamp at the camera.

use super::hits::Disagreement;
use crate::accel::{Accel, NONE, Ray};
use crate::film::Image;
use crate::geometry::{Kinds, Surfaces};
use glam::{Vec2, Vec3};
use rayon::prelude::*;

const RED: [f32; 3] = [1.0, 0.0, 0.0];
const ORANGE: [f32; 3] = [1.0, 0.35, 0.0];
/// The brightest grey of what is not marked, so that marks stand out.
const BRIGHTEST: f32 = 0.35;
/// A mark reaches so many pixels to each side: single pixels are hard to see.
const REACH: i64 = 1;

/// The middles of the pixels of `crop`, by rows.
pub(super) fn middles(crop: [u32; 4]) -> Vec<Vec2> {
    let [x0, y0, x1, y1] = crop;
    (y0..y1).flat_map(|y| (x0..x1).map(move |x| Vec2::new(x as f32 + 0.5, y as f32 + 0.5))).collect()
}

/// The scene without marks: `rays` are those of the pixels of `crop`, by rows.
pub(super) fn shaded(
    full_size: (u32, u32),
    crop: [u32; 4],
    rays: &[Ray],
    accel: &dyn Accel,
    surfaces: &Surfaces<'_>,
) -> Image {
    let shade = |ray: &Ray| {
        let hit = accel.closest(ray);
        if hit.geometry == NONE {
            return 0.0;
        }
        let point = surfaces.surface_point(&hit, surfaces.surface_of(&hit, Kinds::ALL), || *ray, Kinds::ALL);
        let facing = Vec3::from(point.ng).dot(ray.direction).abs();
        // Not black at grazing angles: black is where nothing is.
        if facing.is_finite() { BRIGHTEST * (0.1 + 0.9 * facing) } else { BRIGHTEST }
    };
    let mut image = Image::cropped(full_size, crop);
    image.pixels = rays.par_iter().map(shade).map(|l| [l; 3]).collect();
    image
}

/// Marks the pixel `x`, `y` of the full frame.
pub(super) fn mark(image: &mut Image, (x, y): (u32, u32), what: &Disagreement) {
    let explained = what.reason.is_explained();
    for dy in -REACH..=REACH {
        for dx in -REACH..=REACH {
            let (px, py) = (
                i64::from(x) - i64::from(image.origin.0) + dx,
                i64::from(y) - i64::from(image.origin.1) + dy,
            );
            if (0..i64::from(image.width)).contains(&px) && (0..i64::from(image.height)).contains(&py) {
                let at = image.index(px as u32, py as u32);
                // What is explained never hides what is not.
                if !explained || image.pixels[at] != RED {
                    image.pixels[at] = if explained { ORANGE } else { RED };
                }
            }
        }
    }
}
