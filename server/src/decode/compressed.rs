//! PNG and JPEG, with their size read, compared and limited before memory is taken for the pixels.

use std::io::Cursor;
use std::panic::{AssertUnwindSafe, catch_unwind};

use domvs_proto::frame::{self, FrameHeader};
use image::codecs::png::PngDecoder;
use image::{ColorType, ImageDecoder, ImageError, Limits};

use super::{DecodeError, DecodeLimits, check_pixels, jpeg};

/// Bytes of a pixel of four 16-bit samples, the largest there is.
const MOST_BYTES_PER_PIXEL: u64 = 8;
/// What a decoder may take beside the pixels: its window, a colour profile.
const WORKING_BYTES: u64 = 4 << 20;
/// Chunks of a PNG; a decoder keeps and counts each. Encoders that write 8 KiB at a time stay below in 64 MiB.
const MOST_CHUNKS: usize = 1 << 14;

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
    let (width, height, color) = match codec {
        Codec::Png => {
            let [width, height] = png_size(bytes).ok_or_else(|| codec.undecodable("it does not begin like a PNG"))?;
            check_size(width, height, header, limits)?;
            check_chunks(bytes).map_err(|error| codec.undecodable(error))?;
            let color = guarded(|| read_png(bytes, limits, samples)).map_err(|error| codec.undecodable(error))?;
            (width, height, color)
        }
        Codec::Jpeg => {
            let outline = jpeg::outline(bytes).map_err(|error| codec.undecodable(error))?;
            check_size(outline.width, outline.height, header, limits)?;
            let color = guarded(|| jpeg::read(bytes, &outline, samples)).map_err(|error| codec.undecodable(error))?;
            (outline.width, outline.height, color)
        }
    };
    Ok(Picture { width, height, color })
}

/// What a decoder says of a file; if it panics on it, which is the file's fault as well and no reason for the task to end, that.
/// What it leaves in the samples is thrown away before the next.
fn guarded(read: impl FnOnce() -> Result<ColorType, String>) -> Result<ColorType, String> {
    catch_unwind(AssertUnwindSafe(read)).unwrap_or_else(|_| Err("the decoder failed on it".to_owned()))
}

/// Decodes a PNG whose size was found to be within the limits.
fn read_png(bytes: &[u8], limits: DecodeLimits, samples: &mut Vec<u8>) -> Result<ColorType, String> {
    let said = |error: ImageError| error.to_string();
    let decoder = PngDecoder::with_limits(Cursor::new(bytes), image_limits(limits)).map_err(said)?;
    let color = decoder.color_type();
    samples.clear();
    // Pixels within the limits times 8 bytes at most.
    samples.resize(decoder.total_bytes() as usize, 0);
    decoder.read_image(samples).map_err(said)?;
    Ok(color)
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

/// Fails on more chunks than an encoder makes, and on a palette that is none, which the decoder does not check.
/// What else is wrong with them, the decoder says.
fn check_chunks(bytes: &[u8]) -> Result<(), String> {
    let (mut rest, mut chunks) = (bytes.get(8..).unwrap_or_default(), 0);
    // A length, a name, the data, a checksum.
    while let Some((length, after)) = rest.split_first_chunk() {
        let length = u32::from_be_bytes(*length) as usize;
        chunks += 1;
        if chunks > MOST_CHUNKS {
            return Err(format!("at most {MOST_CHUNKS} chunks, got more"));
        }
        if after.starts_with(b"PLTE") && (!length.is_multiple_of(3) || length > 3 * 256) {
            return Err(format!("a palette has up to 256 colours of 3 bytes, got {length} bytes"));
        }
        rest = after.get(length + 8..).unwrap_or_default();
    }
    Ok(())
}
