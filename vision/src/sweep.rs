//! One pass over a view, or over both at once, image row by image row: gradient, inverse depth, projection along `u`, the columns of `L_I`,
//! and then `× q_m(v)` into the table of features.
//!
//! No full-size plane is made: a row's planes stay in the nearest cache, and the buffers are made once. The difference `I - I*` is
//! taken pixel by pixel, before the projection, so that it keeps its digits when the images nearly agree. `L` is linear in the gradients and
//! in `ζ` times them: a sweep over both views takes the means of those planes, and costs hardly more than one view.

use std::array::from_fn;

use fearless_simd::{Simd, SimdBase, SimdFloat, dispatch};

use crate::basis::Basis;
use crate::camera::Intrinsics;
use crate::depth::Depth;
use crate::features::Sight;
use crate::image::Plane;
use crate::interaction::{GradientMoments, Slopes};
use crate::light::across;
use crate::path::Path;
use crate::projection::{Carriers, MOST_PLANES};
use crate::row::{Row, load};
use crate::sample::Sample;
use crate::table::{BLOCK, ERROR_AND_INTERACTION, FeatureTable, LIGHT, padded};

/// What one sweep looks at.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Views<'a, T> {
    /// `L(I*, Z*)`, without an error.
    Desired(Sight<'a, T>),
    /// `L(I, Z)` and `I - I*`.
    Current(Sight<'a, T>, &'a Plane<T>),
    /// `½(L(I, Z) + L(I*, Z*))` and `I - I*`.
    Both([Sight<'a, T>; 2]),
}

impl<'a, T: Sample> Views<'a, T> {
    fn size(&self) -> [usize; 2] {
        match self {
            Views::Desired((image, _)) | Views::Current((image, _), _) | Views::Both([(image, _), _]) => image.size(),
        }
    }

    /// `ζ`, if it is one number for every pixel of all views.
    fn constant_per_m(&self) -> Option<f64> {
        let constant =
            |depth: &Depth<T>| if let Depth::Constant { depth_m } = depth { Some(1.0 / depth_m) } else { None };
        match self {
            Views::Desired((_, depth)) | Views::Current((_, depth), _) => constant(depth),
            Views::Both([(_, current), (_, desired)]) => {
                constant(current).filter(|zeta| Some(*zeta) == constant(desired))
            }
        }
    }

    fn error_of(&self) -> Option<[&'a Plane<T>; 2]> {
        match *self {
            Views::Desired(_) => None,
            Views::Current((image, _), desired) | Views::Both([(image, _), (desired, _)]) => Some([image, desired]),
        }
    }
}

/// What a sweep's rows are made of.
#[derive(Debug, Clone, Copy)]
struct Plan {
    /// `ζ`, when it needs no planes of its own.
    constant_per_m: Option<f64>,
    /// Where `I - I*` is among the planes.
    error: Option<usize>,
    /// By plane.
    degrees: &'static [usize],
}

impl Plan {
    fn of<T: Sample>(views: &Views<'_, T>) -> Plan {
        let (constant_per_m, has_error) = (views.constant_per_m(), views.error_of().is_some());
        let degrees: &[usize] = if constant_per_m.is_some() { &[2, 1, 0] } else { &[2, 1, 1, 0, 0] };
        let count = degrees.len() - usize::from(!has_error);
        Plan { constant_per_m, error: has_error.then_some(count - 1), degrees: &degrees[..count] }
    }
}

/// The buffers of one sweep.
#[derive(Debug)]
pub(crate) struct Sweep<T> {
    camera: Intrinsics,
    path: Path,
    carriers: Carriers<T>,
    planes: [Row<T>; MOST_PLANES],
    moments: RowMoments,
    /// `[row of a block][column][n]`.
    columns: Vec<f64>,
    /// Of `u` from -1 to 1, for the light.
    right: Row<T>,
}

/// The moments of one image row's planes, by `n`; stretches are padded to whole vectors.
#[derive(Debug)]
struct RowMoments {
    /// `[plane][n]`, of all carriers.
    carried: Vec<f64>,
    x_gu: Vec<f64>,
    xx_gu: Vec<f64>,
    x_gv: Vec<f64>,
    x_zgu: Vec<f64>,
}

impl<T: Sample> Sweep<T> {
    /// Buffers for rows as long as the basis along `u`.
    pub(crate) fn new(camera: Intrinsics, basis_u: &Basis, highest_order: usize) -> Sweep<T> {
        let (carriers, width) = (Carriers::new(basis_u, highest_order), basis_u.length());
        let row = || vec![0.0; padded(highest_order + 2)];
        let mut sweep = Sweep {
            camera,
            path: Path::best(),
            planes: from_fn(|_| Row::zeros(width)),
            moments: RowMoments {
                carried: vec![0.0; MOST_PLANES * carriers.stride()],
                x_gu: row(),
                xx_gu: row(),
                x_gv: row(),
                x_zgu: row(),
            },
            carriers,
            columns: vec![0.0; BLOCK * ERROR_AND_INTERACTION * padded(highest_order + 1)],
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

    /// Fills `table` with `L` and, if these views have one, the error; of their planes times the weights, if there are any.
    /// Returns the multiply-adds it took.
    pub(crate) fn add_up(
        &mut self,
        views: Views<'_, T>,
        weight: Option<&Plane<T>>,
        basis_v: &Basis,
        order: usize,
        table: &mut FeatureTable<ERROR_AND_INTERACTION>,
    ) -> u64 {
        table.clear(order);
        let (plan, [width, height]) = (Plan::of(&views), views.size());
        dispatch!(self.path.level(), simd => self.add_rows(simd, views, plan, weight, basis_v, table));
        let per_row = width * self.carriers.multiply_adds(plan.degrees, order) + table.multiply_adds_of_a_row();
        (height * per_row) as u64
    }

    #[inline(always)]
    fn add_rows<S: Simd>(
        &mut self,
        simd: S,
        views: Views<'_, T>,
        plan: Plan,
        weight: Option<&Plane<T>>,
        basis_v: &Basis,
        table: &mut FeatureTable<ERROR_AND_INTERACTION>,
    ) {
        let (height, order) = (views.size()[1], table.order());
        let length = ERROR_AND_INTERACTION * table.stride();
        for v in 0..height {
            self.fill_planes(simd, views, plan, weight.map(|weight| weight.row(v)), v);
            let planes = self.planes.each_ref().map(Row::padded);
            self.carriers.project(simd, planes, plan.degrees, order, &mut self.moments.carried);
            self.moments.raise(&self.carriers, plan, order);
            let columns = &mut self.columns[v % BLOCK * length..][..length];
            self.moments.fill_columns(
                simd,
                (&self.camera, self.carriers.stride()),
                plan,
                self.camera.y(v as f64),
                columns,
            );
            if v % BLOCK == BLOCK - 1 || v == height - 1 {
                let rows = v - v % BLOCK..v + 1;
                table.add_rows(simd, &self.columns, rows, basis_v);
            }
        }
    }

    /// Fills `table` with the moments of the light's planes `{I*, 1, u I*, v I*, u, v}`, times the weights, if there are any.
    /// Returns the multiply-adds it took.
    pub(crate) fn add_up_light(
        &mut self,
        desired: &Plane<T>,
        weight: Option<&Plane<T>>,
        basis_v: &Basis,
        order: usize,
        table: &mut FeatureTable<LIGHT>,
    ) -> u64 {
        table.clear(order);
        dispatch!(self.path.level(), simd => self.add_light_rows(simd, desired, weight, basis_v, table));
        let per_row = desired.width() * self.carriers.multiply_adds(&[0; 4], order) + table.multiply_adds_of_a_row();
        (desired.height() * per_row) as u64
    }

    #[inline(always)]
    fn add_light_rows<S: Simd>(
        &mut self,
        simd: S,
        desired: &Plane<T>,
        weight: Option<&Plane<T>>,
        basis_v: &Basis,
        table: &mut FeatureTable<LIGHT>,
    ) {
        let ([width, height], order, stride) = (desired.size(), table.order(), table.stride());
        for v in 0..height {
            self.fill_light_planes(simd, desired.row(v), weight.map(|weight| weight.row(v)), width);
            let planes = self.planes.each_ref().map(Row::padded);
            self.carriers.project(simd, planes, &[0; 4], order, &mut self.moments.carried);
            let stretch = self.carriers.stride();
            let [own, one, u_own, u_plane] = from_fn(|plane| &self.moments.carried[plane * stretch..][..order + 1]);
            let down = across(v, height);
            // `v` is one number along a row: its planes need no projection of their own.
            let sources = [(own, 1.0), (one, 1.0), (u_own, 1.0), (own, down), (u_plane, 1.0), (one, down)];
            let columns = &mut self.columns[v % BLOCK * LIGHT * stride..][..LIGHT * stride];
            for (column, (source, factor)) in columns.chunks_exact_mut(stride).zip(sources) {
                column.iter_mut().zip(source).for_each(|(column, source)| *column = factor * source);
            }
            if v % BLOCK == BLOCK - 1 || v == height - 1 {
                table.add_rows(simd, &self.columns, v - v % BLOCK..v + 1, basis_v);
            }
        }
    }

    #[inline(always)]
    fn fill_light_planes<S: Simd>(&mut self, simd: S, desired: &[T], weight: Option<&[T]>, width: usize) {
        let lanes = T::Vector::<S>::LEN;
        let [own, one, u_own, u_plane, _] = self.planes.each_mut().map(Row::padded_mut);
        for at in (0..width).step_by(lanes) {
            let right = load(simd, self.right.padded(), at);
            let weight = match weight {
                Some(weight) => load(simd, weight, at),
                None => T::Vector::<S>::splat(simd, T::from_f64(1.0)),
            };
            let (value, part) = (load(simd, desired, at) * weight, at..at + lanes);
            value.store_slice(&mut own[part.clone()]);
            weight.store_slice(&mut one[part.clone()]);
            (right * value).store_slice(&mut u_own[part.clone()]);
            (right * weight).store_slice(&mut u_plane[part]);
        }
    }

    /// The row's planes: `∇I_u`, `∇I_v`, then `ζ ∇I_u`, `ζ ∇I_v` if they have to be planes, then `I - I*` if there is one.
    #[inline(always)]
    fn fill_planes<S: Simd>(&mut self, simd: S, views: Views<'_, T>, plan: Plan, weight: Option<&[T]>, v: usize) {
        let lanes = T::Vector::<S>::LEN;
        let (own, other) = match views {
            Views::Desired(sight) | Views::Current(sight, _) => (Line::of(sight, v), None),
            Views::Both([current, desired]) => (Line::of(current, v), Some(Line::of(desired, v))),
        };
        let images = views.error_of().map(|images| images.map(|image| image.row(v)));
        let (has_zeta, half) = (plan.constant_per_m.is_none(), T::Vector::<S>::splat(simd, T::from_f64(0.5)));
        let [g_u, g_v, third, fourth, fifth] = self.planes.each_mut().map(Row::padded_mut);
        for at in (0..views.size()[0]).step_by(lanes) {
            let part = at..at + lanes;
            let weight = match weight {
                Some(weight) => load(simd, weight, at),
                None => T::Vector::<S>::splat(simd, T::from_f64(1.0)),
            };
            let [mut along_u, mut along_v] = own.slopes.at(simd, at);
            if has_zeta {
                let zeta = own.zeta(simd, at);
                let (mut zeta_u, mut zeta_v) = (zeta * along_u, zeta * along_v);
                if let Some(other) = &other {
                    let ([other_u, other_v], zeta) = (other.slopes.at(simd, at), other.zeta(simd, at));
                    zeta_u = half * other_u.mul_add(zeta, zeta_u);
                    zeta_v = half * other_v.mul_add(zeta, zeta_v);
                }
                (weight * zeta_u).store_slice(&mut third[part.clone()]);
                (weight * zeta_v).store_slice(&mut fourth[part.clone()]);
            }
            if let Some(other) = &other {
                let [other_u, other_v] = other.slopes.at(simd, at);
                (along_u, along_v) = (half * (along_u + other_u), half * (along_v + other_v));
            }
            (weight * along_u).store_slice(&mut g_u[part.clone()]);
            (weight * along_v).store_slice(&mut g_v[part.clone()]);
            if let Some([image, desired]) = images {
                let error = load(simd, image, at) - load(simd, desired, at);
                (weight * error).store_slice(if has_zeta { &mut fifth[part] } else { &mut third[part] });
            }
        }
    }
}

/// One image row of a view.
struct Line<'a, T> {
    slopes: Slopes<'a, T>,
    constant_per_m: T,
    per_m: Option<&'a [T]>,
}

impl<'a, T: Sample> Line<'a, T> {
    #[inline(always)]
    fn of((image, depth): Sight<'a, T>, v: usize) -> Line<'a, T> {
        let (constant_per_m, per_m) = match depth {
            Depth::Constant { depth_m } => (T::from_f64(1.0 / depth_m), None),
            Depth::Map(map) => (T::ZERO, Some(map.inverse_per_m().row(v))),
        };
        Line { slopes: Slopes::of(image, v), constant_per_m, per_m }
    }

    #[inline(always)]
    fn zeta<S: Simd>(&self, simd: S, at: usize) -> T::Vector<S> {
        match self.per_m {
            Some(row) => load(simd, row, at),
            None => T::Vector::<S>::splat(simd, self.constant_per_m),
        }
    }
}

impl RowMoments {
    /// The moments of `x g_u`, `x² g_u`, `x g_v` and `x ζ g_u`.
    #[inline(always)]
    fn raise<T: Sample>(&mut self, carriers: &Carriers<T>, plan: Plan, order: usize) {
        let (count, stretch) = (order + 1, carriers.stride());
        let [g_u, g_v, zg_u] = from_fn(|plane| &self.carried[plane * stretch..][..stretch]);
        carriers.raise(0, g_u, g_u, &mut self.x_gu[..count + 1]);
        carriers.raise(1, g_u, &self.x_gu, &mut self.xx_gu[..count]);
        carriers.raise(0, g_v, g_v, &mut self.x_gv[..count]);
        if plan.constant_per_m.is_none() {
            carriers.raise(0, zg_u, zg_u, &mut self.x_zgu[..count]);
        }
    }

    /// `[e, L_I]` of the row's moments at normalized `y`, `[column][n]`.
    #[inline(always)]
    fn fill_columns<S: Simd>(
        &self,
        simd: S,
        (camera, stretch): (&Intrinsics, usize),
        plan: Plan,
        y: f64,
        columns: &mut [f64],
    ) {
        let ([f_u, f_v], constant) = (camera.focal_px(), plan.constant_per_m);
        let (y, one_and_yy) = (S::f64s::splat(simd, y), S::f64s::splat(simd, 1.0 + y * y));
        let (lanes, stride) = (S::f64s::LEN, columns.len() / ERROR_AND_INTERACTION);
        for at in (0..stride).step_by(lanes) {
            let carried = |plane: usize| S::f64s::from_slice(simd, &self.carried[plane * stretch + at..][..lanes]);
            let raised = |row: &[f64]| S::f64s::from_slice(simd, &row[at..at + lanes]);
            let g_u = [carried(0) * f_u, raised(&self.x_gu) * f_u, raised(&self.xx_gu) * f_u];
            let g_v = [carried(1) * f_v, raised(&self.x_gv) * f_v];
            let (zeta_g_u, zeta_g_v) = match constant {
                Some(zeta) => ([g_u[0] * zeta, g_u[1] * zeta], g_v[0] * zeta),
                None => ([carried(2) * f_u, raised(&self.x_zgu) * f_u], carried(3) * f_v),
            };
            let error = match plan.error {
                Some(plane) => carried(plane),
                None => S::f64s::splat(simd, 0.0),
            };
            error.store_slice(&mut columns[at..at + lanes]);
            let interaction = GradientMoments { g_u, g_v, zeta_g_u, zeta_g_v }.interaction(y, one_and_yy);
            for (i, value) in interaction.into_iter().enumerate() {
                value.store_slice(&mut columns[(i + 1) * stride + at..][..lanes]);
            }
        }
    }
}
