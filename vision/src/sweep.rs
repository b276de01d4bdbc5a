//! One pass over a view, or over both at once, image row by image row: gradient, inverse depth, projection along `u`, the columns of `L_I`,
//! and then the multipliers along `v` into the table of features.
//!
//! No full-size plane is made: a row's planes stay in the nearest cache, and the buffers are made once. The difference `I - I*` is
//! taken pixel by pixel, before the projection, so that it keeps its digits when the images nearly agree.
//!
//! `L` is linear in the image, in its gradients and in `ζ` times them. So a sweep over both views takes the means of those planes, and costs
//! hardly more than one view; and where the desired half is kept, the current one is that of `I*` and of `I - I*`, which is projected anyway: its
//! own moments serve for `∇I_v` too, by summation by parts ([`crate::along_v`]).

use std::array::from_fn;

use fearless_simd::{Simd, SimdBase, dispatch};

use crate::along_v::{AlongV, Multiplier};
use crate::basis::Basis;
use crate::camera::Intrinsics;
use crate::depth::Depth;
use crate::fold::Folds;
use crate::image::Plane;
use crate::interaction::Slopes;
use crate::light::across;
use crate::path::Path;
use crate::plan::{
    ALONG_U, ALONG_U_Y, ALONG_V, ALONG_V_Y, ALONG_V_YY, ERROR, MOST_TERMS, Plan, Swept, Views, ZETA_U, ZETA_V,
    ZETA_V_Y, constant_per_m,
};
use crate::projection::{Carriers, MOST_PLANES};
use crate::row::{Row, load};
use crate::sample::Sample;
use crate::table::{BLOCK, ERROR_AND_INTERACTION, FeatureTable, LIGHT, RowMoments, Sums, Term};

/// The buffers of one sweep.
#[derive(Debug)]
pub(crate) struct Sweep<T> {
    camera: Intrinsics,
    path: Path,
    carriers: Carriers<T>,
    planes: Folds<T>,
    /// `ζ` of each view where it is one number.
    constants: [Row<T>; 2],
    moments: RowMoments,
    sums: Sums,
    /// Of `u` from -1 to 1, for the light.
    right: Row<T>,
}

impl<T: Sample> Sweep<T> {
    /// Buffers for rows as long as the basis along `u`.
    pub(crate) fn new(camera: Intrinsics, basis_u: &Basis, highest_order: usize) -> Sweep<T> {
        let (carriers, width) = (Carriers::new(basis_u, highest_order), basis_u.length());
        let mut sweep = Sweep {
            camera,
            path: Path::best(),
            planes: Folds::new(width),
            constants: from_fn(|_| Row::zeros(width)),
            moments: RowMoments::new(MOST_PLANES, carriers.count()),
            sums: Sums::new(MOST_TERMS, carriers.count(), highest_order),
            carriers,
            right: Row::zeros(width),
        };
        for (u, right) in sweep.right.padded_mut()[..width].iter_mut().enumerate() {
            *right = T::from_f64(across(u, width));
        }
        sweep.set_basis(basis_u);
        sweep
    }

    /// Takes other rows along `u`, of the same kind, number and length.
    pub(crate) fn set_basis(&mut self, basis_u: &Basis) {
        self.carriers.set(basis_u, &self.camera);
    }

    pub(crate) fn set_path(&mut self, path: Path) {
        self.path = path;
    }

    /// Fills `table` with what these views say, of planes times the weights, if there are any.
    pub(crate) fn add_up(
        &mut self,
        views: Views<'_, T>,
        weight: Option<&Plane<T>>,
        along_v: &AlongV,
        order: usize,
        table: &mut FeatureTable<ERROR_AND_INTERACTION>,
    ) -> Swept {
        let (plan, [width, height]) = (Plan::of(&views, weight.is_some()), views.first().0.size());
        let terms = plan.terms();
        self.set_constants(views);
        self.sums.clear();
        dispatch!(self.path.level(), simd => self.add_rows(simd, (views, plan), weight, (along_v, &terms), order));
        table.fill(order, |n, m| self.error_and_interaction(plan, n, m));
        let per_row = self.carriers.kept(width) * self.carriers.multiply_adds(plan.degrees, order)
            + self.sum_multiply_adds(&terms, order);
        Swept { multiply_adds: (height * per_row) as u64, of_desired: plan.of_desired }
    }

