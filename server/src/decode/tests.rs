//! Every format against its formula written out again, every lie against its error, hostile bytes against a panic.

#![expect(clippy::unwrap_used, reason = "a test may panic")]

use std::io::Cursor;

use domvs_proto::frame::{DepthFormat, FrameError, FrameHeader, PixelFormat};
use image::{ColorType, ImageEncoder};
use proptest::prelude::*;

use super::*;

const LIMITS: DecodeLimits = DecodeLimits { max_pixels: 1 << 20, max_bytes: 1 << 24 };
const NO_TYPE: &str = "application/octet-stream";
/// One rounding of an `f32` in [0, 1]: half a unit in the last place, and as much again for a second one.
const ROUNDING: f64 = 1.2e-7;

/// Bytes without a pattern that a wrong stride could hide: a linear congruential sequence.
fn noise(count: usize) -> Vec<u8> {
    let mut state = 12_345_u32;
    let mut next = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 24) as u8
    };
    (0..count).map(|_| next()).collect()
}

fn decode_raw(header: &FrameHeader, payload: &[u8]) -> Result<Plane<f32>, DecodeError> {
    Decoder::new().decode(Some(header), NO_TYPE, payload.into(), LIMITS).map(|decoded| decoded.image.clone())
}

fn decode_file(encoding: &str, payload: &[u8]) -> Result<Plane<f32>, DecodeError> {
    Decoder::new().decode(None, encoding, payload.into(), LIMITS).map(|decoded| decoded.image.clone())
}

fn assert_plane(plane: &Plane<f32>, [width, height]: [usize; 2], expected: impl Fn(usize, usize) -> f64) {
    assert_eq!([plane.width(), plane.height()], [width, height]);
    for v in 0..height {
        for u in 0..width {
            let (expected, got) = (expected(u, v), f64::from(plane.at(u, v)));
            assert!((got - expected).abs() <= ROUNDING, "at ({u}, {v}): expected {expected}, got {got}");
        }
    }
}

fn luma(r: u8, g: u8, b: u8) -> f64 {
    (0.299 * f64::from(r) + 0.587 * f64::from(g) + 0.114 * f64::from(b)) / 255.0
}

fn png(bytes: &[u8], width: u32, height: u32, color: ColorType) -> Vec<u8> {
    let mut file = Vec::new();
    let encoder = image::codecs::png::PngEncoder::new(Cursor::new(&mut file));
    encoder.write_image(bytes, width, height, color.into()).unwrap();
    file
}

fn jpeg(bytes: &[u8], width: u32, height: u32, color: ColorType) -> Vec<u8> {
    let mut file = Vec::new();
    let encoder = image::codecs::jpeg::JpegEncoder::new_with_quality(Cursor::new(&mut file), 100);
    encoder.write_image(bytes, width, height, color.into()).unwrap();
    file
}

#[test]
fn every_raw_format_follows_its_formula_with_tight_and_padded_rows() {
    type Formula = fn(&[u8]) -> f64;
    let formats: [(PixelFormat, usize, Formula); 8] = [
        (PixelFormat::Mono8, 1, |p| f64::from(p[0]) / 255.0),
        (PixelFormat::Mono16, 2, |p| (f64::from(p[0]) + 256.0 * f64::from(p[1])) / 65535.0),
        (PixelFormat::Rgb8, 3, |p| luma(p[0], p[1], p[2])),
        (PixelFormat::Bgr8, 3, |p| luma(p[2], p[1], p[0])),
        (PixelFormat::Rgba8, 4, |p| luma(p[0], p[1], p[2])),
        (PixelFormat::Bgra8, 4, |p| luma(p[2], p[1], p[0])),
        (PixelFormat::Yuyv, 2, |p| f64::from(p[0]) / 255.0),
        (PixelFormat::Nv12, 1, |p| f64::from(p[0]) / 255.0),
    ];
    let [width, height] = [6, 4];
    for (format, pixel, formula) in formats {
        for padding in [0, 5] {
            let stride = width * pixel + padding;
            let rows = if format == PixelFormat::Nv12 { height + height / 2 } else { height };
            let payload = noise(stride * rows);
            let row_bytes = if padding == 0 { 0 } else { stride as u32 };
            let header = FrameHeader { row_bytes, ..FrameHeader::new(format, width as u32, height as u32) };
            let image = decode_raw(&header, &payload).unwrap();
            assert_plane(&image, [width, height], |u, v| formula(&payload[v * stride + u * pixel..]));
        }
    }
}

