//! How far the scene is: one constant, or a map with its holes filled.
//!
//! The law divides by depth only, so a map keeps the inverse, `ζ = 1/Z`, and no later step can meet a hole; it remembers where they were.

use fearless_simd::dispatch;

use crate::image::Plane;
use crate::median::select;
use crate::path::Path;
use crate::sample::Sample;

/// The depth of a view, along the optical axis.
#[derive(Debug, Clone, PartialEq)]
pub enum Depth<T> {
    /// One positive depth for every pixel.
    Constant {
        /// Metres; checked when a view is used.
        depth_m: f64,
    },
    /// A depth per pixel.
    Map(DepthMap<T>),
}

/// Inverse depth per pixel, without holes.
#[derive(Debug, Clone, PartialEq)]
pub struct DepthMap<T> {
    inverse_per_m: Plane<T>,
    holes: Vec<bool>,
    unknown: usize,
    /// One row of depths, metres.
    row_m: Vec<T>,
    /// Room for the median.
    selection: Vec<T>,
}

/// What a hole (0, negative or not finite) becomes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum HoleFill {
    /// The upper median of the known depths of the same map.
    Median,
    /// This depth in metres.
    Constant(f64),
}

/// Why depths do not make a map.
#[derive(Debug, thiserror::Error, PartialEq)]
#[non_exhaustive]
pub enum DepthError {
    /// Not one known depth to take a median of.
    #[error("no known depth among {pixels} pixels")]
    NothingKnown {
        /// Pixels of the map.
        pixels: usize,
    },
    /// A depth given as a number is not positive and finite.
    #[error("a depth must be positive and finite, got {depth_m} m")]
    NotPositive {
        /// As given, metres.
        depth_m: f64,
    },
    /// A map was refilled with another size.
    #[error("expected a depth map of {expected:?} pixels, got {got:?}")]
    SizeMismatch {
        /// `[width, height]` of the map.
        expected: [usize; 2],
        /// `[width, height]` given.
        got: [usize; 2],
    },
}

impl<T: Sample> Depth<T> {
    /// Which pixels of a map were holes; `None` if there are none.
    pub(crate) fn holes(&self) -> Option<&[bool]> {
        match self {
            Depth::Map(map) if map.unknown > 0 => Some(&map.holes),
            Depth::Constant { .. } | Depth::Map(_) => None,
        }
    }
}

impl<T: Sample> DepthMap<T> {
    /// A map from depths in metres; holes (0, negative, not finite, or so small that the inverse overflows) are filled.
    ///
    /// # Errors
    /// A fill that is not positive, or a median of nothing.
    pub fn from_metres(depth_m: &Plane<T>, fill: HoleFill) -> Result<DepthMap<T>, DepthError> {
        let mut map = DepthMap::unknown_everywhere(depth_m.size());
        map.set_metres(depth_m, fill)?;
        Ok(map)
    }

    /// A map of `[width, height]` pixels from depths in metres, as [`DepthMap::set_rows`] takes them.
    ///
    /// # Errors
    /// A fill that is not positive, or a median of nothing.
    pub fn from_rows(
        size: [usize; 2],
        fill: HoleFill,
        metres: impl FnMut(&mut [T]),
    ) -> Result<DepthMap<T>, DepthError> {
        let mut map = DepthMap::unknown_everywhere(size);
        map.set_rows(fill, metres)?;
        Ok(map)
    }

    fn unknown_everywhere([width, height]: [usize; 2]) -> DepthMap<T> {
        let inverse_per_m = Plane::filled(width, height, T::from_f64(1.0));
        let pixels = inverse_per_m.samples().len();
        DepthMap {
            row_m: vec![T::ZERO; inverse_per_m.width()],
            inverse_per_m,
            holes: vec![true; pixels],
            unknown: pixels,
            selection: Vec::with_capacity(pixels),
        }
    }

    /// Refills the map in place, without allocating; on an error the depths stay as they were.
    ///
    /// # Errors
    /// Another size, a fill that is not positive, or a median of nothing.
    pub fn set_metres(&mut self, depth_m: &Plane<T>, fill: HoleFill) -> Result<(), DepthError> {
        let (expected, got) = (self.inverse_per_m.size(), depth_m.size());
        if expected != got {
            return Err(DepthError::SizeMismatch { expected, got });
        }
        self.refill(fill, |_, inverse, holes, v| invert_row(depth_m.row(v), inverse, holes))
    }

    /// Refills the map in place, without allocating, from depths in metres that `metres` writes row by row, from the top.
    /// On an error the depths stay as they were; where nothing was known, every pixel counts as a hole from then on.
    ///
    /// # Errors
    /// A fill that is not positive, or a median of nothing.
    pub fn set_rows(&mut self, fill: HoleFill, mut metres: impl FnMut(&mut [T])) -> Result<(), DepthError> {
        self.refill(fill, |row_m, inverse, holes, _| {
            metres(row_m);
            invert_row(row_m, inverse, holes)
        })
    }

    /// Refills each row by `invert`, which has room for its depths, writes `ζ` and the holes of row `v`, and says how many there are.
    fn refill(
        &mut self,
        fill: HoleFill,
        mut invert: impl FnMut(&mut [T], &mut [T], &mut [bool], usize) -> usize,
    ) -> Result<(), DepthError> {
        if let HoleFill::Constant(depth_m) = fill
            && !is_known(T::from_f64(depth_m))
        {
            return Err(DepthError::NotPositive { depth_m });
        }
        let width = self.inverse_per_m.width();
        let rows = self.inverse_per_m.samples_mut().chunks_exact_mut(width).zip(self.holes.chunks_exact_mut(width));
        self.unknown = 0;
        for (v, (inverse, holes)) in rows.enumerate() {
            self.unknown += invert(&mut self.row_m, inverse, holes, v);
        }
        if self.unknown > 0 {
            let fill_per_m = match fill {
                HoleFill::Constant(depth_m) => T::from_f64(1.0 / depth_m),
                HoleFill::Median => self.median_per_m()?,
            };
            dispatch!(Path::best().level(), _ => fill_holes(self.inverse_per_m.samples_mut(), &self.holes, fill_per_m));
        }
        Ok(())
    }