    /// Multiply-adds of use for one row's part of the sums.
    fn sum_multiply_adds(&self, terms: &[Option<Term>], order: usize) -> usize {
        let degrees = || terms.iter().flatten().map(|term| term.degree);
        (0..=order)
            .map(|m| degrees().map(|degree| self.carriers.multiply_adds(&[degree], order - m)).sum::<usize>())
            .sum()
    }

    fn set_constants(&mut self, views: Views<'_, T>) {
        let depths = match views {
            Views::Desired((_, depth)) => [depth; 2],
            Views::Current((_, current), (_, desired)) | Views::Both((_, current), (_, desired)) => [current, desired],
        };
        for (row, depth) in self.constants.iter_mut().zip(depths) {
            if let Some(zeta) = constant_per_m(depth) {
                row.padded_mut().fill(T::from_f64(zeta));
            }
        }
    }

    #[inline(always)]
    fn add_rows<S: Simd>(
        &mut self,
        simd: S,
        (views, plan): (Views<'_, T>, Plan),
        weight: Option<&Plane<T>>,
        (along_v, terms): (&AlongV, &[Option<Term>]),
        order: usize,
    ) {
        let height = views.first().0.height();
        for v in 0..height {
            let weight = weight.map(|weight| weight.row(v));
            // Each stage is a function of its own, so that its loops have the registers to themselves.
            simd.vectorize(
                #[inline(always)]
                || self.fill_planes(simd, views, plan, weight, v),
            );
            self.take_row(simd, plan.degrees, (along_v, terms), order, [v, height]);
        }
    }

    /// Projects the planes of row `v`, and adds up the block that ends with it.
    #[inline(always)]
    fn take_row<S: Simd>(
        &mut self,
        simd: S,
        degrees: &[usize],
        (along_v, terms): (&AlongV, &[Option<Term>]),
        order: usize,
        [v, height]: [usize; 2],
    ) {
        simd.vectorize(
            #[inline(always)]
            || {
                self.carriers.project(simd, &self.planes, degrees, order, v % BLOCK, &mut self.moments);
            },
        );
        if v == height - 1 {
            self.moments.clear_rows(v % BLOCK + 1);
        }
        if v == height - 1 || v % BLOCK == BLOCK - 1 {
            simd.vectorize(
                #[inline(always)]
                || self.add_block(simd, (along_v, terms), order, v / BLOCK),
            );
        }
    }

    #[inline(always)]
    fn add_block<S: Simd>(
        &mut self,
        simd: S,
        (along_v, terms): (&AlongV, &[Option<Term>]),
        order: usize,
        block: usize,
    ) {
        for (slot, term) in terms.iter().enumerate() {
            let Some(term) = *term else { continue };
            for chunk in 0..self.carriers.chunks() {
                let factors = along_v.of(term.times, block, self.carriers.multipliers(chunk, term.degree, order));
                self.sums.add(simd, (slot, term), chunk, &self.moments, factors);
            }
        }
    }

    /// `[e, L]` of one feature, from the sums: [`crate::interaction`] written out, each product of `x` raised, each of `y` a multiplier of its own.
    fn error_and_interaction(&self, plan: Plan, n: usize, m: usize) -> [f64; ERROR_AND_INTERACTION] {
        let sum = |slot: usize, degree: usize| self.carriers.raised(degree, self.sums.of(slot, m), n);
        let [f_u, f_v] = self.camera.focal_px();
        let translation = match plan.constant_per_m {
            Some(zeta) => [
                zeta * f_u * sum(ALONG_U, 0),
                zeta * f_v * sum(ALONG_V, 0),
                -zeta * (f_u * sum(ALONG_U, 1) + f_v * sum(ALONG_V_Y, 0)),
            ],
            None => [f_u * sum(ZETA_U, 0), f_v * sum(ZETA_V, 0), -(f_u * sum(ZETA_U, 1) + f_v * sum(ZETA_V_Y, 0))],
        };
        [
            if plan.error.is_some() { sum(ERROR, 0) } else { 0.0 },
            translation[0],
            translation[1],
            translation[2],
            -(f_u * sum(ALONG_U_Y, 1) + f_v * sum(ALONG_V_YY, 0)),
            f_u * (sum(ALONG_U, 0) + sum(ALONG_U, 2)) + f_v * sum(ALONG_V_Y, 1),
            f_v * sum(ALONG_V, 1) - f_u * sum(ALONG_U_Y, 0),
        ]
    }

    /// The row's planes, as the plan has them.
    #[inline(always)]
    fn fill_planes<S: Simd>(&mut self, simd: S, views: Views<'_, T>, plan: Plan, weight: Option<&[T]>, v: usize) {
        let ((own, own_depth), half) = (views.first(), T::from_f64(0.5));
        let slopes = Slopes::of(own, v);
        let (row, zeta) = (own.row(v), zeta_row(own_depth, self.constants[0].padded(), v));
        let shape = (own.width(), self.carriers.are_folded());
        match (views, plan.constant_per_m) {
            (Views::Current(_, (desired, _)), constant) if plan.by_parts => {
                let desired = Slopes::of(desired, v);
                if constant.is_some() {
                    return self.planes.fill(
                        simd,
                        shape,
                        #[inline(always)]
                        |at, place| slopes.difference(&desired, simd, at, place),
                    );
                }
                self.planes.fill(
                    simd,
                    shape,
                    #[inline(always)]
                    |at, place| {
                        let [along_u, difference] = slopes.difference(&desired, simd, at, place);
                        let (slopes, zeta) = (slopes.at(simd, at, place), load(simd, zeta, at));
                        [along_u, difference, slopes[0] * zeta, slopes[1] * zeta]
                    },
                );
            }
            (Views::Both(_, (other, other_depth)), constant) => {
                let (other_slopes, other_row) = (Slopes::of(other, v), other.row(v));
                let other_zeta = zeta_row(other_depth, self.constants[1].padded(), v);
                if constant.is_some() {
                    return self.planes.fill(
                        simd,
                        shape,
                        #[inline(always)]
                        |at, place| {
                            let (a, b) = (slopes.at(simd, at, place), other_slopes.at(simd, at, place));
                            let halved = weight_at(simd, weight, at) * half;
                            let error = (load(simd, row, at) - load(simd, other_row, at)) * (halved + halved);
                            [(a[0] + b[0]) * halved, (a[1] + b[1]) * halved, error]
                        },
                    );
                }
                self.planes.fill(
                    simd,
                    shape,
                    #[inline(always)]
                    |at, place| {
                        let (a, b) = (slopes.at(simd, at, place), other_slopes.at(simd, at, place));
                        let halved = weight_at(simd, weight, at) * half;
                        let (a_zeta, b_zeta) = (load(simd, zeta, at), load(simd, other_zeta, at));
                        let error = (load(simd, row, at) - load(simd, other_row, at)) * (halved + halved);
                        [
                            (a[0] + b[0]) * halved,
                            (a[1] + b[1]) * halved,
                            (a[0] * a_zeta + b[0] * b_zeta) * halved,
                            (a[1] * a_zeta + b[1] * b_zeta) * halved,
                            error,
                        ]
                    },
                );
            }
            (_, constant) => {
                // Without an error its plane is not looked at.
                let desired = views.error_to().unwrap_or(own).row(v);
                if constant.is_some() {
                    return self.planes.fill(
                        simd,
                        shape,
                        #[inline(always)]
                        |at, place| {
                            let weight = weight_at(simd, weight, at);
                            let ([along_u, along_v], error) =
                                (slopes.at(simd, at, place), load(simd, row, at) - load(simd, desired, at));
                            [along_u * weight, along_v * weight, error * weight]
                        },
                    );
                }
                self.planes.fill(
                    simd,
                    shape,
                    #[inline(always)]
                    |at, place| {
                        let weight = weight_at(simd, weight, at);
                        let ([along_u, along_v], error) =
                            (slopes.at(simd, at, place), load(simd, row, at) - load(simd, desired, at));
                        let (along_u, along_v, zeta) = (along_u * weight, along_v * weight, load(simd, zeta, at));
                        [along_u, along_v, along_u * zeta, along_v * zeta, error * weight]
                    },
                );
            }
        }
    }

    /// Fills `table` with the moments of the light's planes `{I*, 1, u I*, v I*, u, v}`, times the weights, if there are any.
    /// Returns the multiply-adds of use.
    pub(crate) fn add_up_light(
        &mut self,
        desired: &Plane<T>,
        weight: Option<&Plane<T>>,
        along_v: &AlongV,
        order: usize,
        table: &mut FeatureTable<LIGHT>,
    ) -> u64 {
        let [width, height] = desired.size();
        let term = |plane, times| Some(Term { plane, times, degree: 0 });
        let (q, yq) = (Multiplier::Q, Multiplier::Yq);
        let terms = [term(0, q), term(1, q), term(2, q), term(0, yq), term(3, q), term(1, yq)];
        self.sums.clear();
        dispatch!(self.path.level(), simd => self.add_light_rows(simd, desired, weight, (along_v, &terms), order));
        // From -1 to 1 down the image is so many `y`, and a shift.
        let [top, bottom] = [0, height - 1].map(|v| self.camera.y(v as f64));
        let per_y = 2.0 / (bottom - top);
        table.fill(order, |n, m| {
            let sum = |slot: usize| self.sums.of(slot, m)[n];
            let down = |times_y: usize, plain: usize| per_y * (sum(times_y) - top * sum(plain)) - sum(plain);
            [sum(0), sum(1), sum(2), down(3, 0), sum(4), down(5, 1)]
        });
        let per_row = self.carriers.kept(width) * self.carriers.multiply_adds(&[0; 4], order)
            + self.sum_multiply_adds(&terms, order);
        (height * per_row) as u64
    }

    #[inline(always)]
    fn add_light_rows<S: Simd>(
        &mut self,
        simd: S,
        desired: &Plane<T>,
        weight: Option<&Plane<T>>,
        terms: (&AlongV, &[Option<Term>]),
        order: usize,
    ) {
        let [width, height] = desired.size();
        for v in 0..height {
            let weight = weight.map(|weight| weight.row(v));
            simd.vectorize(
                #[inline(always)]
                || self.fill_light_planes(simd, desired.row(v), weight, width),
            );
            self.take_row(simd, &[0; 4], terms, order, [v, height]);
        }
    }

    #[inline(always)]
    fn fill_light_planes<S: Simd>(&mut self, simd: S, desired: &[T], weight: Option<&[T]>, width: usize) {
        let right = self.right.padded();
        self.planes.fill(
            simd,
            (width, self.carriers.are_folded()),
            #[inline(always)]
            |at, _| {
                let (right, weight) = (load(simd, right, at), weight_at(simd, weight, at));
                let value = load(simd, desired, at) * weight;
                [value, weight, right * value, right * weight]
            },
        );
    }
}

/// The weights from `at` on: one each if there are none.
#[inline(always)]
fn weight_at<S: Simd, T: Sample>(simd: S, weight: Option<&[T]>, at: usize) -> T::Vector<S> {
    match weight {
        Some(weight) => load(simd, weight, at),
        None => T::Vector::<S>::splat(simd, T::from_f64(1.0)),
    }
}

/// `ζ` along row `v`.
fn zeta_row<'a, T: Sample>(depth: &'a Depth<T>, constant: &'a [T], v: usize) -> &'a [T] {
    match depth {
        Depth::Constant { .. } => constant,
        Depth::Map(map) => map.inverse_per_m().row(v),
    }
}
