use super::*;
use crate::math::Vec3;
use crate::scene::PolygonMesh;
use std::f32::consts::PI;
use std::sync::Arc;

fn subdivide(control: &TriangleMesh, levels: u32) -> Result<TriangleMesh> {
    super::subdivide(&Cage::Loop(Arc::new(control.clone())), levels, &|| false)
}

fn mesh(positions: &[[f32; 3]], indices: &[[u32; 3]]) -> TriangleMesh {
    TriangleMesh { positions: positions.to_vec(), indices: indices.to_vec(), ..TriangleMesh::default() }
}

fn tetrahedron() -> TriangleMesh {
    let p = [[1., 1., 1.], [1., -1., -1.], [-1., 1., -1.], [-1., -1., 1.]];
    mesh(&p, &[[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]])
}

fn icosahedron() -> TriangleMesh {
    let g = (1.0 + 5f32.sqrt()) / 2.0;
    let mut p = Vec::new();
    for (a, b) in [(1.0, g), (-1.0, g), (1.0, -g), (-1.0, -g)] {
        p.extend([[0.0, a, b], [a, b, 0.0], [b, 0.0, a]]);
    }
    let v = |i: usize| Vec3::from(p[i]);
    let mut t = Vec::new();
    for a in 0..12 {
        for b in 0..12 {
            for c in 0..12 {
                let short = |i, j| (v(i).distance(v(j)) - 2.0).abs() < 1e-3;
                let outward = (v(b) - v(a)).cross(v(c) - v(a)).dot(v(a)) > 0.0;
                if a < b && a < c && b != c && short(a, b) && short(b, c) && short(c, a) && outward {
                    t.push([a as u32, b as u32, c as u32]);
                }
            }
        }
    }
    assert_eq!(t.len(), 20);
    mesh(&p, &t)
}

/// An n×n grid of squares, each split in two, in the plane z = 0.
fn plane(n: u32) -> TriangleMesh {
    let row = n + 1;
    let p: Vec<[f32; 3]> = (0..row * row).map(|i| [(i % row) as f32, (i / row) as f32, 0.0]).collect();
    let mut t = Vec::new();
    for y in 0..n {
        for x in 0..n {
            let i = y * row + x;
            t.extend([[i, i + 1, i + row + 1], [i, i + row + 1, i + row]]);
        }
    }
    mesh(&p, &t)
}

fn check_topology(m: &TriangleMesh, euler: i64) {
    let mut edges: Vec<(u32, u32)> = m
        .indices
        .iter()
        .flat_map(|t| [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])])
        .map(|(a, b)| (a.min(b), a.max(b)))
        .collect();
    edges.sort_unstable();
    edges.dedup();
    assert_eq!(m.positions.len() as i64 - edges.len() as i64 + m.indices.len() as i64, euler);
    assert_eq!(m.normals.len(), m.positions.len());
    for t in &m.indices {
        let v = |i: usize| Vec3::from(m.positions[t[i] as usize]);
        let face = (v(1) - v(0)).cross(v(2) - v(0));
        for &i in t {
            assert!(face.dot(Vec3::from(m.normals[i as usize])) > 0.0, "a normal against its face");
        }
    }
}

#[test]
fn control_vertices_reach_the_same_limit_from_every_level() {
    // Valence 3: weight 1/5 a neighbour, whose sum is −p: the limit is p/5.
    // Valence 5: weight 1/10, the neighbours' sum is √5 p: the limit is (½ + √5/10) p.
    for (control, factor) in [(tetrahedron(), 0.2), (icosahedron(), 0.5 + 0.1 * 5f32.sqrt())] {
        for levels in 0..5 {
            let m = subdivide(&control, levels).expect("valid");
            assert_eq!(m.indices.len(), control.indices.len() << (2 * levels));
            check_topology(&m, 2);
            for (p, c) in m.positions.iter().zip(&control.positions) {
                assert!((Vec3::from(*p) - factor * Vec3::from(*c)).length() < 1e-5, "level {levels}: {p:?}");
            }
            for (n, c) in m.normals.iter().zip(&control.positions) {
                assert!((Vec3::from(*n) - Vec3::from(*c).normalize()).length() < 1e-5);
            }
            assert!(m.positions.capacity() > m.positions.len());
        }
    }
}

