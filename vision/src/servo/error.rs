//! Why there is no servo, or no step.

use crate::basis::{BasisError, LENGTHS};
use crate::law::LawError;
use crate::weights::MaskError;
use crate::window::NoBrightness;

/// Why there is no servo, or no step.
#[derive(Debug, thiserror::Error, PartialEq)]
#[non_exhaustive]
pub enum ServoError {
    /// The law's own numbers.
    #[error(transparent)]
    Law(#[from] LawError),
    /// A side is too short or too long.
    #[error("images have {} to {} pixels a side, got {got:?}", LENGTHS.start(), LENGTHS.end())]
    SizeOutOfRange {
        /// `[width, height]`.
        got: [usize; 2],
    },
    /// The order is too high for the size.
    #[error("expected orders up to {highest} for {size:?} pixels (shorter side - 3), got {got}")]
    OrderTooHigh {
        /// `min(width, height) - 3`.
        highest: usize,
        /// The rule's highest order.
        got: usize,
        /// `[width, height]`.
        size: [usize; 2],
    },
    /// An image has another size than the desired one.
    #[error("expected an image of {expected:?} pixels, got {got:?}")]
    ImageSize {
        /// `[width, height]` of the desired image.
        expected: [usize; 2],
        /// `[width, height]` given.
        got: [usize; 2],
    },
    /// A depth map has another size than the desired image.
    #[error("expected a depth map of {expected:?} pixels, got {got:?}")]
    DepthSize {
        /// `[width, height]` of the desired image.
        expected: [usize; 2],
        /// `[width, height]` given.
        got: [usize; 2],
    },
    /// A constant depth is not positive and finite.
    #[error("a constant depth must be positive and finite, got {depth_m} m")]
    DepthNotPositive {
        /// As given, metres.
        depth_m: f64,
    },
    /// A pixel is not a finite number, or so large that sums over the image are not.
    #[error("the image holds numbers that are not finite, or sums beyond all numbers")]
    ImageNotFinite,
    /// An adaptive window needs brightness to follow.
    #[error(transparent)]
    NoBrightness(#[from] NoBrightness),
    /// The window leaves no orthonormal basis.
    #[error(transparent)]
    Basis(#[from] BasisError),
    /// A mask, or the pixels that are left.
    #[error(transparent)]
    Mask(#[from] MaskError),
    /// A depth scale is estimated for constant depths only.
    #[error("a depth scale is estimated for a constant depth, got a depth map")]
    DepthScaleOfMap,
}
