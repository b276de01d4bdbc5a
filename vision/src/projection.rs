//! Everything is a projection: rows of planes times the basis rows of the `u` axis.
//!
//! The double sum `Σ_u Σ_v p_n(u) q_m(v) J(u, v)` is done in two stages, image row by image row: here `h_n = Σ_u p_n(u) J(u, v)`,
//! then `h_n q_m(v)` is added up ([`crate::table`]). The interaction matrix also needs moments of `x p_n` and `x² p_n`; for the
//! polynomials both lie in the span of `p_0 … p_{l+2}`, by the recurrence, so two more rows carry them ("carriers"). Rows without a
//! recurrence (cosines): their carriers are `p_n`, `x p_n` and `x² p_n` themselves.
//!
//! A plane of degree `k` is projected on the carriers of degrees `0 … k`: 2 for the gradient along `u`, 1 along `v`, 0 for an image.

use std::ops::Range;

use fearless_simd::{Simd, SimdBase, SimdFloat};

use crate::basis::Basis;
use crate::camera::Intrinsics;
use crate::path::has_many_registers;
use crate::row::{PADDING, Row};
use crate::sample::Sample;
use crate::table::{CHUNK, RowMoments};

/// Most planes that are projected together.
pub(crate) const MOST_PLANES: usize = 5;