#[test]
fn an_icosahedron_tends_to_a_near_sphere_and_its_volume_converges() {
    let radii = |levels| {
        let m = subdivide(&icosahedron(), levels).expect("valid");
        let r: Vec<f32> = m.positions.iter().map(|&p| Vec3::from(p).length()).collect();
        let (lo, hi) = r.iter().fold((f32::MAX, 0f32), |(a, b), &r| (a.min(r), b.max(r)));
        let volume: f32 = m
            .indices
            .iter()
            .map(|t| t.map(|i| Vec3::from(m.positions[i as usize])))
            .map(|[a, b, c]| a.dot(b.cross(c)) / 6.0)
            .sum();
        (hi / lo, volume)
    };
    let (ratio, _) = radii(5);
    assert!(ratio < 1.05, "{ratio}");
    // A smooth surface: the error of inscribed triangles falls by four a level.
    let v: Vec<f32> = (2..6).map(|l| radii(l).1).collect();
    let fall = (v[1] - v[0]) / (v[2] - v[1]);
    assert!((3.5..4.5).contains(&fall), "{fall}");
}

#[test]
fn a_regular_plane_stays_a_plane() {
    let m = subdivide(&plane(6), 2).expect("valid");
    check_topology(&m, 1);
    assert!(m.positions.iter().all(|p| p[2] == 0.0 && (0.0..=6.0).contains(&p[0])));
    assert!(m.normals.iter().all(|n| n[2] > 0.9999));
    // Away from the boundary the rules reproduce linear functions: the control vertices stay.
    for y in 2..=4 {
        for x in 2..=4 {
            let p = m.positions[(y * 7 + x) as usize];
            assert!((p[0] - x as f32).abs() < 1e-5 && (p[1] - y as f32).abs() < 1e-5);
        }
    }
    // Straight boundaries stay straight: the middle of each side keeps its place.
    assert!((m.positions[3][0] - 3.0).abs() < 1e-5 && m.positions[3][1] == 0.0);
}

#[test]
fn boundary_vertices_of_every_valence_have_normals() {
    // Fans of 1 to 6 triangles around a boundary vertex.
    for n in 1..=6u32 {
        let mut p = vec![[0f32; 3]];
        p.extend((0..=n).map(|i| {
            let (s, c) = (PI * i as f32 / n.max(2) as f32).sin_cos();
            [c, s, 0.0]
        }));
        let t: Vec<[u32; 3]> = (1..=n).map(|i| [0, i, i + 1]).collect();
        for levels in 0..3 {
            check_topology(&subdivide(&mesh(&p, &t), levels).expect("valid"), 1);
        }
    }
}

#[test]
fn strange_meshes_end_in_a_mesh_or_an_error() {
    let quad = [[0., 0., 0.], [1., 0., 0.], [0., 1., 0.], [0., 0., 1.], [-1., 0., 0.], [0., -1., 0.]];
    let meshes: &[&[[u32; 3]]] = &[
        &[],
        &[[0, 0, 1]],
        // Three triangles at an edge; two of opposite sense; a bow tie; the same one twice.
        &[[0, 1, 2], [1, 0, 3], [0, 1, 4]],
        &[[0, 1, 2], [0, 1, 3]],
        &[[0, 1, 2], [0, 4, 5]],
        &[[0, 1, 2], [0, 1, 2]],
        &[[0, 1, 2], [2, 1, 0]],
    ];
    for t in meshes {
        let m = subdivide(&mesh(&quad, t), 3).expect("a mesh");
        assert!(m.positions.iter().chain(&m.normals).flatten().all(|c| c.is_finite()));
        assert!(m.indices.iter().flatten().all(|&i| (i as usize) < m.positions.len()));
    }
    // A bow tie's middle opens: each wing has its own vertex there.
    let bow = subdivide(&mesh(&quad, &[[0, 1, 2], [0, 4, 5]]), 0).expect("valid");
    assert_eq!(bow.positions.len(), 7);
    assert!(subdivide(&mesh(&quad, &[[0, 1, 6]]), 1).is_err());
    for levels in [14, 16, 40, u32::MAX] {
        assert!(subdivide(&tetrahedron(), levels).is_err());
    }
}

mod catmull_clark {
    use super::*;
    use proptest::prelude::*;

    fn polygons(positions: &[[f32; 3]], faces: &[&[u32]]) -> PolygonMesh {
        let ends = faces.iter().scan(0, |end, face| {
            *end += face.len() as u32;
            Some(*end)
        });
        PolygonMesh { positions: positions.to_vec(), corners: faces.concat(), ends: ends.collect() }
    }

