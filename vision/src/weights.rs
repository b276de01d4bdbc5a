//! How much each pixel counts: a mask that the user gives (deviation D19), and no weight where a depth map has a hole (D20).
//!
//! The weights multiply `I - I*` and all six planes of `L_I` of both images. The gradient of a pixel reads its four neighbours, so a pixel
//! beside a masked one has no weight either: what is under the mask then reaches nothing.

use fearless_simd::dispatch;

use crate::depth::Depth;
use crate::image::Plane;
use crate::law::Holes;
use crate::path::Path;
use crate::sample::Sample;

/// Smallest share of pixels with weight that a step is made of.
pub const SMALLEST_SHARE: f64 = 0.01;

/// Weights that are made together.
const CHUNK: usize = 512;

/// The weights of one image size, and what they are made of.
#[derive(Debug)]
pub(crate) struct Weights<T> {
    size: [usize; 2],
    holes: Holes,
    /// The mask without its border; `None` weighs every pixel fully.
    mask: Option<Plane<T>>,
    /// The product, while there is anything to weigh.
    in_use: Plane<T>,
    are_in_use: bool,
    /// Whether `in_use` is the mask as it is.
    is_mask: bool,
    share: f64,
}

/// Why a plane is no mask.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum MaskError {
    /// A weight is outside `[0, 1]`, or not a number.
    #[error("expected weights in [0, 1], got {got}")]
    Weight {
        /// The first such weight.
        got: f64,
    },
    /// Too little is left.
    #[error("expected weight on {SMALLEST_SHARE} of the pixels at least, got {share}")]
    TooFew {
        /// Share of pixels with weight, from 0 to 1.
        share: f64,
    },
}

impl<T: Sample> Weights<T> {
    /// Full weight everywhere.
    pub(crate) fn new([width, height]: [usize; 2], holes: Holes) -> Weights<T> {
        let in_use = Plane::filled(width, height, T::from_f64(1.0));
        Weights { size: [width, height], holes, mask: None, in_use, are_in_use: false, is_mask: true, share: 1.0 }
    }

    /// Takes another mask, from the next [`Weights::update`] on; it has the right size.
    ///
    /// # Errors
    /// A weight out of range, or too few of them.
    pub(crate) fn set_mask(&mut self, mask: Option<&Plane<T>>) -> Result<(), MaskError> {
        let Some(mask) = mask else {
            (self.mask, self.is_mask) = (None, !self.are_in_use);
            return Ok(());
        };
        let one = T::from_f64(1.0);
        if let Some(weight) = mask.samples().iter().find(|weight| !(T::ZERO..=one).contains(weight)) {
            return Err(MaskError::Weight { got: weight.to_f64() });
        }
        let mask = without_border(mask);
        enough(share(&mask))?;
        (self.mask, self.is_mask) = (Some(mask), false);
        Ok(())
    }

    /// Makes the weights of a pair with these depths; says whether any differs from those before.
    ///
    /// # Errors
    /// Too few pixels have weight.
    pub(crate) fn update(&mut self, path: Path, depths: [&Depth<T>; 2]) -> Result<bool, MaskError> {
        let holes = match self.holes {
            Holes::Ignored => depths.map(Depth::holes),
            Holes::Filled => [None; 2],
        };
        let has_holes = holes != [None; 2];
        if self.is_mask && !has_holes {
            return Ok(false);
        }
        self.are_in_use = self.mask.is_some() || has_holes;
        self.is_mask = !has_holes;
        let mask = self.mask.as_ref().map(|mask| mask.samples());
        let (mut changed, mut counted) = (false, 0);
        for (i, weights) in self.in_use.samples_mut().chunks_mut(CHUNK).enumerate() {
            let part = i * CHUNK..i * CHUNK + weights.len();
            let (mask, holes) =
                (mask.map(|mask| &mask[part.clone()]), holes.map(|holes| holes.map(|h| &h[part.clone()])));
            let (is_other, count) = dispatch!(path.level(), _ => set(weights, mask, holes));
            changed |= is_other;
            counted += count as usize;
        }
        self.share = counted as f64 / (self.size[0] * self.size[1]) as f64;
        enough(self.share)?;
        Ok(changed)
    }

    /// The weights, if any pixel's may not be 1.
    pub(crate) fn plane(&self) -> Option<&Plane<T>> {
        self.are_in_use.then_some(&self.in_use)
    }

    /// Share of pixels with weight.
    pub(crate) fn share(&self) -> f64 {
        self.share
    }
}

