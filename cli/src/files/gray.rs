//! A gray image out of a file: 0.299 R + 0.587 G + 0.114 B, over 255 (8-bit) or 65535 (16-bit), unrounded.
//! Float samples are taken as they are; an alpha channel is left out.

use std::path::Path;

use anyhow::{Context, ensure};
use domvs_vision::Plane;

use super::{Raster, Samples, read_raster};

/// The image in `path` as gray values; integer files end in [0, 1], float files as they are.
///
/// # Errors
/// Fails, naming the file, when it cannot be read, is no PNG, JPEG or TIFF, or holds values that are not finite.
pub fn read_gray(path: &Path) -> anyhow::Result<Plane<f64>> {
    let raster = read_raster(path)?;
    let gray = gray_samples(&raster);
    let unusable = gray.iter().filter(|value| !value.is_finite()).count();
    ensure!(unusable == 0, "{}: {unusable} of {} samples are not finite", path.display(), gray.len());
    Plane::new(raster.width, raster.height, gray).with_context(|| format!("{}", path.display()))
}

fn gray_samples(raster: &Raster) -> Vec<f64> {
    match &raster.samples {
        Samples::U8(samples) => to_gray(samples, raster.channels, 255.0),
        Samples::U16(samples) => to_gray(samples, raster.channels, 65535.0),
        Samples::F32(samples) => to_gray(samples, raster.channels, 1.0),
        Samples::F64(samples) => to_gray(samples, raster.channels, 1.0),
    }
}

fn to_gray<S: Copy + Into<f64>>(samples: &[S], channels: usize, white: f64) -> Vec<f64> {
    let pixels = samples.chunks_exact(channels);
    if channels < 3 {
        return pixels.map(|pixel| pixel[0].into() / white).collect();
    }
    let luma = |pixel: &[S]| 0.299 * pixel[0].into() + 0.587 * pixel[1].into() + 0.114 * pixel[2].into();
    pixels.map(|pixel| luma(pixel) / white).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{GrayAlphaImage, ImageBuffer, Luma, LumaA, Rgb, Rgb32FImage, RgbImage};
    use std::path::PathBuf;
    use tiff::encoder::{TiffEncoder, colortype};

    fn folder() -> tempfile::TempDir {
        tempfile::tempdir().expect("a temporary folder")
    }

    #[test]
    fn eight_bit_colour_is_weighted_and_not_rounded() {
        let (folder, name) = (folder(), "colour.png");
        let path = folder.path().join(name);
        RgbImage::from_pixel(2, 3, Rgb([10, 200, 77])).save(&path).expect("a PNG");
        let plane = read_gray(&path).expect("a gray plane");
        assert_eq!((plane.width(), plane.height()), (2, 3));
        let expected = (0.299 * 10.0 + 0.587 * 200.0 + 0.114 * 77.0) / 255.0;
        assert_eq!(plane.at(1, 2), expected);
    }

    #[test]
    fn sixteen_bit_gray_is_over_65535_and_alpha_is_left_out() {
        let folder = folder();
        let deep = folder.path().join("deep.png");
        ImageBuffer::<Luma<u16>, _>::from_pixel(3, 2, Luma([513])).save(&deep).expect("a PNG");
        assert_eq!(read_gray(&deep).expect("a gray plane").at(0, 0), 513.0 / 65535.0);
        let alpha = folder.path().join("alpha.png");
        GrayAlphaImage::from_pixel(3, 2, LumaA([51, 7])).save(&alpha).expect("a PNG");
        assert_eq!(read_gray(&alpha).expect("a gray plane").at(2, 1), 51.0 / 255.0);
    }

    #[test]
    fn a_jpeg_is_read_whatever_its_name_says() {
        let folder = folder();
        let path = folder.path().join("really-a-jpeg.png");
        let image = RgbImage::from_pixel(16, 16, Rgb([128, 128, 128]));
        image.save_with_format(&path, image::ImageFormat::Jpeg).expect("a JPEG");
        let value = read_gray(&path).expect("a gray plane").at(8, 8);
        // JPEG quantisation: at most one level off on a flat image.
        assert!((value - 128.0 / 255.0).abs() <= 1.0 / 255.0, "{value}");
    }

    fn write_tiff<C>(name: &str, folder: &Path, samples: &[C::Inner]) -> PathBuf
    where
        C: colortype::ColorType,
        [C::Inner]: tiff::encoder::TiffValue,
    {
        let path = folder.join(name);
        let file = std::fs::File::create(&path).expect("a file");
        let mut encoder = TiffEncoder::new(file).expect("an encoder");
        encoder.write_image::<C>(3, 2, samples).expect("a TIFF");
        path
    }

    #[test]
    fn float_tiff_is_taken_as_it_is_and_integer_tiff_is_scaled() {
        let folder = folder();
        let floats = [-0.5f32, 0.0, 1.0, 1.75, 1e-3, 2.0];
        let path = write_tiff::<colortype::Gray32Float>("f32.tiff", folder.path(), &floats);
        let expected: Vec<f64> = floats.iter().map(|&value| f64::from(value)).collect();
        assert_eq!(read_gray(&path).expect("a gray plane").samples(), expected);

        let doubles = [0.1, 0.2, 0.3, 0.4, 0.5, 1.0 / 3.0];
        let path = write_tiff::<colortype::Gray64Float>("f64.tiff", folder.path(), &doubles);
        assert_eq!(read_gray(&path).expect("a gray plane").samples(), doubles);

        let path = write_tiff::<colortype::Gray16>("u16.tiff", folder.path(), &[0, 1, 2, 3, 4, 65535]);
        assert_eq!(read_gray(&path).expect("a gray plane").at(2, 1), 1.0);
        let path = write_tiff::<colortype::Gray8>("u8.tiff", folder.path(), &[0, 1, 2, 3, 4, 51]);
        assert_eq!(read_gray(&path).expect("a gray plane").at(2, 1), 0.2);
    }

    #[test]
    fn samples_that_are_not_finite_are_counted_in_the_error() {
        let folder = folder();
        let floats = [f32::NAN, 0.0, f32::INFINITY, 0.5, 0.5, 0.5];
        let path = write_tiff::<colortype::Gray32Float>("holes.tiff", folder.path(), &floats);
        let error = format!("{:#}", read_gray(&path).expect_err("no image"));
        assert!(error.contains("holes.tiff") && error.contains("2 of 6"), "{error}");
    }

    #[test]
    fn what_is_no_image_is_refused_with_its_name() {
        let folder = folder();
        let missing = format!("{:#}", read_gray(&folder.path().join("no.png")).expect_err("no file"));
        assert!(missing.contains("no.png"), "{missing}");
        let path = folder.path().join("text.png");
        std::fs::write(&path, "not an image at all").expect("a file");
        let error = format!("{:#}", read_gray(&path).expect_err("no image"));
        assert!(error.contains("text.png") && error.contains("neither PNG"), "{error}");
    }

    #[test]
    fn a_colour_float_tiff_is_weighted_too() {
        let folder = folder();
        let image = Rgb32FImage::from_pixel(3, 2, Rgb([0.5, 0.25, 1.0]));
        let path = write_tiff::<colortype::RGB32Float>("rgb.tiff", folder.path(), image.as_raw());
        assert_eq!(read_gray(&path).expect("a gray plane").at(0, 0), 0.299 * 0.5 + 0.587 * 0.25 + 0.114);
    }
}
