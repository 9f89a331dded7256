//! `Shape "curve"`: every basis and degree that pbrt-v4 knows becomes cubic Bézier segments.
//!
//! Invariant: where two segments meet, both have the same point to the bit. Never draws a curve.

use super::params::{Params, Type};
use crate::error::{Error, Result};
use crate::scene::{CurveKind, Strand};
use glam::Vec3;

/// The curve that `p` describes.
pub(super) fn strand(p: &Params) -> Result<Strand> {
    let width = p.float("width", 1.0)?;
    let widths = [p.float("width0", width)?, p.float("width1", width)?];
    let degree = p.int_in("degree", 3, 2..=3)? as usize;
    let spline = p.choice("basis", &[("bezier", false), ("bspline", true)])?;
    let kinds = [("flat", CurveKind::Flat), ("ribbon", CurveKind::Ribbon), ("cylinder", CurveKind::Cylinder)];
    let kind = p.choice("type", &kinds)?;
    // How finely pbrt divides a curve before it traces it: time, not the picture.
    p.int("splitdepth", 3)?;
    let Some((given, at)) = p.tuples::<3>("P", &[Type::Point3])? else {
        return Err(Error::at(&p.at, "the curve needs \"point3 P\"; give its control points"));
    };
    let n = given.len();
    if n <= degree || (!spline && (n - 1) % degree != 0) {
        let right = if spline { format!("{} or more", degree + 1) } else { format!("{degree} n + 1") };
        return Err(Error::at(&at, format!("{n} control points; {right} are needed for degree {degree}")));
    }
    let step = if spline { 1 } else { degree };
    let points: Vec<[[f32; 3]; 4]> =
        given.windows(degree + 1).step_by(step).map(|w| bezier(w, spline).map(|p| p.to_array())).collect();
    let normals = match (p.tuples::<3>("N", &[Type::Normal])?, kind) {
        (Some((normals, at)), CurveKind::Ribbon) => {
            if normals.len() != points.len() + 1 {
                let (found, wanted) = (normals.len(), points.len() + 1);
                return Err(Error::at(&at, format!("{found} normals; this curve takes {wanted}")));
            }
            normals
        }
        (None, CurveKind::Ribbon) => {
            return Err(Error::at(&p.at, "a ribbon needs \"normal N\"; give one more than it has segments"));
        }
        _ => Vec::new(),
    };
    Ok(Strand { kind, points, widths, normals })
}

/// One segment of `degree + 1` control points as a cubic.
fn bezier(control: &[[f32; 3]], spline: bool) -> [Vec3; 4] {
    let p = |i: usize| Vec3::from(control[i]);
    let third = |a: Vec3, b: Vec3| (2.0 * a + b) / 3.0;
    match (control.len(), spline) {
        (3, spline) => {
            let (mut a, b, mut c) = (p(0), p(1), p(2));
            if spline {
                (a, c) = (0.5 * (a + b), 0.5 * (b + c));
            }
            [a, third(b, a), third(b, c), c]
        }
        (_, false) => [p(0), p(1), p(2), p(3)],
        (_, true) => {
            let knot = |a: Vec3, b: Vec3, c: Vec3| (a + 4.0 * b + c) / 6.0;
            let (a, b, c, d) = (p(0), p(1), p(2), p(3));
            [knot(a, b, c), third(b, c), third(c, b), knot(b, c, d)]
        }
    }
}
