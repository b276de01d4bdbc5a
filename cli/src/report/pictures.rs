//! The four pictures of a run as 8-bit gray PNGs. In `difference.png` mid-gray means equal, brighter means that the
//! final image is brighter than the desired one.

use std::path::Path;

use anyhow::{Context, ensure};
use domvs_vision::Plane;
use image::GrayImage;

/// The images that a run is remembered by, gray in [0, 1], all of one size.
#[derive(Clone, Copy, Debug)]
pub struct RunImages<'a> {
    /// Where the camera should go.
    pub desired: &'a Plane<f32>,
    /// Where it started.
    pub initial: &'a Plane<f32>,
    /// Where it ended.
    pub last: &'a Plane<f32>,
}

/// Writes `desired.png`, `initial.png`, `final.png` and `difference.png`.
pub fn write_pictures(folder: &Path, images: &RunImages<'_>) -> anyhow::Result<()> {
    write_gray(&folder.join("desired.png"), images.desired)?;
    write_gray(&folder.join("initial.png"), images.initial)?;
    write_gray(&folder.join("final.png"), images.last)?;
    write_gray(&folder.join("difference.png"), &difference(images.last, images.desired)?)
}

/// (1 + I − I*) / 2.
fn difference(image: &Plane<f32>, desired: &Plane<f32>) -> anyhow::Result<Plane<f32>> {
    let (got, expected) = (size(image), size(desired));
    ensure!(got == expected, "the desired image is {expected:?} pixels, the final one {got:?}");
    let (width, height) = expected;
    Ok(Plane::from_fn(width, height, |u, v| 0.5 + 0.5 * (image.at(u, v) - desired.at(u, v))))
}

fn size(plane: &Plane<f32>) -> (usize, usize) {
    (plane.width(), plane.height())
}

fn write_gray(path: &Path, plane: &Plane<f32>) -> anyhow::Result<()> {
    let levels = plane.samples().iter().map(|&value| (value.clamp(0.0, 1.0) * 255.0).round() as u8).collect();
    let (width, height) = size(plane);
    let (columns, rows) = (u32::try_from(width)?, u32::try_from(height)?);
    let image = GrayImage::from_raw(columns, rows, levels).expect("a plane has width x height samples");
    image.save(path).with_context(|| format!("cannot write {}", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_images_leave_a_mid_gray_difference_and_brighter_is_brighter() {
        let desired = Plane::filled(4, 3, 0.5f32);
        let last = Plane::from_fn(4, 3, |u, _| if u == 0 { 1.0 } else { 0.5 });
        let folder = tempfile::tempdir().expect("a temporary folder");
        let images = RunImages { desired: &desired, initial: &last, last: &last };
        write_pictures(folder.path(), &images).expect("four pictures");
        let difference = image::open(folder.path().join("difference.png")).expect("a PNG").into_luma8();
        assert_eq!(difference.dimensions(), (4, 3));
        assert_eq!(difference.get_pixel(1, 1).0, [128]);
        assert_eq!(difference.get_pixel(0, 1).0, [191]);
        let initial = image::open(folder.path().join("initial.png")).expect("a PNG").into_luma8();
        assert_eq!(initial.get_pixel(0, 0).0, [255]);
    }

    #[test]
    fn images_of_two_sizes_are_refused() {
        let (desired, last) = (Plane::filled(4, 3, 0.5f32), Plane::filled(3, 4, 0.5f32));
        assert!(difference(&last, &desired).is_err());
    }
}
