//! Why a frame is refused: one variant for each lie, with the numbers.

use super::PixelFormat;

/// Why a frame was refused before its pixels were read.
#[derive(Debug, Clone, thiserror::Error, PartialEq)]
#[non_exhaustive]
pub enum FrameError {
    /// The header is cut short or too long.
    #[error("a frame header has {expected} bytes, got {got}")]
    HeaderLength {
        /// What the flags ask for, bytes.
        expected: usize,
        /// What came, bytes.
        got: usize,
    },
    /// Byte 0 is not [`crate::WIRE_VERSION`].
    #[error("this service speaks wire version 1, got {got}")]
    WrongVersion {
        /// The version that came.
        got: u8,
    },
    /// Byte 1 is not a pixel format.
    #[error("pixel formats are 0 to 9, got {got}")]
    UnknownPixelFormat {
        /// The code that came.
        got: u8,
    },
    /// Byte 2 is not a depth format.
    #[error("depth formats are 0 to 2, got {got}")]
    UnknownDepthFormat {
        /// The code that came.
        got: u8,
    },
    /// A flag that this version does not know: it might say that more bytes follow.
    #[error("only bit 0 of the frame flags is known, got {got:#04x}")]
    UnknownFlags {
        /// The byte that came.
        got: u8,
    },
    /// The reserved word is not 0.
    #[error("the reserved word of a frame header must be 0, got {got:#010x}")]
    ReservedInUse {
        /// The word that came.
        got: u32,
    },
    /// Width or height is 0 where the payload needs them, or only one of them is.
    #[error("width and height must be positive, got {width}x{height}")]
    EmptyImage {
        /// Pixels in a row.
        width: u32,
        /// Rows.
        height: u32,
    },
    /// YUYV needs an even width; NV12 an even width and height.
    #[error("{pixel_format:?} needs an even size, got {width}x{height}")]
    OddSize {
        /// The format with shared colour samples.
        pixel_format: PixelFormat,
        /// Pixels in a row.
        width: u32,
        /// Rows.
        height: u32,
    },
    /// A row does not fit into `row_bytes`, or rows of a PNG or JPEG were given a length.
    #[error("a row takes {expected} bytes, got row_bytes {got}")]
    RowBytes {
        /// Bytes of a tight row.
        expected: u64,
        /// What the header says.
        got: u32,
    },
    /// The sizes in the header cannot be counted in 64 bits.
    #[error("a frame of {width}x{height} pixels is beyond counting")]
    TooLarge {
        /// Pixels in a row.
        width: u32,
        /// Rows.
        height: u32,
    },
    /// The payload is not as long as the header says.
    #[error("the payload must have {expected} bytes, got {got}")]
    PayloadLength {
        /// What the header adds up to, bytes.
        expected: u64,
        /// What came, bytes.
        got: u64,
    },
    /// The payload of a PNG or JPEG has no byte for the image.
    #[error("the payload holds no image")]
    EmptyPayload,
    /// The depth plane would start inside the pixels, or there is an offset without depth.
    #[error("the depth plane must start at {expected} or later, got depth_offset {got}")]
    DepthOffset {
        /// The first byte after the pixels; 0 when there is no depth.
        expected: u64,
        /// What the header says.
        got: u32,
    },
    /// `depth_unit_m` is not a length.
    #[error("depth_unit_m must be positive and finite, got {got}")]
    DepthUnit {
        /// What the header says, metres per count.
        got: f32,
    },
}
