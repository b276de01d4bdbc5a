//! Everything is a projection: rows of planes times the basis rows of the `u` axis.
//!
//! The double sum `Σ_u Σ_v p_n(u) q_m(v) J(u, v)` is done in two stages, image row by image row: here `h_n = Σ_u p_n(u) J(u, v)`,
//! then `h_n q_m(v)` is added up ([`crate::sweep`]). The interaction matrix also needs moments of `x p_n` and `x² p_n`; for the
//! polynomials both lie in the span of `p_0 … p_{l+2}`, by the recurrence, so two more rows carry them ("carriers"). Rows without a
//! recurrence (cosines): their carriers are `p_n`, `x p_n` and `x² p_n` themselves.
//!
//! A plane of degree `k` is projected on the carriers of degrees `0 … k`: 2 for the gradient along `u`, 1 along `v`, 0 for an image.

use std::ops::Range;

use fearless_simd::Simd;

use crate::basis::Basis;
use crate::camera::Intrinsics;
use crate::row::Row;
use crate::sample::Sample;
use crate::strands::{has_many_registers, products};
use crate::table::padded;

/// Most planes that are projected together.
pub(crate) const MOST_PLANES: usize = 5;

/// The rows that carry `p_n`, `x p_n` and `x² p_n` along `u`, for `n` up to the highest order.
#[derive(Debug)]
pub(crate) struct Carriers<T> {
    rows: Vec<Row<T>>,
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
        Carriers { rows: (0..rows).map(|_| Row::zeros(basis.length())).collect(), times_x, highest_order }
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

    /// How far apart [`Carriers::project`] puts the moments of two planes: whole vectors, and room for all carriers.
    pub(crate) fn stride(&self) -> usize {
        padded(self.rows.len())
    }

    /// Multiply-adds of one [`Carriers::project`] that are of use, by pixels of a row.
    pub(crate) fn multiply_adds(&self, degrees: &[usize], order: usize) -> usize {
        let rows = |degree: usize| (0..=degree).map(|degree| self.range(degree, order).len()).sum::<usize>();
        degrees.iter().map(|degree| rows(*degree)).sum()
    }

    /// Projects `planes[i]`, one row of a plane each, on all carriers that orders up to `order` need; `degrees[i]` is plane `i`'s
    /// degree, highest first. `moments` gets one stretch of [`Carriers::stride`] per plane.
    #[inline(always)]
    pub(crate) fn project<S: Simd>(
        &self,
        simd: S,
        planes: [&[T]; MOST_PLANES],
        degrees: &[usize],
        order: usize,
        moments: &mut [f64],
    ) {
        if let TimesX::Recurrence { .. } = self.times_x {
            // The two rows more are in one stretch with the others: all planes take them along, which costs less than a pass of their own.
            return self.project_all(simd, planes, degrees.len(), 0..order + 1 + degrees[0], moments);
        }
        for degree in 0..=degrees[0] {
            let reaching = degrees.iter().take_while(|d| **d >= degree).count();
            self.project_all(simd, planes, reaching, self.range(degree, order), moments);
        }
    }

    /// The first `count` planes times the carriers in `rows`.
    #[inline(always)]
    fn project_all<S: Simd>(
        &self,
        simd: S,
        planes: [&[T]; MOST_PLANES],
        count: usize,
        rows: Range<usize>,
        moments: &mut [f64],
    ) {
        let [a, b, c, d, e] = planes;
        match count {
            1 => self.tiles(simd, [a], rows, moments),
            2 => self.tiles(simd, [a, b], rows, moments),
            3 => self.tiles(simd, [a, b, c], rows, moments),
            4 => self.tiles(simd, [a, b, c, d], rows, moments),
            _ => self.tiles(simd, [a, b, c, d, e], rows, moments),
        }
    }

    /// `P` planes times the carriers in `rows`, as many at a time as there are registers for.
    #[inline(always)]
    fn tiles<S: Simd, const P: usize>(&self, simd: S, planes: [&[T]; P], rows: Range<usize>, moments: &mut [f64]) {
        let mut first = rows.start;
        if has_many_registers::<S>() {
            while rows.end - first > 5 || rows.end - first == 4 {
                self.tile::<S, P, 4>(simd, planes, first, moments);
                first += 4;
            }
            if rows.end - first > 2 {
                self.tile::<S, P, 3>(simd, planes, first, moments);
                first += 3;
            }
        }
        while first + 2 <= rows.end {
            self.tile::<S, P, 2>(simd, planes, first, moments);
            first += 2;
        }
        if first < rows.end {
            self.tile::<S, P, 1>(simd, planes, first, moments);
        }
    }

    #[inline(always)]
    fn tile<S: Simd, const P: usize, const C: usize>(
        &self,
        simd: S,
        planes: [&[T]; P],
        first: usize,
        moments: &mut [f64],
    ) {
        let stride = self.stride();
        let rows: [&[T]; C] = std::array::from_fn(|i| self.rows[first + i].padded());
        for (i, row) in products(simd, rows, planes).into_iter().enumerate() {
            for (plane, product) in row.into_iter().enumerate() {
                moments[plane * stride + first + i] = product;
            }
        }
    }

    /// From the moments of `x^degree p_n` and of the carriers, those of `x^(degree + 1) p_n` for `n < raised.len()`.
    #[inline(always)]
    pub(crate) fn raise(&self, degree: usize, carried: &[f64], moments: &[f64], raised: &mut [f64]) {
        match &self.times_x {
            TimesX::Recurrence { below, here } => {
                let count = raised.len();
                let (below, here, moments) = (&below[..count + 1], &here[..count], &moments[..count + 1]);
                raised[0] = here[0] * moments[0] + below[1] * moments[1];
                for n in 1..count {
                    raised[n] = below[n] * moments[n - 1] + here[n] * moments[n] + below[n + 1] * moments[n + 1];
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
}

/// `row[u] = values[u] * factor(u)`, rounded once.
fn fill<T: Sample>(row: &mut Row<T>, values: &[f64], factor: impl Fn(f64) -> f64) {
    for (u, (sample, value)) in row.padded_mut().iter_mut().zip(values).enumerate() {
        *sample = T::from_f64(value * factor(u as f64));
    }
}
