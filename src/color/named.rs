//! Finds pbrt-v4's named spectra: metals, glasses and illuminants. Never reduces one to RGB.

use super::data::cie::{D50, D65, F};
use super::data::metals::{AG, AL, AU, CU, CU_ZN, EV_NM, METAL_FIRST_EV, MGO, TIO2};
use super::spectrum::{Spectrum, planck_relative};

/// Every name, for messages that say what would be right.
pub(super) const NAMES: &[&str] = &[
    "glass-BK7",
    "glass-BAF10",
    "glass-FK51A",
    "glass-LASF9",
    "glass-F5",
    "glass-F10",
    "glass-F11",
    "glass-SF5",
    "glass-SF10",
    "glass-SF11",
    "metal-Ag-eta",
    "metal-Ag-k",
    "metal-Al-eta",
    "metal-Al-k",
    "metal-Au-eta",
    "metal-Au-k",
    "metal-Cu-eta",
    "metal-Cu-k",
    "metal-CuZn-eta",
    "metal-CuZn-k",
    "metal-MgO-eta",
    "metal-MgO-k",
    "metal-TiO2-eta",
    "metal-TiO2-k",
    "stdillum-A",
    "stdillum-D50",
    "stdillum-D65",
    "stdillum-F1",
    "stdillum-F2",
    "stdillum-F3",
    "stdillum-F4",
    "stdillum-F5",
    "stdillum-F6",
    "stdillum-F7",
    "stdillum-F8",
    "stdillum-F9",
    "stdillum-F10",
    "stdillum-F11",
    "stdillum-F12",
    "illum-acesD60",
];

/// The spectrum of that name.
pub(super) fn find(name: &str) -> Option<Spectrum> {
    let (kind, rest) = name.split_once('-')?;
    match kind {
        "glass" => glass(rest),
        "metal" => metal(rest),
        "stdillum" => illuminant(rest).map(Spectrum::with_unit_luminance),
        "illum" if rest == "acesD60" => Spectrum::daylight(6000.0),
        _ => None,
    }
}

fn table(samples: impl Iterator<Item = (f32, f32)>) -> Option<Spectrum> {
    Some(Spectrum::from_samples(samples.collect()).expect("stored tables increase and are finite"))
}

fn illuminant(name: &str) -> Option<Spectrum> {
    let from = |first: f32, values: &'static [f32]| {
        table(values.iter().enumerate().map(move |(i, &v)| (first + 5.0 * i as f32, v)))
    };
    match name {
        // CIE 15, §3.1: a black body of 1.435e7 / 2848 nm K under the older constant.
        "A" => {
            let kelvin = 2848.0 * 1.438_776_877 / 1.435;
            table((300..=830).step_by(5).map(|nm| (nm as f32, planck_relative(f64::from(nm), kelvin) as f32)))
        }
        "D50" => from(300.0, &D50),
        "D65" => from(300.0, &D65),
        _ => {
            let number: usize = name.strip_prefix('F')?.parse().ok()?;
            // The canonical spelling only: "F01" is no name.
            if !(1..=12).contains(&number) || name.len() != 1 + number.ilog10() as usize + 1 {
                return None;
            }
            from(380.0, &F[number - 1])
        }
    }
}

fn metal(name: &str) -> Option<Spectrum> {
    let (metal, part) = name.split_once('-')?;
    let k = match part {
        "eta" => false,
        "k" => true,
        _ => return None,
    };
    let by_energy = |rows: &'static [(f32, f32)]| {
        table(rows.iter().enumerate().map(move |(i, &(n_row, k_row))| {
            let nm = EV_NM / (METAL_FIRST_EV - 0.05 * i as f64);
            (nm as f32, if k { k_row } else { n_row })
        }))
    };
    let by_nm = |rows: &'static [(f32, f32, f32)]| {
        table(rows.iter().map(move |&(nm, n_row, k_row)| (nm, if k { k_row } else { n_row })))
    };
    match metal {
        "Ag" => by_energy(&AG),
        "Al" => by_energy(&AL),
        "Au" => by_energy(&AU),
        "Cu" => by_energy(&CU),
        "CuZn" => by_nm(&CU_ZN),
        "MgO" => by_nm(&MGO),
        "TiO2" => by_nm(&TIO2),
        _ => None,
    }
}

/// Sellmeier's dispersion n² = 1 + Σ Bᵢλ²/(λ² − Cᵢ), λ in µm, with the coefficients of SCHOTT's
/// catalogue (2017) for the glasses' lead-free successors, the same as behind pbrt-v4's tables.
fn glass(name: &str) -> Option<Spectrum> {
    #[rustfmt::skip]
    let (first_nm, b, c): (i32, [f64; 3], [f64; 3]) = match name {
        "BK7" => (300, [1.03961212, 0.231792344, 1.01046945], [0.00600069867, 0.0200179144, 103.560653]),
        "BAF10" => (350, [1.5851495, 0.143559385, 1.08521269], [0.00926681282, 0.0424489805, 105.613573]),
        "FK51A" => (300, [0.971247817, 0.216901417, 0.904651666], [0.00472301995, 0.0153575612, 168.68133]),
        "LASF9" => (370, [2.00029547, 0.298926886, 1.80691843], [0.0121426017, 0.0538736236, 156.530829]),
        "F5" | "SF5" => (370, [1.52481889, 0.187085527, 1.42729015], [0.011254756, 0.0588995392, 129.141675]),
        "F10" | "SF10" => (380, [1.62153902, 0.256287842, 1.64447552], [0.0122241457, 0.0595736775, 147.468793]),
        "F11" | "SF11" => (370, [1.73759695, 0.313747346, 1.89878101], [0.013188707, 0.0623068142, 155.23629]),
        _ => return None,
    };
    table((first_nm..=900).step_by(10).map(|nm| {
        let l2 = (f64::from(nm) * 1e-3).powi(2);
        let n2 = 1.0 + (0..3).map(|i| b[i] * l2 / (l2 - c[i])).sum::<f64>();
        (nm as f32, n2.sqrt() as f32)
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_name_is_found_and_no_other() {
        for name in NAMES {
            assert!(find(name).is_some(), "{name}");
        }
        for name in
            ["", "glass-", "metal-Au", "metal-Au-n", "stdillum-F13", "stdillum-F0", "stdillum-F01", "F1"]
        {
            assert!(find(name).is_none(), "{name}");
        }
    }

    #[test]
    fn glasses_have_their_catalogued_index_at_the_d_line() {
        let catalogue = [
            ("BK7", 1.51680),
            ("BAF10", 1.67003),
            ("FK51A", 1.48656),
            ("LASF9", 1.85025),
            ("SF5", 1.67271),
            ("SF10", 1.72828),
            ("SF11", 1.78472),
        ];
        for (name, nd) in catalogue {
            let n = glass(name).expect(name).eval(587.5618);
            assert!((n - nd).abs() < 3e-5, "{name}: {n}, not {nd}");
        }
    }

    #[test]
    fn metals_match_rows_of_their_sources() {
        let at = |name: &str, nm: f64| find(name).expect(name).eval(nm);
        assert!((at("metal-Au-eta", 652.548_279) - 0.166).abs() < 1e-4);
        assert!((at("metal-Au-k", 459.200_653) - 1.846).abs() < 1e-4);
        assert!((at("metal-Cu-k", 302.400_421) - 1.687).abs() < 1e-4);
        assert!((at("metal-CuZn-eta", 300.0) - 1.388).abs() < 1e-5);
    }
}
