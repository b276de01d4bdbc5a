//! A plane of samples: a gray image, or a depth in metres.
//!
//! Row-major; `u` runs right, `v` down, and indices come in that order. A gray image is nominally in `[0, 1]`,
//! but nothing here clips or checks values: [`crate::Servo`] refuses what is not finite.

use crate::aligned::Aligned;
use crate::sample::Sample;

/// A `width` x `height` plane of samples, row-major, index `(u right, v down)`.
#[derive(Debug, Clone, PartialEq)]
pub struct Plane<T> {
    width: usize,
    height: usize,
    samples: Aligned<T>,
}

/// Why a plane cannot be made.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
#[non_exhaustive]
pub enum ImageError {
    /// A side is zero.
    #[error("an image has at least 1x1 pixels, got {width}x{height}")]
    Empty {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
    },
    /// The samples do not fill the sides.
    #[error("{width}x{height} pixels need {expected} samples, got {got}")]
    SampleCount {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
        /// `width * height`.
        expected: usize,
        /// What was given.
        got: usize,
    },
}

impl<T: Sample> Plane<T> {
    /// A plane of `width` x `height` from row-major `samples`.
    ///
    /// # Errors
    /// A zero side, or a sample count other than `width * height`.
    pub fn new(width: usize, height: usize, samples: Vec<T>) -> Result<Plane<T>, ImageError> {
        if width == 0 || height == 0 {
            return Err(ImageError::Empty { width, height });
        }
        let expected = width.saturating_mul(height);
        if samples.len() != expected {
            return Err(ImageError::SampleCount { width, height, expected, got: samples.len() });
        }
        Ok(Plane { width, height, samples: Aligned::copied(&samples) })
    }

    /// A plane of one value; a zero side becomes 1.
    pub fn filled(width: usize, height: usize, value: T) -> Plane<T> {
        let (width, height) = (width.max(1), height.max(1));
        Plane { width, height, samples: Aligned::filled(width * height, value) }
    }

    /// A plane whose sample at `(u, v)` is `sample(u, v)`; a zero side becomes 1.
    pub fn from_fn(width: usize, height: usize, sample: impl Fn(usize, usize) -> T) -> Plane<T> {
        let mut plane = Plane::filled(width, height, T::ZERO);
        let width = plane.width;
        for (v, row) in plane.samples_mut().chunks_exact_mut(width).enumerate() {
            row.iter_mut().enumerate().for_each(|(u, at)| *at = sample(u, v));
        }
        plane
    }

    /// Columns.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// All samples, row-major.
    pub fn samples(&self) -> &[T] {
        self.samples.as_slice()
    }

    /// All samples, row-major, to write in place.
    pub fn samples_mut(&mut self) -> &mut [T] {
        self.samples.as_mut_slice()
    }

    /// The sample in column `u` of row `v`; panics outside the plane.
    pub fn at(&self, u: usize, v: usize) -> T {
        self.row(v)[u]
    }

    /// Row `v`, `width` samples; panics outside the plane.
    pub fn row(&self, v: usize) -> &[T] {
        &self.samples()[v * self.width..][..self.width]
    }

    /// `[width, height]`, as errors report it.
    pub(crate) fn size(&self) -> [usize; 2] {
        [self.width, self.height]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plane_is_indexed_right_then_down() {
        let plane = Plane::from_fn(3, 2, |u, v| (10 * v + u) as f32);
        assert_eq!(plane.samples(), &[0.0, 1.0, 2.0, 10.0, 11.0, 12.0]);
        assert_eq!((plane.at(2, 1), plane.row(1)), (12.0, &[10.0, 11.0, 12.0][..]));
    }

    #[test]
    fn samples_that_do_not_fill_the_plane_are_refused() {
        let refused = Plane::new(3, 2, vec![0.0; 5]);
        assert_eq!(refused, Err(ImageError::SampleCount { width: 3, height: 2, expected: 6, got: 5 }));
        assert_eq!(Plane::<f32>::new(0, 2, vec![]), Err(ImageError::Empty { width: 0, height: 2 }));
    }
}
