//! What a moment along `u` is multiplied by to become a feature or a part of its row of `L`: `q_m(v)`, times a power of `y`; or what takes its place
//! when the image is not differentiated down its columns.
//!
//! `Σ_v q(v) y^k (D I)(v) = Σ_v (Dᵀ y^k q)(v) I(v)`, with `D` the differences that make `∇I_v`, one-sided at the border: summation by parts,
//! exact but for rounding. So the plane of `∇I_v` need not be made or projected; the image's own moments serve. With weights it must: they stand
//! between `q` and `D`, and belong to no axis.

use crate::basis::Basis;
use crate::camera::Intrinsics;
use crate::table::BLOCK;

/// A function of `m` and `v`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Multiplier {
    /// `q`.
    Q,
    /// `y q`.
    Yq,
    /// `(1 + y²) q`.
    OneAndYyq,
    /// `Dᵀ(q)`.
    ByPartsQ,
    /// `Dᵀ(y q)`.
    ByPartsYq,
    /// `Dᵀ((1 + y²) q)`.
    ByPartsOneAndYyq,
}

impl Multiplier {
    const COUNT: usize = 6;
}

/// The multipliers of every `m` at every `v`.
#[derive(Debug)]
pub(crate) struct AlongV {
    rows: usize,
    /// `[block][multiplier][m]`, as they are needed together; zeros below the image.
    values: Vec<[f64; BLOCK]>,
    product: Vec<f64>,
    difference: Vec<f64>,
}

impl AlongV {
    /// Of the first `rows` rows of a basis.
    pub(crate) fn new(basis: &Basis, rows: usize, camera: &Intrinsics) -> AlongV {
        let (height, blocks) = (basis.length(), basis.length().div_ceil(BLOCK));
        let values = vec![[0.0; BLOCK]; Multiplier::COUNT * rows * blocks];
        let mut along_v = AlongV { rows, values, product: vec![0.0; height], difference: vec![0.0; height] };
        along_v.set(basis, camera);
        along_v
    }

    /// Takes another basis of as many rows, in place.
    pub(crate) fn set(&mut self, basis: &Basis, camera: &Intrinsics) {
        use Multiplier::{ByPartsOneAndYyq, ByPartsQ, ByPartsYq, OneAndYyq, Q, Yq};
        for (plain, by_parts) in [(Q, ByPartsQ), (Yq, ByPartsYq), (OneAndYyq, ByPartsOneAndYyq)] {
            for m in 0..self.rows {
                let q = self.product.iter_mut().zip(basis.row(m)).zip(0..);
                match plain {
                    Yq => q.for_each(|((product, q), v)| *product = camera.y(f64::from(v)) * q),
                    OneAndYyq => q.for_each(|((product, q), v)| *product = (1.0 + camera.y(f64::from(v)).powi(2)) * q),
                    _ => self.product.copy_from_slice(basis.row(m)),
                }
                fill_transposed_difference(&self.product, &mut self.difference);
                self.put(plain, by_parts, m);
            }
        }
    }

    /// One of them for the first so many `m`, in a block of image rows.
    #[inline(always)]
    pub(crate) fn of(&self, multiplier: Multiplier, block: usize, count: usize) -> &[[f64; BLOCK]] {
        &self.values[self.place(multiplier, 0, block)..][..count]
    }

    /// Both of these multipliers for `m`, block by block.
    fn put(&mut self, plain: Multiplier, by_parts: Multiplier, m: usize) {
        let stretches = self.product.chunks(BLOCK).zip(self.difference.chunks(BLOCK));
        for (block, (product, difference)) in stretches.enumerate() {
            for (multiplier, stretch) in [(plain, product), (by_parts, difference)] {
                let place = (block * Multiplier::COUNT + multiplier as usize) * self.rows + m;
                self.values[place][..stretch.len()].copy_from_slice(stretch);
            }
        }
    }

    fn place(&self, multiplier: Multiplier, m: usize, block: usize) -> usize {
        (block * Multiplier::COUNT + multiplier as usize) * self.rows + m
    }
}

/// `(Dᵀ f)(v)`: half of what stands above less half of what stands below, where the first and last of `f` count in full. At least two.
fn fill_transposed_difference(f: &[f64], difference: &mut [f64]) {
    let last = f.len() - 1;
    for (difference, window) in difference[1..last].iter_mut().zip(f.windows(3)) {
        *difference = 0.5 * (window[0] - window[2]);
    }
    let whole_or_half = |v: usize| if v == 0 || v == last { f[v] } else { 0.5 * f[v] };
    difference[0] = -f[0] - whole_or_half(1);
    difference[last] = whole_or_half(last - 1) + f[last];
    if last > 1 {
        difference[1] = f[0] - whole_or_half(2);
        difference[last - 1] = whole_or_half(last - 2) - f[last];
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn summation_by_parts_is_exact_up_to_the_border() {
        for height in [2, 3, 4, 11] {
            let (f, image): (Vec<f64>, Vec<f64>) =
                (0..height).map(|v| ((7 * v % 11) as f64 - 3.0, (5 * v * v % 13) as f64)).unzip();
            let slope = |v: usize| {
                let (above, below) = (v.saturating_sub(1), (v + 1).min(height - 1));
                (image[below] - image[above]) / (below - above) as f64
            };
            let left: f64 = (0..height).map(|v| f[v] * slope(v)).sum();
            let mut difference = vec![0.0; height];
            fill_transposed_difference(&f, &mut difference);
            let right: f64 = difference.iter().zip(&image).map(|(difference, image)| difference * image).sum();
            assert_eq!(left, right, "whole and half numbers, {height} rows");
        }
    }
}