#[test]
fn black_is_exactly_0_and_white_exactly_1() {
    let formats = [PixelFormat::Mono8, PixelFormat::Mono16, PixelFormat::Rgb8, PixelFormat::Bgra8, PixelFormat::Yuyv];
    for format in formats {
        for (byte, gray) in [(0, 0.0), (255, 1.0)] {
            let payload = vec![byte; 4 * format.bytes_per_pixel() as usize];
            let image = decode_raw(&FrameHeader::new(format, 2, 2), &payload).unwrap();
            assert_eq!(image.samples(), [gray; 4], "{format:?}");
        }
    }
}

#[test]
fn float_pixels_are_taken_as_they_are() {
    let samples = [0.1_f32, -1.0, 2.0, f32::MIN_POSITIVE / 2.0];
    let payload: Vec<u8> = samples.iter().flat_map(|sample| sample.to_le_bytes()).collect();
    let image = decode_raw(&FrameHeader::new(PixelFormat::Mono32F, 2, 2), &payload).unwrap();
    assert_eq!(image.samples(), samples);
}

#[test]
fn float_pixels_that_are_no_gray_are_refused_with_their_count() {
    let payload: Vec<u8> = [0.5_f32, 255.0, -1.001, f32::NAN].iter().flat_map(|sample| sample.to_le_bytes()).collect();
    let refused = decode_raw(&FrameHeader::new(PixelFormat::Mono32F, 2, 2), &payload);
    assert_eq!(refused, Err(DecodeError::OutOfRange { pixels: 4, outside: 2 }));
    let sentence = refused.expect_err("refused").to_string();
    assert!(sentence.contains("-1 to 2") && sentence.contains("2 of 4"), "{sentence}");
}

#[test]
fn a_few_pixels_that_are_not_finite_become_0_and_are_counted() {
    let payload: Vec<u8> =
        [f32::NAN, 0.5, f32::INFINITY, 0.25].iter().flat_map(|sample| sample.to_le_bytes()).collect();
    let mut decoder = Decoder::new();
    let header = FrameHeader::new(PixelFormat::Mono32F, 2, 2);
    let decoded = decoder.decode(Some(&header), NO_TYPE, (&payload).into(), LIMITS).unwrap();
    assert_eq!(decoded.replaced_pixels, 2);
    assert_eq!(decoded.image.samples(), [0.0, 0.5, 0.0, 0.25]);
}

#[test]
fn more_than_half_not_finite_is_refused() {
    let payload: Vec<u8> =
        [f32::NAN, f32::NAN, f32::INFINITY, 0.25].iter().flat_map(|sample| sample.to_le_bytes()).collect();
    let refused = decode_raw(&FrameHeader::new(PixelFormat::Mono32F, 2, 2), &payload);
    assert_eq!(refused, Err(DecodeError::NotFinite { pixels: 4, finite: 1 }));
}

