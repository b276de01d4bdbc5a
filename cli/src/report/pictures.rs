//! Images as 8-bit gray PNGs: the four pictures of a run, and strips of many. In `difference.png` mid-gray means equal,
//! brighter means that the final image is brighter than the desired one.

use std::io::Cursor;
use std::path::Path;

use anyhow::{Context, ensure};
use domvs_vision::Plane;
use image::{GrayImage, ImageFormat};

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
    std::fs::write(path, png(plane)?).with_context(|| format!("cannot write {}", path.display()))
}

/// The bytes of an 8-bit gray PNG.
///
/// # Errors
/// Fails when the image has no pixels.
pub fn png(plane: &Plane<f32>) -> anyhow::Result<Vec<u8>> {
    let levels = plane.samples().iter().map(|&value| (value.clamp(0.0, 1.0) * 255.0).round() as u8).collect();
    let (width, height) = size(plane);
    let image = GrayImage::from_raw(u32::try_from(width)?, u32::try_from(height)?, levels);
    let image = image.expect("a plane has width x height samples");
    let mut bytes = Cursor::new(Vec::new());
    image.write_to(&mut bytes, ImageFormat::Png).context("cannot make a PNG")?;
    Ok(bytes.into_inner())
}

/// Images of one size side by side with a white gap of four pixels; wide ones are shrunk to 160 pixels or a little less.
pub fn strip(images: &[&Plane<f32>]) -> Plane<f32> {
    const GAP: usize = 4;
    const WIDEST: usize = 160;
    let Some(first) = images.first() else { return Plane::filled(1, 1, 1.0) };
    let step = first.width().div_ceil(WIDEST);
    let (width, height) = (first.width() / step, first.height() / step);
    let pitch = width + GAP;
    let area = (step * step) as f32;
    Plane::from_fn(images.len() * pitch - GAP, height, |u, v| {
        let (index, u) = (u / pitch, u % pitch);
        if u >= width {
            return 1.0;
        }
        let block = (0..step * step).map(|i| images[index].at(u * step + i % step, v * step + i / step));
        block.sum::<f32>() / area
    })
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
    fn a_strip_has_its_images_side_by_side_and_shrinks_wide_ones_by_means() {
        let (dark, bright) = (Plane::filled(4, 3, 0.25f32), Plane::filled(4, 3, 0.75f32));
        let both = strip(&[&dark, &bright]);
        assert_eq!((both.width(), both.height()), (12, 3));
        assert_eq!([both.at(3, 0), both.at(5, 1), both.at(8, 2)], [0.25, 1.0, 0.75]);
        let checked = Plane::from_fn(320, 8, |u, v| ((u + v) % 2) as f32);
        let small = strip(&[&checked]);
        assert_eq!((small.width(), small.height(), small.at(7, 3)), (160, 4, 0.5));
    }

    #[test]
    fn images_of_two_sizes_are_refused() {
        let (desired, last) = (Plane::filled(4, 3, 0.5f32), Plane::filled(3, 4, 0.5f32));
        assert!(difference(&last, &desired).is_err());
    }
}
