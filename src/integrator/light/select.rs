//! Chooses a light by its power alone, in constant time: right for few lights. For thousands,
//! `tree` knows which of them matter to a point.

/// One bin: with probability `own` the bin itself, otherwise `alias`.
#[derive(Clone, Copy, Debug)]
struct Bin {
    own: f32,
    pmf: f32,
    alias: u32,
}

/// Walker's alias table, built by Vose 1991.
#[derive(Clone, Debug)]
pub struct AliasTable {
    bins: Vec<Bin>,
}

impl AliasTable {
    /// In proportion to `weights`; what is negative or not finite counts as 0. `None` where
    /// nothing is left, or for more than 2³² weights.
    #[must_use]
    pub fn new(weights: &[f32]) -> Option<Self> {
        let clean = |w: f32| if w > 0.0 && w.is_finite() { f64::from(w) } else { 0.0 };
        let total: f64 = weights.iter().map(|&w| clean(w)).sum();
        let n = weights.len();
        if total <= 0.0 || u32::try_from(n).is_err() {
            return None;
        }
        let mut scaled: Vec<f64> = weights.iter().map(|&w| clean(w) / total * n as f64).collect();
        let mut bins: Vec<Bin> = weights
            .iter()
            .enumerate()
            .map(|(i, &w)| Bin { own: 1.0, pmf: (clean(w) / total) as f32, alias: i as u32 })
            .collect();
        let (mut small, mut large): (Vec<usize>, Vec<usize>) = (0..n).partition(|&i| scaled[i] < 1.0);
        while let (Some(&s), Some(&l)) = (small.last(), large.last()) {
            small.pop();
            bins[s].own = scaled[s] as f32;
            bins[s].alias = l as u32;
            scaled[l] -= 1.0 - scaled[s];
            if scaled[l] < 1.0 {
                large.pop();
                small.push(l);
            }
        }
        // Rounding may leave a bin that is full but for an ulp; an empty one must stay empty, and
        // has met a partner, since what is full sums to n.
        for i in small {
            if bins[i].pmf == 0.0 {
                bins[i].own = 0.0;
                bins[i].alias = weights.iter().position(|&w| clean(w) > 0.0).unwrap_or(0) as u32;
            }
        }
        Some(Self { bins })
    }

    /// Number of bins.
    #[must_use]
    pub fn len(&self) -> usize {
        self.bins.len()
    }

    /// Never: a table without bins is not made.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.bins.is_empty()
    }

    /// (index, its probability, `u` stretched back to [0, 1)). Of the 24 bits of `u`, log₂ n
    /// choose the bin; beyond some 2¹⁶ entries the rest is coarse.
    #[inline]
    #[must_use]
    pub fn sample(&self, u: f32) -> (usize, f32, f32) {
        let n = self.bins.len();
        let at = f64::from(u) * n as f64;
        let i = (at as usize).min(n - 1);
        let up = (at - i as f64) as f32;
        let bin = self.bins[i];
        let below_one = 1.0 - f32::EPSILON / 2.0;
        if up < bin.own {
            (i, bin.pmf, (up / bin.own).min(below_one))
        } else {
            let alias = bin.alias as usize;
            (alias, self.bins[alias].pmf, ((up - bin.own) / (1.0 - bin.own)).clamp(0.0, below_one))
        }
    }

    /// Probability of entry `i`.
    #[inline]
    #[must_use]
    pub fn pmf(&self, i: usize) -> f32 {
        self.bins[i].pmf
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{Rng, Z_LIMIT, chi_squared_z};
    use super::*;

    #[test]
    fn frequencies_are_the_weights_and_u_stays_uniform() {
        let mut rng = Rng::new(6);
        let mut weights: Vec<f32> = (0..100).map(|_| rng.f32().powi(3)).collect();
        weights[3] = 0.0;
        weights[99] = 0.0;
        weights[50] = 40.0;
        weights[7] = f32::NAN;
        weights[8] = -3.0;
        weights[9] = f32::INFINITY;
        let table = AliasTable::new(&weights).expect("weight");
        const COUNT: usize = 400_000;
        let (mut observed, mut remapped) = (vec![0.0; 100], vec![0.0; 32]);
        for _ in 0..COUNT {
            let (i, pmf, u) = table.sample(rng.f32());
            assert_eq!(pmf, table.pmf(i));
            assert!(pmf > 0.0 && (0.0..1.0).contains(&u));
            observed[i] += 1.0;
            remapped[(u * 32.0) as usize] += 1.0;
        }
        let expected: Vec<f64> = (0..100).map(|i| f64::from(table.pmf(i)) * COUNT as f64).collect();
        assert!((expected.iter().sum::<f64>() / COUNT as f64 - 1.0).abs() < 1e-5);
        assert!(chi_squared_z(&observed, &expected) < Z_LIMIT);
        assert!(chi_squared_z(&remapped, &[COUNT as f64 / 32.0; 32]) < Z_LIMIT);
    }

    #[test]
    fn edges() {
        assert!(AliasTable::new(&[]).is_none() && AliasTable::new(&[0.0, f32::NAN]).is_none());
        let one = AliasTable::new(&[0.0, 0.0, 5.0, 0.0]).expect("weight");
        for i in 0..1000 {
            assert_eq!(one.sample(i as f32 / 1000.0).0, 2);
        }
        assert_eq!(one.sample(1.0 - f32::EPSILON / 2.0).0, 2);
        assert_eq!((one.len(), one.is_empty(), one.pmf(2)), (4, false, 1.0));
    }
}
