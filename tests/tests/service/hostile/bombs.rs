//! PNG files of some kilobytes that claim, or unpack to, much more.

use image::ExtendedColorType;

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

/// PNG files of some kilobytes that claim, or unpack to, hundreds of megabytes.
fn bombs() -> Vec<(&'static str, Vec<u8>)> {
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
