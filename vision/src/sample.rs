//! The number a pixel plane is made of: `f32` where speed counts, `f64` where the last digits do.
//!
//! Only planes and the bases that meet them are generic. Sums over rows, the features and the 6x6 part are always `f64`.

use std::fmt::Debug;
use std::ops::{Add, AddAssign, Div, Mul, Sub};

use fearless_simd::{Simd, SimdFloat, SimdFloatElement, SimdWiden};

/// A pixel's number type: `f32` or `f64`.
pub trait Sample:
    Copy
    + Debug
    + Default
    + PartialOrd
    + Send
    + Sync
    + 'static
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + AddAssign
    + SimdFloatElement
{
    /// As many samples as a vector register of the path holds.
    type Vector<S: Simd>: SimdFloat<S, Element = Self>;

    /// Nought.
    const ZERO: Self;

    /// Beyond every number.
    const INFINITY: Self;

    /// The step from 1 to the next number.
    const EPSILON: Self;

    /// How many vectors of `f64` a vector of samples becomes.
    const WIDE: usize;

    /// A vector of samples as `f64`, exactly: the first [`Sample::WIDE`] of the two.
    fn widened<S: Simd>(simd: S, samples: Self::Vector<S>) -> [S::f64s; 2];

    /// The nearest sample to `value`.
    fn from_f64(value: f64) -> Self;

    /// This sample as `f64`, exactly.
    fn to_f64(self) -> f64;
}

impl Sample for f32 {
    type Vector<S: Simd> = S::f32s;

    const ZERO: f32 = 0.0;
    const INFINITY: f32 = f32::INFINITY;
    const EPSILON: f32 = f32::EPSILON;
    const WIDE: usize = 2;

    #[inline(always)]
    fn widened<S: Simd>(_: S, samples: S::f32s) -> [S::f64s; 2] {
        let (low, high) = samples.widen();
        [low, high]
    }

    fn from_f64(value: f64) -> f32 {
        value as f32
    }

    fn to_f64(self) -> f64 {
        f64::from(self)
    }
}

impl Sample for f64 {
    type Vector<S: Simd> = S::f64s;

    const ZERO: f64 = 0.0;
    const INFINITY: f64 = f64::INFINITY;
    const EPSILON: f64 = f64::EPSILON;
    const WIDE: usize = 1;

    #[inline(always)]
    fn widened<S: Simd>(_: S, samples: S::f64s) -> [S::f64s; 2] {
        [samples; 2]
    }

    fn from_f64(value: f64) -> f64 {
        value
    }

    fn to_f64(self) -> f64 {
        self
    }
}