    /// How many pixels were holes before they were filled.
    pub fn unknown(&self) -> usize {
        self.unknown
    }

    /// Whether each pixel was a hole before it was filled, row by row.
    pub fn holes(&self) -> &[bool] {
        &self.holes
    }

    /// `1/Z` in 1/m, every pixel positive and finite.
    pub fn inverse_per_m(&self) -> &Plane<T> {
        &self.inverse_per_m
    }

    /// The inverse of the upper median depth: the inverse falls where depth grows, rounding included, so it is their lower median.
    fn median_per_m(&mut self) -> Result<T, DepthError> {
        let (inverse, holes) = (self.inverse_per_m.samples(), &self.holes);
        let known = inverse.len() - self.unknown;
        if known == 0 {
            return Err(DepthError::NothingKnown { pixels: inverse.len() });
        }
        Ok(select(inverse, holes, [known - 1 - known / 2, known], &mut self.selection))
    }
}

/// [`invert`] on the widest path: each depth comes out the same on every one.
fn invert_row<T: Sample>(depth_m: &[T], inverse_per_m: &mut [T], holes: &mut [bool]) -> usize {
    dispatch!(Path::best().level(), _ => invert(depth_m, inverse_per_m, holes))
}

/// `ζ = 1/Z` of a row where it is known; where it is not, `ζ` stays and there is a hole. Returns how many there are.
#[inline(always)]
fn invert<T: Sample>(depth_m: &[T], inverse_per_m: &mut [T], holes: &mut [bool]) -> usize {
    let (one, width) = (T::from_f64(1.0), depth_m.len());
    let mut unknown = 0u32;
    for ((inverse, is_hole), z) in inverse_per_m[..width].iter_mut().zip(&mut holes[..width]).zip(depth_m) {
        let made = one / *z;
        // One division; `&`, not `&&`, so that a row is worked through without a jump.
        let known = (*z > T::ZERO) & (made > T::ZERO) & (made < T::INFINITY);
        *inverse = if known { made } else { *inverse };
        *is_hole = !known;
        unknown += u32::from(!known);
    }
    unknown as usize
}

#[inline(always)]
fn fill_holes<T: Sample>(inverse_per_m: &mut [T], holes: &[bool], fill_per_m: T) {
    for (inverse, is_hole) in inverse_per_m.iter_mut().zip(holes) {
        *inverse = if *is_hole { fill_per_m } else { *inverse };
    }
}

/// Whether a depth and its inverse are both positive, finite numbers.
fn is_known<T: Sample>(depth_m: T) -> bool {
    let inverse = T::from_f64(1.0) / depth_m;
    depth_m > T::ZERO && inverse > T::ZERO && inverse < T::INFINITY
}

#[cfg(test)]
mod tests {
    use super::*;

    fn holed() -> Plane<f32> {
        let samples = vec![2.0, 0.0, -1.0, f32::NAN, f32::INFINITY, 1e-42, 4.0, 8.0];
        Plane::new(4, 2, samples).expect("eight samples")
    }

    #[test]
    fn holes_get_the_median_and_are_counted() {
        let map = DepthMap::from_metres(&holed(), HoleFill::Median).expect("three are known");
        assert_eq!(map.unknown(), 5);
        assert_eq!(map.holes(), [false, true, true, true, true, true, false, false]);
        let expected = [0.5, 0.25, 0.25, 0.25, 0.25, 0.25, 0.25, 0.125];
        assert_eq!(map.inverse_per_m().samples(), &expected);
    }

    #[test]
    fn a_map_without_a_known_depth_is_refused_and_stays_as_it_was() {
        let mut map = DepthMap::from_metres(&holed(), HoleFill::Constant(0.5)).expect("a good fill");
        let before = map.clone();
        let nothing = Plane::filled(4, 2, 0.0f32);
        assert_eq!(map.set_metres(&nothing, HoleFill::Median), Err(DepthError::NothingKnown { pixels: 8 }));
        assert!(map.set_metres(&nothing, HoleFill::Constant(f64::NAN)).is_err());
        assert!(map.set_metres(&Plane::filled(2, 4, 1.0), HoleFill::Median).is_err());
        assert_eq!(map.inverse_per_m(), before.inverse_per_m());
    }

    #[test]
    fn the_fill_is_the_upper_median_of_all_known_depths() {
        // Widths and values without a pattern; every seventh, then every third, then all but two are holes.
        let mut state = 7u32;
        for (count, hole_every) in [(99, 7), (100, 7), (5_000, 3), (60_000, 7), (60_001, 3)] {
            let mut samples: Vec<f32> = (0..count)
                .map(|_| {
                    state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                    0.3 + (state >> 16) as f32 * 1e-4
                })
                .collect();
            samples.iter_mut().step_by(hole_every).for_each(|z| *z = 0.0);
            let mut known: Vec<f32> = samples.iter().copied().filter(|z| *z > 0.0).collect();
            known.sort_by(f32::total_cmp);
            let map = DepthMap::from_metres(&Plane::new(count, 1, samples).expect("one row"), HoleFill::Median);
            let expected = 1.0 / known[known.len() / 2];
            assert_eq!(map.expect("known ones").inverse_per_m().at(0, 0), expected, "{count} pixels");
        }
    }
}
