//! A depth map out of a file, in metres. 0, a negative or a not finite value means unknown.

use std::path::Path;

use anyhow::{Context, bail, ensure};
use domvs_vision::Plane;

use super::{Samples, read_raster};

/// A depth map as the file has it: metres, holes still in place.
#[derive(Clone, Debug)]
pub struct DepthFile {
    /// Metres; 0, negative or not finite where unknown.
    pub metres: Plane<f64>,
    /// How many pixels have no depth.
    pub unknown: usize,
    /// The middle one of the known depths, in metres.
    pub median_m: f64,
}

/// Reads a 16-bit gray PNG or TIFF, in counts of `unit_m` metres, or a float TIFF in metres.
///
/// # Errors
/// Fails, naming the file, when it cannot be read, is colour or 8-bit, or when over half of its depths are unknown.
pub fn read_depth(path: &Path, unit_m: f64) -> anyhow::Result<DepthFile> {
    let raster = read_raster(path)?;
    ensure!(raster.channels == 1, "{}: a depth map has one channel, got {}", path.display(), raster.kind());
    let kind = raster.kind();
    let metres: Vec<f64> = match raster.samples {
        Samples::U16(counts) => counts.into_iter().map(|count| f64::from(count) * unit_m).collect(),
        Samples::F32(metres) => metres.into_iter().map(f64::from).collect(),
        Samples::F64(metres) => metres,
        Samples::U8(_) => {
            bail!("{}: a depth map is a 16-bit PNG or a 32-bit float TIFF in metres, got {kind}", path.display())
        }
    };
    let mut known: Vec<f64> = metres.iter().copied().filter(|depth| depth.is_finite() && *depth > 0.0).collect();
    let unknown = metres.len() - known.len();
    ensure!(
        2 * unknown <= metres.len(),
        "{}: {unknown} of {} depths are unknown (0, negative or not finite), more than half",
        path.display(),
        metres.len()
    );
    let median_m = median(&mut known);
    let metres = Plane::new(raster.width, raster.height, metres).with_context(|| format!("{}", path.display()))?;
    Ok(DepthFile { metres, unknown, median_m })
}

/// The middle value, the upper one of two; NaN of nothing.
fn median(values: &mut [f64]) -> f64 {
    let middle = values.len() / 2;
    match values.is_empty() {
        true => f64::NAN,
        false => *values.select_nth_unstable_by(middle, f64::total_cmp).1,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{GrayImage, ImageBuffer, Luma};
    use std::path::PathBuf;

    fn write_counts(folder: &tempfile::TempDir, counts: &[u16]) -> PathBuf {
        let path = folder.path().join("depth.png");
        let image = ImageBuffer::<Luma<u16>, _>::from_raw(4, 2, counts.to_vec()).expect("eight counts");
        image.save(&path).expect("a PNG");
        path
    }

    #[test]
    fn counts_become_metres_and_holes_are_counted() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = write_counts(&folder, &[500, 600, 0, 0, 700, 0, 65535, 0]);
        let depth = read_depth(&path, 1e-3).expect("a depth map");
        assert_eq!(depth.unknown, 4, "exactly half is still allowed");
        assert_eq!(depth.metres.at(1, 0), 600.0 * 1e-3);
        assert_eq!(depth.median_m, 700.0 * 1e-3);
    }

    #[test]
    fn more_than_half_unknown_is_an_error_with_numbers() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = write_counts(&folder, &[500, 600, 0, 0, 0, 0, 65535, 0]);
        let error = format!("{:#}", read_depth(&path, 1e-3).expect_err("too many holes"));
        assert!(error.contains("depth.png") && error.contains("5 of 8"), "{error}");
    }

    #[test]
    fn an_eight_bit_image_is_no_depth_map() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("gray.png");
        GrayImage::new(4, 2).save(&path).expect("a PNG");
        let error = format!("{:#}", read_depth(&path, 1e-3).expect_err("8-bit"));
        assert!(error.contains("8-bit gray"), "{error}");
    }
}