    fn refined(control: &PolygonMesh, levels: u32) -> TriangleMesh {
        subdivision(control, levels).expect("valid")
    }

    fn subdivision(control: &PolygonMesh, levels: u32) -> Result<TriangleMesh> {
        super::super::subdivide(&Cage::CatmullClark(Arc::new(control.clone())), levels, &|| false)
    }

    fn cube() -> PolygonMesh {
        let p: Vec<[f32; 3]> =
            (0..8).map(|i| [0, 1, 2].map(|k| if i >> k & 1 == 1 { 1.0 } else { -1.0 })).collect();
        let faces: [&[u32]; 6] =
            [&[0, 2, 3, 1], &[4, 5, 7, 6], &[0, 1, 5, 4], &[2, 6, 7, 3], &[0, 4, 6, 2], &[1, 3, 7, 5]];
        polygons(&p, &faces)
    }

    /// n×n squares, heights by `z`.
    fn grid(n: u32, z: impl Fn(f32, f32) -> f32) -> PolygonMesh {
        let row = n + 1;
        let at = |i: u32| ((i % row) as f32, (i / row) as f32);
        let p: Vec<[f32; 3]> = (0..row * row).map(at).map(|(x, y)| [x, y, z(x, y)]).collect();
        let squares: Vec<[u32; 4]> =
            (0..n * n).map(|i| i / n * row + i % n).map(|i| [i, i + 1, i + row + 1, i + row]).collect();
        polygons(&p, &squares.iter().map(|s| &s[..]).collect::<Vec<_>>())
    }

    #[test]
    fn a_cubes_corners_go_half_way_to_its_middle() {
        // Valence 3: (9 v + 4 Σ neighbours + Σ opposite) / 24, which are v and −v.
        for levels in 1..6 {
            let m = refined(&cube(), levels);
            assert_eq!(m.indices.len(), 12 << (2 * levels));
            check_topology(&m, 2);
            for ((p, n), c) in m.positions.iter().zip(&m.normals).zip(&cube().positions) {
                let c = Vec3::from(*c);
                assert!((Vec3::from(*p) - 0.5 * c).length() < 1e-6, "level {levels}: {p:?}");
                assert!((Vec3::from(*n) - c.normalize()).length() < 1e-5);
            }
            assert!(m.positions.capacity() > m.positions.len());
        }
    }

    #[test]
    fn squares_become_the_bicubic_spline() {
        // The spline of coefficients x² is x² + 1/3: Σ w (x + d)² with w = (1, 4, 1)/6.
        for levels in 1..5 {
            let m = refined(&grid(6, |x, _| x * x), levels);
            check_topology(&m, 1);
            let mut seen = 0;
            for (&[x, y, z], &n) in m.positions.iter().zip(&m.normals) {
                if x.min(y) < 1.0 || x.max(y) > 5.0 {
                    continue;
                }
                seen += 1;
                assert!((z - (x * x + 1.0 / 3.0)).abs() < 2e-5, "level {levels}: {z} at {x}");
                let normal = Vec3::new(-2.0 * x, 0.0, 1.0).normalize();
                assert!((Vec3::from(n) - normal).length() < 1e-4, "level {levels}: {n:?} at {x}");
            }
            assert_eq!(seen, ((4 << levels) + 1u32).pow(2));
        }
    }

    /// Quadrangles around vertex 0, all the way round or from one side to the other.
    fn fan(n: u32, closed: bool, heights: &[f32]) -> PolygonMesh {
        let (arms, angle) = if closed { (n, 2.0 * PI) } else { (n + 1, PI) };
        let at = |i: f32, r: f32| {
            let (s, c) = (angle * i / n.max(2) as f32).sin_cos();
            [r * c, r * s, 0.0]
        };
        let mut p = vec![[0f32; 3]];
        p.extend((0..arms).map(|i| at(i as f32, 1.0)));
        p.extend((0..n).map(|i| at(i as f32 + 0.5, 1.4)));
        p.iter_mut().zip(heights).for_each(|(p, h)| p[2] = *h);
        let faces: Vec<[u32; 4]> = (0..n).map(|i| [0, 1 + i, 1 + arms + i, 1 + (i + 1) % arms]).collect();
        polygons(&p, &faces.iter().map(|f| &f[..]).collect::<Vec<_>>())
    }

