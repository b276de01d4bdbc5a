//! Everything is a projection: rows of planes times the basis rows of the `u` axis.
//!
//! The double sum `Σ_u Σ_v p_n(u) q_m(v) J(u, v)` is done in two stages, image row by image row: here `h_n = Σ_u p_n(u) J(u, v)`,
//! then `h_n q_m(v)` is added up ([`crate::table`]). The interaction matrix also needs moments of `x p_n` and `x² p_n`; for the
//! polynomials both lie in the span of `p_0 … p_{l+2}`, by the recurrence, so two more rows carry them ("carriers"). Rows without a
//! recurrence (cosines): their carriers are `p_n`, `x p_n` and `x² p_n` themselves.
//!
//! A plane of degree `k` is projected on the carriers of degrees `0 … k`: 2 for the gradient along `u`, 1 along `v`, 0 for an image.
//!
//! Rows that are even and odd about the middle in turn meet a row of pixels folded there ([`crate::fold`]): half the multiply-adds.

use std::ops::Range;

use fearless_simd::{Simd, SimdBase, SimdFloat};

use crate::basis::Basis;
use crate::camera::Intrinsics;
use crate::fold::{FOLDABLE, Folds};
use crate::path::has_many_registers;
use crate::row::{PADDING, Row};
use crate::sample::Sample;
use crate::table::{CHUNK, RowMoments};

/// Most planes that are projected together.
pub(crate) const MOST_PLANES: usize = 5;

/// The rows that carry `p_n`, `x p_n` and `x² p_n` along `u`, for `n` up to the highest order.
#[derive(Debug)]
pub(crate) struct Carriers<T> {
    /// `[stretch of a row][slot][sample]`, so that one address leads to all carriers of a stretch. Of folded rows only the first half.
    values: Row<T>,
    count: usize,
    /// Whether they are even and odd in turn; then those of even number have the first slots of their group.
    folded: bool,
    times_x: TimesX,
    highest_order: usize,
}

/// How moments of `x p_n` come from moments of the carriers.
#[derive(Debug)]
enum TimesX {
    /// `x p_n = below[n] p_{n-1} + here[n] p_n + below[n + 1] p_{n+1}`.
    Recurrence { below: Vec<f64>, here: Vec<f64> },
    /// They are carriers themselves, of `t p_n` and `t² p_n` in place of `x`, with `x = scale t + shift` and `t` from -1 to 1.
    OwnRows { scale: f64, shift: f64 },
}

