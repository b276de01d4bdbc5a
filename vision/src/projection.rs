//! Everything is a projection: rows of planes times the basis rows of the `u` axis.
//!
//! The double sum `Σ_u Σ_v p_n(u) q_m(v) J(u, v)` is done in two stages, image row by image row: here `h_n = Σ_u p_n(u) J(u, v)`,
//! then `h_n q_m(v)` is added up ([`crate::sweep`]). The interaction matrix also needs moments of `x p_n` and `x² p_n`; for the
//! polynomials both lie in the span of `p_0 … p_{l+2}`, by the recurrence, so two more rows carry them ("carriers"). Rows without a
//! recurrence (cosines): their carriers are `p_n`, `x p_n` and `x² p_n` themselves.
//!
//! A plane of degree `k` is projected on the carriers of degrees `0 … k`: 2 for the gradient along `u`, 1 along `v`, 0 for an image.

use std::ops::Range;

use crate::basis::Basis;
use crate::camera::Intrinsics;
use crate::sample::Sample;

/// Samples that are worked on side by side; rows are padded with zeros to whole chunks.
pub(crate) const LANES: usize = 4;

/// A row of samples in whole chunks.
pub(crate) type Chunks<T> = Vec<[T; LANES]>;

/// A zeroed row for `length` samples.
pub(crate) fn padded_row<T: Sample>(length: usize) -> Chunks<T> {
    vec![[T::ZERO; LANES]; length.div_ceil(LANES)]
}

/// The rows that carry `p_n`, `x p_n` and `x² p_n` along `u`, for `n` up to the highest order.
#[derive(Debug)]
pub(crate) struct Carriers<T> {
    rows: Vec<Chunks<T>>,
    times_x: TimesX,
    highest_order: usize,
}

/// How moments of `x p_n` come from moments of the carriers.
#[derive(Debug)]
enum TimesX {
    /// `x p_n = below[n] p_{n-1} + here[n] p_n + below[n + 1] p_{n+1}`.
    Recurrence { below: Vec<f64>, here: Vec<f64> },
    /// They are carriers themselves.
    OwnRows,
}

impl<T: Sample> Carriers<T> {
    /// How many basis rows the carriers need for orders up to `order`.
    pub(crate) fn basis_rows(order: usize) -> usize {
        order + 3
    }

    /// Room for the carriers of bases like this one.
    pub(crate) fn new(basis: &Basis, highest_order: usize) -> Carriers<T> {
        let (rows, times_x) = match basis.recurrence() {
            Some(_) => {
                let rows = highest_order + 3;
                (rows, TimesX::Recurrence { below: vec![0.0; rows], here: vec![0.0; rows - 1] })
            }
            None => (3 * (highest_order + 1), TimesX::OwnRows),
        };
        Carriers { rows: (0..rows).map(|_| padded_row(basis.length())).collect(), times_x, highest_order }
    }

    /// Fills the carriers from another basis of the same kind, in place.
    pub(crate) fn set(&mut self, basis: &Basis, camera: &Intrinsics) {
        debug_assert_eq!(matches!(self.times_x, TimesX::OwnRows), basis.recurrence().is_none());
        match (&mut self.times_x, basis.recurrence()) {
            (TimesX::Recurrence { below, here }, Some(by)) => {
                // x = scale t + shift, since u = (t + 1)(points - 1)/2.
                let half = (by.points - 1) as f64 / 2.0;
                let (scale, shift) = (half / camera.focal_px()[0], camera.x(half));
                for (below, beta) in below.iter_mut().zip(by.off_diagonal) {
                    *below = scale * beta;
                }
                for (here, alpha) in here.iter_mut().zip(by.diagonal) {
                    *here = scale * alpha + shift;
                }
                for (n, row) in self.rows.iter_mut().enumerate() {
                    fill(row, basis.row(n), |_| 1.0);
                }
            }
            _ => {
                for (i, row) in self.rows.iter_mut().enumerate() {
                    let (degree, n) = (i / (self.highest_order + 1), i % (self.highest_order + 1));
                    fill(row, basis.row(n), |u| camera.x(u).powi(degree as i32));
                }
            }
        }
    }

    /// How many carriers there are.
    pub(crate) fn len(&self) -> usize {
        self.rows.len()
    }

