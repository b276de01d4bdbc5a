//! The inner products of two blurred planes, without the blurred planes: `⟨G*a, G*b⟩ = Σ a · (M_v b M_u)`, with `M = KᵀK` of each axis and
//! `K` its Gaussian matrix, `K(x, u) = exp(-(x - u)²/2λ²)` over the pixels of the image.
//!
//! A wide blur forgets: of `N` pixels only about `1.7 N/λ` numbers are left above the 12th digit. So `M ≈ FᵀF` with few rows `F`, and everything
//! is a projection again: `⟨G*a, G*b⟩ ≈ ⟨F_v a F_uᵀ, F_v b F_uᵀ⟩`. The rows come from a Cholesky factorisation that takes the pixel of the
//! largest remainder first, and needs the diagonal of `M` and one column of it for each row; it ends when the trace of `M - FᵀF`, which is
//! never negative, is below [`REMAINDER`] of `M`'s. A product is then off by at most `2 REMAINDER |a| |b| tr M_u tr M_v`.

use std::ops::Range;

use crate::chunks::{Chunks, LANES, padded_row, tile};
use crate::convolution::tap_count;
use crate::gram::{COLUMNS, Gram};
use crate::products::add_products;
use crate::sample::Sample;

/// What may be left of the trace of `M`, relative to it.
pub(crate) const REMAINDER: f64 = 1e-12;

/// Chunks of a row that are added up in the samples' own precision: what a wide blur leaves of a rough image is small beside its terms.
const STRETCH: usize = 32;

/// `M(p, q) = Σ_x K(x, p) K(x, q) = exp(-(p - q)²/4λ²) Σ_x exp(-(x - (p + q)/2)²/λ²)`.
struct BlurTwice {
    /// The first factor, by `|p - q|`.
    apart: Vec<f64>,
    /// The second factor, by `p + q`.
    together: Vec<f64>,
}

impl BlurTwice {
    fn new(extent_px: f64, length: usize) -> BlurTwice {
        let bell = |distance: f64| (-(distance / extent_px).powi(2)).exp();
        let gathered = |sum: usize| (0..length).map(|x| bell(x as f64 - 0.5 * sum as f64)).sum();
        BlurTwice {
            apart: (0..length).map(|distance| bell(0.5 * distance as f64)).collect(),
            together: (0..2 * length - 1).map(gathered).collect(),
        }
    }

    fn at(&self, p: usize, q: usize) -> f64 {
        self.apart[p.abs_diff(q)] * self.together[p + q]
    }
}