/// Carriers that follow each other in the slots: the numbers of the first and of those after it.
#[derive(Debug, Clone, Copy)]
struct Run {
    slot: usize,
    carrier: usize,
    step: usize,
    count: usize,
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
            None => (3 * (highest_order + 1).next_multiple_of(CHUNK), TimesX::OwnRows { scale: 1.0, shift: 0.0 }),
        };
        let values = Row::zeros(count * basis.length().next_multiple_of(PADDING));
        Carriers { values, count, folded: false, times_x, highest_order }
    }

    /// Fills the carriers from another basis of the same kind, in place.
    pub(crate) fn set(&mut self, basis: &Basis, camera: &Intrinsics) {
        self.folded = basis.length() >= FOLDABLE && basis.is_even_and_odd_in_turn();
        // x = scale t + shift, since u = (t + 1)(points - 1)/2.
        let points = basis.recurrence().map_or(basis.length(), |by| by.points);
        let half = (points - 1) as f64 / 2.0;
        let (to_scale, to_shift) = (half / camera.focal_px()[0], camera.x(half));
        match (&mut self.times_x, basis.recurrence()) {
            (TimesX::Recurrence { below, here }, Some(by)) => {
                for (below, beta) in below.iter_mut().zip(by.off_diagonal) {
                    *below = to_scale * beta;
                }
                for (here, alpha) in here.iter_mut().zip(by.diagonal) {
                    *here = to_scale * alpha + to_shift;
                }
                for n in 0..self.count {
                    self.fill(n, basis.row(n), |_| 1.0);
                }
            }
            (TimesX::OwnRows { scale, shift }, _) => {
                (*scale, *shift) = (to_scale, to_shift);
                let (highest_order, between) = (self.highest_order, self.own_rows());
                for (degree, n) in (0..3).flat_map(|degree| (0..=highest_order).map(move |n| (degree, n))) {
                    self.fill(degree * between + n, basis.row(n), |u| (u / half - 1.0).powi(degree as i32));
                }
            }
            _ => unreachable!("a basis keeps its kind"),
        }
    }

    /// `carrier[u] = values[u] * factor(u)`, rounded once. The pixel in the middle of a folded row is its own mirror image: it counts by half.
    fn fill(&mut self, carrier: usize, values: &[f64], factor: impl Fn(f64) -> f64) {
        let (slot, kept) = (self.slot(carrier), self.kept(values.len()));
        let (chunks, _) = self.values.padded_mut().as_chunks_mut::<PADDING>();
        for u in 0..kept.next_multiple_of(PADDING) {
            let share = match values.len() {
                length if kept < length && 2 * u + 1 == length => 0.5,
                _ if u < kept => 1.0,
                // What a folded row has beyond its middle meets zeros.
                _ => 0.0,
            };
            let value = values.get(u).map_or(0.0, |value| value * factor(u as f64) * share);
            chunks[u / PADDING * self.count + slot][u % PADDING] = T::from_f64(value);
        }
    }

    /// How many samples of a row of so many meet a carrier.
    pub(crate) fn kept(&self, length: usize) -> usize {
        if self.folded { length.div_ceil(2) } else { length }
    }

    /// Whether rows are to be folded before they are projected.
    pub(crate) fn are_folded(&self) -> bool {
        self.folded
    }

    /// Where a carrier is in a stretch.
    fn slot(&self, carrier: usize) -> usize {
        if !self.folded {
            return carrier;
        }
        let group = self.group();
        let (first, number) = (carrier / group * group, carrier % group);
        first + number / 2 + if number % 2 == 1 { group.div_ceil(2) } else { 0 }
    }

    /// How many carriers of one degree of `x` there are.
    fn group(&self) -> usize {
        if let TimesX::Recurrence { .. } = self.times_x { self.count } else { self.own_rows() }
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

    /// Projects row `i` of `folds`, one row of a plane each, on all carriers that orders up to `order` need; `degrees[i]` is that plane's
    /// degree, highest first. `moments` gets them for one `row` of its block.
    #[inline(always)]
    pub(crate) fn project<S: Simd>(
        &self,
        simd: S,
        folds: &Folds<T>,
        degrees: &[usize],
        order: usize,
        row: usize,
        moments: &mut RowMoments,
    ) {
        if let TimesX::Recurrence { .. } = self.times_x {
            // The two rows more are in one stretch with the others: all planes take them along, which costs less than a pass of their own.
            return self.project_group(simd, folds, (degrees.len(), 0), 0..order + 1 + degrees[0], row, moments);
        }
        for degree in 0..=degrees[0] {
            let reaching = degrees.iter().take_while(|d| **d >= degree).count();
            self.project_group(simd, folds, (reaching, degree), self.range(degree, order), row, moments);
        }
    }

    /// The first `count` planes times these carriers of one degree, the group's first among them.
    #[inline(always)]
    fn project_group<S: Simd>(
        &self,
        simd: S,
        folds: &Folds<T>,
        (count, degree): (usize, usize),
        carriers: Range<usize>,
        row: usize,
        moments: &mut RowMoments,
    ) {
        if !self.folded {
            let run = Run { slot: carriers.start, carrier: carriers.start, step: 1, count: carriers.len() };
            return self.project_run(simd, folds.whole(), count, run, row, moments);
        }
        for odd in 0..2 {
            let (carrier, count_of_run) = (carriers.start + odd, (carriers.len() + 1 - odd) / 2);
            let run = Run { slot: self.slot(carrier), carrier, step: 2, count: count_of_run };
            // An odd power of `t` makes an odd carrier of an even row.
            let halves = if (odd + degree).is_multiple_of(2) { folds.even() } else { folds.odd() };
            self.project_run(simd, halves, count, run, row, moments);
        }
    }

    /// The first `count` planes times this run of carriers.
    #[inline(always)]
    fn project_run<S: Simd>(
        &self,
        simd: S,
        planes: [&[T]; MOST_PLANES],
        count: usize,
        run: Run,
        row: usize,
        moments: &mut RowMoments,
    ) {
        let [a, b, c, d, e] = planes;
        match count {
            1 => self.tiles(simd, [a], run, row, moments),
            2 => self.tiles(simd, [a, b], run, row, moments),
            3 => self.tiles(simd, [a, b, c], run, row, moments),
            4 => self.tiles(simd, [a, b, c, d], run, row, moments),
            _ => self.tiles(simd, [a, b, c, d, e], run, row, moments),
        }
    }

    /// `P` planes times this run of carriers, as many at a time as there are registers for, in stretches as even as can be.
    #[inline(always)]
    fn tiles<S: Simd, const P: usize>(
        &self,
        simd: S,
        planes: [&[T]; P],
        mut run: Run,
        row: usize,
        moments: &mut RowMoments,
    ) {
        let most = if has_many_registers::<S>() { [10, 10, 8, 6, 4][P - 1] } else { [8, 5, 3, 2, 2][P - 1] };
        while run.count > 0 {
            let count = run.count.div_ceil(run.count.div_ceil(most));
            match count {
                10 if most >= 10 => self.tile::<S, P, 10>(simd, planes, run, row, moments),
                9 if most >= 10 => self.tile::<S, P, 9>(simd, planes, run, row, moments),
                8 if most >= 8 => self.tile::<S, P, 8>(simd, planes, run, row, moments),
                7 if most >= 8 => self.tile::<S, P, 7>(simd, planes, run, row, moments),
                6 if most >= 6 => self.tile::<S, P, 6>(simd, planes, run, row, moments),
                5 if most >= 5 => self.tile::<S, P, 5>(simd, planes, run, row, moments),
                4 if most >= 4 => self.tile::<S, P, 4>(simd, planes, run, row, moments),
                3 if most >= 3 => self.tile::<S, P, 3>(simd, planes, run, row, moments),
                2 => self.tile::<S, P, 2>(simd, planes, run, row, moments),
                _ => self.tile::<S, P, 1>(simd, planes, run, row, moments),
            }
            run = Run {
                slot: run.slot + count,
                carrier: run.carrier + run.step * count,
                count: run.count - count,
                ..run
            };
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
        run: Run,
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
            let carriers = &carriers[run.slot..run.slot + C];
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
            let moments = &mut moments.row_mut(p, row)[run.carrier..=run.carrier + run.step * (C - 1)];
            for c in 0..C {
                moments[run.step * c] = strands[c][p].reduce_sum().to_f64();
            }
        }
    }

    /// Of sums by carrier: those of `x^degree p_n`, from those that a plane of at least this degree has.
    pub(crate) fn raised(&self, degree: usize, sums: &[f64], n: usize) -> f64 {
        match (&self.times_x, degree) {
            (_, 0) => sums[n],
            (TimesX::OwnRows { scale, shift }, _) => {
                let own = |degree: usize| sums[degree * self.own_rows() + n];
                match degree {
                    1 => scale * own(1) + shift * own(0),
                    _ => scale * scale * own(2) + 2.0 * scale * shift * own(1) + shift * shift * own(0),
                }
            }
            (TimesX::Recurrence { below, here }, _) => {
                let lower = |n: usize| self.raised(degree - 1, sums, n);
                let before = if n == 0 { 0.0 } else { below[n] * lower(n - 1) };
                before + here[n] * lower(n) + below[n + 1] * lower(n + 1)
            }
        }
    }

    /// How many chunks of carriers there are.
    pub(crate) fn chunks(&self) -> usize {
        self.count.div_ceil(CHUNK)
    }

    /// For how many `m`, from 0 on, a plane of this degree needs a carrier of this chunk.
    pub(crate) fn multipliers(&self, chunk: usize, degree: usize, order: usize) -> usize {
        match self.times_x {
            TimesX::Recurrence { .. } => (order + 1 + degree).saturating_sub(chunk * CHUNK).min(order + 1),
            TimesX::OwnRows { .. } => {
                let (power, carrier) = (chunk * CHUNK / self.own_rows(), chunk * CHUNK % self.own_rows());
                if power > degree { 0 } else { (order + 1).saturating_sub(carrier) }
            }
        }
    }

    /// The carriers that a plane of this degree needs beyond those of the degrees below.
    fn range(&self, degree: usize, order: usize) -> Range<usize> {
        match (&self.times_x, degree) {
            (TimesX::OwnRows { .. }, _) => degree * self.own_rows()..degree * self.own_rows() + order + 1,
            (TimesX::Recurrence { .. }, 0) => 0..order + 1,
            (TimesX::Recurrence { .. }, _) => order + degree..order + degree + 1,
        }
    }
}
