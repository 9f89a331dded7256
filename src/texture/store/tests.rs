use super::*;
use crate::error::Location;
use crate::scene::{TextureFilter, Wrap};
use crate::texture::encoding;
use crate::texture::filter::FILTERS;

const ID: ImageId = ImageId(0);

fn image(width: u32, height: u32, channels: u8, pixels: Pixels) -> ImageData {
    ImageData { width, height, channels, pixels }
}

fn sampler(filter: TextureFilter, wrap: Wrap) -> Sampler {
    Sampler { filter, wrap, channels: Channels::Rgb }
}

/// An independent bilinear reference over a row-major image, pbrt's conventions.
fn reference(data: &[f32], w: i64, h: i64, uv: [f64; 2], wrap: Wrap) -> f64 {
    let (x, y) = (uv[0] * w as f64 - 0.5, (1.0 - uv[1]) * h as f64 - 0.5);
    let at = |x: i64, y: i64| -> f64 {
        let (x, y) = match wrap {
            Wrap::Repeat => (x.rem_euclid(w), y.rem_euclid(h)),
            Wrap::Clamp => (x.clamp(0, w - 1), y.clamp(0, h - 1)),
            _ if x < 0 || y < 0 || x >= w || y >= h => return 0.0,
            _ => (x, y),
        };
        f64::from(data[(y * w + x) as usize])
    };
    let (x0, y0) = (x.floor() as i64, y.floor() as i64);
    let (tx, ty) = (x - x.floor(), y - y.floor());
    (1.0 - ty) * ((1.0 - tx) * at(x0, y0) + tx * at(x0 + 1, y0))
        + ty * ((1.0 - tx) * at(x0, y0 + 1) + tx * at(x0 + 1, y0 + 1))
}

fn noise(n: usize) -> Vec<u8> {
    let mut s = 0x9e37_79b9_u32;
    (0..n)
        .map(|_| {
            s ^= s << 13;
            s ^= s >> 17;
            s ^= s << 5;
            (s >> 24) as u8
        })
        .collect()
}

#[test]
fn bilinear_agrees_with_a_plain_reference_for_every_kind_and_wrap() {
    let (w, h) = (13u32, 6u32);
    let bytes = noise((w * h) as usize);
    let linear: Vec<f32> = bytes.iter().map(|&b| f32::from(b) / 255.0).collect();
    let rgb: Vec<u8> = bytes.iter().flat_map(|&b| [b, 255 - b, b / 2]).collect();
    let wide: Vec<u16> = bytes.iter().map(|&b| u16::from(b) * 257).collect();
    let kinds = [
        (image(w, h, 1, Pixels::U8(bytes.clone())), Kind::Grey8, 1e-6),
        (image(w, h, 3, Pixels::U8(rgb)), Kind::Rgba8, 1e-6),
        (image(w, h, 1, Pixels::U16(wide)), Kind::GreyHalf, 1e-3),
        (image(w, h, 1, Pixels::F32(linear.clone())), Kind::GreyFloat, 1e-6),
    ];
    for (data, kind, tolerance) in kinds {
        let store = TextureStore::from_data(data, Encoding::Linear, false).expect("memory");
        assert_eq!(whole(&store).kind, kind);
        for wrap in [Wrap::Repeat, Wrap::Clamp, Wrap::Black] {
            for i in 0..2000 {
                let uv = Vec2::new(i as f32 * 0.00317 - 2.5, (i * 7919 % 2000) as f32 * 0.0021 - 2.0);
                let got = store.lookup(ID, uv, Footprint::default(), sampler(TextureFilter::Bilinear, wrap));
                let want = reference(&linear, i64::from(w), i64::from(h), [uv.x.into(), uv.y.into()], wrap);
                // Beyond the store's own precision only uv's rounding in f32 matters: 13 texels × 4e-7.
                assert!(
                    (f64::from(got.x) - want).abs() < tolerance + 1e-5,
                    "{kind:?} {wrap:?} {uv} {got} {want}"
                );
            }
        }
    }
}

#[test]
fn the_first_row_of_a_file_is_at_the_top_and_texel_centres_are_exact() {
    let data = image(2, 2, 1, Pixels::U8(vec![10, 20, 30, 40]));
    let store = TextureStore::from_data(data, Encoding::Linear, false).expect("memory");
    for filter in [TextureFilter::Point, TextureFilter::Bilinear] {
        for (uv, value) in
            [([0.25, 0.75], 10.), ([0.75, 0.75], 20.), ([0.25, 0.25], 30.), ([0.75, 0.25], 40.)]
        {
            let c = store.lookup(ID, uv.into(), Footprint::default(), sampler(filter, Wrap::Repeat));
            assert!((c.x * 255.0 - value).abs() < 1e-4);
        }
    }
}