    proptest! {
        /// Limits are the same from every level, which only the right weights are. Rounding moves a point by 5e-7 a step, and a
        /// normal by that over what is left of the fan, a quarter a level at the least.
        #[test]
        fn a_vertex_has_the_same_limit_from_every_level(
            n in 1u32..8,
            closed in any::<bool>(),
            heights in prop::collection::vec(-0.3f32..0.3, 16),
        ) {
            let n = if closed { n.max(2) } else { n };
            let mut control = fan(n, closed, &heights);
            // Weights that do not sum to 0 would show where it is.
            for p in &mut control.positions {
                *p = [p[0] + 3.0, p[1] - 2.0, p[2] + 5.0];
            }
            let first = refined(&control, 1);
            for levels in 2..5 {
                let m = refined(&control, levels);
                let far = (Vec3::from(m.positions[0]) - Vec3::from(first.positions[0])).length();
                prop_assert!(far < 4e-6, "level {}: {}", levels, far);
                let turned = (Vec3::from(m.normals[0]) - Vec3::from(first.normals[0])).length();
                prop_assert!(turned < 1e-3, "level {}: {}", levels, turned);
            }
        }
    }

    #[test]
    fn flat_fans_stay_flat_and_face_the_same_way() {
        for (n, closed) in (1..8).map(|n| (n, false)).chain((2..8).map(|n| (n, true))) {
            for levels in 1..4 {
                let m = refined(&fan(n, closed, &[]), levels);
                check_topology(&m, 1);
                assert!(m.positions.iter().all(|p| p[2] == 0.0));
                assert!(m.normals.iter().all(|n| n[2] > 0.9999), "{n} faces");
            }
        }
    }

    #[test]
    fn faces_have_any_number_of_corners() {
        // Prisms over 3 to 9 sides: two faces and as many squares.
        for n in 3..10u32 {
            let mut p = Vec::new();
            for z in [0.0, 1.0] {
                p.extend((0..n).map(|i| {
                    let (s, c) = (2.0 * PI * i as f32 / n as f32).sin_cos();
                    [c, s, z]
                }));
            }
            let (bottom, top): (Vec<u32>, Vec<u32>) = ((0..n).rev().collect(), (n..2 * n).collect());
            let walls: Vec<[u32; 4]> = (0..n).map(|i| [i, (i + 1) % n, n + (i + 1) % n, n + i]).collect();
            let faces: Vec<&[u32]> =
                [&bottom[..], &top[..]].into_iter().chain(walls.iter().map(|w| &w[..])).collect();
            let control = polygons(&p, &faces);
            for levels in 1..4 {
                let m = refined(&control, levels);
                assert_eq!(m.indices.len() as u32, (12 * n) << (2 * (levels - 1)));
                check_topology(&m, 2);
                // The middle of the top is the mean of what surrounds it, straight up.
                let middle = m.positions[2 * n as usize + 1];
                assert!(middle[0].abs() + middle[1].abs() < 1e-6, "{middle:?}");
                assert!(m.normals[2 * n as usize + 1][2] > 0.9999);
            }
        }
    }

    #[test]
    fn strange_meshes_end_in_a_mesh_or_an_error() {
        let p = [[0., 0., 0.], [1., 0., 0.], [0., 1., 0.], [0., 0., 1.], [-1., 0., 0.], [0., -1., 0.]];
        let meshes: &[&[&[u32]]] = &[
            &[],
            &[&[0, 0, 1, 2]],
            &[&[0, 1, 0, 2]],
            // Three faces at an edge; two of opposite sense; a bow tie; the same one twice; its back.
            &[&[0, 1, 2, 3], &[1, 0, 3], &[0, 1, 4]],
            &[&[0, 1, 2], &[0, 1, 3, 5]],
            &[&[0, 1, 2], &[0, 4, 5, 3]],
            &[&[0, 1, 2, 3], &[0, 1, 2, 3]],
            &[&[0, 1, 2, 3], &[3, 2, 1, 0]],
        ];
        for faces in meshes {
            let m = refined(&polygons(&p, faces), 3);
            assert!(m.positions.iter().chain(&m.normals).flatten().all(|c| c.is_finite()), "{faces:?}");
            assert!(m.indices.iter().flatten().all(|&i| (i as usize) < m.positions.len()));
        }
        assert!(subdivision(&polygons(&p, &[&[0, 1, 6]]), 1).is_err());
        for levels in [14, 16, 40, u32::MAX] {
            assert!(subdivision(&cube(), levels).is_err());
        }
    }
}
