use super::super::testing::{Rng, Z_LIMIT, chi_squared_z};
use super::*;

fn triangle(rng: &mut Rng, size: f32, two_sided: bool) -> ([Vec3; 3], LightBounds) {
    let at = rng.direction() * 10.0 * rng.f32();
    let v = [at + rng.direction() * size, at + rng.direction() * size, at + rng.direction() * size];
    let cross = (v[1] - v[0]).cross(v[2] - v[0]);
    let n = cross.normalize_or(Vec3::Z);
    (v, LightBounds::flat(&v, n, cross.length() * (0.1 + rng.f32()), two_sided))
}

fn mixed(rng: &mut Rng, count: usize) -> Vec<LightBounds> {
    (0..count)
        .map(|i| match i % 5 {
            0 => LightBounds::round(rng.direction() * 8.0, Vec3::splat(9.0), rng.f32() + 0.1),
            1 => {
                let p = rng.direction() * 8.0;
                LightBounds::round(p, p, rng.f32() + 0.1)
            }
            2 => LightBounds::spot(rng.direction() * 9.0, rng.direction(), rng.f32() + 0.1, 0.9, 0.7),
            k => triangle(rng, 0.5, k == 3).1,
        })
        .map(|b| LightBounds { min: b.min.min(b.max), max: b.min.max(b.max), ..b })
        .collect()
}

#[test]
fn a_union_of_cones_holds_both() {
    let mut rng = Rng::new(32);
    for _ in 0..100_000 {
        let (a, b) = (rng.direction(), rng.direction());
        let b = if rng.f32() < 0.3 { (a + b * 0.1).normalize() } else { b };
        let (ca, cb) = (2.0 * rng.f32() - 1.0, 2.0 * rng.f32() - 1.0);
        let (axis, cos) = union_cones(a, ca, b, cb);
        let theta = cos.acos();
        let slack = 2e-3;
        let holds = |w: Vec3, c: f32| cos <= -1.0 || angle(axis, w) + c.acos() <= theta + slack;
        assert!((axis.length() - 1.0).abs() < 1e-5 && holds(a, ca) && holds(b, cb), "{a} {ca} {b} {cb}");
    }
}

#[test]
fn probabilities_match_frequencies_and_sum_with_refusals_to_one() {
    let mut rng = Rng::new(33);
    for round in 0..6 {
        let lights = mixed(&mut rng, [1, 2, 7, 60, 300, 300][round]);
        let tree = LightTree::new(&lights).expect("power");
        let p = rng.direction() * 7.0;
        let n = if round == 4 { Vec3::ZERO } else { rng.direction() };
        const COUNT: usize = 200_000;
        let mut observed = vec![0.0; lights.len() + 1];
        for _ in 0..COUNT {
            match tree.sample(p, n, rng.f32()) {
                Some((i, pmf)) => {
                    assert_eq!(pmf, tree.pmf(p, n, i));
                    assert!(pmf > 0.0);
                    observed[i] += 1.0;
                }
                None => observed[lights.len()] += 1.0,
            }
        }
        let mut expected: Vec<f64> =
            (0..lights.len()).map(|i| f64::from(tree.pmf(p, n, i)) * COUNT as f64).collect();
        let sum = expected.iter().sum::<f64>();
        assert!(sum <= COUNT as f64 * (1.0 + 1e-5));
        expected.push((COUNT as f64 - sum).max(0.0));
        if expected.iter().filter(|&&e| e > 0.0).count() > 1 {
            assert!(chi_squared_z(&observed, &expected) < Z_LIMIT, "round {round}");
        }
    }
    // Points emit everywhere: nothing may be refused.
    let lights: Vec<LightBounds> = (0..500)
        .map(|_| {
            let p = rng.direction() * rng.f32();
            LightBounds::round(p, p, rng.f32())
        })
        .collect();
    let tree = LightTree::new(&lights).expect("power");
    for _ in 0..20 {
        let (p, n) = (rng.direction() * 2.0 * rng.f32(), rng.direction());
        let sum: f64 = (0..lights.len()).map(|i| f64::from(tree.pmf(p, n, i))).sum();
        assert!((sum - 1.0).abs() < 1e-5, "{sum}");
    }
}