#[test]
fn averaging_happens_after_decoding() {
    let data = image(2, 1, 1, Pixels::U8(vec![0, 255]));
    let store = TextureStore::from_data(data, Encoding::Srgb, true).expect("memory");
    let mid = store.lookup(ID, Vec2::splat(0.5), Footprint::default(), Sampler::default());
    assert!((mid.x - 0.5).abs() < 1e-6);
    let wide = Footprint { duv_dx: Vec2::X, duv_dy: Vec2::Y, ..Footprint::default() };
    let all = store.lookup(ID, Vec2::splat(0.2), wide, Sampler::default());
    // The coarse level is stored at 8 bits again: half a step of sRGB at 0.5.
    assert!((all.x - 0.5).abs() < 0.003, "{all}");
}

#[test]
fn channels_choose_rgb_average_or_alpha() {
    let data = image(1, 1, 4, Pixels::U8(vec![30, 60, 90, 51]));
    let store = TextureStore::from_data(data, Encoding::Linear, false).expect("memory");
    let get = |store: &TextureStore, channels| {
        let s = Sampler { channels, ..Sampler::default() };
        store.lookup(ID, Vec2::ZERO, Footprint::default(), s) * 255.0
    };
    assert!((get(&store, Channels::Rgb) - Rgb::new(30., 60., 90.)).abs().max_element() < 1e-4);
    assert!((get(&store, Channels::Average).x - 60.0).abs() < 1e-4);
    assert!((get(&store, Channels::Alpha).x - 51.0).abs() < 1e-4);
    // Opaque throughout counts as no alpha, as in pbrt.
    let data = image(1, 1, 4, Pixels::U8(vec![30, 60, 90, 255]));
    let store = TextureStore::from_data(data, Encoding::Linear, false).expect("memory");
    assert!((get(&store, Channels::Alpha).x - 60.0).abs() < 1e-4);
}

#[test]
fn a_footprint_reads_the_level_of_its_size() {
    // 64² image whose texels alternate: level 0 shows 0 and 1, every coarser level ½.
    let texels: Vec<f32> = (0..64 * 64).map(|i| ((i + i / 64) % 2) as f32).collect();
    let data = image(64, 64, 1, Pixels::F32(texels));
    let store = TextureStore::from_data(data, Encoding::Linear, true).expect("memory");
    let at = Vec2::splat(0.5 / 64.0);
    let get = |filter, texels: f32| {
        let d = texels / 64.0;
        let f = Footprint { duv_dx: Vec2::new(d, 0.0), duv_dy: Vec2::new(0.0, d), ..Footprint::default() };
        store.lookup(ID, at, f, sampler(filter, Wrap::Repeat)).x
    };
    use TextureFilter::{Bilinear, Ewa, Point, Trilinear};
    let fine = (63 % 2) as f32;
    for filter in [Point, Bilinear, Trilinear] {
        assert_eq!(get(filter, 0.0), fine, "{filter:?}");
        assert_eq!(get(filter, 0.9), fine, "{filter:?}");
        assert!((get(filter, 3.0) - 0.5).abs() < 1e-6, "{filter:?}");
    }
    assert!((get(Ewa, 6.0) - 0.5).abs() < 1e-3);
}

#[test]
fn without_levels_every_footprint_reads_the_finest() {
    let data = image(64, 64, 3, Pixels::U8(noise(64 * 64 * 3)));
    let one = TextureStore::from_data(data.clone(), Encoding::Srgb, false).expect("memory");
    let all = TextureStore::from_data(data, Encoding::Srgb, true).expect("memory");
    assert_eq!(one.bytes(), 64 * 64 * 4);
    assert!(all.bytes() < 64 * 64 * 4 * 4 / 3 + 1024);
    let wide = Footprint { duv_dx: Vec2::splat(0.3), duv_dy: Vec2::splat(-0.1), ..Footprint::default() };
    for i in 0..100 {
        let uv = Vec2::new(i as f32 * 0.013, i as f32 * 0.071);
        let s = Sampler::default();
        assert_eq!(one.lookup(ID, uv, wide, s), all.lookup(ID, uv, Footprint::default(), s));
    }
}

