//! Samples → gray, one formula per format. Lengths were checked before; rows may be padded.

use domvs_proto::frame::PixelFormat;
use domvs_vision::Plane;
use image::ColorType;

/// Raw pixels, little-endian, a row every `row_bytes`; of YUYV and NV12 only Y is read.
pub(super) fn from_raw(format: PixelFormat, bytes: &[u8], row_bytes: usize, image: &mut Plane<f32>) {
    match format {
        PixelFormat::ByEncoding => unreachable!("compressed frames are read by their decoders"),
        PixelFormat::Mono8 | PixelFormat::Nv12 => fill(image, bytes, row_bytes, |&[y]| over_255(y)),
        PixelFormat::Yuyv => fill(image, bytes, row_bytes, |&[y, _]| over_255(y)),
        PixelFormat::Mono16 => fill(image, bytes, row_bytes, |y| over_65535(u16::from_le_bytes(*y))),
        PixelFormat::Rgb8 => fill(image, bytes, row_bytes, |&[r, g, b]| luma8(r, g, b)),
        PixelFormat::Bgr8 => fill(image, bytes, row_bytes, |&[b, g, r]| luma8(r, g, b)),
        PixelFormat::Rgba8 => fill(image, bytes, row_bytes, |&[r, g, b, _]| luma8(r, g, b)),
        PixelFormat::Bgra8 => fill(image, bytes, row_bytes, |&[b, g, r, _]| luma8(r, g, b)),
        PixelFormat::Mono32F => fill(image, bytes, row_bytes, |y| f32::from_le_bytes(*y)),
    }
}

/// What a PNG or JPEG decoder wrote: tight rows, 16-bit samples in the machine's byte order.
pub(super) fn from_samples(color: ColorType, bytes: &[u8], image: &mut Plane<f32>) {
    let row = image.width() * usize::from(color.bytes_per_pixel());
    let wide = |high, low| u16::from_ne_bytes([high, low]);
    match color {
        ColorType::L8 => fill(image, bytes, row, |&[y]| over_255(y)),
        ColorType::La8 => fill(image, bytes, row, |&[y, _]| over_255(y)),
        ColorType::Rgb8 => fill(image, bytes, row, |&[r, g, b]| luma8(r, g, b)),
        ColorType::Rgba8 => fill(image, bytes, row, |&[r, g, b, _]| luma8(r, g, b)),
        ColorType::L16 => fill(image, bytes, row, |&[y, z]| over_65535(wide(y, z))),
        ColorType::La16 => fill(image, bytes, row, |&[y, z, _, _]| over_65535(wide(y, z))),
        ColorType::Rgb16 => fill(image, bytes, row, |&[r, s, g, h, b, c]| luma16(wide(r, s), wide(g, h), wide(b, c))),
        ColorType::Rgba16 => {
            fill(image, bytes, row, |&[r, s, g, h, b, c, _, _]| luma16(wide(r, s), wide(g, h), wide(b, c)));
        }
        _ => unreachable!("PNG and JPEG decoders write 8 or 16 bits per sample, 1 to 4 samples per pixel"),
    }
}

/// Every sample of the plane from the `N` bytes of its pixel.
pub(super) fn fill<const N: usize>(
    plane: &mut Plane<f32>,
    bytes: &[u8],
    row_bytes: usize,
    sample: impl Fn(&[u8; N]) -> f32,
) {
    let width = plane.width();
    for (to, from) in plane.samples_mut().chunks_exact_mut(width).zip(bytes.chunks(row_bytes)) {
        let (pixels, _) = from[..width * N].as_chunks::<N>();
        for (to, pixel) in to.iter_mut().zip(pixels) {
            *to = sample(pixel);
        }
    }
}

fn over_255(sample: u8) -> f32 {
    f32::from(sample) / 255.0
}

fn over_65535(sample: u16) -> f32 {
    f32::from(sample) / 65535.0
}

/// `(0.299 R + 0.587 G + 0.114 B) / 255`; the weights in thousandths make the sum exact, so the result is rounded once.
fn luma8(r: u8, g: u8, b: u8) -> f32 {
    luma(r.into(), g.into(), b.into()) as f32 / 255_000.0
}

/// The same over 65535; the sum needs 26 bits, so the result is rounded twice.
fn luma16(r: u16, g: u16, b: u16) -> f32 {
    luma(r.into(), g.into(), b.into()) as f32 / 65_535_000.0
}

fn luma(r: u32, g: u32, b: u32) -> u32 {
    299 * r + 587 * g + 114 * b
}