/// Rows `F` of `length` pixels with `FᵀF ≈ M`; none, if more than `most` rows were needed.
pub(crate) fn factor(extent_px: f64, length: usize, most: usize) -> Option<Vec<Vec<f64>>> {
    let matrix = BlurTwice::new(extent_px, length);
    let mut remainder: Vec<f64> = (0..length).map(|p| matrix.at(p, p)).collect();
    let enough = REMAINDER * remainder.iter().sum::<f64>();
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

/// Planes projected on the rows `F` of both axes, for one image size and extent.
#[derive(Debug)]
pub(crate) struct Projection<T> {
    /// Rows along `u`, padded with zeros.
    along_u: Vec<Chunks<T>>,
    /// Rows along `v`, `[v][row]`.
    along_v: Vec<Vec<f64>>,
    /// Of one image row, `[plane][row along u]`, each stretch padded with zeros.
    projected: Chunks<f64>,
    /// `[row along v][plane][row along u]`.
    table: Vec<Chunks<f64>>,
    planes: usize,
}

impl<T: Sample> Projection<T> {
    /// Buffers for `planes` planes of `[width, height]` pixels; none, if blurring in full takes less time.
    pub(crate) fn new(extent_px: f64, [width, height]: [usize; 2], planes: usize) -> Option<Projection<T>> {
        let taps = [width, height].map(|length| tap_count::<T>(extent_px, length));
        let most = taps[0] + taps[1];
        let (along_u, along_v) = (factor(extent_px, width, most)?, factor(extent_px, height, most)?);
        if !pays([along_u.len(), along_v.len()], taps, width) {
            return None;
        }
        let stretch = planes * along_u.len().div_ceil(LANES);
        Some(Projection {
            along_u: along_u.iter().map(|row| padded(row)).collect(),
            along_v: (0..height).map(|v| along_v.iter().map(|row| row[v]).collect()).collect(),
            projected: vec![[0.0; LANES]; stretch],
            table: vec![vec![[0.0; LANES]; stretch]; along_v.len()],
            planes,
        })
    }

    /// Starts anew.
    pub(crate) fn clear(&mut self) {
        self.table.iter_mut().for_each(|row| row.as_flattened_mut().fill(0.0));
    }

    /// Takes row `v` of all planes.
    pub(crate) fn take_row(&mut self, v: usize, planes: &[&[[T; LANES]]]) {
        self.projected.as_flattened_mut().fill(0.0);
        let pairs = self.along_u.len() - self.along_u.len() % 2;
        for from in (0..planes[0].len()).step_by(STRETCH) {
            let stretch = from..(from + STRETCH).min(planes[0].len());
            for first in (0..pairs).step_by(2) {
                self.project::<2>(first, planes, stretch.clone());
            }
            if pairs < self.along_u.len() {
                self.project::<1>(pairs, planes, stretch);
            }
        }
        let projected = self.projected.as_flattened();
        for (table, factor) in self.table.iter_mut().zip(&self.along_v[v]) {
            for (sum, product) in table.as_flattened_mut().iter_mut().zip(projected) {
                *sum += factor * product;
            }
        }
    }

    /// Adds up the products of a stretch of all planes with `R` rows along `u`: three planes at a time, the last one with the first three.
    fn project<const R: usize>(&mut self, first: usize, planes: &[&[[T; LANES]]], stretch: Range<usize>) {
        let rows: [&[[T; LANES]]; R] = std::array::from_fn(|i| &self.along_u[first + i][stretch.clone()]);
        let (stride, projected) = (LANES * self.along_u.len().div_ceil(LANES), self.projected.as_flattened_mut());
        let mut add = |plane: usize, row: usize, product: f64| projected[plane * stride + first + row] += product;
        let (last, part) = (planes.len() - 1, |plane: usize| &planes[plane][stretch.clone()]);
        for (row, products) in tile([part(0), part(1), part(2), part(last)], rows).into_iter().enumerate() {
            [0, 1, 2, last].into_iter().zip(products).for_each(|(plane, product)| add(plane, row, product));
        }
        for group in (3..last).step_by(3) {
            for (row, products) in tile([group, group + 1, group + 2].map(part), rows).into_iter().enumerate() {
                (group..).zip(products).for_each(|(plane, product)| add(plane, row, product));
            }
        }
    }

    /// Adds the inner products of the blurred planes.
    pub(crate) fn add_products(&self, gram: &mut Gram) {
        let stride = self.along_u.len().div_ceil(LANES);
        for row in &self.table {
            let planes: [&[[f64; LANES]]; COLUMNS] =
                std::array::from_fn(|i| if i < self.planes { &row[i * stride..][..stride] } else { &row[..0] });
            add_products(&planes[..self.planes], gram);
        }
    }
}

/// Whether projecting on so many rows `[along u, along v]` takes less time than blurring with so many taps.
fn pays(rows: [usize; 2], taps: [usize; 2], width: usize) -> bool {
    rows[0] as f64 + 2.0 * (rows[0] * rows[1]) as f64 / width as f64 <= (taps[0] + taps[1]) as f64
}

fn padded<T: Sample>(values: &[f64]) -> Chunks<T> {
    let mut row = padded_row(values.len());
    for (sample, value) in row.as_flattened_mut().iter_mut().zip(values) {
        *sample = T::from_f64(*value);
    }
    row
}
