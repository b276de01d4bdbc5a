//! Krawtchouk: `w(u)/w(u-1) = p (P - u) / ((1 - p) u)` on `P` points, `0 < p < 1`, Table I: a window of width `√(N p (1-p))` about `p N`.
//!
//! The adaptive `p` is the mean centroid of the two images, Eq. (19).

use crate::family::{Family, Rows};
use crate::law::{Law, LawError};
use crate::window::{Brightness, NoBrightness, WindowInUse, mean_centroid};

/// Krawtchouk rows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Krawtchouk {
    /// Where, strictly between 0 and 1.
    pub p: f64,
    /// On which points.
    pub lattice: Lattice,
}

/// How Krawtchouk's point is chosen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum KrawtchoukP {
    /// The mean centroid of the two images.
    Adaptive,
    /// Always `[p along u, p along v]`, strictly between 0 and 1.
    Fixed([f64; 2]),
}

/// On which points Krawtchouk's polynomials are orthonormal.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Lattice {
    /// `0 … N`, as printed, cut to the `N` pixels: not quite orthonormal on them when `p` nears 1 (erratum E2).
    Paper,
    /// `0 … N - 1`.
    Exact,
}

impl Family for Krawtchouk {
    const WORD: &'static str = "krawtchouk";
    const ROWS: Rows<Krawtchouk> =
        Rows::UnderWeight(|Krawtchouk { p, .. }, u, points| p / (1.0 - p) * (points - u) / u);

    fn is_in_range(&self) -> bool {
        self.p > 0.0 && self.p < 1.0
    }

    fn has_extra_point(&self) -> bool {
        self.lattice == Lattice::Paper
    }

    fn check(law: &Law) -> Result<(), LawError> {
        match law.krawtchouk_p {
            KrawtchoukP::Fixed(p) if !p.iter().all(|p| *p > 0.0 && *p < 1.0) => Err(LawError::KrawtchoukP { p }),
            _ => Ok(()),
        }
    }

    fn follows_images(law: &Law) -> bool {
        law.krawtchouk_p == KrawtchoukP::Adaptive
    }

    fn choose(law: &Law, current: &Brightness, desired: &Brightness) -> Result<[Krawtchouk; 2], NoBrightness> {
        let lattice = law.lattice;
        let p = match law.krawtchouk_p {
            KrawtchoukP::Adaptive => krawtchouk_p(lattice, current, desired)?,
            KrawtchoukP::Fixed(p) => p,
        };
        Ok(p.map(|p| Krawtchouk { p, lattice }))
    }

    fn window(rows: [Krawtchouk; 2]) -> WindowInUse {
        WindowInUse::Krawtchouk { p: rows.map(|rows| rows.p) }
    }
}

/// Krawtchouk's `[p along u, p along v]` from the mean centroid of both images, Eq. (19).
///
/// # Errors
/// [`NoBrightness`].
pub fn krawtchouk_p(lattice: Lattice, current: &Brightness, desired: &Brightness) -> Result<[f64; 2], NoBrightness> {
    let center = mean_centroid(current, desired)?;
    Ok([0, 1].map(|axis| match lattice {
        Lattice::Paper => center[axis] / current.along(axis).len() as f64,
        Lattice::Exact => center[axis] / (current.along(axis).len() - 1) as f64,
    }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Plane;

    #[test]
    fn krawtchouk_looks_at_the_mean_centroid() {
        let spot = |at| Brightness::of(&Plane::from_fn(20, 11, |u, v| if [u, v] == at { 1.0 } else { 0.0 }));
        let (current, desired) = (spot([4, 2]), spot([8, 4]));
        assert_eq!(krawtchouk_p(Lattice::Paper, &current, &desired), Ok([6.0 / 20.0, 3.0 / 11.0]));
        assert_eq!(krawtchouk_p(Lattice::Exact, &current, &desired), Ok([6.0 / 19.0, 0.3]));
    }
}
