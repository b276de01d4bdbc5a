//! Image and depth files as `f64` planes. What a file is, its first bytes say, not its name.
//! PNG and JPEG go through the `image` crate, TIFF through the `tiff` crate (which knows float samples).
//! Nothing is rotated, resized or colour-managed: samples are taken as the camera wrote them.

mod depth;
mod gray;
mod mask;

pub use depth::{DepthFile, read_depth};
pub use gray::read_gray;
pub use mask::mask_png;

use std::io::Cursor;
use std::path::Path;

use anyhow::{Context, bail, ensure};
use image::{DynamicImage, ImageReader};
use tiff::decoder::{Decoder, DecodingResult};
use tiff::{ColorType, TiffError};

/// What a file holds, before it means gray values or metres: interleaved channels, row by row.
struct Raster {
    width: usize,
    height: usize,
    channels: usize,
    samples: Samples,
}

enum Samples {
    U8(Vec<u8>),
    U16(Vec<u16>),
    F32(Vec<f32>),
    F64(Vec<f64>),
}

impl Raster {
    /// For messages: `16-bit gray`, `8-bit colour`.
    fn kind(&self) -> String {
        let depth = match self.samples {
            Samples::U8(_) => "8-bit",
            Samples::U16(_) => "16-bit",
            Samples::F32(_) => "32-bit float",
            Samples::F64(_) => "64-bit float",
        };
        format!("{depth} {}", if self.channels < 3 { "gray" } else { "colour" })
    }
}

fn read_raster(path: &Path) -> anyhow::Result<Raster> {
    let bytes = std::fs::read(path).with_context(|| format!("cannot read {}", path.display()))?;
    let raster = match bytes.get(..4) {
        Some(b"II*\0" | b"MM\0*" | b"II+\0" | b"MM\0+") => tiff_raster(&bytes),
        _ => png_or_jpeg_raster(&bytes),
    };
    raster.with_context(|| format!("cannot decode {} ({} bytes)", path.display(), bytes.len()))
}

fn png_or_jpeg_raster(bytes: &[u8]) -> anyhow::Result<Raster> {
    let reader = ImageReader::new(Cursor::new(bytes)).with_guessed_format()?;
    ensure!(reader.format().is_some(), "it is neither PNG nor JPEG nor TIFF");
    let image = reader.decode()?;
    let (width, height) = (image.width() as usize, image.height() as usize);
    let channels = usize::from(image.color().channel_count());
    let samples = match image {
        DynamicImage::ImageLuma8(image) => Samples::U8(image.into_raw()),
        DynamicImage::ImageLumaA8(image) => Samples::U8(image.into_raw()),
        DynamicImage::ImageRgb8(image) => Samples::U8(image.into_raw()),
        DynamicImage::ImageRgba8(image) => Samples::U8(image.into_raw()),
        DynamicImage::ImageLuma16(image) => Samples::U16(image.into_raw()),
        DynamicImage::ImageLumaA16(image) => Samples::U16(image.into_raw()),
        DynamicImage::ImageRgb16(image) => Samples::U16(image.into_raw()),
        DynamicImage::ImageRgba16(image) => Samples::U16(image.into_raw()),
        other => bail!("samples of the kind {:?} are not supported", other.color()),
    };
    Ok(Raster { width, height, channels, samples })
}

fn tiff_raster(bytes: &[u8]) -> anyhow::Result<Raster> {
    let mut decoder = Decoder::new(Cursor::new(bytes))?;
    let (width, height) = decoder.dimensions()?;
    let channels = tiff_channels(decoder.colortype()?)?;
    let samples = match decoder.read_image()? {
        DecodingResult::U8(samples) => Samples::U8(samples),
        DecodingResult::U16(samples) => Samples::U16(samples),
        DecodingResult::F32(samples) => Samples::F32(samples),
        DecodingResult::F64(samples) => Samples::F64(samples),
        _ => bail!("TIFF samples must be 8 or 16-bit unsigned, or 32 or 64-bit float"),
    };
    Ok(Raster { width: width as usize, height: height as usize, channels, samples })
}

fn tiff_channels(color: ColorType) -> Result<usize, TiffError> {
    match color {
        ColorType::Gray(8 | 16 | 32 | 64) => Ok(1),
        ColorType::GrayA(8 | 16 | 32 | 64) => Ok(2),
        ColorType::RGB(8 | 16 | 32 | 64) => Ok(3),
        ColorType::RGBA(8 | 16 | 32 | 64) => Ok(4),
        other => Err(tiff::TiffUnsupportedError::UnsupportedColorType(other).into()),
    }
}