#[test]
fn the_mean_survives_all_levels_at_odd_sizes() {
    let (w, h) = (37u32, 11u32);
    let texels: Vec<f32> = noise((w * h) as usize).iter().map(|&b| f32::from(b) / 255.0 + 0.001).collect();
    let mean = texels.iter().sum::<f32>() / texels.len() as f32;
    let store =
        TextureStore::from_data(image(w, h, 1, Pixels::F32(texels)), Encoding::Linear, true).expect("memory");
    let wide = Footprint { duv_dx: Vec2::X, duv_dy: Vec2::Y, ..Footprint::default() };
    for filter in [TextureFilter::Bilinear, TextureFilter::Trilinear] {
        let all = store.lookup(ID, Vec2::ZERO, wide, sampler(filter, Wrap::Repeat));
        assert!((all.x - mean).abs() < 1e-5 * mean, "{} {mean}", all.x);
    }
}

#[test]
fn one_colour_stays_one_colour_for_every_footprint() {
    // OpenImageIO's testtex idea: eccentricities 1 to 32 at all angles.
    let rgb = [200u8, 100, 7];
    let data = image(61, 47, 3, Pixels::U8(rgb.repeat(61 * 47)));
    let store = TextureStore::from_data(data, Encoding::Srgb, true).expect("memory");
    let want = Rgb::from_array(rgb.map(|b| encoding::table8(Encoding::Srgb)[b as usize]));
    for filter in FILTERS {
        for step in 0..512 {
            let angle = Vec2::from_angle(step as f32 * 0.4);
            let short = 2f32.powi(step % 12 - 11);
            let long = short * (1 << (step / 12 % 6)) as f32;
            let f = Footprint { duv_dx: angle * long, duv_dy: angle.perp() * short, ..Footprint::default() };
            let uv = Vec2::new(step as f32 * 0.37, -0.61 * step as f32);
            for wrap in [Wrap::Repeat, Wrap::Clamp] {
                let c = store.lookup(ID, uv, f, sampler(filter, wrap));
                assert!((c - want).abs().max_element() < 1e-6, "{filter:?} {f:?} {c}");
            }
        }
    }
}

#[test]
fn ewa_averages_along_its_long_axis_only() {
    // Vertical stripes one texel wide.
    let texels: Vec<f32> = (0..64 * 64).map(|i| (i % 2) as f32).collect();
    let store = TextureStore::from_data(image(64, 64, 1, Pixels::F32(texels)), Encoding::Linear, true)
        .expect("memory");
    let s = sampler(TextureFilter::Ewa, Wrap::Repeat);
    let px = 1.0 / 64.0;
    let (thin, long) = (0.05 * px, 0.4 * px);
    let uv = Vec2::new(10.5 * px, 10.5 * px);
    let along = Footprint { duv_dx: Vec2::Y * long, duv_dy: Vec2::X * thin, ..Footprint::default() };
    let across = Footprint { duv_dx: Vec2::X * (8.0 * px), duv_dy: Vec2::Y * px, ..Footprint::default() };
    assert!(store.lookup(ID, uv, along, s).x < 0.1);
    assert!((store.lookup(ID, uv, across, s).x - 0.5).abs() < 0.02);
}

#[test]
fn hostile_coordinates_and_footprints_give_finite_values() {
    let store =
        TextureStore::from_data(image(5, 3, 3, Pixels::U8(noise(45))), Encoding::Srgb, true).expect("memory");
    let odd = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX, f32::MIN, 1e-40, -0.0, 3e9, -1e-9];
    for &a in &odd {
        for &b in &odd {
            for filter in FILTERS {
                for wrap in [Wrap::Repeat, Wrap::Black, Wrap::Clamp, Wrap::OctahedralSphere] {
                    for f in [Vec2::new(a, b), Vec2::new(b, 1e-3), Vec2::new(0.1, 0.2)] {
                        let f = Footprint { duv_dx: f, duv_dy: Vec2::new(a, 1e-3), ..Footprint::default() };
                        let c = store.lookup(ID, Vec2::new(a, b), f, sampler(filter, wrap));
                        assert!(
                            c.is_finite() && c.min_element() >= 0.0 && c.max_element() <= 1.0,
                            "{c} {a} {b} {f:?}"
                        );
                    }
                }
            }
        }
    }
    assert_eq!(store.lookup(ImageId(9), Vec2::ZERO, Footprint::default(), Sampler::default()), Rgb::ZERO);
}

