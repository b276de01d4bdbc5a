//! Features and interaction matrix of the discrete orthogonal moments: `e = P - P*` and `L̂ = ½(L(I, Z) + L(I*, Z*))`.
//!
//! Sweeps ([`crate::sweep`]) make them, Eq. (9), (29), (40), (52). The bases and the desired view's half of `L̂` are kept until a parameter
//! changes. A step with new bases sweeps both views at once; the next one with the same bases makes the desired half, up to the highest order, of
//! which every lower one is a part, and from then on only current views are swept.

use crate::along_v::AlongV;
use crate::basis::{Basis, BasisError};
use crate::camera::Intrinsics;
use crate::family::Polynomial;
use crate::features::Sights;
use crate::gram::Gram;
use crate::image::Plane;
use crate::order::feature_count;
use crate::path::Path;
use crate::plan::Views;
use crate::projection::Carriers;
use crate::sample::Sample;
use crate::sweep::Sweep;
use crate::table::{ERROR_AND_INTERACTION, FeatureTable, LIGHT};

/// One feature of the last step: its error `e_nm` and its row of `L̂`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FeatureRow {
    /// Degree along `u`.
    pub n: usize,
    /// Degree along `v`.
    pub m: usize,
    /// `P_nm - P*_nm`.
    pub error: f64,
    /// Row of the mean interaction matrix, per m/s and rad/s.
    pub interaction: [f64; 6],
}

/// What has been computed since the servo was made, the first bases included; everything else was found in the cache.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Work {
    /// Bases, of one axis each.
    pub bases: usize,
    /// Sweeps over the desired view.
    pub desired_sweeps: usize,
    /// Sweeps over a current view.
    pub current_sweeps: usize,
    /// Sweeps over both views at once.
    pub joint_sweeps: usize,
    /// Multiply-adds in projections and inner products that were of use: what a separable evaluation needs, of a folded row half of it.
    pub multiply_adds: u64,
}

/// The moments' buffers and caches for one camera and image size.
#[derive(Debug)]
pub(crate) struct Moments<T> {
    camera: Intrinsics,
    sweep: Sweep<T>,
    basis_u: Basis,
    basis_v: Basis,
    along_v: AlongV,
    /// What the two bases hold; `None` after a basis could not be made.
    made: [Option<Polynomial>; 2],
    desired_half: Half,
    highest_order: usize,
    /// The current view is swept up to this order even if the features end before.
    least_swept: usize,
    order: usize,
    desired: FeatureTable<ERROR_AND_INTERACTION>,
    current: FeatureTable<ERROR_AND_INTERACTION>,
    /// `C`, if the law estimates light.
    light: Option<FeatureTable<LIGHT>>,
    work: Work,
}

/// What is known of the desired view's half of `L̂`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Half {
    /// It is of these bases and weights.
    Made,
    /// It is of others.
    Outdated,
    /// Of others too, but the last step had these already: it will be of use more than once.
    Wanted,
}

/// What a law needs of moments besides its features.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Extras {
    /// Columns of light.
    pub light: bool,
    /// The current view's own rows, at least up to this order.
    pub least_swept: usize,
}

impl<T: Sample> Moments<T> {
    /// Buffers for images of `[width, height]` pixels and orders up to `highest_order`.
    ///
    /// # Errors
    /// A basis that cannot be.
    pub(crate) fn new(
        camera: Intrinsics,
        [width, height]: [usize; 2],
        highest_order: usize,
        [along_u, along_v]: [Polynomial; 2],
        extras: Extras,
    ) -> Result<Moments<T>, BasisError> {
        let basis_u = Basis::new(width, Carriers::<T>::basis_rows(highest_order), along_u)?;
        let basis_v = Basis::new(height, highest_order + 1, along_v)?;
        Ok(Moments {
            camera,
            along_v: AlongV::new(&basis_v, highest_order + 1, &camera),
            sweep: Sweep::new(camera, &basis_u, highest_order),
            basis_u,
            basis_v,
            made: [Some(along_u), Some(along_v)],
            desired_half: Half::Outdated,
            highest_order,
            least_swept: extras.least_swept,
            order: 0,
            desired: FeatureTable::new(highest_order),
            current: FeatureTable::new(highest_order),
            light: extras.light.then(|| FeatureTable::new(highest_order)),
            work: Work { bases: 2, ..Work::default() },
        })
    }

