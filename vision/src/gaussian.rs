//! Photometric Gaussian mixtures: every pixel becomes a Gaussian, `G(x) = Σ_u I(u) exp(-|u - x|²/2λ²)`, and the features are the mixture at every
//! pixel `x`: `e = G*(I - I*)`, `L̂ = G*½(L_I + L_I*)`.
//!
//! After N. Crombez, E. M. Mouaddib, G. Caron and F. Chaumette, <https://doi.org/10.1109/TRO.2018.2876765>. Blurring both sides alike is brightness
//! constancy alone; the form in which Gaussians carry their brightness along is another, and wrong: E11 of `docs/paper.md`.
//!
//! Only inner products of blurred planes are needed ([`crate::blurred`]). Two forms: the exact one has a row of the blur for every pixel, and all
//! its sums are `f64`; the fast one has fewer rows ([`crate::low_rank`]), and sums short stretches in the samples' own precision.

use fearless_simd::{Simd, dispatch};

use crate::banded::WIDTH;
use crate::blurred::{BLOCK, BlurredProducts, PART};
use crate::camera::Intrinsics;
use crate::convolution::bells;
use crate::features::Sights;
use crate::gram::{COLUMNS, Gram};
use crate::law::{Gaussian, GaussianForm};
use crate::low_rank::factor;
use crate::path::Path;
use crate::planes::{Across, PLAIN, PairRow};
use crate::products::PairSums;
use crate::sample::Sample;

/// The Gaussian mixtures' buffers for one camera, image size and extent.
#[derive(Debug)]
pub(crate) struct GaussianMixture<T> {
    across: Across<T>,
    planes: usize,
    /// A block of rows of a strip, `[plane][v][u]`.
    parts: Vec<T>,
    blurred: Blurred<T>,
}

/// The two forms.
#[derive(Debug)]
enum Blurred<T> {
    /// With the block in `f64`.
    Exact(BlurredProducts<f64>, Vec<f64>),
    Fast(BlurredProducts<T>),
}

impl<T: Sample> GaussianMixture<T> {
    /// Buffers for images of `size`, `[width, height]` pixels, for 7 planes or, with light, 13.
    pub(crate) fn new(camera: Intrinsics, size: [usize; 2], planes: usize, gaussian: Gaussian) -> GaussianMixture<T> {
        let blurred = match gaussian.form {
            GaussianForm::Exact => {
                let [along_u, along_v] = size.map(|length| bells::<T>(gaussian.extent_px, length));
                let products = BlurredProducts::new(size, planes, [&along_u, &along_v]);
                Blurred::Exact(products, vec![0.0; planes * PART])
            }
            GaussianForm::Fast => {
                let [along_u, along_v] = size.map(|length| factor::<T>(gaussian.extent_px, length));
                Blurred::Fast(BlurredProducts::new(size, planes, [&along_u, &along_v]))
            }
        };
        GaussianMixture { across: Across::new(camera, size[0]), planes, parts: vec![T::ZERO; planes * PART], blurred }
    }

    /// The inner products of the blurred planes over all pixels, and the multiply-adds they took.
    pub(crate) fn gram(&mut self, path: Path, sights: Sights<'_, T>) -> (Gram, u64) {
        let mut gram = Gram::new();
        match self.planes {
            COLUMNS => dispatch!(path.level(), simd => self.add_strips::<_, COLUMNS>(simd, sights, &mut gram)),
            _ => dispatch!(path.level(), simd => self.add_strips::<_, PLAIN>(simd, sights, &mut gram)),
        }
        gram.features = sights.current.0.samples().len();
        let multiply_adds = match &self.blurred {
            Blurred::Exact(products, _) => products.multiply_adds(self.planes),
            Blurred::Fast(products) => products.multiply_adds(self.planes),
        };
        (gram, multiply_adds)
    }

    #[inline(always)]
    fn add_strips<S: Simd, const N: usize>(&mut self, simd: S, sights: Sights<'_, T>, gram: &mut Gram) {
        let mut sums = [PairSums::<S, f64, N>::new(simd), PairSums::<S, f64, N>::new(simd)];
        let (across, parts) = (&self.across, &mut self.parts[..]);
        match &mut self.blurred {
            Blurred::Exact(products, wide) => {
                for strip in 0..products.strips() {
                    for first in (0..sights.current.0.height()).step_by(BLOCK) {
                        let rows = fill_block::<S, T, N>(simd, sights, across, (strip, first), parts);
                        for (wide, sample) in wide.iter_mut().zip(&*parts) {
                            *wide = sample.to_f64();
                        }
                        products.take_rows(simd, rows, wide);
                    }
                    products.end_strip(simd, strip, &mut sums);
                }
            }
            Blurred::Fast(products) => {
                for strip in 0..products.strips() {
                    for first in (0..sights.current.0.height()).step_by(BLOCK) {
                        let rows = fill_block::<S, T, N>(simd, sights, across, (strip, first), parts);
                        products.take_rows(simd, rows, parts);
                    }
                    products.end_strip(simd, strip, &mut sums);
                }
            }
        }
        let [plus, minus] = &mut sums;
        plus.add_to(gram, 1.0);
        minus.add_to(gram, -1.0);
    }
}

/// The planes of the image rows from `first` on in a strip of columns; says which rows.
#[inline(always)]
fn fill_block<S: Simd, T: Sample, const N: usize>(
    simd: S,
    sights: Sights<'_, T>,
    across: &Across<T>,
    (strip, first): (usize, usize),
    parts: &mut [T],
) -> std::ops::Range<usize> {
    let rows = first..(first + BLOCK).min(sights.current.0.height());
    let columns = strip * WIDTH..((strip + 1) * WIDTH).min(across.width());
    for v in rows.clone() {
        let mut planes = parts.chunks_exact_mut(PART);
        let stretches = std::array::from_fn(|_| {
            let plane = planes.next().expect("a part for each plane");
            &mut plane[(v - first) * WIDTH..][..WIDTH]
        });
        PairRow::of(sights, across, v).fill::<S, N>(simd, columns.clone(), stretches);
    }
    rows
}
