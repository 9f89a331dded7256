//! Hard cases: what must stay true of numbers at their limits, by both backends.
//!
//! Invariant: a case counts what it tried and keeps the worst that it saw; its doc comment says what must hold and
//! how its bound was derived. The quick form of a case is a test of its own; the full form is the same code with
//! more counts, and all of them print one table (`make hard`, `docs/hard-cases.md`).
//! Never: holds Embree to what only the native hierarchy promises. Where a bound is not Embree's, its failures are
//! counted and shown.

mod crowds;
mod damage;
mod damage_places;
mod extremes;
mod leaving;
mod meeting;
mod pictures;
mod placing;
mod rays;
mod shrinking;

use std::fmt::Write;
use weir::accel::Builder;
use weir::settings::{Backend, RenderSettings};

/// How much is tried.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Effort {
    /// Some seconds for all cases.
    Quick,
    /// Minutes.
    Full,
}

impl Effort {
    fn of(self, quick: usize, full: usize) -> usize {
        match self {
            Self::Quick => quick,
            Self::Full => full,
        }
    }
}

/// Who traverses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Tracer {
    Native,
    Embree,
    Robust,
}

impl Tracer {
    pub(crate) const ALL: [Self; 3] = [Self::Native, Self::Embree, Self::Robust];
    /// For pictures, which differ in nothing but traversal.
    pub(crate) const TWO: [Self; 2] = [Self::Native, Self::Embree];

    fn name(self) -> &'static str {
        match self {
            Self::Native => "native",
            Self::Embree => "Embree",
            Self::Robust => "Embree, robust",
        }
    }

    fn backend(self) -> Backend {
        if self == Self::Native { Backend::Native } else { Backend::Embree }
    }

    fn builder(self) -> Builder {
        Builder::new(self.backend(), self == Self::Robust, 1).expect("both backends are in this program")
    }

    fn settings(self) -> RenderSettings {
        RenderSettings {
            backend: self.backend(),
            robust: self == Self::Robust,
            threads: Some(1),
            ..RenderSettings::default()
        }
    }
}

/// A line of the table: one case on one backend.
pub(crate) struct Row {
    case: String,
    tracer: Tracer,
    tried: u64,
    worst: f64,
    /// Whether the worst is a number of failures, which add up.
    counted: bool,
    /// Whether a part of it was beyond its own bound.
    broken: bool,
    /// `None`: nobody promised anything; what was seen is reported.
    bound: Option<f64>,
    /// What was seen worst, for whom it fails.
    example: String,
}

impl Row {
    /// With a bound for the native hierarchy alone if `promised` is false.
    pub(crate) fn new(case: impl Into<String>, tracer: Tracer, bound: f64, promised: bool) -> Self {
        let bound = (promised || tracer == Tracer::Native).then_some(bound);
        Self {
            case: case.into(),
            tracer,
            tried: 0,
            worst: 0.0,
            counted: false,
            broken: false,
            bound,
            example: String::new(),
        }
    }

    /// Something was tried and had this error.
    pub(crate) fn measure(&mut self, error: f64, example: impl FnOnce() -> String) {
        self.tried += 1;
        // What is not a number is worse than all others.
        let error = if error.is_nan() { f64::INFINITY } else { error };
        if error > self.worst {
            self.worst = error;
            self.example = example();
        }
    }

    /// Something was tried and was right or wrong; the worst is how many were wrong.
    pub(crate) fn count(&mut self, wrong: bool, example: impl FnOnce() -> String) {
        self.tried += 1;
        self.counted = true;
        if wrong {
            self.worst += 1.0;
            if self.example.is_empty() {
                self.example = example();
            }
        }
    }