    /// Projects `planes[i]`, one row of a plane each, on all carriers that orders up to `order` need; `degrees[i]` is plane `i`'s
    /// degree, highest first. `moments` gets one stretch of [`Carriers::len`] per plane.
    pub(crate) fn project(&self, planes: &[&[[T; LANES]]], degrees: &[usize], order: usize, moments: &mut [f64]) {
        for degree in 0..=degrees[0] {
            let reaching = degrees.iter().take_while(|d| **d >= degree).count();
            let rows = self.range(degree, order);
            match planes[..reaching] {
                [a] => self.tiles::<1, 4>([a], rows, moments),
                [a, b] => self.tiles::<2, 2>([a, b], rows, moments),
                [a, b, c] => self.tiles::<3, 2>([a, b, c], rows, moments),
                [a, b, c, d] => self.tiles::<4, 2>([a, b, c, d], rows, moments),
                [a, b, c, d, e] => self.tiles::<5, 2>([a, b, c, d, e], rows, moments),
                _ => unreachable!("a view has one to five planes"),
            }
        }
    }

    /// From the moments of `x^degree p_n` and of the carriers, those of `x^(degree + 1) p_n` for `n < raised.len()`.
    pub(crate) fn raise(&self, degree: usize, carried: &[f64], moments: &[f64], raised: &mut [f64]) {
        match &self.times_x {
            TimesX::Recurrence { below, here } => {
                let mut before = 0.0;
                for (n, raised) in raised.iter_mut().enumerate() {
                    *raised = below[n] * before + here[n] * moments[n] + below[n + 1] * moments[n + 1];
                    before = moments[n];
                }
            }
            TimesX::OwnRows => {
                let rows = self.range(degree + 1, self.highest_order);
                for (raised, carried) in raised.iter_mut().zip(&carried[rows]) {
                    *raised = *carried;
                }
            }
        }
    }

    /// The carriers that a plane of this degree needs beyond those of the degrees below.
    fn range(&self, degree: usize, order: usize) -> Range<usize> {
        match (&self.times_x, degree) {
            (TimesX::OwnRows, _) => degree * (self.highest_order + 1)..degree * (self.highest_order + 1) + order + 1,
            (TimesX::Recurrence { .. }, 0) => 0..order + 1,
            (TimesX::Recurrence { .. }, _) => order + degree..order + degree + 1,
        }
    }

    /// `P` planes times the carriers in `rows`, `C` at a time.
    fn tiles<const P: usize, const C: usize>(
        &self,
        planes: [&[[T; LANES]]; P],
        rows: Range<usize>,
        moments: &mut [f64],
    ) {
        let stride = self.rows.len();
        let mut write = |first: usize, tile: &[[f64; P]]| {
            for (i, products) in tile.iter().enumerate() {
                for (plane, product) in products.iter().enumerate() {
                    moments[plane * stride + first + i] = *product;
                }
            }
        };
        let mut first = rows.start;
        while first + C <= rows.end {
            write(first, &tile::<T, P, C>(planes, std::array::from_fn(|i| &self.rows[first + i][..])));
            first += C;
        }
        for row in first..rows.end {
            write(row, &tile::<T, P, 1>(planes, [&self.rows[row][..]]));
        }
    }
}

/// The products of `P` plane rows with `C` carriers. Every pair has its own strands, one per lane: no strand waits for another,
/// and the compiler may keep each in one register (so `P * C` stays at 10 or below, of 16).
#[inline(always)]
pub(crate) fn tile<T: Sample, const P: usize, const C: usize>(
    planes: [&[[T; LANES]]; P],
    carriers: [&[[T; LANES]]; C],
) -> [[f64; P]; C] {
    let length = carriers[0].len();
    let planes = planes.map(|plane| &plane[..length]);
    let carriers = carriers.map(|carrier| &carrier[..length]);
    let mut strands = [[[T::ZERO; LANES]; P]; C];
    for i in 0..length {
        for c in 0..C {
            for p in 0..P {
                for lane in 0..LANES {
                    strands[c][p][lane] += carriers[c][i][lane] * planes[p][i][lane];
                }
            }
        }
    }
    strands.map(|of_carrier| of_carrier.map(|lanes| add_lanes(&lanes)))
}

/// The lanes of a strand, added in `f64`. Not inlined: seeing these sums, the compiler would lay the strands' lanes out across strands.
#[inline(never)]
pub(crate) fn add_lanes<T: Sample>(lanes: &[T; LANES]) -> f64 {
    lanes.iter().map(|lane| lane.to_f64()).sum()
}

/// `row[u] = values[u] * factor(u)`, rounded once.
fn fill<T: Sample>(row: &mut Chunks<T>, values: &[f64], factor: impl Fn(f64) -> f64) {
    for (u, (sample, value)) in row.as_flattened_mut().iter_mut().zip(values).enumerate() {
        *sample = T::from_f64(value * factor(u as f64));
    }
}