#[test]
fn whatever_contributes_has_a_chance() {
    let mut rng = Rng::new(34);
    for round in 0..400 {
        let (size, two_sided) = (10f32.powf(rng.f32() * 5.0 - 4.0), round % 3 == 0);
        let drawn: Vec<_> = (0..1 + round % 40).map(|_| triangle(&mut rng, size, two_sided)).collect();
        let lights: Vec<LightBounds> = drawn.iter().map(|d| d.1).collect();
        let Some(tree) = LightTree::new(&lights) else { continue };
        for _ in 0..50 {
            // Also points next to a light and in its plane.
            let (v, b) = &drawn[(rng.u64() % drawn.len() as u64) as usize];
            let near = v[0].lerp(v[1], 3.0 * rng.f32()).lerp(v[2], 2.0 * rng.f32() - 0.5);
            let p = match rng.u64() % 3 {
                0 => rng.direction() * 10.0,
                1 => near + b.axis * size * rng.f32() * 1e-3,
                _ => near + rng.direction() * size * rng.f32(),
            };
            let n = rng.direction();
            for (i, (v, b)) in drawn.iter().enumerate() {
                let sends = (0..3).any(|k| {
                    let to = (p - v[k]).as_dvec3();
                    let cos = to.dot(b.axis.as_dvec3()) / to.length();
                    cos > 1e-6 || (b.two_sided && cos < -1e-6)
                });
                if sends && b.usable() {
                    assert!(tree.pmf(p, n, i) > 0.0, "round {round}, light {i}, {p} {n} {b:?}");
                }
            }
        }
    }
    // Spots: every point of the cone.
    for _ in 0..20_000 {
        let (start, end) = (rng.f32() * 2.0 - 1.0, rng.f32());
        let end = -1.0 + (start + 1.0) * end;
        let (at, axis) = (rng.direction() * 3.0, rng.direction());
        let tree = LightTree::new(&[LightBounds::spot(at, axis, 1.0, start, end)]).expect("power");
        let p = at + rng.direction() * rng.f32();
        if (p - at).normalize().dot(axis) > end + 1e-6 {
            assert_eq!(tree.pmf(p, Vec3::Z, 0), 1.0, "{start} {end}");
        }
    }
}

#[test]
fn the_near_light_is_preferred_and_the_one_turned_away_is_not_chosen() {
    let square = |z: f32, n: Vec3| {
        let v = [Vec3::new(-1.0, -1.0, z), Vec3::new(1.0, -1.0, z), Vec3::new(0.0, 1.0, z)];
        LightBounds::flat(&v, n, 1.0, false)
    };
    let lights = [square(2.0, Vec3::NEG_Z), square(20.0, Vec3::NEG_Z), square(3.0, Vec3::Z)];
    let tree = LightTree::new(&lights).expect("power");
    let pmf = |i| tree.pmf(Vec3::ZERO, Vec3::Z, i);
    assert!(pmf(0) > 0.9 && pmf(1) > 0.0 && pmf(1) < 0.1 && pmf(2) == 0.0);
}

#[test]
fn lights_in_one_place_and_lights_without_power() {
    let p = Vec3::ONE;
    let mut lights = vec![LightBounds::round(p, p, 1.0); 1000];
    lights[3].power = 0.0;
    lights[4].power = f32::NAN;
    lights[5].min.x = f32::INFINITY;
    let tree = LightTree::new(&lights).expect("power");
    let pmf = |i| tree.pmf(Vec3::ZERO, Vec3::ZERO, i);
    assert_eq!((pmf(3), pmf(4), pmf(5), pmf(5000)), (0.0, 0.0, 0.0, 0.0));
    assert!((pmf(0) * 997.0 - 1.0).abs() < 1e-3);
    assert!(tree.sample(p, Vec3::ZERO, 0.5).is_none_or(|(_, pmf)| pmf.is_finite()));
    assert!(LightTree::new(&[]).is_none() && LightTree::new(&lights[3..5]).is_none());
    assert!(tree.bytes() < 1000 * 128);
}
