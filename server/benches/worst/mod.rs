//! The files that cost the most among those that the limits let through, 3840x2160 pixels.

use std::io::Cursor;

use image::{ExtendedColorType, ImageEncoder};

const WIDTH: u32 = 3840;
const HEIGHT: u32 = 2160;
const BLOCKS: usize = (WIDTH / 8 * HEIGHT / 8) as usize;
/// As many scans as a JPEG may have.
const SCANS: usize = 32;

/// 16-bit RGBA noise, which packs to nothing less.
pub fn noisy_png() -> Vec<u8> {
    let mut state = 1_u32;
    let mut noise = || {
        state ^= state << 13;
        state ^= state >> 17;
        state ^= state << 5;
        state as u8
    };
    let samples: Vec<u8> = (0..8 * WIDTH * HEIGHT).map(|_| noise()).collect();
    let mut file = Cursor::new(vec![]);
    let encoder = image::codecs::png::PngEncoder::new(&mut file);
    encoder.write_image(&samples, WIDTH, HEIGHT, ExtendedColorType::Rgba16).expect("true lengths");
    file.into_inner()
}

/// A gray progressive JPEG: every coefficient is there after two scans, and each further one refines them all.
pub fn refining_jpeg() -> Vec<u8> {
    let mut file = head(1);
    // Words of one bit: no change of the mean; a coefficient of one bit, which is 1; the end of 16384 blocks and of more.
    file.extend(table(0x00, 0x00));
    file.extend(scan(0, 0, 0x01));
    file.extend(vec![0; BLOCKS / 8]);
    file.extend(table(0x10, 0x01));
    file.extend(scan(1, 63, 0x0d));
    file.extend(vec![0x55; BLOCKS * 126 / 8]);
    file.extend(table(0x10, 0xe0));
    for _ in 2..SCANS {
        file.extend(scan(1, 63, 0xdc));
        let (mut bits, mut left) = (vec![], BLOCKS);
        while left > 0 {
            bits.extend([0, 1, 1, 1, 1, 0, 1, 1, 1, 1, 0, 1, 1, 1, 1]);
            let blocks = left.min(16_384 + 0b11_1101_1110_1111);
            bits.extend((0..63 * blocks).map(|coefficient| (coefficient % 2 == 0) as u8));
            left -= blocks;
        }
        file.extend(packed(&bits));
    }
    file.extend([0xff, 0xd9]);
    file
}

/// A progressive JPEG of three components whose scans say nothing, in a few bytes each.
pub fn idle_jpeg() -> Vec<u8> {
    let mut file = head(3);
    file.extend(table(0x00, 0x00));
    file.extend(segment(0xda, &[3, 1, 0, 2, 0, 3, 0, 0, 0, 0]));
    file.extend(vec![0; 3 * BLOCKS / 8]);
    file.extend(table(0x10, 0xe0));
    let runs = [0, 1, 1, 1, 1, 0, 1, 1, 1, 1, 0, 1, 1, 1, 1].repeat(BLOCKS / 16_384 + 1);
    for number in 1..SCANS {
        file.extend(segment(0xda, &[1, 1 + (number % 3) as u8, 0, 1, 63, 0]));
        file.extend(packed(&runs));
    }
    file.extend([0xff, 0xd9]);
    file
}

/// Begin, quantisation by ones, and the frame of a progressive image.
fn head(components: u8) -> Vec<u8> {
    let [(w, idth), (h, eight)] = [WIDTH, HEIGHT].map(|side| ((side >> 8) as u8, side as u8));
    let mut frame = vec![8, h, eight, w, idth, components];
    (1..=components).for_each(|id| frame.extend([id, 0x11, 0]));
    [&b"\xff\xd8"[..], &segment(0xdb, &[&[0][..], &[1; 64]].concat()), &segment(0xc2, &frame)].concat()
}

/// A Huffman table of one word of one bit.
fn table(place: u8, symbol: u8) -> Vec<u8> {
    segment(0xc4, &[&[place, 1][..], &[0; 15], &[symbol]].concat())
}

fn scan(first: u8, last: u8, approximation: u8) -> Vec<u8> {
    segment(0xda, &[1, 1, 0, first, last, approximation])
}

fn segment(marker: u8, content: &[u8]) -> Vec<u8> {
    [&[0xff, marker][..], &(content.len() as u16 + 2).to_be_bytes(), content].concat()
}

/// Bits as bytes, filled with ones, and an `ff` among them stuffed.
fn packed(bits: &[u8]) -> Vec<u8> {
    let bytes = bits.chunks(8).map(|bits| (0..8).fold(0, |byte, at| byte << 1 | bits.get(at).copied().unwrap_or(1)));
    bytes.flat_map(|byte| if byte == 0xff { vec![0xff, 0] } else { vec![byte] }).collect()
}
