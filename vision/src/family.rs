//! The families of moments. A family is one file, which says all about it, and one line of the list at the end of this one.
//!
//! A family is known by the rows that make its moments: under a weight, as its ratios (Table I of the paper), or in closed form. What is
//! made of the rows, from bases to twists, asks nobody for names. Hahn is the paper's family: `a = b = 0` is Tchebichef, and `a, b → ∞`
//! at a fixed `p = b/(a + b)` is Krawtchouk, Eq. (6), (7).

use std::fmt::Debug;

use crate::basis::Basis;
use crate::law::{Law, LawError};
use crate::window::{Brightness, NoBrightness, WindowInUse};

/// One axis' rows, with their parameters, and what a law makes of them.
pub trait Family: Copy + PartialEq + Debug {
    /// Its name in settings and on command lines.
    const WORD: &'static str;

    /// What its rows are.
    const ROWS: Rows<Self>;

    /// Whether the parameters are within their ranges.
    fn is_in_range(&self) -> bool {
        true
    }

    /// Whether the rows live on one point more than there are pixels.
    fn has_extra_point(&self) -> bool {
        false
    }

    /// Whether the law's settings for this family make sense.
    ///
    /// # Errors
    /// The first that does not.
    fn check(_law: &Law) -> Result<(), LawError> {
        Ok(())
    }

    /// Whether the parameters follow the images under this law.
    fn follows_images(_law: &Law) -> bool {
        false
    }

    /// The rows along `[u, v]` under this law.
    ///
    /// # Errors
    /// An image without brightness to follow.
    fn choose(law: &Law, current: &Brightness, desired: &Brightness) -> Result<[Self; 2], NoBrightness>;

    /// The parameters as a step reports them.
    fn window(_rows: [Self; 2]) -> WindowInUse {
        WindowInUse::Whole
    }
}

/// How a family's rows are known.
#[derive(Debug)]
pub enum Rows<F> {
    /// Polynomials orthonormal under a weight `w`, known by `w(u)/w(u-1)` at `u` of so many points; no factorial is needed. They have a
    /// three-term recurrence.
    UnderWeight(fn(&F, u: f64, points: f64) -> f64),
    /// Row `n` at `u` of so many pixels. They have no recurrence.
    ClosedForm(fn(&F, n: usize, u: usize, length: usize) -> f64),
}

/// What a law says about its moments, for one pair of images.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Chosen {
    /// The rows along `[u, v]`.
    pub polynomials: [Polynomial; 2],
    /// Their parameters, as a step reports them.
    pub window: WindowInUse,
}

macro_rules! families {
    ($($module:ident::$family:ident $what:literal)+) => {
        $(pub mod $module;)+
        $(pub use $module::$family;)+

        /// What the law compares in the two images.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
        pub enum Method {
            $(#[doc = $what] $family,)+
            /// Photometric servoing: every pixel is a feature.
            Photometric,
            /// The photometric gaussian mixture: every pixel of the two images seen through a bell.
            GaussianMixture,
        }

        /// Which rows, with their parameters.
        #[derive(Debug, Clone, Copy, PartialEq)]
        pub enum Polynomial {
            $(#[doc = $what] $family($family),)+
        }

        $(impl From<$family> for Polynomial {
            fn from(rows: $family) -> Polynomial {
                Polynomial::$family(rows)
            }
        })+

        impl Method {
            /// Every method.
            pub const ALL: &[Method] = &[$(Method::$family,)+ Method::Photometric, Method::GaussianMixture];

            /// Its name in settings and on command lines.
            pub fn word(self) -> &'static str {
                match self {
                    $(Method::$family => $family::WORD,)+
                    Method::Photometric => "photometric",
                    Method::GaussianMixture => "gaussian_mixture",
                }
            }

            /// Whether its features are moments.
            pub fn is_on_moments(self) -> bool {
                !matches!(self, Method::Photometric | Method::GaussianMixture)
            }
        }

        impl Polynomial {
            /// Whether the parameters are within their ranges.
            pub(crate) fn is_in_range(&self) -> bool {
                match self { $(Polynomial::$family(rows) => rows.is_in_range(),)+ }
            }

            /// Whether the rows live on one point more than there are pixels.
            pub(crate) fn has_extra_point(&self) -> bool {
                match self { $(Polynomial::$family(rows) => rows.has_extra_point(),)+ }
            }

            /// Whether the rows have a three-term recurrence.
            pub(crate) fn has_recurrence(&self) -> bool {
                match self { $(Polynomial::$family(_) => matches!($family::ROWS, Rows::UnderWeight(_)),)+ }
            }

            /// Makes these rows the basis' own.
            pub(crate) fn fill(&self, basis: &mut Basis) {
                match self { $(Polynomial::$family(rows) => basis.fill(rows),)+ }
            }
        }

        /// Whether the law's settings make sense to every family.
        pub(crate) fn check(law: &Law) -> Result<(), LawError> {
            $($family::check(law)?;)+
            Ok(())
        }

        /// Whether the law's rows follow the images.
        pub(crate) fn follows_images(law: &Law) -> bool {
            match law.method {
                $(Method::$family => $family::follows_images(law),)+
                Method::Photometric | Method::GaussianMixture => false,
            }
        }

        /// The rows this law asks for; `None` if its features are not moments.
        pub(crate) fn choose(
            law: &Law,
            current: &Brightness,
            desired: &Brightness,
        ) -> Result<Option<Chosen>, NoBrightness> {
            Ok(match law.method {
                $(Method::$family => {
                    let rows = $family::choose(law, current, desired)?;
                    Some(Chosen { polynomials: rows.map(Polynomial::$family), window: $family::window(rows) })
                })+
                Method::Photometric | Method::GaussianMixture => None,
            })
        }
    };
}

families! {
    hahn::Hahn "Hahn moments: a window anywhere between the whole image (Tchebichef) and a narrow spot (Krawtchouk)."
    krawtchouk::Krawtchouk "Krawtchouk moments: a narrow spot around a chosen point."
    tchebichef::Tchebichef "Tchebichef moments: the whole image, evenly."
    cosine::Cosine "Orthonormal cosine (DCT-II) coefficients: the whole image, evenly."
}

impl Method {
    /// The method of this name.
    pub fn from_word(word: &str) -> Option<Method> {
        Method::ALL.iter().copied().find(|method| method.word() == word)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_method_is_found_by_its_own_word() {
        assert!(Method::ALL.iter().all(|method| Method::from_word(method.word()) == Some(*method)));
        assert_eq!(Method::from_word("legendre"), None);
    }
}
