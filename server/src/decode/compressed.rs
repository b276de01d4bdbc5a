//! PNG and JPEG, with their size read, compared and limited before memory is taken for the pixels.

use std::io::Cursor;

use domvs_proto::frame::{self, FrameHeader};
use image::codecs::jpeg::JpegDecoder;
use image::codecs::png::PngDecoder;
use image::{ColorType, ImageDecoder, ImageResult, Limits};

use super::{DecodeError, DecodeLimits, check_pixels};

/// Bytes of a pixel of four 16-bit samples, the largest there is.
const MOST_BYTES_PER_PIXEL: u64 = 8;
/// What a decoder may take beside the pixels: its window, a colour profile.
const WORKING_BYTES: u64 = 4 << 20;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Codec {
    Png,
    Jpeg,
}

/// What was written to `samples`: tight rows of this colour type.
#[derive(Debug, Clone, Copy)]
pub(super) struct Picture {
    pub width: u32,
    pub height: u32,
    pub color: ColorType,
}

impl Codec {
    fn undecodable(self, reason: impl ToString) -> DecodeError {
        let encoding = match self {
            Codec::Png => frame::PNG,
            Codec::Jpeg => frame::JPEG,
        };
        DecodeError::Undecodable { encoding, reason: reason.to_string() }
    }
}

/// Decodes `bytes` into `samples`. Fails on any disagreement with the header or the limits, and on a broken image.
pub(super) fn read(
    codec: Codec,
    bytes: &[u8],
    header: &FrameHeader,
    limits: DecodeLimits,
    samples: &mut Vec<u8>,
) -> Result<Picture, DecodeError> {
    match codec {
        Codec::Png => {
            let [width, height] = png_size(bytes).ok_or_else(|| codec.undecodable("it does not begin like a PNG"))?;
            check_size(width, height, header, limits)?;
            let decoder = PngDecoder::with_limits(Cursor::new(bytes), image_limits(limits));
            read_samples(codec, decoder, header, limits, samples)
        }
        Codec::Jpeg => {
            if !jpeg_has_its_end(bytes) {
                return Err(codec.undecodable("its end is missing"));
            }
            // This constructor reads headers only; it takes no memory for pixels.
            read_samples(codec, JpegDecoder::new(Cursor::new(bytes)), header, limits, samples)
        }
    }
}

fn read_samples<D: ImageDecoder>(
    codec: Codec,
    decoder: ImageResult<D>,
    header: &FrameHeader,
    limits: DecodeLimits,
    samples: &mut Vec<u8>,
) -> Result<Picture, DecodeError> {
    let mut decoder = decoder.map_err(|error| codec.undecodable(error))?;
    let (width, height) = decoder.dimensions();
    check_size(width, height, header, limits)?;
    decoder.set_limits(image_limits(limits)).map_err(|error| codec.undecodable(error))?;
    let color = decoder.color_type();
    let bytes = u64::from(width) * u64::from(height) * u64::from(color.bytes_per_pixel());
    samples.clear();
    samples.resize(usize::try_from(bytes).map_err(|error| codec.undecodable(error))?, 0);
    decoder.read_image(samples).map_err(|error| codec.undecodable(error))?;
    Ok(Picture { width, height, color })
}

/// The image's own size must be what the header says (0x0: nothing), not empty, and within the limits.
fn check_size(width: u32, height: u32, header: &FrameHeader, limits: DecodeLimits) -> Result<(), DecodeError> {
    let (expected, got) = ([header.width, header.height], [width, height]);
    if expected != [0, 0] && expected != got {
        return Err(DecodeError::SizeMismatch { expected, got });
    }
    if width == 0 || height == 0 {
        return Err(frame::FrameError::EmptyImage { width, height }.into());
    }
    check_pixels(width, height, limits)
}

fn image_limits(limits: DecodeLimits) -> Limits {
    let most_pixels = u32::try_from(limits.max_pixels).unwrap_or(u32::MAX);
    let mut image_limits = Limits::default();
    image_limits.max_image_width = Some(most_pixels);
    image_limits.max_image_height = Some(most_pixels);
    image_limits.max_alloc = Some(limits.max_pixels.saturating_mul(MOST_BYTES_PER_PIXEL).saturating_add(WORKING_BYTES));
    image_limits
}

/// Width and height from the first chunk of a PNG (IHDR), which has a fixed place.
fn png_size(bytes: &[u8]) -> Option<[u32; 2]> {
    let rest = bytes.strip_prefix(b"\x89PNG\r\n\x1a\n\0\0\0\x0dIHDR")?;
    let (width, rest) = rest.split_first_chunk()?;
    let (height, _) = rest.split_first_chunk()?;
    Some([u32::from_be_bytes(*width), u32::from_be_bytes(*height)])
}

/// True if an end-of-image marker follows the last start of a scan. Inside a scan a byte `ff` never stands before these
/// two, and a thumbnail's own end comes before the image's scans.
fn jpeg_has_its_end(bytes: &[u8]) -> bool {
    let last = |marker: [u8; 2]| bytes.windows(2).rposition(|pair| pair == marker);
    last([0xff, 0xda]).is_some_and(|scan| last([0xff, 0xd9]).is_some_and(|end| end > scan))
}
