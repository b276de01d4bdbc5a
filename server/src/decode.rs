//! Frame bytes → gray plane in [0, 1] and, if the frame has one, a depth plane in metres.
//!
//! What a frame holds is said by its header, or for PNG and JPEG by its Encoding alone. Sizes are checked before
//! anything is allocated: the payload against the header (`FrameHeader::layout`), the pixel count against the limits, a PNG's and a
//! JPEG's own size against both. So neither a lie nor a decompression bomb costs memory.
//!
//! Gray is `(0.299 R + 0.587 G + 0.114 B) / 255`, unrounded; 16-bit samples are over 65535; Y of YUYV and NV12 is over 255;
//! alpha is ignored; `mono32f` is taken as it is, within [`TAKEN`]. A PNG's gamma and colour profile and a JPEG's orientation are
//! ignored: a camera's pixels stay where they are.
//!
//! Odd sizes of YUYV and NV12 are refused, as the header's rules say. A cut-off JPEG is refused as well: decoders would fill
//! the missing part with gray, and the camera would be moved by it.
//!
//! Rows are read where they lie in the packets that came, and nothing is looked at twice: what the image is judged by is found
//! on the way. A [`Decoder`] keeps its plane: raw frames of one size allocate nothing after the first. PNG and JPEG decoders
//! allocate their own working memory for each frame.

mod compressed;
mod depth;
mod gray;
mod jpeg;
mod preprocess;
#[cfg(test)]
mod tests;

use domvs_proto::frame::{self, FrameError, FrameHeader, PixelFormat};
use domvs_vision::Plane;

use self::compressed::Codec;
pub use self::depth::DepthRows;
use self::gray::{Found, Rows};
pub use self::preprocess::{invert, weights};
use crate::payload::Payload;
use crate::screen::GraySums;

/// Samples of `mono32f` that are taken as they are. [0, 1] is meant; noise and light may lead outside, gray from 0 to 255 is a mistake.
pub const TAKEN: std::ops::RangeInclusive<f32> = -1.0..=2.0;

/// What one frame may cost.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DecodeLimits {
    /// Pixels of the image.
    pub max_pixels: u64,
    /// Bytes of the payload.
    pub max_bytes: usize,
}

/// A decoded frame; its image lives in the [`Decoder`] until the next frame.
#[derive(Debug)]
pub struct Decoded<'a> {
    /// Gray in [0, 1], every sample finite.
    pub image: &'a mut Plane<f32>,
    /// What the gray values are judged by: contrast, and how much is black or white.
    pub sums: GraySums,
    /// The depth plane, of the image's size.
    pub depth: Option<DepthRows<'a>>,
    /// How many pixels were not finite (`mono32f` only) and are now 0.
    pub replaced_pixels: usize,
}

/// Why a frame cannot be used.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum DecodeError {
    /// The header lies about the payload.
    #[error(transparent)]
    Frame(#[from] FrameError),
    /// The payload is beyond the limit; nothing of it was read.
    #[error("a payload may have {limit} bytes, got {got}")]
    TooManyBytes {
        /// The limit.
        limit: usize,
        /// Bytes of the payload.
        got: usize,
    },
    /// The image is beyond the limit; nothing was allocated for it.
    #[error("an image may have {limit} pixels, got {width}x{height}")]
    TooManyPixels {
        /// The limit.
        limit: u64,
        /// Pixels in a row.
        width: u32,
        /// Rows.
        height: u32,
    },
    /// Neither a header nor the Encoding says what the payload is.
    #[error("a frame without pixel format must be image/png or image/jpeg, got encoding {encoding:?}")]
    UnknownEncoding {
        /// The Encoding that came, its first 64 characters.
        encoding: String,
    },
    /// A PNG or JPEG has another size than its header says.
    #[error("the header says {expected:?} pixels, the image has {got:?}")]
    SizeMismatch {
        /// Width and height in the header.
        expected: [u32; 2],
        /// Width and height in the PNG or JPEG.
        got: [u32; 2],
    },
    /// The PNG or JPEG is broken, cut off, or of a kind that is not supported.
    #[error("cannot decode {encoding}: {reason}")]
    Undecodable {
        /// The Encoding.
        encoding: &'static str,
        /// What the decoder said.
        reason: String,
    },
    /// More than half of the pixels are NaN or infinite.
    #[error("at least half of {pixels} pixels must be finite, got {finite}")]
    NotFinite {
        /// Pixels of the image.
        pixels: usize,
        /// Those that are finite.
        finite: usize,
    },
    /// Some finite samples are far from gray in [0, 1].
    #[error("mono32f samples must be {} to {} ([0, 1] is meant), got {outside} of {pixels} outside", TAKEN.start(), TAKEN.end())]
    OutOfRange {
        /// Pixels of the image.
        pixels: usize,
        /// Those outside.
        outside: usize,
    },
}

