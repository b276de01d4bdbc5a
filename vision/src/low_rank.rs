//! Fewer rows than pixels: `F` and signs `D` with `FᵀDF ≈ M = KᵀK`, where `K(x, u) = exp(-(x - u)²/2λ²)` blurs an axis.
//!
//! The products of two blurred planes need `M` alone: `⟨G*a, G*b⟩ = Σ a · (M_v b M_u)`. A wide blur forgets: of `N` pixels about `1.7 N/λ` numbers
//! are left above the 12th digit. The rows are made in the cheapest of three ways:
//! - the bells of `K` as they are, for an extent of a pixel or so;
//! - bells `s < 0.6 λ` apart, over the axis and beyond its ends: `Σ_x h(x)` over all whole `x` is `s Σ_k h(s k)` for what has been blurred, but for
//!   `2 exp(-π²λ²/s²)` of it (Poisson's summation). What that adds beyond the ends, where there are no pixels, is taken off again, by the third way;
//! - a Cholesky factorisation that takes the pixel of the largest remainder first, and needs the diagonal of `M` and one column of it for each
//!   row; it ends when the trace of `M - FᵀF`, which is never negative, is small enough. Few rows, but long ones: for a wide blur.
//!
//! What is left out is [`REMAINDER`] of the trace of `M`: a product is off by at most `2 REMAINDER |a| |b| tr M_u tr M_v`, or so.

use std::f64::consts::PI;
use std::ops::Range;

use crate::banded::BandedRow;
use crate::convolution::{bell, bells};
use crate::sample::Sample;

/// What may be left of the trace of `M`, relative to it.
const REMAINDER: f64 = 1e-13;

/// What a row costs besides its numbers, in numbers.
const COST_OF_A_ROW: usize = 64;

/// Rows of an axis of `length` pixels.
pub(crate) fn factor<T: Sample>(extent_px: f64, length: usize) -> Vec<BandedRow> {
    let own = bells::<T>(extent_px, length);
    let sampled = sampled::<T>(extent_px, length);
    let local = if cost(&own) <= cost(&sampled) { own } else { sampled };
    // No more than 2 N/λ rows, nor much more than that many: else it would not be the cheapest.
    let most = cost(&local) / (length.min((2.0 * extent_px) as usize) + COST_OF_A_ROW);
    match cholesky(extent_px, length, 0..length as i64, REMAINDER * trace(extent_px, length), most) {
        Some(rows) => {
            let whole: Vec<BandedRow> = rows.into_iter().map(|row| trimmed::<T>(&row, 1.0)).collect();
            if cost(&whole) < cost(&local) { whole } else { local }
        }
        None => local,
    }
}

fn cost(rows: &[BandedRow]) -> usize {
    rows.iter().map(|row| row.values.len() + COST_OF_A_ROW).sum()
}

/// Bells a little more than half an extent apart, less what they see beyond the ends.
fn sampled<T: Sample>(extent_px: f64, length: usize) -> Vec<BandedRow> {
    let apart = PI * extent_px / (4.0 / REMAINDER).ln().sqrt();
    let beyond = extent_px * (100.0 / REMAINDER).ln().sqrt();
    let count = (((length - 1) as f64 + 2.0 * beyond) / apart).ceil() as usize + 1;
    let at = |k: usize| k as f64 * apart - beyond;
    let mut rows: Vec<BandedRow> = (0..count)
        .map(|k| bell::<T>(extent_px, length, at(k), apart.sqrt()))
        .filter(|row| !row.values.is_empty())
        .collect();

    let enough = 0.5 * REMAINDER * trace(extent_px, length);
    let before =
        cholesky(extent_px, length, -(beyond.ceil() as i64)..0, enough, length).expect("no more rows than pixels");
    for mut row in before {
        rows.push(trimmed::<T>(&row, -1.0));
        row.reverse();
        rows.push(trimmed::<T>(&row, -1.0));
    }
    rows
}

/// `tr M`, but for what the ends lack.
fn trace(extent_px: f64, length: usize) -> f64 {
    length as f64 * (PI.sqrt() * extent_px).max(1.0)
}

