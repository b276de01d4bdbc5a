//! One pass over a view, image row by image row: gradient, inverse depth, projection along `u`, the columns of `L_I`, and then
//! `× q_m(v)` into the table of features.
//!
//! No full-size plane is made: a row's planes stay in the nearest cache, and the buffers are made once. The difference `I - I*` is
//! taken pixel by pixel, before the projection, so that it keeps its digits when the images nearly agree.

use crate::basis::Basis;
use crate::camera::Intrinsics;
use crate::depth::Depth;
use crate::features::Sight;
use crate::image::Plane;
use crate::interaction::{GradientMoments, gradient_row};
use crate::light::across;
use crate::moments::FeatureRow;
use crate::projection::{Carriers, Chunks, padded_row};
use crate::sample::Sample;

/// A feature's error, then its row of `L`.
pub(crate) const ERROR_AND_INTERACTION: usize = 7;

/// A feature's row of `C`.
pub(crate) const LIGHT: usize = 6;

/// Most planes a row is projected for: `∇I_u`, `∇I_v`, `ζ ∇I_u`, `ζ ∇I_v`, `I - I*`.
const PLANES: usize = 5;

/// The buffers of one sweep over a view.
#[derive(Debug)]
pub(crate) struct Sweep<T> {
    camera: Intrinsics,
    carriers: Carriers<T>,
    planes: [Chunks<T>; PLANES],
    carried: Vec<f64>,
    powers: Powers,
    columns: Vec<f64>,
}

/// Moments of `x g_u`, `x² g_u`, `x g_v` and `x ζ g_u`, by `n`.
#[derive(Debug)]
struct Powers {
    x_gu: Vec<f64>,
    xx_gu: Vec<f64>,
    x_gv: Vec<f64>,
    x_zgu: Vec<f64>,
}

impl<T: Sample> Sweep<T> {
    /// Buffers for rows as long as the basis along `u`.
    pub(crate) fn new(camera: Intrinsics, basis_u: &Basis, highest_order: usize) -> Sweep<T> {
        let carriers = Carriers::new(basis_u, highest_order);
        let row = || vec![0.0; highest_order + 2];
        let mut sweep = Sweep {
            camera,
            planes: std::array::from_fn(|_| padded_row(basis_u.length())),
            carried: vec![0.0; PLANES * carriers.len()],
            carriers,
            powers: Powers { x_gu: row(), xx_gu: row(), x_gv: row(), x_zgu: row() },
            columns: vec![0.0; (highest_order + 1) * ERROR_AND_INTERACTION],
        };
        sweep.set_basis(basis_u);
        sweep
    }

    /// Takes other rows along `u`, of the same kind, number and length.
    pub(crate) fn set_basis(&mut self, basis_u: &Basis) {
        self.carriers.set(basis_u, &self.camera);
    }

    /// Fills `table` with `L(I, Z)` of this view and, if `desired` is given, with the moments of `I - I*`; of their planes times
    /// the weights, if there are any.
    pub(crate) fn add_up(
        &mut self,
        (image, depth): Sight<'_, T>,
        desired: Option<&Plane<T>>,
        weight: Option<&Plane<T>>,
        basis_v: &Basis,
        order: usize,
        table: &mut FeatureTable<ERROR_AND_INTERACTION>,
    ) {
        table.clear(order);
        for v in 0..image.height() {
            let error_slot = self.fill_planes(image, depth, desired, v);
            if let Some(weight) = weight {
                self.weigh(weight.row(v));
            }
            self.project(matches!(depth, Depth::Map(_)), error_slot, order);
            let constant = if let Depth::Constant { depth_m } = depth { Some(1.0 / depth_m) } else { None };
            self.fill_columns(self.camera.y(v as f64), constant, error_slot, order);
            table.add_row(&self.columns, |m| basis_v.row(m)[v]);
        }
    }

