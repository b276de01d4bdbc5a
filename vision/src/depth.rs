//! How far the scene is: one constant, or a map with its holes filled.
//!
//! The law divides by depth only, so a map keeps the inverse, `ζ = 1/Z`, and no later step can meet a hole; it remembers where they were.

use crate::image::Plane;
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
    known_m: Vec<T>,
    holes: Vec<bool>,
    unknown: usize,
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
        let [width, height] = depth_m.size();
        let mut map = DepthMap {
            inverse_per_m: Plane::filled(width, height, T::ZERO),
            known_m: Vec::with_capacity(width * height),
            holes: vec![false; width * height],
            unknown: 0,
        };
        map.set_metres(depth_m, fill)?;
        Ok(map)
    }

    /// Refills the map in place, without allocating; on an error the map stays as it was.
    ///
    /// # Errors
    /// Another size, a fill that is not positive, or a median of nothing.
    pub fn set_metres(&mut self, depth_m: &Plane<T>, fill: HoleFill) -> Result<(), DepthError> {
        let (expected, got) = (self.inverse_per_m.size(), depth_m.size());
        if expected != got {
            return Err(DepthError::SizeMismatch { expected, got });
        }
        let unknown = depth_m.samples().iter().filter(|z| !is_known(**z)).count();
        let fill_per_m = if unknown == 0 { T::ZERO } else { T::from_f64(1.0 / self.fill_depth(depth_m, fill)?) };
        let one = T::from_f64(1.0);
        let filled = self.inverse_per_m.samples_mut().iter_mut().zip(&mut self.holes);
        for ((inverse, is_hole), z) in filled.zip(depth_m.samples()) {
            *is_hole = !is_known(*z);
            *inverse = if *is_hole { fill_per_m } else { one / *z };
        }
        self.unknown = unknown;
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

    fn fill_depth(&mut self, depth_m: &Plane<T>, fill: HoleFill) -> Result<f64, DepthError> {
        let fill_m = match fill {
            HoleFill::Constant(fill_m) => fill_m,
            HoleFill::Median => {
                self.known_m.clear();
                self.known_m.extend(depth_m.samples().iter().filter(|z| is_known(**z)));
                let middle = self.known_m.len() / 2;
                if self.known_m.is_empty() {
                    return Err(DepthError::NothingKnown { pixels: depth_m.samples().len() });
                }
                let by_depth = |a: &T, b: &T| a.partial_cmp(b).expect("known depths are numbers");
                self.known_m.select_nth_unstable_by(middle, by_depth).1.to_f64()
            }
        };
        if is_known(T::from_f64(fill_m)) { Ok(fill_m) } else { Err(DepthError::NotPositive { depth_m: fill_m }) }
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
}
