//! Samples → gray, one formula per format, row by row. Lengths were checked before; rows may be padded.
//!
//! Rows are worked on with the widest instructions of the machine, as the law's kernels are; each sample comes out the same on all of them.

use domvs_proto::frame::PixelFormat;
use domvs_vision::Plane;
use fearless_simd::{Level, dispatch};
use image::ColorType;

use super::TAKEN;
use crate::payload::Reader;
use crate::screen::GraySums;

/// The rows of an image, as many bytes each.
pub(super) struct Rows<'a, I> {
    pub reader: Reader<'a, I>,
    pub row_bytes: usize,
    pub seam: &'a mut Vec<u8>,
}

/// What was found on the way.
#[derive(Debug, Default)]
pub(super) struct Found {
    pub sums: GraySums,
    /// Pixels that were not finite, and are 0 now.
    pub replaced: usize,
    /// Finite pixels that are not taken.
    pub outside: usize,
}

/// Raw pixels, little-endian; of YUYV and NV12 only Y is read.
pub(super) fn from_raw<'a, I: Iterator<Item = &'a [u8]>>(
    format: PixelFormat,
    rows: Rows<'a, I>,
    image: &mut Plane<f32>,
) -> Found {
    match format {
        PixelFormat::ByEncoding => unreachable!("compressed frames are read by their decoders"),
        PixelFormat::Mono8 | PixelFormat::Nv12 => fill(image, rows, |&[y]| over_255(y)),
        PixelFormat::Yuyv => fill(image, rows, |&[y, _]| over_255(y)),
        PixelFormat::Mono16 => fill(image, rows, |y| over_65535(u16::from_le_bytes(*y))),
        PixelFormat::Rgb8 => fill(image, rows, |&[r, g, b]| luma8(r, g, b)),
        PixelFormat::Bgr8 => fill(image, rows, |&[b, g, r]| luma8(r, g, b)),
        PixelFormat::Rgba8 => fill(image, rows, |&[r, g, b, _]| luma8(r, g, b)),
        PixelFormat::Bgra8 => fill(image, rows, |&[b, g, r, _]| luma8(r, g, b)),
        PixelFormat::Mono32F => fill_finite(image, rows, |y| f32::from_le_bytes(*y)),
    }
}

/// What a PNG or JPEG decoder wrote: tight rows, 16-bit samples in the machine's byte order.
pub(super) fn from_samples<'a, I: Iterator<Item = &'a [u8]>>(
    color: ColorType,
    rows: Rows<'a, I>,
    image: &mut Plane<f32>,
) -> Found {
    let wide = |high, low| u16::from_ne_bytes([high, low]);
    match color {
        ColorType::L8 => fill(image, rows, |&[y]| over_255(y)),
        ColorType::La8 => fill(image, rows, |&[y, _]| over_255(y)),
        ColorType::Rgb8 => fill(image, rows, |&[r, g, b]| luma8(r, g, b)),
        ColorType::Rgba8 => fill(image, rows, |&[r, g, b, _]| luma8(r, g, b)),
        ColorType::L16 => fill(image, rows, |&[y, z]| over_65535(wide(y, z))),
        ColorType::La16 => fill(image, rows, |&[y, z, _, _]| over_65535(wide(y, z))),
        ColorType::Rgb16 => fill(image, rows, |&[r, s, g, h, b, c]| luma16(wide(r, s), wide(g, h), wide(b, c))),
        ColorType::Rgba16 => fill(image, rows, |&[r, s, g, h, b, c, _, _]| luma16(wide(r, s), wide(g, h), wide(b, c))),
        _ => unreachable!("PNG and JPEG decoders write 8 or 16 bits per sample, 1 to 4 samples per pixel"),
    }
}

/// Every sample of the plane from the `N` bytes of its pixel; for formats that have no number that is not finite.
fn fill<'a, const N: usize, I: Iterator<Item = &'a [u8]>>(
    image: &mut Plane<f32>,
    mut rows: Rows<'a, I>,
    sample: impl Fn(&[u8; N]) -> f32,
) -> Found {
    let (mut found, level) = (Found::default(), Level::new());
    let width = image.width();
    for to in image.samples_mut().chunks_exact_mut(width) {
        let from = rows.next();
        dispatch!(level, _ => {
            convert(to, from, &sample);
            found.sums.add_row(to);
        });
    }
    found
}

/// The same for floats: what is not finite becomes 0 (black, as outside the image) and is counted, what is out of range is counted.
fn fill_finite<'a, const N: usize, I: Iterator<Item = &'a [u8]>>(
    image: &mut Plane<f32>,
    mut rows: Rows<'a, I>,
    sample: impl Fn(&[u8; N]) -> f32,
) -> Found {
    let (mut found, level) = (Found::default(), Level::new());
    let width = image.width();
    for to in image.samples_mut().chunks_exact_mut(width) {
        let from = rows.next();
        let taken = dispatch!(level, _ => {
            convert(to, from, &sample);
            to.iter().filter(|gray| TAKEN.contains(gray)).count()
        });
        if taken < width {
            let finite = to.iter().filter(|gray| gray.is_finite()).count();
            (found.replaced, found.outside) = (found.replaced + width - finite, found.outside + finite - taken);
            to.iter_mut().filter(|gray| !gray.is_finite()).for_each(|gray| *gray = 0.0);
        }
        dispatch!(level, _ => found.sums.add_row(to));
    }
    found
}

/// A row of samples from a row of pixels of `N` bytes each, with or without padding behind.
#[inline(always)]
pub(super) fn convert<const N: usize>(to: &mut [f32], from: &[u8], sample: impl Fn(&[u8; N]) -> f32) {
    let (pixels, _) = from.as_chunks::<N>();
    for (to, pixel) in to.iter_mut().zip(pixels) {
        *to = sample(pixel);
    }
}

impl<'a, I: Iterator<Item = &'a [u8]>> Rows<'a, I> {
    fn next(&mut self) -> &[u8] {
        self.reader.take(self.row_bytes, self.seam)
    }
}

/// `y / 255`, rounded once: two multiplications are quicker than a division, and a test holds them equal.
fn over_255(sample: u8) -> f32 {
    let y = f32::from(sample);
    y * (1.0 / 256.0) + y * (1.0 / 65_280.0)
}

/// `y / 65535`, in the same way.
fn over_65535(sample: u16) -> f32 {
    const REST: f32 = (1.0 / 65_535.0 - 1.0 / 65_536.0) as f32;
    let y = f32::from(sample);
    y * (1.0 / 65_536.0) + y * REST
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn multiplied_gray_is_divided_gray_to_the_last_bit() {
        for sample in 0..=u8::MAX {
            assert_eq!(over_255(sample), f32::from(sample) / 255.0, "{sample}");
        }
        for sample in 0..=u16::MAX {
            assert_eq!(over_65535(sample), f32::from(sample) / 65535.0, "{sample}");
        }
    }
}