#[test]
fn every_kind_of_png_follows_the_formula() {
    let [width, height] = [7, 5];
    let wide = |p: &[u8], i: usize| f64::from(u16::from_ne_bytes([p[2 * i], p[2 * i + 1]]));
    type Formula<'a> = &'a dyn Fn(&[u8]) -> f64;
    let luma16 = |p: &[u8]| (0.299 * wide(p, 0) + 0.587 * wide(p, 1) + 0.114 * wide(p, 2)) / 65535.0;
    let kinds: [(ColorType, Formula<'_>); 8] = [
        (ColorType::L8, &|p| f64::from(p[0]) / 255.0),
        (ColorType::La8, &|p| f64::from(p[0]) / 255.0),
        (ColorType::Rgb8, &|p| luma(p[0], p[1], p[2])),
        (ColorType::Rgba8, &|p| luma(p[0], p[1], p[2])),
        (ColorType::L16, &|p| wide(p, 0) / 65535.0),
        (ColorType::La16, &|p| wide(p, 0) / 65535.0),
        (ColorType::Rgb16, &luma16),
        (ColorType::Rgba16, &luma16),
    ];
    for (color, formula) in kinds {
        let pixel = usize::from(color.bytes_per_pixel());
        let bytes = noise(width * height * pixel);
        let image = decode_file("image/png", &png(&bytes, width as u32, height as u32, color)).unwrap();
        assert_plane(&image, [width, height], |u, v| formula(&bytes[(v * width + u) * pixel..]));
    }
}

#[test]
fn gray_and_colour_jpeg_follow_the_formula_within_the_loss_of_jpeg() {
    let [width, height] = [24_u32, 16];
    let ramp = |i: usize| (i % 24 * 8) as u8;
    // Quality 100 of a smooth ramp: a few levels of 255 are lost, the more where colour is subsampled.
    let gray: Vec<u8> = (0..24 * 16).map(ramp).collect();
    let color: Vec<u8> = (0..24 * 16).flat_map(|i| [ramp(i), 200, 255 - ramp(i)]).collect();
    let from_gray = decode_file("image/jpeg", &jpeg(&gray, width, height, ColorType::L8)).unwrap();
    let from_color = decode_file("image/jpeg", &jpeg(&color, width, height, ColorType::Rgb8)).unwrap();
    for i in 0..24 * 16 {
        let (u, v) = (i % 24, i / 24);
        assert!((f64::from(from_gray.at(u, v)) - f64::from(ramp(i)) / 255.0).abs() < 3.0 / 255.0);
        assert!((f64::from(from_color.at(u, v)) - luma(ramp(i), 200, 255 - ramp(i))).abs() < 6.0 / 255.0);
    }
}

#[test]
fn a_media_type_may_have_parameters_and_nothing_else_is_guessed() {
    let file = png(&noise(4), 2, 2, ColorType::L8);
    assert!(decode_file("image/png;camera=left", &file).is_ok());
    for encoding in ["", "zenoh/bytes", "image/gif", "IMAGE"] {
        let refused = decode_file(encoding, &file);
        assert!(matches!(refused, Err(DecodeError::UnknownEncoding { .. })), "{encoding}: {refused:?}");
    }
    assert!(matches!(decode_file("image/jpeg", &file), Err(DecodeError::Undecodable { .. })));
}

#[test]
fn depth_is_in_metres_and_keeps_what_is_unknown() {
    let mut decoder = Decoder::new();
    let base = FrameHeader { depth_offset: 8, ..FrameHeader::new(PixelFormat::Mono8, 2, 2) };
    let counts: [u16; 4] = [0, 1500, 65535, 1];
    let payload: Vec<u8> = [0; 8].into_iter().chain(counts.iter().flat_map(|count| count.to_le_bytes())).collect();
    let header = FrameHeader { depth_format: DepthFormat::U16, depth_unit_m: 0.001, ..base.clone() };
    let depth = decoder.decode(Some(&header), NO_TYPE, (&payload).into(), LIMITS).unwrap().depth.unwrap().to_plane();
    for (got, count) in depth.samples().iter().zip(counts) {
        let expected = f64::from(count) * 0.001;
        // 0.001 itself is rounded to f32, and so is the product: 2 roundings, relative.
        assert!((f64::from(*got) - expected).abs() <= expected * ROUNDING);
    }

    let metres = [f32::NAN, -1.0, 0.75, f32::INFINITY];
    let payload: Vec<u8> = [0; 8].into_iter().chain(metres.iter().flat_map(|metre| metre.to_le_bytes())).collect();
    let header = FrameHeader { depth_format: DepthFormat::F32, depth_unit_m: 1.0, ..base };
    let decoded = decoder.decode(Some(&header), NO_TYPE, (&payload).into(), LIMITS).unwrap();
    assert_eq!(decoded.replaced_pixels, 0, "unknown depth is no bad pixel");
    let depth = decoded.depth.unwrap().to_plane();
    assert!(depth.at(0, 0).is_nan() && depth.at(1, 1) == f32::INFINITY);
    assert_eq!((depth.at(1, 0), depth.at(0, 1)), (-1.0, 0.75));
}

#[test]
fn a_png_may_be_followed_by_depth_and_the_next_frame_has_none_of_it() {
    let file = png(&noise(4), 2, 2, ColorType::L8);
    let offset = file.len().next_multiple_of(8);
    let mut payload = file.clone();
    payload.resize(offset, 0);
    payload.extend([1.0_f32, 2.0, 3.0, 4.0].iter().flat_map(|metre| metre.to_le_bytes()));
    let header = FrameHeader {
        depth_format: DepthFormat::F32,
        depth_unit_m: 1.0,
        depth_offset: offset as u32,
        ..FrameHeader::new(PixelFormat::ByEncoding, 2, 2)
    };
    let mut decoder = Decoder::new();
    let decoded = decoder.decode(Some(&header), "image/png", (&payload).into(), LIMITS).unwrap();
    assert_eq!(decoded.depth.unwrap().to_plane().samples(), [1.0, 2.0, 3.0, 4.0]);
    assert!(decoder.decode(None, "image/png", (&file).into(), LIMITS).unwrap().depth.is_none());
}

#[test]
fn frames_of_one_size_are_decoded_into_the_same_memory() {
    let mut decoder = Decoder::new();
    let header = FrameHeader {
        depth_format: DepthFormat::U16,
        depth_unit_m: 0.001,
        depth_offset: 16,
        ..FrameHeader::new(PixelFormat::Mono8, 4, 4)
    };
    let mut plane =
        || decoder.decode(Some(&header), NO_TYPE, (&noise(48)).into(), LIMITS).unwrap().image.samples().as_ptr();
    assert_eq!(plane(), plane());
}

#[test]
fn a_changed_size_is_followed() {
    let mut decoder = Decoder::new();
    for [width, height] in [[4, 2], [2, 4], [8, 8], [1, 1]] {
        let payload = noise((width * height) as usize);
        let header = FrameHeader::new(PixelFormat::Mono8, width, height);
        let decoded = decoder.decode(Some(&header), NO_TYPE, (&payload).into(), LIMITS).unwrap();
        assert_plane(decoded.image, [width as usize, height as usize], |u, v| {
            f64::from(payload[v * width as usize + u]) / 255.0
        });
    }
}

#[test]
fn odd_sizes_of_shared_colour_formats_are_refused() {
    for (format, width, height, bytes) in
        [(PixelFormat::Yuyv, 3, 2, 12), (PixelFormat::Nv12, 3, 2, 9), (PixelFormat::Nv12, 2, 3, 9)]
    {
        let refused = decode_raw(&FrameHeader::new(format, width, height), &noise(bytes));
        assert!(matches!(refused, Err(DecodeError::Frame(FrameError::OddSize { .. }))), "{refused:?}");
    }
}

#[test]
fn a_payload_that_is_too_short_or_too_long_is_refused() {
    for bytes in [0, 11, 13] {
        let refused = decode_raw(&FrameHeader::new(PixelFormat::Mono8, 4, 3), &noise(bytes));
        assert_eq!(refused, Err(FrameError::PayloadLength { expected: 12, got: bytes as u64 }.into()));
    }
}

#[test]
fn a_depth_without_unit_is_refused_for_floats_too() {
    let header =
        FrameHeader { depth_format: DepthFormat::F32, depth_offset: 1, ..FrameHeader::new(PixelFormat::Mono8, 1, 1) };
    assert!(matches!(decode_raw(&header, &noise(5)), Err(DecodeError::Frame(FrameError::DepthUnit { .. }))));
}

#[test]
fn a_png_of_another_size_than_its_header_says_is_refused() {
    let file = png(&noise(6), 3, 2, ColorType::L8);
    let header = FrameHeader::new(PixelFormat::ByEncoding, 2, 3);
    let refused = Decoder::new().decode(Some(&header), "image/png", (&file).into(), LIMITS).map(|_| ());
    assert_eq!(refused, Err(DecodeError::SizeMismatch { expected: [2, 3], got: [3, 2] }));
    let picture = jpeg(&noise(6), 3, 2, ColorType::L8);
    let refused = Decoder::new().decode(Some(&header), "image/jpeg", (&picture).into(), LIMITS).map(|_| ());
    assert_eq!(refused, Err(DecodeError::SizeMismatch { expected: [2, 3], got: [3, 2] }));
}

#[test]
fn limits_hold_before_anything_is_allocated() {
    let small = DecodeLimits { max_pixels: 15, max_bytes: 20 };
    let header = FrameHeader::new(PixelFormat::Mono8, 4, 4);
    let mut decoder = Decoder::new();
    let too_many_pixels = decoder.decode(Some(&header), NO_TYPE, (&noise(16)).into(), small).map(|_| ());
    assert_eq!(too_many_pixels, Err(DecodeError::TooManyPixels { limit: 15, width: 4, height: 4 }));
    let too_many_bytes = decoder.decode(Some(&header), NO_TYPE, (&noise(21)).into(), small).map(|_| ());
    assert_eq!(too_many_bytes, Err(DecodeError::TooManyBytes { limit: 20, got: 21 }));
    assert!(decoder.image.is_none() && decoder.samples.capacity() == 0);
}

#[test]
fn a_decompression_bomb_is_refused_by_its_size_before_memory_is_taken() {
    let bomb = png(&vec![0; 4096 * 4096], 4096, 4096, ColorType::L8);
    assert!(bomb.len() < 100_000, "a bomb is small: {} bytes", bomb.len());
    let mut picture = jpeg(&noise(64), 8, 8, ColorType::L8);
    let frame_header = picture.windows(2).position(|pair| pair == [0xff, 0xc0]).unwrap();
    picture[frame_header + 5..frame_header + 9].copy_from_slice(&[0xff, 0xfe, 0xff, 0xfd]);
    let mut decoder = Decoder::new();
    for (encoding, file, width, height) in [("image/png", bomb, 4096, 4096), ("image/jpeg", picture, 0xfffd, 0xfffe)] {
        let refused = decoder.decode(None, encoding, (&file).into(), LIMITS).map(|_| ());
        assert_eq!(refused, Err(DecodeError::TooManyPixels { limit: LIMITS.max_pixels, width, height }));
        assert!(decoder.image.is_none() && decoder.samples.capacity() == 0);
    }
}

#[test]
fn chunks_without_end_are_refused_before_they_are_read() {
    let file = png(&noise(64), 8, 8, ColorType::L8);
    let (head, image) = file.split_at(33);
    // A chunk of text without content, and its checksum.
    let chunk = b"\0\0\0\x02tEXta\0\xac\x8c\x0a\xf3";
    let with = |chunks: usize| [head, &chunk.repeat(chunks), image].concat();
    let refused = decode_file("image/png", &with(1 << 14)).map(|_| ());
    let reason = "at most 16384 chunks, got more".to_owned();
    assert_eq!(refused, Err(DecodeError::Undecodable { encoding: "image/png", reason }));
}

#[test]
fn a_palette_that_is_none_is_refused_before_the_decoder_trips_over_it() {
    let found = include_bytes!("../../../fuzz/corpus/png/found-palette_of_49_bytes");
    let reason = "a palette has up to 256 colours of 3 bytes, got 49 bytes".to_owned();
    let refused = decode_file("image/png", found).map(|_| ());
    assert_eq!(refused, Err(DecodeError::Undecodable { encoding: "image/png", reason }));
}

#[test]
fn a_cut_off_image_is_refused_wherever_it_is_cut() {
    let bytes = noise(32 * 32 * 3);
    let files =
        [("image/png", png(&bytes, 32, 32, ColorType::Rgb8)), ("image/jpeg", jpeg(&bytes, 32, 32, ColorType::Rgb8))];
    for (encoding, file) in files {
        assert!(decode_file(encoding, &file).is_ok());
        // A PNG's pixels end before its last chunk (12 bytes), which may be missing.
        for kept in (0..file.len() - 16).step_by(7) {
            let refused = decode_file(encoding, &file[..kept]);
            assert!(refused.is_err(), "{encoding} cut to {kept} of {} bytes", file.len());
        }
    }
}

#[test]
fn an_error_leaves_the_decoder_usable() {
    let mut decoder = Decoder::new();
    let header = FrameHeader::new(PixelFormat::Mono8, 2, 2);
    assert!(decoder.decode(None, "image/png", (&noise(99)).into(), LIMITS).is_err());
    assert!(decoder.decode(Some(&header), NO_TYPE, [255; 4][..].into(), LIMITS).is_ok());
    assert!(decoder.decode(None, "image/jpeg", (&noise(99)).into(), LIMITS).is_err());
    let decoded = decoder.decode(Some(&header), NO_TYPE, [255; 4][..].into(), LIMITS).unwrap();
    assert_eq!(decoded.image.samples(), [1.0; 4]);
}

#[test]
fn inverting_twice_gives_the_image_back() {
    let mut image = Plane::new(2, 1, vec![0.25, 1.0]).unwrap();
    invert(&mut image);
    assert_eq!(image.samples(), [0.75, 0.0]);
    invert(&mut image);
    assert_eq!(image.samples(), [0.25, 1.0]);
}

fn any_header() -> impl Strategy<Value = FrameHeader> {
    let sizes = (prop_oneof![0..9_u32, any::<u32>()], prop_oneof![0..9_u32, any::<u32>()]);
    let places = (prop_oneof![Just(0_u32), 0..40_u32, any::<u32>()], prop_oneof![0..99_u32, any::<u32>()]);
    (0..10_u8, 0..3_u8, sizes, places, any::<f32>()).prop_map(
        |(pixels, depth, (width, height), (row_bytes, depth_offset), unit)| FrameHeader {
            depth_format: DepthFormat::from_code(depth).unwrap(),
            row_bytes,
            depth_offset,
            depth_unit_m: unit,
            ..FrameHeader::new(PixelFormat::from_code(pixels).unwrap(), width, height)
        },
    )
}

/// Whatever came: no panic, and what is accepted is finite, within the limits and of the header's size.
fn check_anything(header: Option<&FrameHeader>, encoding: &str, payload: &[u8]) {
    if let Ok(decoded) = Decoder::new().decode(header, encoding, payload.into(), LIMITS) {
        assert!(decoded.image.samples().iter().all(|sample| sample.is_finite()));
        assert!(decoded.image.samples().len() as u64 <= LIMITS.max_pixels);
        if let Some(depth) = decoded.depth {
            assert_eq!(depth.size(), [decoded.image.width(), decoded.image.height()]);
            assert_eq!(depth.to_plane().samples().len(), decoded.image.samples().len());
        }
    }
}

proptest! {
    // A fixed seed, so that a failure is the same everywhere.
    #![proptest_config(ProptestConfig {
        rng_seed: prop::test_runner::RngSeed::Fixed(2),
        failure_persistence: None,
        ..ProptestConfig::with_cases(2000)
    })]

    #[test]
    fn any_header_on_any_bytes_never_panics(
        header in prop::option::of(any_header()),
        encoding in prop_oneof![Just("image/png"), Just("image/jpeg"), Just(NO_TYPE)],
        payload in prop::collection::vec(any::<u8>(), 0..400),
    ) {
        check_anything(header.as_ref(), encoding, &payload);
    }

    #[test]
    fn a_header_that_fits_any_bytes_never_panics(header in any_header(), payload in prop::collection::vec(any::<u8>(), 1..400)) {
        let header = FrameHeader { width: payload.len() as u32, height: 1, row_bytes: 0, depth_format: DepthFormat::None, depth_offset: 0, ..header };
        check_anything(Some(&header), NO_TYPE, &payload);
    }

    #[test]
    fn a_damaged_png_or_jpeg_never_panics(
        damage in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
        kind in 0..4_usize,
    ) {
        let bytes = noise(24 * 20 * 3);
        let (encoding, mut file) = match kind {
            0 => ("image/png", png(&bytes, 24, 20, ColorType::Rgb8)),
            1 => ("image/png", png(&bytes[..24 * 20 * 2], 24, 20, ColorType::L16)),
            2 => ("image/jpeg", jpeg(&bytes, 24, 20, ColorType::Rgb8)),
            _ => ("image/jpeg", jpeg(&bytes[..24 * 20], 24, 20, ColorType::L8)),
        };
        for (place, byte) in damage {
            let place = place.index(file.len());
            file[place] = byte;
        }
        check_anything(None, encoding, &file);
    }
}