#[test]
fn bad_texels_of_float_images_become_finite() {
    let v = vec![f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e30];
    let store =
        TextureStore::from_data(image(4, 1, 1, Pixels::F32(v)), Encoding::Linear, false).expect("memory");
    let got: Vec<f32> = (0..4)
        .map(|i| {
            let uv = Vec2::new((i as f32 + 0.5) / 4.0, 0.5);
            store.lookup(ID, uv, Footprint::default(), sampler(TextureFilter::Point, Wrap::Clamp)).x
        })
        .collect();
    assert_eq!(got, [0.0, 65504.0, -65504.0, 1e30]);
}

#[test]
fn an_unused_image_is_not_opened_and_a_missing_one_names_its_place() {
    let at = Location { line: 7, column: 3, ..Location::whole("scene.pbrt") };
    let source = ImageSource { path: "nowhere.png".into(), encoding: Encoding::Srgb, named: false, at };
    let load = |sources: &[ImageSource], needs: &[ImageNeeds]| {
        TextureStore::load(sources, needs, &TextureOptions::default(), Watch::nobody())
    };
    let need = |used| [ImageNeeds { used, ..ImageNeeds::default() }];
    assert!(load(std::slice::from_ref(&source), &need(false)).is_ok());
    let Err(e) = load(&[source], &need(true)) else { panic!("a missing file was read") };
    assert!(e.to_string().starts_with("scene.pbrt:7:3: image nowhere.png: "), "{e}");
    assert_eq!(e.exit_code(), 2);
}

/// The store's only image, which is in memory as a whole.
fn whole(store: &TextureStore) -> &Stored {
    match &store.images[0] {
        Some(Image::Whole(image)) => image,
        _ => panic!("not in memory as a whole"),
    }
}

/// Not inlined, as the call from shading is not.
#[inline(never)]
fn one_lookup(store: &TextureStore, uv: Vec2) -> Rgb {
    store.lookup(ID, uv, Footprint::default(), Sampler::default())
}

#[test]
#[ignore = "a measurement: cargo test --release lookup_speed -- --ignored --nocapture"]
fn lookup_speed() {
    let n = 4096u32;
    let rgb = TextureStore::from_data(
        image(n, n, 3, Pixels::U8(noise((n * n * 3) as usize))),
        Encoding::Srgb,
        false,
    )
    .expect("memory");
    let small =
        TextureStore::from_data(image(64, 64, 3, Pixels::U8(noise(64 * 64 * 3))), Encoding::Srgb, false)
            .expect("memory");
    let uvs: Vec<Vec2> = {
        let mut s = 1u64;
        let mut next = || {
            s = s.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (s >> 40) as f32 / (1u64 << 24) as f32
        };
        (0..1 << 22).map(|_| Vec2::new(next(), next())).collect()
    };
    for (name, store) in [("4096² RGB8", &rgb), ("64² RGB8", &small)] {
        for chained in [false, true] {
            // The quietest batches count: the machine may be busy with other work.
            let mut times = Vec::new();
            let mut sum = Rgb::ZERO;
            for batch in uvs.chunks(1 << 12) {
                let start = std::time::Instant::now();
                for &uv in batch {
                    // Chained: the next address waits for this value, as a path's next bounce does.
                    let uv = if chained { uv + sum.x * 1e-30 } else { uv };
                    sum += one_lookup(store, uv);
                }
                times.push(start.elapsed().as_secs_f64() * 1e9 / batch.len() as f64);
            }
            times.sort_by(f64::total_cmp);
            let kind = if chained { "dependent" } else { "independent" };
            let (best, median) = (times[times.len() / 20], times[times.len() / 2]);
            println!("{name}, {kind}: {best:.1} ns (5 %), {median:.1} ns (median) a bilinear lookup {sum}");
        }
    }
    // What one random read of a cache line costs here and now, to hold the above against.
    let image = whole(&rgb);
    let texels = image.levels[0].texels::<Rgba8>(&image.memory);
    let mut times = Vec::new();
    let mut sum = 0u64;
    for batch in uvs.chunks(1 << 12) {
        let start = std::time::Instant::now();
        for uv in batch {
            sum += u64::from(texels[(uv.x * texels.len() as f32) as usize % texels.len()][0]);
        }
        times.push(start.elapsed().as_secs_f64() * 1e9 / batch.len() as f64);
    }
    times.sort_by(f64::total_cmp);
    println!("one random texel: {:.1} ns (5 %) {sum}", times[times.len() / 20]);
    let smaps = std::fs::read_to_string("/proc/self/smaps_rollup").unwrap_or_default();
    println!("{}", smaps.lines().find(|l| l.starts_with("AnonHuge")).unwrap_or("no AnonHugePages"));
    println!("{} bytes a texel", rgb.bytes() as f64 / f64::from(n * n));
}
