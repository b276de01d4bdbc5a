//! Where an image's brightness lies, Eq. (14)–(16), (23), (24): what an adaptive window follows. The rules are each family's own.

use fearless_simd::{Simd, SimdBase, SimdFloat, dispatch};

use crate::image::Plane;
use crate::path::Path;
use crate::row::load;
use crate::sample::Sample;

/// The parameters a step used.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum WindowInUse {
    /// The method has no window.
    Whole,
    /// Hahn's.
    Hahn {
        /// `[a, b]` along `u`.
        x: [f64; 2],
        /// `[a, b]` along `v`.
        y: [f64; 2],
    },
    /// Krawtchouk's.
    Krawtchouk {
        /// `[p along u, p along v]`.
        p: [f64; 2],
    },
}

/// The brightness of a plane summed onto its two axes, Eq. (14), and its centroid, Eq. (15).
#[derive(Debug, Clone, PartialEq)]
pub struct Brightness {
    along_u: Vec<f64>,
    along_v: Vec<f64>,
    total: f64,
}

/// An image without a brightness distribution: black, not finite, or with negative pixels that move its centroid outside.
#[derive(Debug, Clone, Copy, thiserror::Error, PartialEq)]
#[error(
    "an adaptive window needs brightness to follow, got a total of {total} with its centroid at {centroid_px:?} px"
)]
pub struct NoBrightness {
    /// Sum over all pixels.
    pub total: f64,
    /// `[u_c, v_c]`.
    pub centroid_px: [f64; 2],
}

impl Brightness {
    /// The sums of `image`.
    pub fn of<T: Sample>(image: &Plane<T>) -> Brightness {
        let mut brightness =
            Brightness { along_u: vec![0.0; image.width()], along_v: vec![0.0; image.height()], total: 0.0 };
        brightness.set(image, None);
        brightness
    }

    /// The sums of another image of the same size, in place; of its pixels times their weights, if there are any.
    pub fn set<T: Sample>(&mut self, image: &Plane<T>, weight: Option<&Plane<T>>) {
        self.set_beside(Path::best(), image, weight, None);
    }

    /// [`Brightness::set`] with these instructions. With a desired image, whose weights are not asked for, returns `Σ (I - I*)²` as well: both
    /// images pass through the cache once.
    pub(crate) fn set_beside<T: Sample>(
        &mut self,
        path: Path,
        image: &Plane<T>,
        weight: Option<&Plane<T>>,
        desired: Option<&Plane<T>>,
    ) -> f64 {
        debug_assert_eq!(image.size(), [self.along_u.len(), self.along_v.len()]);
        self.along_u.fill(0.0);
        let squares = dispatch!(path.level(), simd => self.add_rows(simd, image, weight, desired));
        self.total = self.along_v.iter().sum();
        squares
    }

    /// Sums are `f64`: those of an image of 8-bit samples are exact, whatever their order.
    #[inline(always)]
    fn add_rows<S: Simd, T: Sample>(
        &mut self,
        simd: S,
        image: &Plane<T>,
        weight: Option<&Plane<T>>,
        desired: Option<&Plane<T>>,
    ) -> f64 {
        let mut squares = 0.0;
        let (lanes, wide) = (T::Vector::<S>::LEN, S::f64s::LEN);
        let whole = image.width() - image.width() % lanes;
        for (v, along_v) in self.along_v.iter_mut().enumerate() {
            let (row, weights) = (image.row(v), weight.map(|weight| weight.row(v)));
            let desired = desired.map(|desired| desired.row(v));
            let (mut sums, mut row_squares) = ([S::f64s::splat(simd, 0.0); 2], [S::f64s::splat(simd, 0.0); 2]);
            for at in (0..whole).step_by(lanes) {
                let mut samples = load(simd, row, at);
                if let Some(desired) = desired {
                    let differences = T::widened(simd, samples - load(simd, desired, at));
                    for k in 0..T::WIDE {
                        row_squares[k] = differences[k].mul_add(differences[k], row_squares[k]);
                    }
                }
                if let Some(weights) = weights {
                    samples *= load(simd, weights, at);
                }
                let parts = T::widened(simd, samples);
                for k in 0..T::WIDE {
                    let columns = &mut self.along_u[at + k * wide..][..wide];
                    (S::f64s::from_slice(simd, columns) + parts[k]).store_slice(columns);
                    sums[k] += parts[k];
                }
            }
            *along_v = (sums[0] + sums[1]).reduce_sum();
            squares += (row_squares[0] + row_squares[1]).reduce_sum();
            for u in whole..row.len() {
                let difference = desired.map_or(0.0, |desired| (row[u] - desired[u]).to_f64());
                squares += difference * difference;
                let sample = weights.map_or(row[u], |weights| row[u] * weights[u]).to_f64();
                self.along_u[u] += sample;
                *along_v += sample;
            }
        }
        squares
    }

    /// `[u_c, v_c]` in pixels.
    ///
    /// # Errors
    /// [`NoBrightness`].
    pub fn centroid_px(&self) -> Result<[f64; 2], NoBrightness> {
        let centroid_px = [&self.along_u, &self.along_v].map(|sums| {
            let moment: f64 = sums.iter().enumerate().map(|(i, sum)| i as f64 * sum).sum();
            moment / self.total
        });
        let ends = [self.along_u.len(), self.along_v.len()].map(|length| (length - 1) as f64);
        let is_inside = centroid_px.iter().zip(ends).all(|(c, end)| (0.0..=end).contains(c));
        if self.total > 0.0 && is_inside {
            Ok(centroid_px)
        } else {
            Err(NoBrightness { total: self.total, centroid_px })
        }
    }

    pub(crate) fn along(&self, axis: usize) -> &[f64] {
        [&self.along_u, &self.along_v][axis]
    }

    /// `d`: the fewest pixels to both sides of `center` that hold 99.73 % of the brightness, Eq. (24); outside is black.
    pub(crate) fn dispersion_px(&self, axis: usize, center: usize) -> usize {
        const THREE_SIGMA: f64 = 0.9973;
        let sums = self.along(axis);
        let at = |i: Option<usize>| i.and_then(|i| sums.get(i)).map_or(0.0, |sum| sum / self.total);
        let mut held = at(Some(center));
        for d in 0..sums.len() {
            if held > THREE_SIGMA {
                return d;
            }
            held += at(center.checked_add(d + 1)) + at(center.checked_sub(d + 1));
        }
        sums.len() - 1
    }
}

/// `[ū_c, v̄_c]`, Eq. (16).
pub(crate) fn mean_centroid(current: &Brightness, desired: &Brightness) -> Result<[f64; 2], NoBrightness> {
    let (current, desired) = (current.centroid_px()?, desired.centroid_px()?);
    Ok([0, 1].map(|axis| (current[axis] + desired[axis]) / 2.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_spot_has_its_place_and_no_spread() {
        let spot = Brightness::of(&Plane::from_fn(20, 10, |u, v| if [u, v] == [7, 3] { 1.0 } else { 0.0 }));
        assert_eq!(spot.centroid_px(), Ok([7.0, 3.0]));
        assert_eq!((spot.dispersion_px(0, 7), spot.dispersion_px(0, 9), spot.dispersion_px(1, 0)), (0, 2, 3));
    }

    #[test]
    fn a_black_image_has_no_place() {
        let black = Brightness::of(&Plane::filled(16, 16, 0.0f32));
        assert!(black.centroid_px().is_err());
    }
}
