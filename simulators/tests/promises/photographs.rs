//! The bundled photographs open, have texture, and are what their list says.

use std::path::Path;

use domvs_simulators::{Photograph, PhotographError};
use domvs_vision::Plane;

fn deviation(gray: &Plane<f32>) -> f32 {
    let count = gray.samples().len() as f32;
    let mean = gray.samples().iter().sum::<f32>() / count;
    (gray.samples().iter().map(|s| (s - mean).powi(2)).sum::<f32>() / count).sqrt()
}

#[test]
fn every_bundled_photograph_opens_and_has_texture() {
    for name in Photograph::bundled_names() {
        let photograph = Photograph::bundled(name).expect(name);
        assert!(photograph.width().min(photograph.height()) >= 300, "{name} is small");
        assert!(photograph.gray().samples().iter().all(|gray| (0.0..=1.0).contains(gray)), "{name} is not gray");
        assert!(deviation(photograph.gray()) > 0.08, "{name} is flat");
    }
}

#[test]
fn every_bundled_file_has_its_licence_note() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("photographs");
    let notes = std::fs::read_to_string(folder.join("PHOTOGRAPHS.md")).expect("the list is beside the files");
    for entry in std::fs::read_dir(folder).expect("the folder is there") {
        let name = entry.expect("readable").file_name().into_string().expect("names are ASCII");
        assert!(name == "PHOTOGRAPHS.md" || notes.contains(&format!("`{name}`")), "{name} is not in the list");
    }
}

#[test]
fn any_file_can_be_opened() {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("photographs/coffee.jpg");
    let photograph = Photograph::open(file).expect("a JPEG");
    assert_eq!((photograph.width(), photograph.height()), (600, 400));
    let square = photograph.cropped_square();
    assert_eq!((square.width(), square.height()), (400, 400));
    assert_eq!(square.gray().at(0, 7), photograph.gray().at(100, 7));
}

#[test]
fn colours_become_gray_by_their_weights() {
    let mut png = std::io::Cursor::new(Vec::new());
    let colours = image::RgbImage::from_fn(2, 2, |u, v| match (u, v) {
        (0, 0) => image::Rgb([255, 0, 0]),
        (1, 0) => image::Rgb([0, 255, 0]),
        (0, 1) => image::Rgb([0, 0, 255]),
        _ => image::Rgb([255, 255, 255]),
    });
    colours.write_to(&mut png, image::ImageFormat::Png).expect("memory takes it");
    let photograph = Photograph::decode(png.get_ref()).expect("a PNG");
    for (got, expected) in photograph.gray().samples().iter().zip([0.299_f32, 0.587, 0.114, 1.0]) {
        // f32 rounding.
        assert!((got - expected).abs() < 1e-7, "{got}, expected {expected}");
    }
}

#[test]
fn noise_is_the_same_for_the_same_seed() {
    assert_eq!(Photograph::noise(64, 5).gray(), Photograph::noise(64, 5).gray());
    assert_ne!(Photograph::noise(64, 5).gray(), Photograph::noise(64, 6).gray());
}

#[test]
fn what_is_no_photograph_is_refused_with_its_name() {
    assert!(
        matches!(Photograph::bundled("mona_lisa"), Err(PhotographError::UnknownName { name }) if name == "mona_lisa")
    );
    assert!(matches!(Photograph::open("no/such/file.png"), Err(PhotographError::Unreadable { .. })));
    assert!(matches!(Photograph::decode(b"not an image"), Err(PhotographError::Undecodable { .. })));
    let pixel = Plane::filled(1, 1, 0.0);
    assert!(matches!(Photograph::from_gray(pixel), Err(PhotographError::TooSmall { width: 1, height: 1 })));
}
