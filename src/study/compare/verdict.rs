//! What a voice may say of one primitive: that it is hit for certain, may be, or cannot be, and between which distances.
//! Invariant: derived from the exact meeting and the bounds on rounding alone. Never looks at an answer.

use super::bounds::{BoxInterval, LocalRay, Meeting, Voice};
use crate::accel::Ray;
use crate::math::DVec3;

/// Why a hit is not certain.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Doubt {
    /// The ray passes an edge or a corner within rounding.
    Edge,
    /// At one end of the ray's range within rounding.
    Range,
    /// The triangle is seen edge-on within rounding.
    Grazing,
    /// The triangle has no area.
    Degenerate,
    /// The mask differs within rounding.
    Alpha,
    /// The edge of a shape that is no triangle, or a grazing ray at it.
    Silhouette,
}

/// What a voice may say.
#[derive(Clone, Copy, Debug)]
pub(super) struct Verdict {
    /// Least distance.
    pub(super) lo: f64,
    /// Greatest distance.
    pub(super) hi: f64,
    /// Why it may say that there is no hit.
    pub(super) doubt: Option<Doubt>,
}

impl Verdict {
    /// Whether a hit at `t` may be said.
    pub(super) fn allows(&self, t: f32) -> bool {
        (self.lo..=self.hi).contains(&f64::from(t))
    }
}

/// Of a triangle; `None` where no hit may be said.
pub(super) fn triangle(
    voice: Voice,
    ray: &Ray,
    local: &LocalRay,
    meeting: &Meeting,
    corners: [DVec3; 3],
) -> Option<Verdict> {
    let e = meeting.errors(voice, local);
    let may_be = |sign: f64| (0..3).all(|i| meeting.w[i] * sign >= -e.w[i]);
    let facing = meeting.den.abs() > e.den;
    let possible = if facing { may_be(meeting.den.signum()) } else { may_be(1.0) || may_be(-1.0) };
    if !possible {
        return None;
    }
    let (mut lo, mut hi) = if voice == Voice::Native || facing {
        (meeting.t - e.t, meeting.t + e.t)
    } else {
        (f64::NEG_INFINITY, f64::INFINITY)
    };
    if lo.is_nan() || hi.is_nan() {
        (lo, hi) = (f64::NEG_INFINITY, f64::INFINITY);
    }
    if voice == Voice::Native {
        (lo, hi) = BoxInterval::new(local, corners).hold(lo, hi);
    }
    let (t_min, t_max) = (f64::from(ray.t_min), f64::from(ray.t_max));
    if hi <= t_min || lo > t_max {
        return None;
    }
    let doubt = if meeting.n == DVec3::ZERO {
        Some(Doubt::Degenerate)
    } else if !facing {
        Some(Doubt::Grazing)
    } else if lo <= t_min || hi >= t_max {
        Some(Doubt::Range)
    } else if (0..3).any(|i| meeting.w[i].abs() <= e.w[i]) {
        Some(Doubt::Edge)
    } else {
        None
    };
    Some(Verdict { lo: lo.max(t_min), hi: hi.min(t_max), doubt })
}
