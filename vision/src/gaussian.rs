//! Photometric Gaussian mixtures: every pixel becomes a Gaussian, `G(x) = Σ_u I(u) exp(-|u - x|²/2λ²)`, and the features are the mixture at every
//! pixel `x`: `e = G*(I - I*)`, `L̂ = G*½(L_I + L_I*)`.
//!
//! After N. Crombez, E. M. Mouaddib, G. Caron and F. Chaumette, <https://doi.org/10.1109/TRO.2018.2876765>. Blurring both sides alike is brightness
//! constancy alone; the form in which Gaussians carry their brightness along is another, and wrong: E11 of `docs/paper.md`.
//!
//! Two forms: the exact one blurs the planes in full ([`crate::convolution`]); the fast one needs only inner products of blurred planes, and
//! gets them by projection ([`crate::low_rank`]), unless the extent is so small that the blur itself is quicker.

use crate::camera::Intrinsics;
use crate::chunks::LANES;
use crate::convolution::{Convolution, Stretch};
use crate::features::Sights;
use crate::gram::{COLUMNS, Gram};
use crate::law::{Gaussian, GaussianForm};
use crate::low_rank::Projection;
use crate::planes::RowPlanes;
use crate::products::add_products;
use crate::sample::Sample;

/// The Gaussian mixtures' buffers for one camera, image size and extent.
#[derive(Debug)]
pub(crate) struct GaussianMixture<T> {
    rows: RowPlanes<T>,
    blurred: Blurred<T>,
}

/// How inner products of blurred planes are made.
#[derive(Debug)]
enum Blurred<T> {
    InFull(Convolution),
    Projected(Projection<T>),
}

impl<T: Sample> GaussianMixture<T> {
    /// Buffers for images of `size`, `[width, height]` pixels, for 7 planes or, with light, 13.
    pub(crate) fn new(camera: Intrinsics, size: [usize; 2], planes: usize, gaussian: Gaussian) -> GaussianMixture<T> {
        let in_full = || Blurred::InFull(Convolution::new::<T>(gaussian.extent_px, size, planes));
        let blurred = match gaussian.form {
            GaussianForm::Exact => in_full(),
            GaussianForm::Fast => match Projection::new(gaussian.extent_px, size, planes) {
                Some(projection) => Blurred::Projected(projection),
                None => in_full(),
            },
        };
        GaussianMixture { rows: RowPlanes::new(camera, size[0], planes), blurred }
    }

    /// The inner products of the blurred planes over all pixels.
    pub(crate) fn gram(&mut self, sights: Sights<'_, T>) -> Gram {
        let mut gram = Gram::new();
        match &mut self.blurred {
            Blurred::InFull(convolution) => self.rows.for_each(sights, |v, planes| {
                let planes = planes.iter().map(|plane| plane.as_flattened());
                convolution.take_row(v, planes, |_, rows, finished| add_band(rows.len(), finished, &mut gram));
            }),
            Blurred::Projected(projection) => {
                projection.clear();
                self.rows.for_each(sights, |v, planes| projection.take_row(v, planes));
                projection.add_products(&mut gram);
            }
        }
        gram.features = sights.current.0.samples().len();
        gram
    }
}

/// Adds the products of the first `rows` stretches of all planes.
fn add_band(rows: usize, finished: &[Vec<Stretch>], gram: &mut Gram) {
    let planes: [&[[f64; LANES]]; COLUMNS] =
        std::array::from_fn(|i| finished.get(i).map_or(&[][..], |plane| plane[..rows].as_flattened().as_chunks().0));
    add_products(&planes[..finished.len()], gram);
}