    /// The same case again, on another shape or in another place.
    fn join(&mut self, other: Self) {
        if self.example.is_empty() || !other.holds() {
            self.example = other.example.clone();
        }
        self.broken |= !self.holds() || !other.holds();
        self.tried += other.tried;
        let both = |a: f64, b: f64| if other.counted { a + b } else { a.max(b) };
        self.worst = both(self.worst, other.worst);
        self.bound = self.bound.zip(other.bound).map(|(a, b)| both(a, b));
        self.counted = other.counted;
    }

    fn holds(&self) -> bool {
        self.tried > 0 && !self.broken && self.bound.is_none_or(|bound| self.worst <= bound)
    }
}

/// What cases found.
#[derive(Default)]
pub(crate) struct Table(pub(crate) Vec<Row>);

impl Table {
    /// Adds rows; those of one case and tracer become one.
    pub(crate) fn extend(&mut self, rows: impl IntoIterator<Item = Row>) {
        for row in rows {
            match self.0.iter_mut().find(|r| r.case == row.case && r.tracer == row.tracer) {
                Some(same) => same.join(row),
                None => self.0.push(row),
            }
        }
    }

    fn text(&self) -> String {
        let mut text =
            String::from("| case | backend | tried | worst seen | bound |\n|---|---|--:|--:|--:|\n");
        for row in &self.0 {
            let bound = row.bound.map_or("counted".to_owned(), short);
            let (case, name) = (&row.case, row.tracer.name());
            let _ = writeln!(text, "| {case} | {name} | {} | {} | {bound} |", row.tried, short(row.worst));
        }
        text
    }

    /// Fails with all rows that do not hold.
    #[track_caller]
    pub(crate) fn assert_holds(&self) {
        assert!(!self.0.is_empty(), "a case without rows");
        let wrong = self.0.iter().filter(|row| !row.holds()).fold(String::new(), |mut text, row| {
            let bound = row.bound.map_or("none".to_owned(), short);
            let _ = writeln!(
                text,
                "{} ({}): {} of {}, bound {bound}; {}",
                row.case,
                row.tracer.name(),
                short(row.worst),
                row.tried,
                row.example
            );
            text
        });
        assert!(wrong.is_empty(), "\n{wrong}");
    }
}

/// Whole numbers as they are, others to three digits.
fn short(v: f64) -> String {
    if v == v.trunc() && v.abs() < 1e9 {
        format!("{v:.0}")
    } else if (1e-2..1e3).contains(&v.abs()) {
        format!("{v:.3}")
    } else {
        format!("{v:.1e}")
    }
}

type Case = fn(Effort) -> Table;

/// In the order of the table.
const CASES: &[Case] = &[
    leaving::acne_and_leaks,
    leaving::instances,
    pictures::acne,
    pictures::shadows,
    pictures::leaks,
    damage::bad_numbers,
    rays::bad_rays,
    rays::odd_rays,
    meeting::soups,
    placing::flattened,
    crowds::all,
    extremes::all,
    shrinking::properties,
];

#[test]
#[ignore = "minutes: `make hard`"]
fn hard_cases_print_their_table() {
    let mut all = Table::default();
    for case in CASES {
        all.extend(case(Effort::Full).0);
    }
    println!("{}", all.text());
    all.assert_holds();
}

/// The table must be able to fail.
#[test]
fn a_row_beyond_its_bound_is_found() {
    let fails = |row: Row| std::panic::catch_unwind(|| Table(vec![row]).assert_holds()).is_err();
    let row = |tracer, promised, wrong| {
        let mut row = Row::new("x", tracer, 0.0, promised);
        row.count(wrong, String::new);
        row
    };
    assert!(!fails(row(Tracer::Native, false, false)) && fails(row(Tracer::Native, false, true)));
    assert!(!fails(row(Tracer::Embree, false, true)) && fails(row(Tracer::Embree, true, true)));
    assert!(fails(Row::new("untried", Tracer::Native, 0.0, true)));
    let mut not_a_number = Row::new("x", Tracer::Native, 1e30, true);
    not_a_number.measure(f64::NAN, String::new);
    assert!(fails(not_a_number));
}
