//! The families of rows and the weights that tell them apart: Table I of the paper, as far as it is needed.
//!
//! A weight is known by its ratios `w(u)/w(u-1)`; they need no factorials, and Hahn's `a` and `b` need not be whole.
//! Hahn is the family: `a = b = 0` is Tchebichef, and `a, b → ∞` at a fixed `p = b/(a + b)` is Krawtchouk, Eq. (6), (7).

use crate::window::Lattice;

/// Largest Hahn parameter a basis is made for; the adaptive rule stays below it at every size here.
pub const HAHN_LIMIT: f64 = 1e9;

/// Which rows, with their parameters.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Polynomial {
    /// Hahn, `a, b >= 0`, real; a larger `b` moves the window right, a larger `a + b` narrows it.
    Hahn {
        /// Weighs the right end down.
        a: f64,
        /// Weighs the left end down.
        b: f64,
    },
    /// Krawtchouk, `0 < p < 1`: a window of width `√(N p (1-p))` about `p N`.
    Krawtchouk {
        /// Where.
        p: f64,
        /// On which points.
        lattice: Lattice,
    },
    /// Tchebichef: no window (Hahn with `a = b = 0`).
    Tchebichef,
    /// Orthonormal cosines (DCT-II): no window, not polynomials in `u`.
    Cosine,
}

impl Polynomial {
    /// Whether the parameters are within their ranges.
    pub(crate) fn is_in_range(&self) -> bool {
        match *self {
            Polynomial::Hahn { a, b } => (0.0..=HAHN_LIMIT).contains(&a) && (0.0..=HAHN_LIMIT).contains(&b),
            Polynomial::Krawtchouk { p, .. } => p > 0.0 && p < 1.0,
            Polynomial::Tchebichef | Polynomial::Cosine => true,
        }
    }

    /// Whether the rows live on one point more than there are pixels.
    pub(crate) fn has_extra_point(&self) -> bool {
        matches!(self, Polynomial::Krawtchouk { lattice: Lattice::Paper, .. })
    }

    /// `w(u)/w(u-1)` on `u = 0 … points - 1`, Table I; `points` is the number of lattice points.
    pub(crate) fn weight_ratio(&self, u: f64, points: f64) -> f64 {
        match *self {
            Polynomial::Hahn { a, b } => (b + u) / u * (points - u) / (points + a - u),
            Polynomial::Krawtchouk { p, .. } => p / (1.0 - p) * (points - u) / u,
            Polynomial::Tchebichef | Polynomial::Cosine => 1.0,
        }
    }
}