/// The rows that carry `p_n`, `x p_n` and `x² p_n` along `u`, for `n` up to the highest order.
#[derive(Debug)]
pub(crate) struct Carriers<T> {
    /// `[stretch of a row][carrier][sample]`, so that one address leads to all carriers of a stretch.
    values: Row<T>,
    count: usize,
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
        let (count, times_x) = match basis.recurrence() {
            Some(_) => {
                let rows = highest_order + 3;
                (rows, TimesX::Recurrence { below: vec![0.0; rows], here: vec![0.0; rows - 1] })
            }
            None => (3 * (highest_order + 1).next_multiple_of(CHUNK), TimesX::OwnRows),
        };
        Carriers { values: Row::zeros(count * basis.length().next_multiple_of(PADDING)), count, times_x, highest_order }
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
                for n in 0..self.count {
                    self.fill(n, basis.row(n), |_| 1.0);
                }
            }
            _ => {
                let (highest_order, between) = (self.highest_order, self.own_rows());
                for (degree, n) in (0..3).flat_map(|degree| (0..=highest_order).map(move |n| (degree, n))) {
                    self.fill(degree * between + n, basis.row(n), |u| camera.x(u).powi(degree as i32));
                }
            }
        }
    }

    /// `carrier[u] = values[u] * factor(u)`, rounded once.
    fn fill(&mut self, carrier: usize, values: &[f64], factor: impl Fn(f64) -> f64) {
        let (chunks, _) = self.values.padded_mut().as_chunks_mut::<PADDING>();
        for (u, value) in values.iter().enumerate() {
            chunks[u / PADDING * self.count + carrier][u % PADDING] = T::from_f64(value * factor(u as f64));
        }
    }

    /// How far apart the carriers of two degrees are when each has its own.
    fn own_rows(&self) -> usize {
        (self.highest_order + 1).next_multiple_of(CHUNK)
    }

    /// How many carriers there are.
    pub(crate) fn count(&self) -> usize {
        self.count
    }

    /// Multiply-adds that are of use: by pixels of a row to project planes of these degrees, and by rows to sum up terms of these.
    pub(crate) fn multiply_adds(&self, degrees: &[usize], order: usize) -> usize {
        let rows = |degree: usize| (0..=degree).map(|degree| self.range(degree, order).len()).sum::<usize>();
        degrees.iter().map(|degree| rows(*degree)).sum()
    }

    /// Projects `planes[i]`, one row of a plane each, on all carriers that orders up to `order` need; `degrees[i]` is plane `i`'s
    /// degree, highest first. `moments` gets them for one `row` of its block.
    #[inline(always)]
    pub(crate) fn project<S: Simd>(
        &self,
        simd: S,
        planes: [&[T]; MOST_PLANES],
        degrees: &[usize],
        order: usize,
        row: usize,
        moments: &mut RowMoments,
    ) {
        if let TimesX::Recurrence { .. } = self.times_x {
            // The two rows more are in one stretch with the others: all planes take them along, which costs less than a pass of their own.
            return self.project_all(simd, planes, degrees.len(), 0..order + 1 + degrees[0], row, moments);
        }
        for degree in 0..=degrees[0] {
            let reaching = degrees.iter().take_while(|d| **d >= degree).count();
            self.project_all(simd, planes, reaching, self.range(degree, order), row, moments);
        }
    }

    /// The first `count` planes times these carriers.
    #[inline(always)]
    fn project_all<S: Simd>(
        &self,
        simd: S,
        planes: [&[T]; MOST_PLANES],
        count: usize,
        carriers: Range<usize>,
        row: usize,
        moments: &mut RowMoments,
    ) {
        let [a, b, c, d, e] = planes;
        match count {
            1 => self.tiles(simd, [a], carriers, row, moments),
            2 => self.tiles(simd, [a, b], carriers, row, moments),
            3 => self.tiles(simd, [a, b, c], carriers, row, moments),
            4 => self.tiles(simd, [a, b, c, d], carriers, row, moments),
            _ => self.tiles(simd, [a, b, c, d, e], carriers, row, moments),
        }
    }

    /// `P` planes times these carriers, as many at a time as there are registers for, in stretches as even as can be.
    #[inline(always)]
    fn tiles<S: Simd, const P: usize>(
        &self,
        simd: S,
        planes: [&[T]; P],
        carriers: Range<usize>,
        row: usize,
        moments: &mut RowMoments,
    ) {
        let most = if has_many_registers::<S>() { [8, 8, 8, 6, 4][P - 1] } else { [8, 5, 3, 2, 2][P - 1] };
        let mut first = carriers.start;
        while first < carriers.end {
            let left = carriers.end - first;
            let count = left.div_ceil(left.div_ceil(most));
            match count {
                8 if most >= 8 => self.tile::<S, P, 8>(simd, planes, first, row, moments),
                7 if most >= 8 => self.tile::<S, P, 7>(simd, planes, first, row, moments),
                6 if most >= 6 => self.tile::<S, P, 6>(simd, planes, first, row, moments),
                5 if most >= 5 => self.tile::<S, P, 5>(simd, planes, first, row, moments),
                4 if most >= 4 => self.tile::<S, P, 4>(simd, planes, first, row, moments),
                3 if most >= 3 => self.tile::<S, P, 3>(simd, planes, first, row, moments),
                2 => self.tile::<S, P, 2>(simd, planes, first, row, moments),
                _ => self.tile::<S, P, 1>(simd, planes, first, row, moments),
            }
            first += count;
        }
    }

    /// Every product has a sum of its own that waits for no other ("strand"), in a register if they are few enough.
    ///
    /// Loops are plain: a closure handed to `array::map` would not be compiled for the path.
    #[inline(always)]
    fn tile<S: Simd, const P: usize, const C: usize>(
        &self,
        simd: S,
        planes: [&[T]; P],
        first: usize,
        row: usize,
        moments: &mut RowMoments,
    ) {
        let (lanes, zero) = (T::Vector::<S>::LEN, T::Vector::<S>::splat(simd, T::ZERO));
        let (mut strands, mut parts) = ([[zero; P]; C], [zero; P]);
        let (carriers, _) = self.values.padded().as_chunks::<PADDING>();
        let mut stretches = [&[[T::ZERO; PADDING]; 0][..]; P];
        for p in 0..P {
            (stretches[p], _) = planes[p].as_chunks::<PADDING>();
            stretches[p] = &stretches[p][..stretches[0].len()];
        }
        for (i, carriers) in carriers.chunks_exact(self.count).take(stretches[0].len()).enumerate() {
            let carriers = &carriers[first..first + C];
            let mut at = 0;
            while at < PADDING {
                for p in 0..P {
                    parts[p] = T::Vector::<S>::from_slice(simd, &stretches[p][i][at..at + lanes]);
                }
                for c in 0..C {
                    let carrier = T::Vector::<S>::from_slice(simd, &carriers[c][at..at + lanes]);
                    for p in 0..P {
                        strands[c][p] = carrier.mul_add(parts[p], strands[c][p]);
                    }
                }
                at += lanes;
            }
        }
        for p in 0..P {
            for c in 0..C {
                moments.set(p, first + c, row, strands[c][p].reduce_sum().to_f64());
            }
        }
    }

    /// Of sums by carrier: those of `x^degree p_n`, from those that a plane of at least this degree has.
    pub(crate) fn raised(&self, degree: usize, sums: &[f64], n: usize) -> f64 {
        match (&self.times_x, degree) {
            (_, 0) => sums[n],
            (TimesX::OwnRows, _) => sums[self.range(degree, self.highest_order).start + n],
            (TimesX::Recurrence { below, here }, _) => {
                let lower = |n: usize| self.raised(degree - 1, sums, n);
                let before = if n == 0 { 0.0 } else { below[n] * lower(n - 1) };
                before + here[n] * lower(n) + below[n + 1] * lower(n + 1)
            }
        }
    }

    /// The carriers that a plane of this degree needs: in one stretch, or in one for each power of `x`.
    pub(crate) fn ranges(&self, degree: usize, order: usize) -> impl Iterator<Item = Range<usize>> {
        let (first, last) = match self.times_x {
            TimesX::Recurrence { .. } => (degree, degree),
            TimesX::OwnRows => (0, degree),
        };
        (first..=last).map(move |power| match self.times_x {
            TimesX::Recurrence { .. } => 0..order + 1 + power,
            TimesX::OwnRows => self.range(power, order),
        })
    }

    /// The carriers that a plane of this degree needs beyond those of the degrees below.
    fn range(&self, degree: usize, order: usize) -> Range<usize> {
        match (&self.times_x, degree) {
            (TimesX::OwnRows, _) => degree * self.own_rows()..degree * self.own_rows() + order + 1,
            (TimesX::Recurrence { .. }, 0) => 0..order + 1,
            (TimesX::Recurrence { .. }, _) => order + degree..order + degree + 1,
        }
    }
}
