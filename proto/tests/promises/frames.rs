//! Hostile frame headers: every lie about a length is caught, with the numbers, and nothing overflows.

#![expect(clippy::unwrap_used, reason = "a test may panic")]

use domvs_proto::frame::{
    DepthFormat, FrameError, FrameHeader, HEADER_AND_SECRET_BYTES, HEADER_BYTES, PixelFormat, Secret,
};

fn mono8() -> FrameHeader {
    FrameHeader::new(PixelFormat::Mono8, 6, 4)
}

/// 6x4 mono8 tight, then u16 depth: 24 + 48 bytes.
fn with_depth() -> FrameHeader {
    FrameHeader { depth_format: DepthFormat::U16, depth_offset: 24, depth_unit_m: 0.001, ..mono8() }
}

/// The header's bytes with one of them changed.
fn changed(at: usize, byte: u8) -> Vec<u8> {
    let mut bytes = mono8().encode();
    bytes[at] = byte;
    bytes
}

#[test]
fn every_raw_format_lays_out_tight_rows() {
    let bytes = [6 * 4, 12 * 4, 18 * 4, 18 * 4, 24 * 4, 24 * 4, 24 * 4, 12 * 4, 6 * 6];
    for (format, bytes) in PixelFormat::ALL[1..].iter().zip(bytes) {
        let header = FrameHeader::new(*format, 6, 4);
        assert_eq!(header.layout(bytes).unwrap().pixels, 0..bytes, "{format:?}");
        for wrong in [bytes - 1, bytes + 1] {
            let expected = FrameError::PayloadLength { expected: bytes as u64, got: wrong as u64 };
            assert_eq!(header.layout(wrong), Err(expected), "{format:?}");
        }
    }
}

#[test]
fn padded_rows_and_a_gap_before_depth_are_found() {
    let header = FrameHeader { row_bytes: 8, depth_offset: 40, ..with_depth() };
    let layout = header.layout(40 + 48).unwrap();
    assert_eq!((layout.pixels, layout.row_bytes, layout.depth), (0..32, 8, Some(40..88)));
}

#[test]
fn a_row_that_does_not_fit_is_refused() {
    let header = FrameHeader { row_bytes: 5, ..mono8() };
    assert_eq!(header.layout(20), Err(FrameError::RowBytes { expected: 6, got: 5 }));
}

#[test]
fn rows_of_a_jpeg_have_no_length() {
    let header = FrameHeader { row_bytes: 6, ..FrameHeader::new(PixelFormat::ByEncoding, 6, 4) };
    assert_eq!(header.layout(100), Err(FrameError::RowBytes { expected: 0, got: 6 }));
}

#[test]
fn the_largest_sizes_are_refused_without_overflow() {
    for format in PixelFormat::ALL {
        for depth_format in DepthFormat::ALL {
            for row_bytes in [0, u32::MAX] {
                let header = FrameHeader {
                    depth_format,
                    row_bytes,
                    depth_offset: u32::MAX,
                    depth_unit_m: 1.0,
                    ..FrameHeader::new(format, u32::MAX - 1, u32::MAX - 1)
                };
                for payload_len in [0, 1, usize::MAX] {
                    assert!(header.layout(payload_len).is_err(), "{header:?} {payload_len}");
                }
            }
        }
    }
}

#[test]
fn an_image_without_pixels_is_refused() {
    for (width, height) in [(0, 4), (6, 0), (0, 0)] {
        let header = FrameHeader::new(PixelFormat::Mono8, width, height);
        assert_eq!(header.layout(0), Err(FrameError::EmptyImage { width, height }));
    }
    let half_said = FrameHeader::new(PixelFormat::ByEncoding, 6, 0);
    assert_eq!(half_said.layout(10), Err(FrameError::EmptyImage { width: 6, height: 0 }));
}

#[test]
fn formats_with_shared_colours_need_even_sizes() {
    for (pixel_format, width, height) in
        [(PixelFormat::Yuyv, 5, 4), (PixelFormat::Nv12, 5, 4), (PixelFormat::Nv12, 6, 3)]
    {
        let expected = FrameError::OddSize { pixel_format, width, height };
        assert_eq!(FrameHeader::new(pixel_format, width, height).layout(30), Err(expected));
    }
}

#[test]
fn a_depth_plane_inside_the_pixels_is_refused() {
    let header = FrameHeader { depth_offset: 23, ..with_depth() };
    assert_eq!(header.layout(71), Err(FrameError::DepthOffset { expected: 24, got: 23 }));
}

#[test]
fn a_depth_plane_beyond_the_payload_is_refused() {
    let header = FrameHeader { depth_offset: 4000, ..with_depth() };
    assert_eq!(header.layout(72), Err(FrameError::PayloadLength { expected: 4048, got: 72 }));
}

#[test]
fn a_depth_plane_cut_short_or_followed_by_more_is_refused() {
    assert_eq!(with_depth().layout(72).unwrap().depth, Some(24..72));
    for got in [24, 71, 73] {
        assert_eq!(with_depth().layout(got), Err(FrameError::PayloadLength { expected: 72, got: got as u64 }));
    }
}

#[test]
fn an_offset_without_depth_is_refused() {
    let header = FrameHeader { depth_offset: 24, ..mono8() };
    assert_eq!(header.layout(24), Err(FrameError::DepthOffset { expected: 0, got: 24 }));
}