#[test]
fn a_frame_in_any_pieces_is_the_same_frame() {
    let header = FrameHeader {
        row_bytes: 27,
        depth_format: DepthFormat::U16,
        depth_unit_m: 0.001,
        depth_offset: 27 * 7 + 5,
        ..FrameHeader::new(PixelFormat::Rgb8, 8, 7)
    };
    let raw = noise(27 * 7 + 5 + 2 * 8 * 7);
    let file = png(&noise(24 * 20), 24, 20, ColorType::L8);
    let by_encoding = FrameHeader::new(PixelFormat::ByEncoding, 0, 0);
    for (header, encoding, bytes) in [(&header, NO_TYPE, &raw), (&by_encoding, "image/png", &file)] {
        let decode = |payload: Payload<'_>| {
            let mut decoder = Decoder::new();
            let decoded = decoder.decode(Some(header), encoding, payload, LIMITS).unwrap();
            (decoded.image.clone(), decoded.sums.contrast(), decoded.depth.map(DepthRows::to_plane))
        };
        let whole = decode(bytes.into());
        for length in [1, 13, 26, 64] {
            let mut writer = zenoh::bytes::ZBytes::writer();
            bytes.chunks(length).for_each(|piece| writer.append(piece.into()));
            assert_eq!(decode((&writer.finish()).into()), whole, "in pieces of {length} bytes");
        }
    }
}