    /// Fills `table` with the moments of the light's planes `{I*, 1, u I*, v I*, u, v}`, times the weights, if there are any.
    pub(crate) fn add_up_light(
        &mut self,
        desired: &Plane<T>,
        weight: Option<&Plane<T>>,
        basis_v: &Basis,
        order: usize,
        table: &mut FeatureTable<LIGHT>,
    ) {
        table.clear(order);
        let [width, height] = desired.size();
        for v in 0..height {
            let [own, one, u_own, u_plane, _] =
                self.planes.each_mut().map(|plane| &mut plane.as_flattened_mut()[..width]);
            for (u, sample) in desired.row(v).iter().enumerate() {
                let right = T::from_f64(across(u, width));
                (own[u], one[u], u_own[u], u_plane[u]) = (*sample, T::from_f64(1.0), right * *sample, right);
            }
            if let Some(weight) = weight {
                self.weigh(weight.row(v));
            }
            let planes = self.planes.each_ref().map(|plane| &plane[..]);
            self.carriers.project(&planes[..4], &[0; 4], order, &mut self.carried);
            let stride = self.carriers.len();
            let [own, one, u_own, u_plane] = std::array::from_fn(|plane| &self.carried[plane * stride..][..stride]);
            let down = across(v, height);
            for (n, columns) in self.columns.chunks_exact_mut(LIGHT).take(order + 1).enumerate() {
                // `v` is one number along a row: its planes need no projection of their own.
                columns.copy_from_slice(&[own[n], one[n], u_own[n], down * own[n], u_plane[n], down * one[n]]);
            }
            table.add_row(&self.columns, |m| basis_v.row(m)[v]);
        }
    }

    /// Multiplies a row of every plane, in use or not, by the weights.
    fn weigh(&mut self, weights: &[T]) {
        for plane in &mut self.planes {
            for (sample, weight) in plane.as_flattened_mut().iter_mut().zip(weights) {
                *sample = *sample * *weight;
            }
        }
    }

    /// The row's planes: `∇I_u`, `∇I_v`, with a depth map `ζ ∇I_u`, `ζ ∇I_v`, and with a desired image `I - I*`, whose slot
    /// is returned.
    fn fill_planes(
        &mut self,
        image: &Plane<T>,
        depth: &Depth<T>,
        desired: Option<&Plane<T>>,
        v: usize,
    ) -> Option<usize> {
        let width = image.width();
        let [g_u, g_v, zeta_g_u, zeta_g_v, error] =
            self.planes.each_mut().map(|plane| &mut plane.as_flattened_mut()[..width]);
        gradient_row(image, v, g_u, g_v);
        if let Depth::Map(map) = depth {
            multiply(zeta_g_u, g_u, map.inverse_per_m().row(v));
            multiply(zeta_g_v, g_v, map.inverse_per_m().row(v));
        }
        let desired = desired?;
        let (error, slot) = if matches!(depth, Depth::Map(_)) { (error, 4) } else { (zeta_g_u, 2) };
        for ((error, own), desired) in error.iter_mut().zip(image.row(v)).zip(desired.row(v)) {
            *error = *own - *desired;
        }
        Some(slot)
    }

    fn project(&mut self, has_map: bool, error_slot: Option<usize>, order: usize) {
        let degrees: &[usize] = if has_map { &[2, 1, 1, 0, 0] } else { &[2, 1, 0] };
        let count = if error_slot.is_some() { degrees.len() } else { degrees.len() - 1 };
        let planes = self.planes.each_ref().map(|plane| &plane[..]);
        self.carriers.project(&planes[..count], &degrees[..count], order, &mut self.carried);
    }

