//! Closed triangle meshes, placed and scaled, and points that are inside them for certain.
//!
//! Invariant: every edge of a [`Mesh`] belongs to two triangles, which run along it in opposite directions (tested
//! in `watertight.rs`); rounding moves corners and never parts them.
//! Never: says "inside" of a point from which rounding could let a ray miss; see [`is_inside`].

use glam::{DMat3, DVec3, Vec3};
use std::collections::{HashMap, HashSet};
use std::f64::consts::{PI, TAU};
use weir::accel::{Custom, Ray};

/// A world of triangles alone.
pub(crate) struct Nothing;

impl Custom for Nothing {
    fn bounds(&self, _: u32, _: u32) -> (Vec3, Vec3) {
        unreachable!("there are triangles alone")
    }

    fn intersect(&self, _: u32, _: u32, _: &Ray) -> Option<(f32, f32, f32)> {
        unreachable!("there are triangles alone")
    }

    fn is_opaque(&self, _: u32, _: u32, _: (f32, f32, f32), _: &Ray) -> bool {
        unreachable!("nothing is masked")
    }
}

/// SplitMix64.
pub(crate) struct Random(pub(crate) u64);

impl Random {
    pub(crate) fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// In [0, 1).
    pub(crate) fn unit(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// In [0, n).
    pub(crate) fn below(&mut self, n: usize) -> usize {
        (self.unit() * n as f64) as usize
    }

    /// In the cube [-1, 1)³.
    pub(crate) fn point(&mut self) -> DVec3 {
        DVec3::from_array([(); 3].map(|()| 2.0 * self.unit() - 1.0))
    }
}

/// A closed mesh of about unit size around the zero point.
pub(crate) struct Mesh {
    pub(crate) name: &'static str,
    positions: Vec<DVec3>,
    indices: Vec<[u32; 3]>,
}

/// A mesh as tracers get it.
#[derive(Clone)]
pub(crate) struct Rounded {
    pub(crate) positions: Vec<[f32; 3]>,
    pub(crate) indices: Vec<[u32; 3]>,
}

/// Collects triangles; corners with one key are one corner.
#[derive(Default)]
struct Welder<K> {
    known: HashMap<K, u32>,
    positions: Vec<DVec3>,
    indices: Vec<[u32; 3]>,
}

impl<K: std::hash::Hash + Eq> Welder<K> {
    fn corner(&mut self, key: K, position: impl FnOnce() -> DVec3) -> u32 {
        *self.known.entry(key).or_insert_with(|| {
            self.positions.push(position());
            self.positions.len() as u32 - 1
        })
    }

    /// Four corners in turn; triangles that lost a corner by welding are left out.
    fn quad(&mut self, [a, b, c, d]: [u32; 4]) {
        for t in [[a, b, c], [a, c, d]] {
            if t[0] != t[1] && t[1] != t[2] && t[2] != t[0] {
                self.indices.push(t);
            }
        }
    }

