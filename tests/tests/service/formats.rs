//! Every pixel format of the protocol through the network: the same picture gives the same twist.

use domvs_client::{ImageFile, OutgoingFrame, PixelFormat};
use domvs_proto::settings::{Depth, OrderRange};
use image::ExtendedColorType;

use crate::support::{Scene, Stage, Status, TaskSettings, gray8, jpeg, png, started};

const SIZE: [u32; 2] = [96, 72];

/// One picture in every format that can hold it, with the largest relative difference of its twist from the first one's.
fn gray_frames(gray: &[u8], jpeg: Vec<u8>) -> Vec<(&'static str, OutgoingFrame, f64)> {
    let each = |bytes: fn(u8) -> Vec<u8>| gray.iter().flat_map(|&gray| bytes(gray)).collect::<Vec<u8>>();
    let raw = |format, pixels: Vec<u8>| OutgoingFrame::raw(format, SIZE[0], SIZE[1], pixels).expect("true lengths");
    let png16 = each(|gray| (257 * u16::from(gray)).to_ne_bytes().to_vec());
    let file = |kind, bytes| OutgoingFrame::file(kind, bytes).expect("not empty");
    let mut nv12 = gray.to_vec();
    nv12.resize(gray.len() * 3 / 2, 77);
    // f32 planes that differ by a rounding; the twist of a well conditioned law by some hundred times that.
    let exact = 1e-4;
    vec![
        ("mono8", raw(PixelFormat::Mono8, gray.to_vec()), 0.0),
        ("mono16", raw(PixelFormat::Mono16, each(|gray| (257 * u16::from(gray)).to_le_bytes().to_vec())), exact),
        ("mono32f", raw(PixelFormat::Mono32F, each(|gray| (f32::from(gray) / 255.0).to_le_bytes().to_vec())), exact),
        ("rgb8", raw(PixelFormat::Rgb8, each(|gray| vec![gray; 3])), exact),
        ("bgr8", raw(PixelFormat::Bgr8, each(|gray| vec![gray; 3])), exact),
        ("rgba8", raw(PixelFormat::Rgba8, each(|gray| vec![gray, gray, gray, 9])), exact),
        ("bgra8", raw(PixelFormat::Bgra8, each(|gray| vec![gray, gray, gray, 9])), exact),
        ("yuyv", raw(PixelFormat::Yuyv, each(|gray| vec![gray, 200])), exact),
        ("nv12", raw(PixelFormat::Nv12, nv12), exact),
        ("png", file(ImageFile::Png, png(gray, SIZE, ExtendedColorType::L8)), exact),
        ("16-bit png", file(ImageFile::Png, png(&png16, SIZE, ExtendedColorType::L16)), exact),
        // What a JPEG of quality 95 changes in the moments of a photograph.
        ("jpeg", file(ImageFile::Jpeg, jpeg), 0.05),
    ]
}

/// A picture whose channels differ, so that no two of them can be mistaken for each other.
fn colour_frames(gray: &[u8]) -> Vec<(&'static str, OutgoingFrame, f64)> {
    let rgb: Vec<[u8; 3]> = gray.iter().map(|&gray| [gray, 20 + gray / 2, gray / 5]).collect();
    let raw = |format, pixels: Vec<u8>| OutgoingFrame::raw(format, SIZE[0], SIZE[1], pixels).expect("true lengths");
    let each = |bytes: fn(&[u8; 3]) -> Vec<u8>| rgb.iter().flat_map(bytes).collect::<Vec<u8>>();
    let luma = |&[r, g, b]: &[u8; 3]| {
        let luma = (0.299 * f64::from(r) + 0.587 * f64::from(g) + 0.114 * f64::from(b)) / 255.0;
        (luma as f32).to_le_bytes().to_vec()
    };
    let png = png(&each(|rgb| rgb.to_vec()), SIZE, ExtendedColorType::Rgb8);
    vec![
        ("luma", raw(PixelFormat::Mono32F, each(luma)), 0.0),
        ("rgb8", raw(PixelFormat::Rgb8, each(|rgb| rgb.to_vec())), 1e-4),
        ("bgr8", raw(PixelFormat::Bgr8, each(|&[r, g, b]| vec![b, g, r])), 1e-4),
        ("rgba8", raw(PixelFormat::Rgba8, each(|&[r, g, b]| vec![r, g, b, 0])), 1e-4),
        ("bgra8", raw(PixelFormat::Bgra8, each(|&[r, g, b]| vec![b, g, r, 255])), 1e-4),
        ("colour png", OutgoingFrame::file(ImageFile::Png, png).expect("not empty"), 1e-4),
    ]
}

async fn assert_same_twists(frames: Vec<(&'static str, OutgoingFrame, f64)>, target: &OutgoingFrame, scene: &Scene) {
    let stage = Stage::open().await;
    let client = stage.client("alice").await;
    // A fixed order: a twist then depends on its frame alone.
    let settings =
        TaskSettings { depth: Depth::ConstantM(1.0), order: OrderRange { min: 8, max: 8 }, ..scene.settings() };
    let task = started(&client, &settings, target).await;
    let mut expected = None;
    for (sequence, (format, frame, tolerance)) in (1..).zip(frames) {
        let answer = task.twist(&frame.numbered(sequence, 0)).await.expect("answered");
        assert_eq!(answer.status, Status::Servoing, "{format}");
        let expected = *expected.get_or_insert(answer.twist);
        let largest = expected.iter().fold(0.0_f64, |largest, component| largest.max(component.abs()));
        for (got, expected) in answer.twist.iter().zip(expected) {
            assert!((got - expected).abs() <= tolerance * largest, "{format}: {:?}, {expected:?}", answer.twist);
        }
    }
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn every_gray_format_gives_the_same_twist() {
    let mut scene = Scene::small("coffee");
    let target = scene.target();
    let current = scene.simulation.capture();
    assert_same_twists(gray_frames(&gray8(&current), jpeg(&current)), &target, &scene).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn every_colour_format_is_weighed_in_the_same_way() {
    let mut scene = Scene::small("coffee");
    let target = scene.target();
    let current = scene.simulation.capture();
    assert_same_twists(colour_frames(&gray8(&current)), &target, &scene).await;
}