    /// `[e, L_I]` of the row's moments, for every `n`, at normalized `y`; `constant_per_m` is `1/Z` when the depth is one number.
    fn fill_columns(&mut self, y: f64, constant_per_m: Option<f64>, error_slot: Option<usize>, order: usize) {
        let Powers { x_gu, xx_gu, x_gv, x_zgu } = &mut self.powers;
        let carried: [&[f64]; PLANES] = {
            let stride = self.carriers.len();
            std::array::from_fn(|plane| &self.carried[plane * stride..][..stride])
        };
        let ([g_u, g_v, zg_u, zg_v, _], count) = (carried, order + 1);
        self.carriers.raise(0, g_u, g_u, &mut x_gu[..count + 1]);
        self.carriers.raise(1, g_u, x_gu, &mut xx_gu[..count]);
        self.carriers.raise(0, g_v, g_v, &mut x_gv[..count]);
        if constant_per_m.is_none() {
            self.carriers.raise(0, zg_u, zg_u, &mut x_zgu[..count]);
        }
        let [f_u, f_v] = self.camera.focal_px();
        for (n, columns) in self.columns.chunks_exact_mut(ERROR_AND_INTERACTION).take(count).enumerate() {
            let g_u = [f_u * g_u[n], f_u * x_gu[n], f_u * xx_gu[n]];
            let g_v = [f_v * g_v[n], f_v * x_gv[n]];
            let (zeta_g_u, zeta_g_v) = match constant_per_m {
                Some(zeta) => ([zeta * g_u[0], zeta * g_u[1]], zeta * g_v[0]),
                None => ([f_u * zg_u[n], f_u * x_zgu[n]], f_v * zg_v[n]),
            };
            columns[0] = error_slot.map_or(0.0, |slot| carried[slot][n]);
            columns[1..].copy_from_slice(&GradientMoments { g_u, g_v, zeta_g_u, zeta_g_v }.interaction(y));
        }
    }
}

fn multiply<T: Sample>(product: &mut [T], a: &[T], b: &[T]) {
    for ((product, a), b) in product.iter_mut().zip(a).zip(b) {
        *product = *a * *b;
    }
}

/// So many numbers for each feature `n + m <= order`.
#[derive(Debug)]
pub(crate) struct FeatureTable<const COLUMNS: usize> {
    order: usize,
    highest_order: usize,
    /// `[m][n][column]`.
    values: Vec<f64>,
}

impl<const COLUMNS: usize> FeatureTable<COLUMNS> {
    pub(crate) fn new(highest_order: usize) -> FeatureTable<COLUMNS> {
        let side = highest_order + 1;
        FeatureTable { order: 0, highest_order, values: vec![0.0; side * side * COLUMNS] }
    }

    /// The highest order it was filled to.
    pub(crate) fn order(&self) -> usize {
        self.order
    }

    /// The numbers of one feature.
    pub(crate) fn at(&self, n: usize, m: usize) -> &[f64; COLUMNS] {
        let first = self.start(m) + n * COLUMNS;
        self.values[first..].first_chunk().expect("orders stay below the highest")
    }

    fn clear(&mut self, order: usize) {
        self.order = order;
        self.values.fill(0.0);
    }

    fn start(&self, m: usize) -> usize {
        m * (self.highest_order + 1) * COLUMNS
    }

    /// Adds `q_m(v)` times the row's columns `[n][column]` to every feature with `n + m <= order`.
    fn add_row(&mut self, columns: &[f64], q: impl Fn(usize) -> f64) {
        for m in 0..=self.order {
            let (start, length) = (self.start(m), (self.order - m + 1) * COLUMNS);
            let q_m = q(m);
            for (value, column) in self.values[start..][..length].iter_mut().zip(&columns[..length]) {
                *value += q_m * column;
            }
        }
    }
}

impl FeatureTable<ERROR_AND_INTERACTION> {
    /// `L` of this view becomes `½(L + L*)`, Eq. (40) and (52); `e` stays.
    pub(crate) fn take_mean_interaction(&mut self, desired: &Self) {
        let rows = self.values.chunks_exact_mut(ERROR_AND_INTERACTION);
        for (own, desired) in rows.zip(desired.values.chunks_exact(ERROR_AND_INTERACTION)) {
            for (own, desired) in own[1..].iter_mut().zip(&desired[1..]) {
                *own = 0.5 * (*own + desired);
            }
        }
    }

    /// The features up to this order, `n` outside, `m` inside.
    pub(crate) fn rows(&self, order: usize) -> impl Iterator<Item = FeatureRow> {
        indices(order).map(|(n, m)| {
            let [error, interaction @ ..] = *self.at(n, m);
            FeatureRow { n, m, error, interaction }
        })
    }
}

/// All `(n, m)` with `n + m <= order`, `n` outside, `m` inside.
fn indices(order: usize) -> impl Iterator<Item = (usize, usize)> {
    (0..=order).flat_map(move |n| (0..=order - n).map(move |m| (n, m)))
}
