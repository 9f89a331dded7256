//! "Did you mean": the nearest known name. Never guesses from far away.

/// `; did you mean "x"?` when a candidate is near, else `; <plural> are a, b, c`.
pub(super) fn known_names(word: &str, plural: &str, names: &[&str]) -> String {
    match nearest(word, names) {
        Some(name) => format!("; did you mean \"{name}\"?"),
        None => format!("; {plural} are {}", names.join(", ")),
    }
}

/// The candidate with the fewest edits, if they are at most a third of the word (and at most 3).
pub(super) fn nearest<'a>(word: &str, names: &[&'a str]) -> Option<&'a str> {
    // A name longer than any of ours need not be measured; it also bounds the work.
    if word.len() > 64 {
        return None;
    }
    let limit = (word.chars().count() / 3).clamp(1, 3);
    names
        .iter()
        .map(|n| (edits(&word.to_ascii_lowercase(), &n.to_ascii_lowercase()), *n))
        .filter(|(d, _)| *d <= limit)
        .min_by_key(|(d, _)| *d)
        .map(|(_, n)| n)
}

/// Levenshtein distance, with a swap of neighbours counted as one edit.
fn edits(a: &str, b: &str) -> usize {
    let (a, b): (Vec<char>, Vec<char>) = (a.chars().collect(), b.chars().collect());
    let width = b.len() + 1;
    let mut d = vec![0usize; (a.len() + 1) * width];
    for (j, first) in d[..width].iter_mut().enumerate() {
        *first = j;
    }
    for i in 1..=a.len() {
        d[i * width] = i;
        for j in 1..width {
            let same = usize::from(a[i - 1] != b[j - 1]);
            let mut best = (d[(i - 1) * width + j] + 1)
                .min(d[i * width + j - 1] + 1)
                .min(d[(i - 1) * width + j - 1] + same);
            if i > 1 && j > 1 && a[i - 1] == b[j - 2] && a[i - 2] == b[j - 1] {
                best = best.min(d[(i - 2) * width + j - 2] + 1);
            }
            d[i * width + j] = best;
        }
    }
    d[a.len() * width + b.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn near_names_are_found_and_far_ones_are_not() {
        let names = ["sphere", "disk", "cylinder", "trianglemesh"];
        assert_eq!(nearest("shpere", &names), Some("sphere"));
        assert_eq!(nearest("Sphere", &names), Some("sphere"));
        assert_eq!(nearest("trianglemsh", &names), Some("trianglemesh"));
        assert_eq!(nearest("teapot", &names), None);
        assert_eq!(nearest("", &names), None);
        assert_eq!(known_names("x", "shapes", &["a", "b"]), "; did you mean \"a\"?");
        assert_eq!(known_names("cone", "shapes", &["sphere", "disk"]), "; shapes are sphere, disk");
    }
}