    /// `e`, `L̂` and their inner products at this order, with the rows `polynomials` along `[u, v]`.
    ///
    /// # Errors
    /// A basis that cannot be.
    pub(crate) fn gram(
        &mut self,
        polynomials: [Polynomial; 2],
        order: usize,
        sights: Sights<'_, T>,
    ) -> Result<Gram, BasisError> {
        self.use_bases(polynomials)?;
        self.order = order;
        match self.desired_half {
            Half::Made => self.sweep_current(sights),
            Half::Outdated if self.least_swept == 0 => {
                self.sweep_both(sights);
                self.desired_half = Half::Wanted;
            }
            Half::Outdated | Half::Wanted => {
                self.sweep_desired(sights);
                self.sweep_current(sights);
            }
        }

        let mut gram = Gram::new();
        match &self.light {
            None => self.features().for_each(|row| gram.add(&row.interaction, row.error)),
            Some(light) => {
                self.features().for_each(|row| gram.add_with_light(&row.interaction, light.at(row.n, row.m), row.error))
            }
        }
        debug_assert_eq!(gram.features, feature_count(order));
        Ok(gram)
    }

    /// The features of the last step, `n` outside, `m` inside.
    pub(crate) fn features(&self) -> impl Iterator<Item = FeatureRow> {
        self.current.rows(self.order)
    }

    /// `e - C h` and the current view's own `L(I, Z)` of the last step, up to the order that was swept.
    pub(crate) fn own_rows(&self, light: [f64; 6]) -> impl Iterator<Item = FeatureRow> {
        self.current.rows(self.current.order()).map(move |row| {
            let [_, desired @ ..] = self.desired.at(row.n, row.m);
            let lit = self.light.as_ref().map_or(0.0, |columns| {
                columns.at(row.n, row.m).iter().zip(light).map(|(column, light)| column * light).sum()
            });
            // The mean holds both: what is left of twice the mean is the current view's own.
            let interaction = std::array::from_fn(|k| 2.0 * row.interaction[k] - desired[k]);
            FeatureRow { error: row.error - lit, interaction, ..row }
        })
    }

    pub(crate) fn set_path(&mut self, path: Path) {
        self.basis_u.set_path(path);
        self.basis_v.set_path(path);
        self.sweep.set_path(path);
    }

    /// The desired view has to be swept again: its weights are others.
    pub(crate) fn forget_desired(&mut self) {
        self.desired_half = Half::Outdated;
    }

    fn sweep_both(&mut self, Sights { current, desired, weight }: Sights<'_, T>) {
        let views = Views::Both(current, desired);
        let swept = self.sweep.add_up(views, weight, &self.along_v, self.order, &mut self.current);
        self.work.multiply_adds += swept.multiply_adds;
        self.work.joint_sweeps += 1;
        self.sweep_light(desired.0, weight, self.order);
    }

    fn sweep_current(&mut self, Sights { current, desired, weight }: Sights<'_, T>) {
        let (views, order) = (Views::Current(current, desired), self.order.max(self.least_swept));
        let swept = self.sweep.add_up(views, weight, &self.along_v, order, &mut self.current);
        self.work.multiply_adds += swept.multiply_adds;
        self.work.current_sweeps += 1;
        self.current.take_mean_interaction(&self.desired, swept.of_desired);
    }

    fn sweep_desired(&mut self, Sights { desired, weight, .. }: Sights<'_, T>) {
        let (views, order) = (Views::Desired(desired), self.highest_order);
        let swept = self.sweep.add_up(views, weight, &self.along_v, order, &mut self.desired);
        self.work.multiply_adds += swept.multiply_adds;
        self.work.desired_sweeps += 1;
        self.sweep_light(desired.0, weight, order);
        self.desired_half = Half::Made;
    }

    fn sweep_light(&mut self, desired: &Plane<T>, weight: Option<&Plane<T>>, order: usize) {
        if let Some(light) = &mut self.light {
            self.work.multiply_adds += self.sweep.add_up_light(desired, weight, &self.along_v, order, light);
        }
    }

    pub(crate) fn work(&self) -> Work {
        self.work
    }

    fn use_bases(&mut self, [along_u, along_v]: [Polynomial; 2]) -> Result<(), BasisError> {
        if self.made[0] != Some(along_u) {
            (self.made[0], self.desired_half) = (None, Half::Outdated);
            self.basis_u.remake(along_u)?;
            self.sweep.set_basis(&self.basis_u);
            self.made[0] = Some(along_u);
            self.work.bases += 1;
        }
        if self.made[1] != Some(along_v) {
            (self.made[1], self.desired_half) = (None, Half::Outdated);
            self.basis_v.remake(along_v)?;
            self.along_v.set(&self.basis_v, &self.camera);
            self.made[1] = Some(along_v);
            self.work.bases += 1;
        }
        Ok(())
    }
}