    fn mesh(self, name: &'static str) -> Mesh {
        Mesh { name, positions: self.positions, indices: self.indices }
    }
}

impl Mesh {
    /// An octahedron whose faces were divided into four `levels` times, on the sphere whose radius in direction d
    /// is `radius` of d.
    pub(crate) fn sphere(name: &'static str, levels: u32, mut radius: impl FnMut(DVec3) -> f64) -> Self {
        let mut w = Welder::<[u64; 3]>::default();
        let mut faces: Vec<[DVec3; 3]> = (0..8)
            .map(|octant| {
                let sign = |k: u32| if octant >> k & 1 == 0 { 1.0 } else { -1.0 };
                let [x, y, z] = [DVec3::X * sign(0), DVec3::Y * sign(1), DVec3::Z * sign(2)];
                if sign(0) * sign(1) * sign(2) > 0.0 { [x, y, z] } else { [y, x, z] }
            })
            .collect();
        for _ in 0..levels {
            let divide = |[a, b, c]: [DVec3; 3]| {
                // The same to the bit from both sides of an edge.
                let middle = |p: DVec3, q: DVec3| (p + q).normalize();
                let (ab, bc, ca) = (middle(a, b), middle(b, c), middle(c, a));
                [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
            };
            faces = faces.into_iter().flat_map(divide).collect();
        }
        for face in faces {
            // Plus zero: the two zeros are one corner.
            let corner = face.map(|d| w.corner((d + 0.0).to_array().map(f64::to_bits), || d * radius(d)));
            w.indices.push(corner);
        }
        w.mesh(name)
    }

    /// A box of half extents `half`, its faces grids of `cells`.
    pub(crate) fn block(name: &'static str, cells: [i32; 3], half: DVec3) -> Self {
        let mut w = Welder::<[i32; 3]>::default();
        for axis in 0..3 {
            let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
            for side in [0, cells[axis]] {
                for (i, j) in (0..cells[u]).flat_map(|i| (0..cells[v]).map(move |j| (i, j))) {
                    let mut quad = [(0, 0), (1, 0), (1, 1), (0, 1)].map(|(di, dj)| {
                        let mut at = [0; 3];
                        (at[axis], at[u], at[v]) = (side, i + di, j + dj);
                        let p = DVec3::from_array(
                            [0, 1, 2].map(|k| f64::from(2 * at[k] - cells[k]) / f64::from(cells[k])),
                        );
                        w.corner(at, || p * half)
                    });
                    if side == 0 {
                        quad.reverse();
                    }
                    w.quad(quad);
                }
            }
        }
        w.mesh(name)
    }

    /// A torus of radii 1 and `tube`.
    pub(crate) fn torus(name: &'static str, around: u32, across: u32, tube: f64) -> Self {
        let mut w = Welder::<[u32; 2]>::default();
        for (i, j) in (0..around).flat_map(|i| (0..across).map(move |j| (i, j))) {
            let quad = [(0, 0), (1, 0), (1, 1), (0, 1)].map(|(di, dj)| {
                let (i, j) = ((i + di) % around, (j + dj) % across);
                let (a, b) = (TAU * f64::from(i) / f64::from(around), TAU * f64::from(j) / f64::from(across));
                let r = 1.0 + tube * b.cos();
                w.corner([i, j], || DVec3::new(r * a.cos(), r * a.sin(), tube * b.sin()))
            });
            w.quad(quad);
        }
        w.mesh(name)
    }

    /// A sphere of few rings and many meridians, turned from ring to ring: all triangles are slivers.
    pub(crate) fn slivers(name: &'static str, rings: u32, meridians: u32) -> Self {
        let mut w = Welder::<[u32; 2]>::default();
        for (i, j) in (0..meridians).flat_map(|i| (0..rings).map(move |j| (i, j))) {
            let quad = [(0, 0), (0, 1), (1, 1), (1, 0)].map(|(di, dj)| {
                let (i, j) = ((i + di) % meridians, j + dj);
                let pole = j == 0 || j == rings;
                let a = TAU * (f64::from(i) / f64::from(meridians) + 0.03 * f64::from(j));
                let b = PI * f64::from(j) / f64::from(rings);
                let r = if pole { 0.0 } else { b.sin() };
                w.corner([if pole { 0 } else { i }, j], || DVec3::new(r * a.cos(), r * a.sin(), b.cos()))
            });
            w.quad(quad);
        }
        w.mesh(name)
    }

    /// Scaled, then moved, then rounded.
    pub(crate) fn rounded(&self, scale: f64, offset: DVec3) -> Rounded {
        let mut positions: Vec<[f32; 3]> =
            self.positions.iter().map(|&p| (p * scale + offset).as_vec3().to_array()).collect();
        // Embree reads 16 bytes at the last.
        positions.reserve(1);
        Rounded { positions, indices: self.indices.clone() }
    }
}

impl Rounded {
    pub(crate) fn corners(&self, triangle: usize) -> [DVec3; 3] {
        self.indices[triangle].map(|c| Vec3::from(self.positions[c as usize]).as_dvec3())
    }

    /// Whether rounding has brought most corners together with others.
    pub(crate) fn has_collapsed(&self) -> bool {
        let places: HashSet<[u32; 3]> = self.positions.iter().map(|p| p.map(f32::to_bits)).collect();
        places.len() < self.positions.len() / 2
    }

