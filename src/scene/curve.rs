//! Curves as a scene gives them: cubic Bézier segments with widths.
//!
//! Invariant: a strand has at least one segment, and the numbers of its points, widths and normals fit each other.
//! Never says how finely a curve is drawn.

/// What stands around a curve.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum CurveKind {
    /// In pbrt a strip that turns to every ray.
    #[default]
    Flat,
    /// A tube.
    Cylinder,
    /// A strip with normals of its own.
    Ribbon,
}

/// One curve: segments that follow each other.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Strand {
    /// What stands around it.
    pub kind: CurveKind,
    /// Four control points a segment.
    pub points: Vec<[[f32; 3]; 4]>,
    /// Width at both ends; between them in proportion to the segments.
    pub widths: [f32; 2],
    /// One more than segments for a ribbon; else empty.
    pub normals: Vec<[f32; 3]>,
}

impl Strand {
    /// Bytes of its tables.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        (size_of::<Self>() + 48 * self.points.len() + 12 * self.normals.len()) as u64
    }
}
