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
}

impl AlongV {
    /// Of the first `rows` rows of a basis.
    pub(crate) fn new(basis: &Basis, rows: usize, camera: &Intrinsics) -> AlongV {
        let (height, blocks) = (basis.length(), basis.length().div_ceil(BLOCK));
        let values = vec![[0.0; BLOCK]; Multiplier::COUNT * rows * blocks];
        let mut along_v = AlongV { rows, values, product: vec![0.0; height] };
        along_v.set(basis, camera);
        along_v
    }

    /// Takes another basis of as many rows, in place.
    pub(crate) fn set(&mut self, basis: &Basis, camera: &Intrinsics) {
        use Multiplier::{ByPartsOneAndYyq, ByPartsQ, ByPartsYq, OneAndYyq, Q, Yq};
        for (plain, by_parts) in [(Q, ByPartsQ), (Yq, ByPartsYq), (OneAndYyq, ByPartsOneAndYyq)] {
            for m in 0..self.rows {
                for (v, (product, q)) in self.product.iter_mut().zip(basis.row(m)).enumerate() {
                    let y = camera.y(v as f64);
                    *product = match plain {
                        Yq => y * q,
                        OneAndYyq => (1.0 + y * y) * q,
                        _ => *q,
                    };
                }
                self.put(plain, m, |product, v| product[v]);
                self.put(by_parts, m, transposed_difference);
            }
        }
    }

    /// One of them for `m`, in a block of image rows.
    #[inline(always)]
    pub(crate) fn of(&self, multiplier: Multiplier, m: usize, block: usize) -> &[f64; BLOCK] {
        &self.values[self.place(multiplier, m, block)]
    }

    fn put(&mut self, multiplier: Multiplier, m: usize, value: impl Fn(&[f64], usize) -> f64) {
        for v in 0..self.product.len() {
            let place = self.place(multiplier, m, v / BLOCK);
            self.values[place][v % BLOCK] = value(&self.product, v);
        }
    }

    fn place(&self, multiplier: Multiplier, m: usize, block: usize) -> usize {
        (block * Multiplier::COUNT + multiplier as usize) * self.rows + m
    }
}

/// `(Dᵀ f)(v)`: half of what stands above less half of what stands below, where the first and last of `f` count in full.
fn transposed_difference(f: &[f64], v: usize) -> f64 {
    let last = f.len() - 1;
    let whole_or_half = |v: usize| if v == 0 || v == last { f[v] } else { 0.5 * f[v] };
    let from_above = if v == 0 { -f[0] } else { whole_or_half(v - 1) };
    let from_below = if v == last { -f[last] } else { whole_or_half(v + 1) };
    from_above - from_below
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn summation_by_parts_is_exact_up_to_the_border() {
        for height in [3, 4, 11] {
            let (f, image): (Vec<f64>, Vec<f64>) =
                (0..height).map(|v| ((7 * v % 11) as f64 - 3.0, (5 * v * v % 13) as f64)).unzip();
            let slope = |v: usize| {
                let (above, below) = (v.saturating_sub(1), (v + 1).min(height - 1));
                (image[below] - image[above]) / (below - above) as f64
            };
            let left: f64 = (0..height).map(|v| f[v] * slope(v)).sum();
            let right: f64 = (0..height).map(|v| transposed_difference(&f, v) * image[v]).sum();
            assert_eq!(left, right, "whole and half numbers, {height} rows");
        }
    }
}
