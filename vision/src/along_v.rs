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
    /// Blocks of image rows.
    blocks: usize,
    /// `[multiplier][m][block]`; zeros below the image.
    values: Vec<[f64; BLOCK]>,
    product: Vec<f64>,
}

impl AlongV {
    /// Of the first `rows` rows of a basis.
    pub(crate) fn new(basis: &Basis, rows: usize, camera: &Intrinsics) -> AlongV {
        let (height, blocks) = (basis.length(), basis.length().div_ceil(BLOCK));
        let values = vec![[0.0; BLOCK]; Multiplier::COUNT * rows * blocks];
        let mut along_v = AlongV { rows, blocks, values, product: vec![0.0; height] };
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
                let [first, second] = [plain, by_parts].map(|multiplier| self.start(multiplier, m));
                let height = self.product.len();
                self.values[first..][..self.blocks].as_flattened_mut()[..height].copy_from_slice(&self.product);
                let out = &mut self.values[second..][..self.blocks].as_flattened_mut()[..height];
                transposed_differences(&self.product, out);
            }
        }
    }

    /// One of them for `m`, in a block of image rows.
    #[inline(always)]
    pub(crate) fn of(&self, multiplier: Multiplier, m: usize, block: usize) -> &[f64; BLOCK] {
        &self.values[self.start(multiplier, m) + block]
    }

    fn start(&self, multiplier: Multiplier, m: usize) -> usize {
        (multiplier as usize * self.rows + m) * self.blocks
    }
}

/// `out = Dᵀ f`: half of what stands above less half of what stands below, where the first and last of `f` count in full.
fn transposed_differences(f: &[f64], out: &mut [f64]) {
    let last = f.len() - 1;
    for v in 1..last {
        out[v] = 0.5 * (f[v - 1] - f[v + 1]);
    }
    // Of `f[0]` and `f[last]` the inner pixels have had half.
    out[1] += 0.5 * f[0];
    out[last - 1] -= 0.5 * f[last];
    out[0] = -f[0] - 0.5 * f[1];
    out[last] = 0.5 * f[last - 1] + f[last];
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
            let mut transposed = vec![0.0; height];
            transposed_differences(&f, &mut transposed);
            let left: f64 = (0..height).map(|v| f[v] * slope(v)).sum();
            let right: f64 = (0..height).map(|v| transposed[v] * image[v]).sum();
            assert_eq!(left, right, "whole and half numbers, {height} rows");
        }
    }
}
