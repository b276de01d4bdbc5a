//! The one small thing every method makes of two views: the inner products of the columns `[L | C | e]` over its features.
//!
//! `L̂` has six columns, the camera's degrees of freedom; `C`, if the law estimates light, six ([`crate::LightPrior`]); `e` is one.
//! Everything after a method, from light to the step cap, works on these 13x13 sums and the count of features.

use std::ops::Range;

use nalgebra::{Matrix6, SMatrix, Vector6};

use crate::control::NormalEquations;

/// Columns of a [`Gram`]: six of `L̂`, six of `C`, and `e`.
pub const COLUMNS: usize = 13;

/// Where the columns of `L̂` are.
pub const INTERACTION: Range<usize> = 0..6;

/// Where the columns of `C` are; their products are zero in a law without light.
pub const LIGHT: Range<usize> = 6..12;

/// Where `e` is.
pub const ERROR: usize = 12;

/// Inner products of the columns `[L (6) | C (6) | e]`, and how many features they run over.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gram {
    /// `products[(i, j)]` for `i <= j` is column `i` times column `j`; below the diagonal it is not read.
    pub products: SMatrix<f64, COLUMNS, COLUMNS>,
    /// Rows of the columns.
    pub features: usize,
}

impl Default for Gram {
    fn default() -> Gram {
        Gram::new()
    }
}

impl Gram {
    /// Of no features.
    pub fn new() -> Gram {
        Gram { products: SMatrix::zeros(), features: 0 }
    }

    /// Takes in one feature of a law without light: its row of `L̂` and its error.
    pub fn add(&mut self, interaction: &[f64; 6], error: f64) {
        for j in 0..6 {
            for i in 0..=j {
                self.products[(i, j)] += interaction[i] * interaction[j];
            }
            self.products[(j, ERROR)] += interaction[j] * error;
        }
        self.products[(ERROR, ERROR)] += error * error;
        self.features += 1;
    }

    /// Takes in one feature: its row of `L̂`, its row of `C` and its error.
    pub fn add_with_light(&mut self, interaction: &[f64; 6], light: &[f64; 6], error: f64) {
        self.add(interaction, error);
        for (j, light_j) in LIGHT.zip(light) {
            for (i, l_i) in INTERACTION.zip(interaction) {
                self.products[(i, j)] += l_i * light_j;
            }
            for (i, light_i) in (LIGHT.start..=j).zip(light) {
                self.products[(i, j)] += light_i * light_j;
            }
            self.products[(j, ERROR)] += light_j * error;
        }
    }

    /// Whether every product is a number.
    pub fn is_finite(&self) -> bool {
        self.products.iter().all(|product| product.is_finite())
    }

    /// `L̂ᵀL̂`, `L̂ᵀe` and `e·e`: light left alone.
    pub fn normal_equations(&self) -> NormalEquations {
        let mut matrix: Matrix6<f64> = self.products.fixed_view::<6, 6>(0, 0).into_owned();
        matrix.fill_lower_triangle_with_upper_triangle();
        let vector: Vector6<f64> = self.products.fixed_view::<6, 1>(0, ERROR).into_owned();
        NormalEquations { matrix, vector, error_squared: self.products[(ERROR, ERROR)], features: self.features }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wave(i: usize, j: usize) -> f64 {
        (1.3 * (i + 1) as f64 * (j + 1) as f64).sin()
    }

    #[test]
    fn products_are_those_of_the_columns() {
        let mut gram = Gram::new();
        for i in 0..20 {
            gram.add_with_light(
                &std::array::from_fn(|j| wave(i, j)),
                &std::array::from_fn(|j| wave(i, 6 + j)),
                wave(i, 12),
            );
        }
        for (i, j) in (0..COLUMNS).flat_map(|j| (0..=j).map(move |i| (i, j))) {
            let literal: f64 = (0..20).map(|row| wave(row, i) * wave(row, j)).sum();
            assert!((gram.products[(i, j)] - literal).abs() < 1e-14, "the same twenty terms: {i}, {j}");
        }
        assert_eq!(gram.features, 20);
    }

    #[test]
    fn light_columns_change_nothing_in_the_plain_equations() {
        let (mut plain, mut with_light) = (Gram::new(), Gram::new());
        for i in 0..9 {
            let row = std::array::from_fn(|j| wave(i, j));
            plain.add(&row, wave(i, 12));
            with_light.add_with_light(&row, &std::array::from_fn(|j| wave(i, 6 + j)), wave(i, 12));
        }
        assert_eq!(plain.normal_equations(), with_light.normal_equations());
    }
}
