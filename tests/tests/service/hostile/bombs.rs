//! PNG and JPEG files that claim, or unpack to, or ask for work on, much more than they are.

use image::ExtendedColorType;
use image::codecs::jpeg::JpegEncoder;

use super::{MAX_BYTES, Siege};
use crate::support::{ErrorCode, Question, Status, ZEROS, code, png};

#[tokio::test(flavor = "multi_thread")]
async fn bombs_in_png_files_do_not_go_off() {
    let mut siege = Siege::begin().await;
    let keys = siege.stage.keys.clone();
    for (what, file) in bombs() {
        assert!(file.len() < MAX_BYTES, "{what} must get as far as the decoder");
        let question =
            |key: String| Question::on(key).with(file.clone()).encoded("image/png").attached(siege.secret().as_bytes());
        let twist = siege.ask(question(keys.twist(siege.key()))).await.twist();
        // What claims a small size is unpacked to that size and no further: a black picture.
        let expected = if what.starts_with("96x72") { Status::LowTexture } else { Status::BadFrame };
        assert_eq!((twist.status, twist.twist), (expected, ZEROS), "{what}");
        let code = code(siege.ask(question(keys.target(siege.key()))).await);
        assert!([ErrorCode::BadTarget, ErrorCode::TooLarge].contains(&code), "{what}: {code}");
    }
    siege.goes_on("bombs").await;
    siege.stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn bombs_in_jpeg_files_are_refused_for_what_they_ask() {
    let mut siege = Siege::begin().await;
    let keys = siege.stage.keys.clone();
    for (what, file) in jpeg_bombs() {
        assert!(file.len() < MAX_BYTES, "{what} must get as far as the decoder");
        let question = |key: String| {
            Question::on(key).with(file.clone()).encoded("image/jpeg").attached(siege.secret().as_bytes())
        };
        let twist = siege.ask(question(keys.twist(siege.key()))).await.twist();
        assert_eq!((twist.status, twist.twist), (Status::BadFrame, ZEROS), "{what}");
        assert_eq!(code(siege.ask(question(keys.target(siege.key()))).await), ErrorCode::BadTarget, "{what}");
    }
    siege.goes_on("bombs").await;
    siege.stage.close().await;
}

/// 96x72 pixels with a pattern, 8-bit gray.
pub fn pattern() -> Vec<u8> {
    (0..96 * 72).map(|at| (at * 7 % 251) as u8).collect()
}

/// The pattern as a JPEG file.
pub fn photo() -> Vec<u8> {
    let mut bytes = vec![];
    JpegEncoder::new(&mut bytes).encode(&pattern(), 96, 72, ExtendedColorType::L8).expect("a fine picture");
    bytes
}

/// JPEG files below a megabyte that ask a decoder for minutes or gigabytes.
fn jpeg_bombs() -> Vec<(&'static str, Vec<u8>)> {
    let good = photo();
    let place = |marker: u8| good.windows(2).position(|pair| pair == [0xff, marker]).expect("a segment");
    let (head, scan) = good.split_at(place(0xda));
    let scan = &scan[..scan.len() - 2];
    let of_size = |side: [u8; 2]| {
        let mut file = good.clone();
        let at = place(0xc0) + 5;
        file[at..at + 4].copy_from_slice(&[side, side].concat());
        file
    };
    let with = |more: &[u8]| [head, more, scan, b"\xff\xd9"].concat();
    let table = [&b"\xff\xc4\0\x14\x10\x01"[..], &[0; 15], b"\0"].concat();
    let frame = &good[place(0xc0)..place(0xc0) + 13];
    vec![
        ("65500x65500 pixels", of_size([0xff, 0xdc])),
        ("no pixels", of_size([0, 0])),
        ("a hundred scans", [head, &scan.repeat(100), b"\xff\xd9"].concat()),
        (
            "twenty thousand empty scans",
            [head, &b"\xff\xda\0\x08\x01\x01\0\0\x3f\0\0".repeat(20_000), b"\xff\xd9"].concat(),
        ),
        ("forty thousand tables", with(&table.repeat(40_000))),
        ("ten thousand comments", with(&b"\xff\xfe\0\x03x".repeat(10_000))),
        ("two frames", with(frame)),
        ("a frame without end", good[..good.len() - 2].to_vec()),
        ("a scan that is not there", [head, b"\xff\xd9"].concat()),
        ("nothing but markers", [b"\xff\xd8".to_vec(), vec![0xff; 500_000]].concat()),
    ]
}

/// PNG files of some kilobytes that claim, or unpack to, hundreds of megabytes.
pub fn bombs() -> Vec<(&'static str, Vec<u8>)> {
    // 64 million zeros, as zlib packs them.
    let packed = idat(&png(&vec![0; 8000 * 8000], [8000, 8000], ExtendedColorType::L8));
    let ihdr = |width: u32, height: u32| {
        let mut ihdr = [width.to_be_bytes(), height.to_be_bytes()].concat();
        ihdr.extend([8, 0, 0, 0, 0]);
        ihdr
    };
    let profile = [b"bomb\0\0".to_vec(), packed.clone()].concat();
    let file = |chunks: &[(&[u8; 4], &[u8])]| {
        let mut bytes = b"\x89PNG\r\n\x1a\n".to_vec();
        for (kind, data) in chunks {
            bytes.extend((data.len() as u32).to_be_bytes());
            bytes.extend(*kind);
            bytes.extend(*data);
            bytes.extend(crc(&[kind.as_slice(), data].concat()).to_be_bytes());
        }
        bytes
    };
    vec![
        ("a true size of 64 million pixels", file(&[(b"IHDR", &ihdr(8000, 8000)), (b"IDAT", &packed), (b"IEND", &[])])),
        ("a size of 2^62 pixels", file(&[(b"IHDR", &ihdr(1 << 31, 1 << 31)), (b"IDAT", &packed), (b"IEND", &[])])),
        (
            "a wide size that multiplies to little",
            file(&[(b"IHDR", &ihdr(1 << 31, 2)), (b"IDAT", &packed), (b"IEND", &[])]),
        ),
        ("96x72 pixels and too much data", file(&[(b"IHDR", &ihdr(96, 72)), (b"IDAT", &packed), (b"IEND", &[])])),
        (
            "96x72 pixels with a profile of 64 million bytes",
            file(&[(b"IHDR", &ihdr(96, 72)), (b"iCCP", &profile), (b"IDAT", &packed[..99]), (b"IEND", &[])]),
        ),
        ("no data at all", file(&[(b"IHDR", &ihdr(96, 72)), (b"IEND", &[])])),
        ("a beginning", file(&[(b"IHDR", &ihdr(96, 72))])),
    ]
}

/// The image data of a PNG file, in one piece.
fn idat(file: &[u8]) -> Vec<u8> {
    let (mut data, mut rest) = (vec![], &file[8..]);
    while let Some((length, tail)) = rest.split_first_chunk::<4>() {
        let length = u32::from_be_bytes(*length) as usize;
        if &tail[..4] == b"IDAT" {
            data.extend(&tail[4..4 + length]);
        }
        rest = &tail[4 + length + 4..];
    }
    data
}

/// The checksum of a PNG chunk.
fn crc(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(u32::MAX, |crc, byte| {
        (0..8).fold(crc ^ u32::from(*byte), |crc, _| if crc & 1 == 1 { crc >> 1 ^ 0xedb8_8320 } else { crc >> 1 })
    })
}
