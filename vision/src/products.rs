//! Inner products of all planes of a row with each other, in one pass: what the methods on pixels end with.
//!
//! A plane's stretch of one image row is in the nearest cache. Planes are taken three or four at a time, so that every product has strands
//! of its own that the compiler may keep in registers; the strands of a row are added in `f64`.

use crate::chunks::{LANES, add_lanes, tile};
use crate::gram::{COLUMNS, Gram};
use crate::planes::{PLAIN, gram_column};
use crate::sample::Sample;

/// Adds the products of the planes' stretches to `gram`: 7 planes or, with light, 13, of one length.
pub(crate) fn add_products<T: Sample>(planes: &[&[[T; LANES]]], gram: &mut Gram) {
    match planes.len() {
        PLAIN => add_groups::<T, PLAIN>(planes, gram),
        COLUMNS => add_groups::<T, COLUMNS>(planes, gram),
        count => unreachable!("{count} planes"),
    }
}

/// In groups of three, and the last plane beside them.
fn add_groups<T: Sample, const N: usize>(planes: &[&[[T; LANES]]], gram: &mut Gram) {
    let last = N - 1;
    for i in (0..last).step_by(3) {
        write(gram, [i, i], triangle::<T>(group(planes, i)));
        for j in (i + 3..last).step_by(3) {
            write(gram, [i, j], tile::<T, 3, 3>(group(planes, j), group(planes, i)));
        }
        write(gram, [i, last], tile::<T, 1, 3>([planes[last]], group(planes, i)));
    }
    write(gram, [last, last], tile::<T, 1, 1>([planes[last]], [planes[last]]));
}

fn group<'a, T, const G: usize>(planes: &[&'a [[T; LANES]]], first: usize) -> [&'a [[T; LANES]]; G] {
    std::array::from_fn(|i| planes[first + i])
}

/// `products[i][j]` are of the planes `first_i + i` and `first_j + j`.
fn write<const A: usize, const B: usize>(gram: &mut Gram, [first_i, first_j]: [usize; 2], products: [[f64; B]; A]) {
    for (i, row) in products.into_iter().enumerate() {
        for (j, product) in row.into_iter().enumerate() {
            let (a, b) = (gram_column(first_i + i), gram_column(first_j + j));
            gram.products[(a.min(b), a.max(b))] += product;
        }
    }
}

/// The products of three planes with each other; zero below the diagonal.
#[inline(always)]
fn triangle<T: Sample>(planes: [&[[T; LANES]]; 3]) -> [[f64; 3]; 3] {
    let length = planes[0].len();
    let planes = planes.map(|plane| &plane[..length]);
    let mut strands = [[[T::ZERO; LANES]; 3]; 3];
    for chunk in 0..length {
        for i in 0..3 {
            for j in i..3 {
                for lane in 0..LANES {
                    strands[i][j][lane] += planes[i][chunk][lane] * planes[j][chunk][lane];
                }
            }
        }
    }
    strands.map(|row| row.map(|lanes| add_lanes(&lanes)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_pair_of_planes_is_multiplied_once() {
        for count in [PLAIN, COLUMNS] {
            let sample = |i: usize, u: usize| ((i * 7 + u * (4 + i)) % 11) as f64;
            let planes: Vec<Vec<[f64; LANES]>> =
                (0..count).map(|i| (0..5).map(|u| std::array::from_fn(|l| sample(i, 4 * u + l))).collect()).collect();
            let mut gram = Gram::new();
            add_products(&planes.iter().map(|plane| &plane[..]).collect::<Vec<_>>(), &mut gram);
            for (i, j) in (0..count).flat_map(|j| (0..=j).map(move |i| (i, j))) {
                let expected: f64 = (0..20).map(|u| sample(i, u) * sample(j, u)).sum();
                let (a, b) = (gram_column(i), gram_column(j));
                assert_eq!(gram.products[(a.min(b), a.max(b))], expected, "whole numbers: planes {i}, {j} of {count}");
            }
        }
    }
}
