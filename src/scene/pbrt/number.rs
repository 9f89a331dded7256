//! Decimal numbers out of bytes, without a copy. Exact where a double holds mantissa and power
//! of ten (nearly always in scene files); the standard library decides the rest. Never accepts
//! `inf` or `nan`.

/// Powers of ten a double holds exactly (Clinger 1990, fast path).
const POW10: [f64; 23] = [
    1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15, 1e16, 1e17, 1e18,
    1e19, 1e20, 1e21, 1e22,
];

/// Digits of which any 64-bit mantissa can be made.
const MAX_DIGITS: u32 = 19;

/// A decimal number that starts at `pos`; the value and the position behind it. `None` when no
/// number starts there. The caller checks what follows.
#[inline]
pub(super) fn parse_f64(data: &[u8], start: usize) -> Option<(f64, usize)> {
    let mut pos = start;
    let negative = match data.get(pos)? {
        b'-' => {
            pos += 1;
            true
        }
        b'+' => {
            pos += 1;
            false
        }
        _ => false,
    };
    let (mut mantissa, mut significant, mut power) = (0u64, 0u32, 0i32);
    let mut any = false;
    let mut exact = true;
    while let Some(d) = digit(data, pos) {
        any = true;
        if significant < MAX_DIGITS {
            mantissa = mantissa * 10 + d;
            significant += u32::from(mantissa != 0);
        } else {
            exact = false;
            power = power.saturating_add(1);
        }
        pos += 1;
    }
    if data.get(pos) == Some(&b'.') {
        pos += 1;
        while let Some(d) = digit(data, pos) {
            any = true;
            if significant < MAX_DIGITS {
                mantissa = mantissa * 10 + d;
                significant += u32::from(mantissa != 0);
                power = power.saturating_sub(1);
            } else {
                exact = false;
            }
            pos += 1;
        }
    }
    if !any {
        return None;
    }
    if matches!(data.get(pos), Some(b'e' | b'E')) {
        pos += 1;
        let down = match data.get(pos) {
            Some(b'-') => {
                pos += 1;
                true
            }
            Some(b'+') => {
                pos += 1;
                false
            }
            _ => false,
        };
        digit(data, pos)?;
        let mut e = 0i32;
        while let Some(d) = digit(data, pos) {
            e = e.saturating_mul(10).saturating_add(d as i32);
            pos += 1;
        }
        power = power.saturating_add(if down { -e } else { e });
    }
    let magnitude = if mantissa == 0 && exact {
        0.0
    } else if exact && mantissa <= 1 << 53 && power.unsigned_abs() <= 22 {
        let scale = POW10[power.unsigned_abs() as usize];
        if power < 0 { mantissa as f64 / scale } else { mantissa as f64 * scale }
    } else {
        let text = std::str::from_utf8(&data[start..pos]).ok()?;
        return text.parse::<f64>().ok().map(|v| (v, pos));
    };
    Some((if negative { -magnitude } else { magnitude }, pos))
}

/// A decimal integer that starts at `pos`; the value, saturated to i64, and the position behind it.
#[inline]
pub(super) fn parse_i64(data: &[u8], start: usize) -> Option<(i64, usize)> {
    let mut pos = start;
    let sign = match data.get(pos)? {
        b'-' => {
            pos += 1;
            -1
        }
        b'+' => {
            pos += 1;
            1
        }
        _ => 1,
    };
    digit(data, pos)?;
    let mut value = 0i64;
    while let Some(d) = digit(data, pos) {
        value = value.saturating_mul(10).saturating_add(d as i64);
        pos += 1;
    }
    Some((sign * value, pos))
}

#[inline(always)]
fn digit(data: &[u8], pos: usize) -> Option<u64> {
    let d = data.get(pos)?.wrapping_sub(b'0');
    (d < 10).then_some(u64::from(d))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn whole(text: &str) -> Option<f64> {
        parse_f64(text.as_bytes(), 0).filter(|r| r.1 == text.len()).map(|r| r.0)
    }

    #[test]
    fn known_numbers() {
        for (text, value) in [
            ("0", 0.0),
            ("-0", -0.0),
            ("1", 1.0),
            ("+1.5", 1.5),
            (".5", 0.5),
            ("5.", 5.0),
            ("-1e-3", -1e-3),
            ("1E+2", 100.0),
            ("0.000000000000000000000000000001", 1e-30),
            ("123456789012345678901234567890", 123456789012345678901234567890.0),
            ("0.1000000000000000055511151231257827", 0.1),
            ("1e-400", 0.0),
            ("000000000000000000000000000001", 1.0),
        ] {
            assert_eq!(whole(text), Some(value), "{text}");
        }
        assert_eq!(whole("1e400"), Some(f64::INFINITY), "the caller rejects what is out of range");
    }

    #[test]
    fn what_is_no_number() {
        for text in ["", "-", ".", "e5", "1e", "1e+", "inf", "nan", "x", "-.", "+e1"] {
            assert_eq!(whole(text), None, "{text}");
        }
    }

    proptest! {
        #[test]
        fn agrees_with_the_standard_library(v in any::<f64>().prop_filter("finite", |v| v.is_finite())) {
            for text in [format!("{v}"), format!("{v:e}"), format!("{v:.7}")] {
                prop_assert_eq!(whole(&text), text.parse::<f64>().ok());
            }
        }

        #[test]
        fn short_decimals_agree(m in any::<i32>(), e in -30i32..30) {
            let text = format!("{m}e{e}");
            prop_assert_eq!(whole(&text), text.parse::<f64>().ok());
        }
    }
}
