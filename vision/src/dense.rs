//! Sums over rows of `f64` with vectors: what making a basis is made of.

use fearless_simd::{Simd, SimdBase, SimdFloat};

/// Sums that do not wait for each other.
const STRANDS: usize = 4;

/// `Σ a b`, of as many as both have.
#[inline(always)]
pub(crate) fn dot<S: Simd>(simd: S, a: &[f64], b: &[f64]) -> f64 {
    dot3(simd, a, b, None)
}

/// `Σ a b c`, or `Σ a b` without a `c`.
#[inline(always)]
pub(crate) fn dot3<S: Simd>(simd: S, a: &[f64], b: &[f64], c: Option<&[f64]>) -> f64 {
    let (lanes, length) = (S::f64s::LEN, a.len());
    let whole = length - length % lanes;
    let mut strands = [S::f64s::splat(simd, 0.0); STRANDS];
    let (mut at, mut strand) = (0, 0);
    while at < whole {
        let mut factor = S::f64s::from_slice(simd, &a[at..at + lanes]);
        if let Some(c) = c {
            factor *= S::f64s::from_slice(simd, &c[at..at + lanes]);
        }
        strands[strand] = S::f64s::from_slice(simd, &b[at..at + lanes]).mul_add(factor, strands[strand]);
        (at, strand) = (at + lanes, (strand + 1) % STRANDS);
    }
    let sum = ((strands[0] + strands[1]) + (strands[2] + strands[3])).reduce_sum();
    (whole..length).fold(sum, |sum, u| sum + a[u] * b[u] * c.map_or(1.0, |c| c[u]))
}

/// `out += factor row`.
#[inline(always)]
pub(crate) fn add_multiple<S: Simd>(simd: S, out: &mut [f64], factor: f64, row: &[f64]) {
    let (lanes, length) = (S::f64s::LEN, out.len());
    let whole = length - length % lanes;
    let mut at = 0;
    while at < whole {
        let own = S::f64s::from_slice(simd, &out[at..at + lanes]);
        S::f64s::from_slice(simd, &row[at..at + lanes]).mul_add(factor, own).store_slice(&mut out[at..at + lanes]);
        at += lanes;
    }
    for u in whole..length {
        out[u] += factor * row[u];
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::path::Path;

    #[test]
    fn sums_and_multiples_are_those_of_plain_loops_on_every_path() {
        let row = |step: usize| (0..83).map(|u| (u * step % 17) as f64 - 8.0).collect::<Vec<_>>();
        let (a, b, c) = (row(3), row(5), row(7));
        for path in Path::available() {
            let (mut out, mut expected) = (c.clone(), c.clone());
            let sums = fearless_simd::dispatch!(path.level(), simd => {
                add_multiple(simd, &mut out, 0.5, &a);
                [dot(simd, &a, &b), dot3(simd, &a, &b, Some(&c))]
            });
            expected.iter_mut().zip(&a).for_each(|(out, a)| *out += 0.5 * a);
            let plain = |u: usize| [a[u] * b[u], a[u] * b[u] * c[u]];
            let plain = (0..83).map(plain).fold([0.0; 2], |sum, term| [sum[0] + term[0], sum[1] + term[1]]);
            assert_eq!((sums, out), (plain, expected), "{path}: whole and half numbers");
        }
    }
}