    /// Edges that do not belong to exactly one triangle on each side.
    pub(crate) fn open_edges(&self) -> usize {
        let mut balance: HashMap<[u32; 2], i32> = HashMap::new();
        for [a, b, c] in &self.indices {
            for edge in [[a, b], [b, c], [c, a]] {
                *balance.entry(edge.map(|&v| v)).or_default() += 1;
            }
        }
        balance.iter().filter(|&(&[a, b], &n)| n != 1 || balance.get(&[b, a]) != Some(&1)).count()
    }
}

/// The part of its triangles' own size by which a point keeps away from them; [`is_inside`] derives it.
pub(crate) const MARGIN: f64 = 1.0 / (1u32 << 20) as f64;

/// Whether rays from `o` must hit `mesh`, in whatever direction.
///
/// The rule: `mesh`, as rounded, winds around `o` a number of times that is not zero, and every triangle is farther
/// away than [`MARGIN`] = 16u of the distance to its farthest corner (u = 2⁻²⁴), and than `slack`.
///
/// Why: a test in f32 that shears corners into the ray's frame works on a mesh whose corners are moved, each by the
/// same rounding for all of its triangles: corner v by no more than 6u·|v − o| along each axis (u for the difference,
/// and 2u·|x| + 3u·|z| for the shear, brought back by another shear of at most 1), which is 10.4u·|v − o| in length.
/// A point of a triangle moves no farther than its farthest corner may. So, while corners go from where they
/// are to where rounding puts them, no triangle passes `o`; the mesh winds around it as before; and a closed surface
/// that does so meets every half line that starts there. `slack` is how far `o` itself is known.
pub(crate) fn is_inside(mesh: &Rounded, o: DVec3, slack: f64) -> bool {
    let mut solid_angle = 0.0;
    for i in 0..mesh.indices.len() {
        let [a, b, c] = mesh.corners(i).map(|p| p - o);
        let lengths = DVec3::new(a.length(), b.length(), c.length());
        if distance(a, b, c) <= MARGIN * lengths.max_element() + slack {
            return false;
        }
        // Van Oosterom and Strackee 1983.
        let (la, lb, lc) = (lengths.x, lengths.y, lengths.z);
        let denominator = la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb;
        solid_angle += 2.0 * a.dot(b.cross(c)).atan2(denominator);
    }
    (solid_angle / (4.0 * PI)).abs().round() >= 1.0
}

/// A point of a triangle: for aim 0 its first corner, for 1 anywhere along its first edge, else anywhere.
pub(crate) fn point_of([a, b, c]: [DVec3; 3], random: &mut Random, aim: usize) -> DVec3 {
    let (s, t) = (random.unit(), random.unit());
    match aim {
        0 => a,
        1 => a.lerp(b, s),
        _ => a + (b - a) * (1.0 - s.sqrt()) + (c - a) * (t * s.sqrt()),
    }
}

/// From the zero point to a triangle.
fn distance(a: DVec3, b: DVec3, c: DVec3) -> f64 {
    let to_edge = |p: DVec3, q: DVec3| {
        let e = q - p;
        let length = e.length_squared();
        let s = if length > 0.0 { (-p.dot(e) / length).clamp(0.0, 1.0) } else { 0.0 };
        (p + e * s).length()
    };
    let edges = to_edge(a, b).min(to_edge(b, c)).min(to_edge(c, a));
    let n = (b - a).cross(c - a);
    let sides = [a.cross(b).dot(n), b.cross(c).dot(n), c.cross(a).dot(n)];
    let above = n.length_squared() > 0.0 && sides.iter().all(|&s| s > 0.0);
    if above { edges.min(a.dot(n).abs() / n.length()) } else { edges }
}

/// From a mesh's own space to the world and back.
#[derive(Clone, Copy)]
pub(crate) struct Placement {
    /// Column-major 3×4, as tracers get it.
    pub(crate) transform: [f32; 12],
    forth: DMat3,
    back: DMat3,
    at: DVec3,
}

impl Placement {
    pub(crate) fn new(turn: DMat3, at: DVec3) -> Self {
        let columns = [turn.x_axis, turn.y_axis, turn.z_axis, at].map(DVec3::as_vec3);
        let forth = DMat3::from_cols(columns[0].as_dvec3(), columns[1].as_dvec3(), columns[2].as_dvec3());
        let mut transform = [0.0; 12];
        for (out, column) in transform.chunks_exact_mut(3).zip(columns) {
            out.copy_from_slice(&column.to_array());
        }
        Self { transform, forth, back: forth.inverse(), at: columns[3].as_dvec3() }
    }

    pub(crate) fn to_world(self, p: DVec3) -> DVec3 {
        self.forth * p + self.at
    }

    pub(crate) fn turned(self, d: DVec3) -> DVec3 {
        self.forth * d
    }

    pub(crate) fn to_object(self, p: DVec3) -> DVec3 {
        self.back * (p - self.at)
    }

    /// How far from [`Self::to_object`] of `p` a tracer's own origin in the mesh's space may be. Elements of the
    /// inverse are rounded (u), as are three products, two sums and the sum with the moved origin: 5u at most of
    /// the sum of all sizes; 8u leaves room for an inverse computed in f32 of a matrix as tame as those here.
    pub(crate) fn slack(self, p: DVec3) -> f64 {
        let sizes = |m: DMat3, v: DVec3| {
            let v = v.abs();
            m.x_axis.abs() * v.x + m.y_axis.abs() * v.y + m.z_axis.abs() * v.z
        };
        0.5 * MARGIN * (sizes(self.back, p) + sizes(self.back, self.at)).length()
    }
}
