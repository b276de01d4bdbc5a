//! From received bytes to planes, and from a twist to bytes: `cargo bench -p domvs-server`. 640x480 pixels, one thread.

#![expect(clippy::unwrap_used, reason = "a benchmark stops where something that must hold does not")]

mod worst;

use std::hint::black_box;
use std::io::Cursor;
use std::time::Duration;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use domvs_proto::frame::{DepthFormat, FrameHeader, JPEG, PNG, PixelFormat, RAW};
use domvs_proto::status::Status;
use domvs_proto::twist::TwistMessage;
use domvs_server::decode::{DecodeLimits, Decoder};
use domvs_server::payload::Payload;
use domvs_vision::{DepthMap, HoleFill};
use image::{DynamicImage, GrayImage, ImageFormat, Luma, RgbImage};

const WIDTH: u32 = 640;
const HEIGHT: u32 = 480;
const LIMITS: DecodeLimits = DecodeLimits { max_pixels: 1 << 24, max_bytes: 1 << 26 };

fn gray() -> GrayImage {
    GrayImage::from_fn(WIDTH, HEIGHT, |u, v| Luma([(u * v / 100 + 3 * u + v) as u8]))
}

/// A format's name, its header, its encoding and a payload of one frame.
type Sent = (&'static str, FrameHeader, &'static str, Vec<u8>);

fn raw(name: &'static str, format: PixelFormat, bytes_per_pixel: usize) -> Sent {
    let pixels: Vec<u8> = gray().into_raw().into_iter().flat_map(|gray| vec![gray; bytes_per_pixel]).collect();
    (name, FrameHeader::new(format, WIDTH, HEIGHT), RAW, pixels)
}

fn with_depth() -> Sent {
    let (_, mut header, encoding, mut bytes) = raw("", PixelFormat::Mono8, 1);
    header.depth_offset = bytes.len() as u32;
    (header.depth_format, header.depth_unit_m) = (DepthFormat::U16, 0.001);
    bytes.extend((0..WIDTH * HEIGHT).flat_map(|i| (500 + (i % 1000) as u16).to_le_bytes()));
    ("mono8 and u16 depth", header, encoding, bytes)
}

fn file(name: &'static str, format: ImageFormat, encoding: &'static str, image: &DynamicImage) -> Sent {
    let mut bytes = Cursor::new(Vec::new());
    image.write_to(&mut bytes, format).unwrap();
    (name, FrameHeader::new(PixelFormat::ByEncoding, 0, 0), encoding, bytes.into_inner())
}

fn decode(criterion: &mut Criterion) {
    let plain = DynamicImage::from(gray());
    let colored =
        DynamicImage::from(RgbImage::from_fn(WIDTH, HEIGHT, |u, v| image::Rgb([u as u8, v as u8, (u + v) as u8])));
    let sent = [
        raw("mono8", PixelFormat::Mono8, 1),
        raw("mono16", PixelFormat::Mono16, 2),
        raw("rgb8", PixelFormat::Rgb8, 3),
        raw("bgra8", PixelFormat::Bgra8, 4),
        raw("yuyv", PixelFormat::Yuyv, 2),
        with_depth(),
        file("png gray", ImageFormat::Png, PNG, &plain),
        file("jpeg gray", ImageFormat::Jpeg, JPEG, &plain),
        file("jpeg color", ImageFormat::Jpeg, JPEG, &colored),
    ];
    let mut group = criterion.benchmark_group("decode");
    group.throughput(Throughput::Elements(u64::from(WIDTH * HEIGHT)));
    for (name, header, encoding, payload) in &sent {
        let mut decoder = Decoder::new();
        let (size, far) = ([WIDTH as usize, HEIGHT as usize], HoleFill::Constant(1.0));
        let mut map = DepthMap::<f32>::from_rows(size, far, |row| row.fill(1.0)).unwrap();
        group.bench_function(BenchmarkId::from_parameter(name), |bencher| {
            bencher.iter(|| {
                let decoded = decoder.decode(Some(header), encoding, Payload::from(payload), LIMITS).unwrap();
                // Depth is read where it is used.
                if let Some(depth) = decoded.depth {
                    map.set_rows(far, depth.rows()).unwrap();
                }
                black_box(decoded.sums.contrast())
            });
        });
    }
}

fn hostile(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("worst");
    group.sample_size(10);
    for (name, encoding, file) in [
        ("png 16-bit noise", PNG, worst::noisy_png()),
        ("jpeg refining", JPEG, worst::refining_jpeg()),
        ("jpeg idle", JPEG, worst::idle_jpeg()),
    ] {
        let mut decoder = Decoder::new();
        group.bench_function(BenchmarkId::from_parameter(format!("{name}, {} bytes", file.len())), |bencher| {
            bencher.iter(|| {
                black_box(decoder.decode(None, encoding, Payload::from(&file), LIMITS).unwrap().sums.contrast())
            });
        });
    }
}

fn encode(criterion: &mut Criterion) {
    let twist = TwistMessage { twist: [0.1, -0.2, 0.3, 0.01, 0.02, -0.03], ..TwistMessage::zero(Status::Servoing) };
    criterion.bench_function("encode/twist", |bencher| bencher.iter(|| black_box(&twist).encode()));
    let header = FrameHeader::new(PixelFormat::Mono8, WIDTH, HEIGHT);
    criterion.bench_function("encode/header", |bencher| bencher.iter(|| black_box(&header).encode()));
}

criterion_group! {
    name = benches;
    config = Criterion::default().warm_up_time(Duration::from_millis(300)).measurement_time(Duration::from_secs(1));
    targets = decode, hostile, encode
}
criterion_main!(benches);