/// Decodes the frames of one task, into the same plane again and again.
#[derive(Debug, Default)]
pub struct Decoder {
    image: Option<Plane<f32>>,
    /// What the PNG or JPEG decoder wrote.
    samples: Vec<u8>,
    /// A row, or a PNG or JPEG, that several packets shared.
    seam: Vec<u8>,
}

impl Decoder {
    /// A decoder without buffers; the first frame makes them.
    pub fn new() -> Decoder {
        Decoder::default()
    }

    /// Decodes a frame. `header` is `None` for a PNG or JPEG without attachment, `encoding` the payload's media type
    /// (parameters behind `;` are ignored), looked at only when the header names no pixel format.
    ///
    /// After an error the decoder is as good as new: the next frame does not depend on this one.
    pub fn decode<'a>(
        &'a mut self,
        header: Option<&FrameHeader>,
        encoding: &str,
        payload: Payload<'a>,
        limits: DecodeLimits,
    ) -> Result<Decoded<'a>, DecodeError> {
        if payload.len() > limits.max_bytes {
            return Err(DecodeError::TooManyBytes { limit: limits.max_bytes, got: payload.len() });
        }
        let bare = FrameHeader::new(PixelFormat::ByEncoding, 0, 0);
        let header = header.unwrap_or(&bare);
        let layout = header.layout(payload.len())?;
        check_pixels(header.width, header.height, limits)?;

        let Decoder { image, samples, seam } = self;
        let (image, Found { sums, replaced, outside }) = match header.pixel_format {
            PixelFormat::ByEncoding => {
                let codec = Codec::named(encoding)?;
                let bytes = payload.reader().take(layout.pixels.len(), seam);
                let picture = compressed::read(codec, bytes, header, limits, samples)?;
                let image = plane_of(image, picture.width, picture.height);
                let row_bytes = image.width() * usize::from(picture.color.bytes_per_pixel());
                let rows = Rows { reader: Payload::from(&*samples).reader(), row_bytes, seam };
                let found = gray::from_samples(picture.color, rows, image);
                (image, found)
            }
            raw => {
                let image = plane_of(image, header.width, header.height);
                seam.reserve(layout.row_bytes);
                let rows = Rows { reader: payload.reader(), row_bytes: layout.row_bytes, seam };
                let found = gray::from_raw(raw, rows, image);
                (image, found)
            }
        };
        let pixels = image.samples().len();
        if 2 * replaced > pixels {
            return Err(DecodeError::NotFinite { pixels, finite: pixels - replaced });
        }
        if outside > 0 {
            return Err(DecodeError::OutOfRange { pixels, outside });
        }
        let depth = layout.depth.map(|depth| DepthRows::new(header, payload, depth.start, seam));
        Ok(Decoded { image, sums, depth, replaced_pixels: replaced })
    }
}

/// The size is in the header: 0 (not said) for a PNG or JPEG, which is checked again once it is known.
fn check_pixels(width: u32, height: u32, limits: DecodeLimits) -> Result<(), DecodeError> {
    if u64::from(width) * u64::from(height) > limits.max_pixels {
        return Err(DecodeError::TooManyPixels { limit: limits.max_pixels, width, height });
    }
    Ok(())
}

/// The plane of this size: the one that is there, or a new one.
fn plane_of(plane: &mut Option<Plane<f32>>, width: u32, height: u32) -> &mut Plane<f32> {
    let (width, height) = (width as usize, height as usize);
    if !plane.as_ref().is_some_and(|plane| plane.width() == width && plane.height() == height) {
        *plane = None;
    }
    plane.get_or_insert_with(|| Plane::filled(width, height, 0.0))
}

/// The media type without parameters.
fn media_type(encoding: &str) -> &str {
    encoding.split(';').next().unwrap_or_default().trim()
}

impl Codec {
    fn named(encoding: &str) -> Result<Codec, DecodeError> {
        match media_type(encoding) {
            frame::PNG => Ok(Codec::Png),
            frame::JPEG => Ok(Codec::Jpeg),
            _ => Err(DecodeError::UnknownEncoding { encoding: encoding.chars().take(64).collect() }),
        }
    }
}