/// Without what is nothing beside its largest number, at both ends.
fn trimmed<T: Sample>(row: &[f64], sign: f64) -> BandedRow {
    let nothing = 1e-2 * T::EPSILON.to_f64() * row.iter().fold(0.0, |most: f64, value| most.max(value.abs()));
    let is_something = |value: &f64| value.abs() > nothing;
    let first = row.iter().position(is_something).unwrap_or(0);
    let end = row.iter().rposition(is_something).map_or(0, |last| last + 1);
    BandedRow { first, values: row[first..end].to_vec(), sign }
}

/// Some of `M`'s sum: `Σ_x K(x, p) K(x, q) = exp(-(p - q)²/4λ²) Σ_x exp(-(x - (p + q)/2)²/λ²)`, with `x` in a range of its own.
struct BlurTwice {
    /// The first factor, by `|p - q|`.
    apart: Vec<f64>,
    /// The second factor, by `p + q`.
    together: Vec<f64>,
}

impl BlurTwice {
    fn new(extent_px: f64, length: usize, x: &Range<i64>) -> BlurTwice {
        let bell = |distance: f64| (-(distance / extent_px).powi(2)).exp();
        // Farther than that, a bell is nothing.
        let reach = (9.0 * extent_px).ceil() as i64;
        let gathered = |sum: usize| {
            let middle = sum as i64 / 2;
            let near = x.start.max(middle - reach)..x.end.min(middle + reach + 1);
            near.map(|x| bell(x as f64 - 0.5 * sum as f64)).sum()
        };
        BlurTwice {
            apart: (0..length).map(|distance| bell(0.5 * distance as f64)).collect(),
            together: (0..2 * length - 1).map(gathered).collect(),
        }
    }

    fn at(&self, p: usize, q: usize) -> f64 {
        self.apart[p.abs_diff(q)] * self.together[p + q]
    }
}

/// Rows `F` of `length` pixels with `FᵀF ≈ M`, the sum in `M` being over `x`, until a trace of `enough` is left; none, if more than `most` rows
/// were needed.
fn cholesky(extent_px: f64, length: usize, x: Range<i64>, enough: f64, most: usize) -> Option<Vec<Vec<f64>>> {
    let matrix = BlurTwice::new(extent_px, length, &x);
    let mut remainder: Vec<f64> = (0..length).map(|p| matrix.at(p, p)).collect();
    let mut rows: Vec<Vec<f64>> = Vec::new();
    while remainder.iter().sum::<f64>() > enough {
        if rows.len() == most.min(length) {
            return None;
        }
        let largest = (0..length).max_by(|p, q| remainder[*p].total_cmp(&remainder[*q])).expect("at least one pixel");
        let scale = 1.0 / remainder[largest].sqrt();
        let mut row: Vec<f64> = (0..length).map(|q| matrix.at(largest, q)).collect();
        for made in &rows {
            let along = made[largest];
            row.iter_mut().zip(made).for_each(|(x, made)| *x -= along * made);
        }
        row.iter_mut().for_each(|x| *x *= scale);
        for (remainder, x) in remainder.iter_mut().zip(&row) {
            *remainder = (*remainder - x * x).max(0.0);
        }
        remainder[largest] = 0.0;
        rows.push(row);
    }
    Some(rows)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rows_make_the_products_of_all_bells_whatever_the_extent() {
        for (extent_px, length) in
            [(0.5, 30), (1.0, 41), (2.0, 90), (3.5, 200), (9.0, 301), (9.0, 40), (60.0, 97), (512.0, 64)]
        {
            let (rows, bells) = (factor::<f64>(extent_px, length), bells::<f64>(extent_px, length));
            let product = |rows: &[BandedRow], p: usize, q: usize| -> f64 {
                let at = |row: &BandedRow, p: usize| p.checked_sub(row.first).and_then(|i| row.values.get(i)).copied();
                let term = |row: &BandedRow| Some(row.sign * at(row, p)? * at(row, q)?);
                rows.iter().filter_map(term).sum()
            };
            let most = (0..length).map(|p| product(&bells, p, p)).fold(0.0, f64::max);
            for (p, q) in (0..length).flat_map(|p| (0..=p).map(move |q| (p, q))) {
                let difference = (product(&rows, p, q) - product(&bells, p, q)).abs() / most;
                assert!(
                    difference < length as f64 * REMAINDER,
                    "{difference:e} at {p}, {q} of {length}, {extent_px} px"
                );
            }
            println!(
                "{extent_px} px, {length}: {} rows, {} numbers",
                rows.len(),
                rows.iter().map(|r| r.values.len()).sum::<usize>()
            );
        }
    }
}
