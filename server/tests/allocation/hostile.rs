//! What hostile bytes make the service allocate, in all and not only at once: as much as they are checked against, or nothing.

use std::alloc::System;

use domvs_proto::body;
use domvs_proto::frame::{FrameHeader, JPEG, PNG, PixelFormat, RAW};
use domvs_proto::settings::TaskSettings;
use domvs_server::decode::{DecodeError, DecodeLimits, Decoder};
use domvs_server::payload::header_of;
use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder};
use stats_alloc::Region;
use zenoh::bytes::ZBytes;

use crate::ALLOCATOR;

const LIMITS: DecodeLimits = DecodeLimits { max_pixels: 1 << 16, max_bytes: 64 << 20 };
/// A sentence for the refusal and some small tables.
const LITTLE: usize = 64 << 10;
/// What `LIMITS` allow a decoder, twice because a buffer that grows is allocated anew: 8 bytes for a pixel, 4 MiB beside them.
const WITHIN_LIMITS: usize = 2 * ((8 << 16) + (4 << 20)) + (1 << 20);

/// Bytes that `work` allocated, whether it gave them back or not.
fn bytes_of<T>(work: impl FnOnce() -> T) -> (usize, T) {
    let region: Region<'_, System> = Region::new(ALLOCATOR);
    let made = work();
    let change = region.change();
    (change.bytes_allocated + usize::try_from(change.bytes_reallocated).unwrap_or(0), made)
}

/// Frames that are refused, and what they may cost.
pub fn frames_are_refused_before_memory_is_taken() {
    let good = photo();
    let place = |marker: u8| good.windows(2).position(|pair| pair == [0xff, marker]).expect("a segment");
    let (head, scan) = good.split_at(place(0xda));
    let scan = &scan[..scan.len() - 2];
    let mut wide = good.clone();
    wide[place(0xc0) + 5..place(0xc0) + 9].copy_from_slice(&[0xff, 0xdc, 0xff, 0xdc]);
    let zeros = png_of_zeros(8000);
    let profile = chunk(b"iCCP", &[&b"bomb\0\0"[..], &image_data(&zeros)].concat());
    let small = png_of_zeros(64);
    for (what, encoding, file, most) in [
        ("JPEG of 65500x65500 pixels", JPEG, wide, LITTLE),
        ("JPEG of 20 MB of scans", JPEG, [head, &scan.repeat((20 << 20) / scan.len()), b"\xff\xd9"].concat(), LITTLE),
        ("JPEG of 20 MB of comments", JPEG, [head, &b"\xff\xfe\0\x03x".repeat(4 << 20), scan].concat(), LITTLE),
        ("PNG of 64 million zeros", PNG, zeros, LITTLE),
        (
            "PNG with a profile of 64 million zeros",
            PNG,
            [&small[..33], &profile, &small[33..60]].concat(),
            WITHIN_LIMITS,
        ),
        ("PNG of 60 MB of chunks", PNG, [&small[..33], &chunk(b"tEXt", b"a\0").repeat(4 << 20)].concat(), LITTLE),
        ("60 MB of noise called PNG", PNG, vec![0x89; 60 << 20], LITTLE),
        ("60 MB of markers called JPEG", JPEG, [b"\xff\xd8".to_vec(), vec![0xff; 60 << 20]].concat(), LITTLE),
    ] {
        let mut decoder = Decoder::new();
        let (bytes, refused) = bytes_of(|| decoder.decode(None, encoding, (&file).into(), LIMITS).map(|_| ()));
        assert!(refused.is_err(), "{what} is refused");
        assert!(bytes <= most, "{what}: {bytes} bytes, at most {most}");
    }
    let wide = FrameHeader::new(PixelFormat::Mono8, 1 << 31, 1 << 31);
    let (bytes, refused) = bytes_of(|| Decoder::new().decode(Some(&wide), RAW, [0; 8][..].into(), LIMITS).map(|_| ()));
    assert!(matches!(refused, Err(DecodeError::Frame(_))) && bytes <= LITTLE, "{refused:?}, {bytes} bytes");
    let attachment = ZBytes::from(vec![1; 60 << 20]);
    let (bytes, refused) = bytes_of(|| header_of(Some(&attachment)));
    assert!(refused.is_err() && bytes <= LITTLE, "an attachment of 60 MB: {bytes} bytes");
}

/// A body is bounded in bytes and in values, and so is what is made of it: settings that are read are copied twice before they are refused.
pub fn bodies_take_no_more_than_thirty_two_mebibytes() {
    let fill =
        |begin: &str, piece: &str| [begin, &piece.repeat((body::MAX_JSON_BYTES - begin.len()) / piece.len())].concat();
    // Each is two: itself and the number in it.
    let as_many = r#"{"":0},"#.repeat(body::MAX_JSON_VALUES / 2 - 2);
    for (what, text, most) in [
        ("10 000 lists in one another", "[".repeat(10_000), LITTLE),
        ("10 000 objects in one another", r#"{"a":"#.repeat(10_000), LITTLE),
        ("one byte too many", " ".repeat(body::MAX_JSON_BYTES + 1), LITTLE),
        ("a name of a megabyte", fill(r#"{""#, "x"), 4 << 20),
        ("a list of little objects", fill(r#"{"depth":["#, r#"{"":0},"#), LITTLE),
        ("as many little objects as a body may have", format!(r#"{{"depth":[{as_many}0]}}"#), 32 << 20),
        ("the same name again and again", fill(r#"{"#, r#""method":"hahn","#), LITTLE),
    ] {
        let (bytes, refused) = bytes_of(|| TaskSettings::from_create_body(text.as_bytes()));
        let refused = refused.expect_err("refused").to_string();
        assert!(bytes <= most, "{what}: {bytes} bytes, at most {most}");
        assert!(refused.len() <= 1000, "{what}: a refusal of {} bytes", refused.len());
    }
}

fn photo() -> Vec<u8> {
    let mut bytes = vec![];
    JpegEncoder::new(&mut bytes).encode(&[7; 64 * 64], 64, 64, ExtendedColorType::L8).expect("a fine picture");
    bytes
}

/// A square of black, 8-bit gray.
fn png_of_zeros(side: u32) -> Vec<u8> {
    let (mut bytes, black) = (vec![], vec![0; (side * side) as usize]);
    PngEncoder::new(&mut bytes).write_image(&black, side, side, ExtendedColorType::L8).expect("true lengths");
    bytes
}

/// What is packed in a PNG, of all its IDAT chunks.
fn image_data(file: &[u8]) -> Vec<u8> {
    let (mut data, mut rest) = (vec![], &file[8..]);
    while let Some((length, tail)) = rest.split_first_chunk::<4>() {
        let length = u32::from_be_bytes(*length) as usize;
        if tail.starts_with(b"IDAT") {
            data.extend(&tail[4..4 + length]);
        }
        rest = &tail[4 + length + 4..];
    }
    data
}

fn chunk(kind: &[u8; 4], data: &[u8]) -> Vec<u8> {
    let named = [&kind[..], data].concat();
    let crc = !named.iter().fold(u32::MAX, |crc, byte| {
        (0..8).fold(crc ^ u32::from(*byte), |crc, _| if crc & 1 == 1 { crc >> 1 ^ 0xedb8_8320 } else { crc >> 1 })
    });
    [&(data.len() as u32).to_be_bytes()[..], &named, &crc.to_be_bytes()].concat()
}