/// Sets weights to those of the mask, or 1, but 0 in a hole; says whether any is another now, and how many are not 0.
#[inline(always)]
fn set<T: Sample>(weights: &mut [T], mask: Option<&[T]>, holes: [Option<&[bool]>; 2]) -> (bool, u32) {
    let mut new = [T::from_f64(1.0); CHUNK];
    let new = &mut new[..weights.len()];
    if let Some(mask) = mask {
        new.copy_from_slice(mask);
    }
    for holes in holes.into_iter().flatten() {
        for (new, is_hole) in new.iter_mut().zip(holes) {
            *new = if *is_hole { T::ZERO } else { *new };
        }
    }
    let (mut changed, mut counted) = (0, 0);
    for (weight, new) in weights.iter_mut().zip(new) {
        changed |= u32::from(*weight != *new);
        counted += u32::from(*new > T::ZERO);
        *weight = *new;
    }
    (changed != 0, counted)
}

fn share<T: Sample>(weights: &Plane<T>) -> f64 {
    weights.samples().iter().filter(|weight| **weight > T::ZERO).count() as f64 / weights.samples().len() as f64
}

fn enough(share: f64) -> Result<(), MaskError> {
    if share >= SMALLEST_SHARE { Ok(()) } else { Err(MaskError::TooFew { share }) }
}

/// No weight beside a pixel that has none: nothing that is read for a pixel with weight lies under the mask.
fn without_border<T: Sample>(mask: &Plane<T>) -> Plane<T> {
    let [last_u, last_v] = mask.size().map(|side| side - 1);
    Plane::from_fn(mask.width(), mask.height(), |u, v| {
        let neighbours =
            [(u.saturating_sub(1), v), ((u + 1).min(last_u), v), (u, v.saturating_sub(1)), (u, (v + 1).min(last_v))];
        if neighbours.iter().all(|(u, v)| mask.at(*u, *v) > T::ZERO) { mask.at(u, v) } else { T::ZERO }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::depth::{DepthMap, HoleFill};

    fn map(hole: [usize; 2]) -> Depth<f32> {
        let metres = Plane::from_fn(12, 9, |u, v| if [u, v] == hole { 0.0 } else { 1.0 });
        Depth::Map(DepthMap::from_metres(&metres, HoleFill::Median).expect("known depths"))
    }

    #[test]
    fn a_masked_pixel_takes_the_weight_of_its_four_neighbours_along() {
        let mut weights = Weights::new([12, 9], Holes::Filled);
        let mask = Plane::from_fn(12, 9, |u, v| if [u, v] == [0, 4] { 0.0 } else { 0.5 });
        weights.set_mask(Some(&mask)).expect("weights");
        let constant = Depth::Constant { depth_m: 1.0 };
        assert_eq!(
            (weights.update(Path::best(), [&constant; 2]), weights.update(Path::best(), [&constant; 2])),
            (Ok(true), Ok(false))
        );
        let plane = weights.plane().expect("a mask");
        let without: Vec<usize> = (0..108).filter(|i| plane.samples()[*i] == 0.0).collect();
        assert_eq!(without, [36, 48, 49, 60], "the pixel at the border, above, right and below");
        assert!((weights.share() - 104.0 / 108.0).abs() < 1e-15 && plane.at(5, 5) == 0.5);
    }

    #[test]
    fn a_hole_of_either_map_has_no_weight_and_only_when_holes_are_ignored() {
        let (one, other) = (map([3, 3]), map([7, 1]));
        let mut weights = Weights::new([12, 9], Holes::Ignored);
        assert_eq!(weights.update(Path::best(), [&one, &other]), Ok(true));
        let plane = weights.plane().expect("holes");
        assert_eq!((plane.at(3, 3), plane.at(7, 1), plane.at(3, 4)), (0.0, 0.0, 1.0));
        assert_eq!(weights.update(Path::best(), [&other, &other]), Ok(true), "a hole has moved");
        assert_eq!(weights.update(Path::best(), [&Depth::Constant { depth_m: 1.0 }; 2]), Ok(true));
        assert_eq!((weights.plane(), weights.share()), (None, 1.0));
        let mut filled = Weights::new([12, 9], Holes::Filled);
        assert_eq!((filled.update(Path::best(), [&one, &other]), filled.plane()), (Ok(false), None));
    }

    #[test]
    fn a_mask_that_leaves_next_to_nothing_is_refused_with_its_share() {
        let mut weights = Weights::new([12, 9], Holes::Filled);
        assert_eq!(weights.set_mask(Some(&Plane::filled(12, 9, 0.0f64))), Err(MaskError::TooFew { share: 0.0 }));
        assert_eq!(weights.set_mask(Some(&Plane::filled(12, 9, 1.5f64))), Err(MaskError::Weight { got: 1.5 }));
        assert!(weights.set_mask(Some(&Plane::filled(12, 9, f64::NAN))).is_err());
        assert!(weights.set_mask(Some(&Plane::filled(12, 9, 0.1))).is_ok());
    }
}
