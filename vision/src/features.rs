//! The one place that knows how each method makes its [`Gram`] of two views.

use crate::basis::BasisError;
use crate::camera::Intrinsics;
use crate::depth::Depth;
use crate::family::{Chosen, Method};
use crate::gaussian::GaussianMixture;
use crate::gram::{COLUMNS, Gram};
use crate::image::Plane;
use crate::law::Law;
use crate::moments::{Extras, FeatureRow, Moments, Work};
use crate::path::Path;
use crate::photometric::Photometric;
use crate::planes::PLAIN;
use crate::sample::Sample;

/// An image and its depth.
pub(crate) type Sight<'a, T> = (&'a Plane<T>, &'a Depth<T>);

/// A pair of views of one size, and how much each pixel counts.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Sights<'a, T> {
    pub current: Sight<'a, T>,
    pub desired: Sight<'a, T>,
    /// `None` weighs every pixel fully.
    pub weight: Option<&'a Plane<T>>,
}

/// The buffers of the method in use.
#[derive(Debug)]
pub(crate) enum Features<T> {
    /// Of every family.
    Moments(Box<Moments<T>>),
    /// The pixels themselves, or seen through a bell.
    Pixels(Box<Pixels<T>>),
}

/// A method on pixels.
#[derive(Debug)]
pub(crate) struct Pixels<T> {
    method: PixelMethod<T>,
    path: Path,
    work: Work,
}

#[derive(Debug)]
enum PixelMethod<T> {
    Photometric(Photometric<T>),
    GaussianMixture(Box<GaussianMixture<T>>),
}

impl<T: Sample> Pixels<T> {
    fn gram(&mut self, sights: Sights<'_, T>) -> Gram {
        let (gram, multiply_adds) = match &mut self.method {
            PixelMethod::Photometric(photometric) => photometric.gram(self.path, sights),
            PixelMethod::GaussianMixture(mixture) => mixture.gram(self.path, sights),
        };
        self.work.joint_sweeps += 1;
        self.work.multiply_adds += multiply_adds;
        gram
    }
}

impl<T: Sample> Features<T> {
    /// Buffers for moments of `[width, height]` pixels, up to this order, with these rows to begin with.
    ///
    /// # Errors
    /// A basis that cannot be.
    pub(crate) fn moments(
        camera: Intrinsics,
        size: [usize; 2],
        highest_order: usize,
        chosen: Chosen,
        extras: Extras,
    ) -> Result<Features<T>, BasisError> {
        let moments = Moments::new(camera, size, highest_order, chosen.polynomials, extras)?;
        Ok(Features::Moments(Box::new(moments)))
    }

    /// Buffers for pixels as features, `[width, height]` of them.
    pub(crate) fn pixels(law: &Law, camera: Intrinsics, size: [usize; 2]) -> Features<T> {
        let planes = if law.light.is_some() { COLUMNS } else { PLAIN };
        let method = match law.method {
            Method::GaussianMixture => {
                PixelMethod::GaussianMixture(Box::new(GaussianMixture::new(camera, size, planes, law.gaussian)))
            }
            _ => PixelMethod::Photometric(Photometric::new(camera, size, planes)),
        };
        Features::Pixels(Box::new(Pixels { method, path: Path::best(), work: Work::default() }))
    }

    /// The inner products of this pair; `chosen` is what the law says about moments, at this order.
    ///
    /// # Errors
    /// A basis that cannot be.
    pub(crate) fn gram(
        &mut self,
        chosen: Option<Chosen>,
        order: usize,
        sights: Sights<'_, T>,
    ) -> Result<Gram, BasisError> {
        match self {
            Features::Moments(moments) => {
                let chosen = chosen.expect("a law whose method is on moments chooses rows");
                moments.gram(chosen.polynomials, order, sights)
            }
            Features::Pixels(pixels) => Ok(pixels.gram(sights)),
        }
    }

    pub(crate) fn set_path(&mut self, path: Path) {
        match self {
            Features::Moments(moments) => moments.set_path(path),
            Features::Pixels(pixels) => pixels.path = path,
        }
    }

    /// What is kept of the desired view has other weights now.
    pub(crate) fn forget_desired(&mut self) {
        if let Features::Moments(moments) = self {
            moments.forget_desired();
        }
    }

    /// `e - C h` and the current view's own `L(I, Z)` of the last step; methods without moments have none to show.
    pub(crate) fn own_rows(&self, light: [f64; 6]) -> impl Iterator<Item = FeatureRow> {
        self.in_moments().into_iter().flat_map(move |moments| moments.own_rows(light))
    }

    /// The moments of the last step; methods without moments have none to show.
    pub(crate) fn rows(&self) -> impl Iterator<Item = FeatureRow> {
        self.in_moments().into_iter().flat_map(Moments::features)
    }

    /// What has been computed so far; methods without moments keep nothing, and sweep both views at every step.
    pub(crate) fn work(&self) -> Work {
        match self {
            Features::Moments(moments) => moments.work(),
            Features::Pixels(pixels) => pixels.work,
        }
    }

    fn in_moments(&self) -> Option<&Moments<T>> {
        if let Features::Moments(moments) = self { Some(moments) } else { None }
    }
}
