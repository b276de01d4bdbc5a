//! A mask for a task's settings: whatever image the user drew, as the 8-bit gray PNG that goes over the wire.

use std::path::Path;

use anyhow::{Context, ensure};
use domvs_proto::settings::Mask;
use domvs_vision::Plane;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder};

/// `weights`, which were read from the file at `path`, as a mask.
///
/// # Errors
/// Fails, naming the file, when a weight is outside [0, 1].
pub fn mask_png(weights: &Plane<f64>, path: &Path) -> anyhow::Result<Mask> {
    let outside = weights.samples().iter().find(|weight| !(0.0..=1.0).contains(*weight));
    ensure!(outside.is_none(), "{}: a mask has values of 0 to 1, got {outside:?}", path.display());
    let gray: Vec<u8> = weights.samples().iter().map(|weight| (255.0 * weight).round() as u8).collect();
    let mut png = vec![];
    let size = [weights.width(), weights.height()].map(|side| u32::try_from(side).unwrap_or(u32::MAX));
    PngEncoder::new_with_quality(&mut png, CompressionType::Best, FilterType::Adaptive)
        .write_image(&gray, size[0], size[1], ExtendedColorType::L8)
        .with_context(|| format!("{} as a PNG", path.display()))?;
    Ok(Mask { png })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mask_is_the_same_gray_after_the_way_through_its_png() {
        let weights = Plane::from_fn(9, 7, |u, v| (u * v) as f64 / 255.0);
        let mask = mask_png(&weights, Path::new("mask.tiff")).expect("values of 0 to 1");
        let image = image::load_from_memory(&mask.png).expect("a PNG");
        assert_eq!((image.color(), image.width(), image.height()), (image::ColorType::L8, 9, 7));
        let read: Vec<f64> = image.into_luma8().iter().map(|&gray| f64::from(gray) / 255.0).collect();
        assert_eq!(read, weights.samples());
    }

    #[test]
    fn a_mask_with_values_outside_0_to_1_is_refused_by_its_name() {
        let error = mask_png(&Plane::filled(8, 8, 1.5), Path::new("bright.tiff")).expect_err("too bright");
        assert!(error.to_string().contains("bright.tiff") && error.to_string().contains("1.5"), "{error}");
    }
}
