//! What a sweep looks at, which planes it makes of that, and what it sums up: decided once, before the first row.

use crate::along_v::Multiplier;
use crate::depth::Depth;
use crate::features::Sight;
use crate::image::Plane;
use crate::sample::Sample;
use crate::table::Term;

/// Most terms a sweep sums up, and where each part of the interaction matrix is among them.
pub(crate) const MOST_TERMS: usize = 9;
pub(crate) const ERROR: usize = 0;
pub(crate) const ALONG_U: usize = 1;
pub(crate) const ALONG_U_Y: usize = 2;
pub(crate) const ALONG_V: usize = 3;
pub(crate) const ALONG_V_Y: usize = 4;
pub(crate) const ALONG_V_YY: usize = 5;
pub(crate) const ZETA_U: usize = 6;
pub(crate) const ZETA_V: usize = 7;
pub(crate) const ZETA_V_Y: usize = 8;

/// What one sweep looks at, and makes.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Views<'a, T> {
    /// `L(I*, Z*)`, without an error.
    Desired(Sight<'a, T>),
    /// `I - I*`, and what `½(L(I, Z) + L(I*, Z*))` lacks beside [`Swept::of_desired`] of `L(I*, Z*)`.
    Current(Sight<'a, T>, Sight<'a, T>),
    /// `I - I*` and `½(L(I, Z) + L(I*, Z*))`.
    Both(Sight<'a, T>, Sight<'a, T>),
}

impl<'a, T: Sample> Views<'a, T> {
    /// The view whose slopes are taken first.
    pub(crate) fn first(&self) -> Sight<'a, T> {
        match *self {
            Views::Desired(sight) | Views::Current(sight, _) | Views::Both(sight, _) => sight,
        }
    }

    /// The desired image, if there is an error to it.
    pub(crate) fn error_to(&self) -> Option<&'a Plane<T>> {
        match *self {
            Views::Desired(_) => None,
            Views::Current(_, desired) | Views::Both(_, desired) => Some(desired.0),
        }
    }
}

/// `ζ`, if it is one number.
pub(crate) fn constant_per_m<T>(depth: &Depth<T>) -> Option<f64> {
    if let Depth::Constant { depth_m } = depth { Some(1.0 / depth_m) } else { None }
}

/// What a sweep's rows are made of. The planes are `∇I_u`; `∇I_v` or, by parts, the image itself; then `ζ ∇I_u`, `ζ ∇I_v` if they have to be
/// planes, and at the end `I - I*`, unless that is the image.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Plan {
    /// `ζ`, when it needs no planes of its own.
    pub constant_per_m: Option<f64>,
    /// Whether the planes are those of `I - I*` alone, and the second is that image itself.
    pub by_parts: bool,
    /// Which plane is `I - I*`.
    pub error: Option<usize>,
    /// By plane.
    pub degrees: &'static [usize],
    /// What a mean takes of the desired half's columns of translation and rotation.
    pub of_desired: [f64; 2],
}

impl Plan {
    /// Decides it.
    pub(crate) fn of<T: Sample>(views: &Views<'_, T>, is_weighted: bool) -> Plan {
        let own = constant_per_m(views.first().1);
        let apart = |constant_per_m: Option<f64>, error: bool| {
            let degrees: &[usize] = if constant_per_m.is_some() { &[2, 1, 0] } else { &[2, 1, 1, 0, 0] };
            let count = degrees.len() - usize::from(!error);
            let (degrees, error) = (&degrees[..count], error.then_some(count - 1));
            Plan { constant_per_m, by_parts: false, error, degrees, of_desired: [0.5; 2] }
        };
        match views {
            Views::Desired(_) => apart(own, false),
            Views::Both(_, (_, desired)) => apart(own.filter(|zeta| Some(*zeta) == constant_per_m(desired)), true),
            Views::Current(..) if is_weighted => apart(own, true),
            Views::Current(_, (_, desired)) => {
                let (constant_per_m, degrees, translation): (_, &[usize], _) = match (own, constant_per_m(desired)) {
                    (Some(zeta), Some(desired)) => (Some(zeta), &[2, 1], 0.5 + 0.5 * zeta / desired),
                    _ => (None, &[2, 1, 1, 0], 0.5),
                };
                Plan { constant_per_m, by_parts: true, error: Some(1), degrees, of_desired: [translation, 1.0] }
            }
        }
    }

    /// What is summed up over the rows, each in its place.
    pub(crate) fn terms(&self) -> [Option<Term>; MOST_TERMS] {
        use Multiplier::{ByPartsOneAndYyq, ByPartsQ, ByPartsYq, OneAndYyq, Q, Yq};
        let down = if self.by_parts { [ByPartsQ, ByPartsYq, ByPartsOneAndYyq] } else { [Q, Yq, OneAndYyq] };
        let term = |plane, times, degree| Some(Term { plane, times, degree });
        let with_zeta = |own: Option<Term>| own.filter(|_| self.constant_per_m.is_none());
        [
            self.error.and_then(|plane| term(plane, Q, 0)),
            term(0, Q, 2),
            term(0, Yq, 1),
            term(1, down[0], 1),
            term(1, down[1], 1),
            term(1, down[2], 0),
            with_zeta(term(2, Q, 1)),
            with_zeta(term(3, Q, 0)),
            with_zeta(term(3, Yq, 0)),
        ]
    }
}

/// What a sweep did.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Swept {
    /// Multiply-adds of use.
    pub multiply_adds: u64,
    /// [`Views::Current`]: the mean is so much of the desired half's columns of translation and rotation, and half of what was swept.
    pub of_desired: [f64; 2],
}