#[test]
fn a_depth_unit_that_is_no_length_is_refused() {
    for depth_unit_m in [0.0, -0.001, f32::NAN, f32::INFINITY] {
        let header = FrameHeader { depth_unit_m, ..with_depth() };
        assert!(matches!(header.layout(72), Err(FrameError::DepthUnit { .. })), "{depth_unit_m}");
    }
}

#[test]
fn a_jpeg_fills_the_payload_up_to_its_depth() {
    let plain = FrameHeader::new(PixelFormat::ByEncoding, 0, 0);
    assert_eq!(plain.layout(100).unwrap().pixels, 0..100);
    assert_eq!(plain.layout(0), Err(FrameError::EmptyPayload));
    let deep = FrameHeader { pixel_format: PixelFormat::ByEncoding, depth_offset: 52, ..with_depth() };
    let layout = deep.layout(100).unwrap();
    assert_eq!((layout.pixels, layout.depth), (0..52, Some(52..100)));
    assert_eq!(FrameHeader { depth_offset: 0, ..deep }.layout(48), Err(FrameError::EmptyPayload));
}

#[test]
fn depth_of_a_jpeg_needs_a_size() {
    let header = FrameHeader { width: 0, height: 0, pixel_format: PixelFormat::ByEncoding, ..with_depth() };
    assert_eq!(header.layout(72), Err(FrameError::EmptyImage { width: 0, height: 0 }));
}

#[test]
fn every_other_version_is_refused_whatever_its_length() {
    for got in (0..=u8::MAX).filter(|version| *version != 1) {
        assert_eq!(FrameHeader::decode(&changed(0, got)), Err(FrameError::WrongVersion { got }));
        assert_eq!(FrameHeader::decode(&[got]), Err(FrameError::WrongVersion { got }));
    }
}

#[test]
fn every_unknown_format_is_refused() {
    for got in 10..=u8::MAX {
        assert_eq!(FrameHeader::decode(&changed(1, got)), Err(FrameError::UnknownPixelFormat { got }));
    }
    for got in 3..=u8::MAX {
        assert_eq!(FrameHeader::decode(&changed(2, got)), Err(FrameError::UnknownDepthFormat { got }));
    }
}

#[test]
fn every_unknown_flag_is_refused() {
    for got in 2..=u8::MAX {
        assert_eq!(FrameHeader::decode(&changed(3, got)), Err(FrameError::UnknownFlags { got }));
    }
}

#[test]
fn reserved_bytes_must_be_zero() {
    for at in 44..48 {
        let got = 1 << (8 * (at - 44));
        assert_eq!(FrameHeader::decode(&changed(at, 1)), Err(FrameError::ReservedInUse { got }));
    }
}

#[test]
fn every_other_length_is_refused() {
    let with_secret = FrameHeader { secret: Some(Secret::new([7; 16])), ..mono8() };
    for header in [mono8(), with_secret] {
        let expected = header.encode().len();
        for got in 0..200 {
            let mut bytes = header.encode();
            bytes.resize(got, 0);
            let read = FrameHeader::decode(&bytes);
            let expected = if got < HEADER_BYTES { HEADER_BYTES } else { expected };
            assert_eq!(read.is_ok(), got == expected, "{got}");
            if got != expected {
                assert_eq!(read, Err(FrameError::HeaderLength { expected, got }));
            }
        }
    }
    assert_eq!(HEADER_AND_SECRET_BYTES, 64);
}

#[test]
fn no_attachment_and_a_bare_secret_stand_for_an_encoded_image() {
    let plain = FrameHeader::new(PixelFormat::ByEncoding, 0, 0);
    assert_eq!(FrameHeader::from_attachment(None).unwrap(), plain);
    assert_eq!(FrameHeader::from_attachment(Some(&[])).unwrap(), plain);
    let secret = Some(Secret::new([9; 16]));
    assert_eq!(FrameHeader::from_attachment(Some(&[9; 16])).unwrap(), FrameHeader { secret, ..plain });
    assert_eq!(FrameHeader::from_attachment(Some(&mono8().encode())).unwrap(), mono8());
    assert!(FrameHeader::from_attachment(Some(&[1; 17])).is_err());
}

#[test]
fn a_secret_is_never_printed() {
    let header = FrameHeader { secret: Some(Secret::new([0xAB; 16])), ..mono8() };
    let printed = format!("{header:?} {:#?}", header.secret);
    assert!(!printed.to_lowercase().contains("ab,") && !printed.contains("171"), "{printed}");
    assert!(printed.contains("Secret(..)"));
}

#[test]
fn a_secret_of_another_length_or_alphabet_is_refused_without_being_quoted() {
    for text in [
        "",
        "00",
        &"0".repeat(31),
        &"0".repeat(33),
        &"g".repeat(32),
        &"é".repeat(16),
        "+f0000000000000000000000000000ff",
    ] {
        let error = Secret::try_from(text.to_owned()).unwrap_err().to_string();
        assert!(text.is_empty() || !error.contains(text) || text == "00", "{error}");
    }
    assert!(Secret::try_from([1; 15].as_slice()).is_err());
    assert_eq!(Secret::try_from("0A".repeat(16)).unwrap(), Secret::new([10; 16]));
}

#[test]
fn secrets_differ_by_any_bit() {
    let secret = Secret::new([0x55; 16]);
    for bit in 0..128 {
        let mut bytes = *secret.as_bytes();
        bytes[bit / 8] ^= 1 << (bit % 8);
        assert_ne!(Secret::new(bytes), secret);
    }
}
