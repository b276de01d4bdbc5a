//! From normal equations to a bounded step: the Gauss-Newton solve, its rank, and the step cap, Eq. (31).
//!
//! Every method ends in the same small thing, a [`crate::gram::Gram`], and that in [`NormalEquations`]; what follows does not know where they came from.
//! `v = -λ L̂⁺ e`, with `L̂⁺ e` from `L̂ᵀL̂` (6x6, `f64`), after scaling its columns to length 1 (Jacobi), by eigenvectors. The
//! unscaled columns mix metres and radians, so rank is judged on the scaled matrix: see [`SMALLEST_SINGULAR_RATIO`].

use nalgebra::{Matrix6, SymmetricEigen, Vector6};

use crate::law::StepCap;

/// A direction counts as seen if its singular value, of the column-scaled `L̂`, is above this fraction of the largest.
///
/// Well-posed pairs lie above 2e-3 (their unscaled condition numbers reach 500); what only rounding of `f32` planes tells apart
/// lies below 1e-6. Between the two, errors are magnified up to ten thousandfold, and standing still is the better answer.
pub const SMALLEST_SINGULAR_RATIO: f64 = 1e-4;

/// A column counts as seen if its length is above this fraction of the longest column's.
///
/// Scaling would blow a column of pure rounding errors up to length 1, such as that of a turn about the axis of a round spot.
pub const SMALLEST_COLUMN_RATIO: f64 = 1e-6;

/// What is solved, whatever the method: `LᵀL`, `Lᵀe`, `e·e` and how many features there are.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NormalEquations {
    /// `L̂ᵀL̂`.
    pub matrix: Matrix6<f64>,
    /// `L̂ᵀe`.
    pub vector: Vector6<f64>,
    /// `e·e`.
    pub error_squared: f64,
    /// Rows of `L̂`.
    pub features: usize,
}

/// The solved equations.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Solution {
    /// `-L̂⁺e`, metres and radians; zero in degrees that are not free, and along directions that are not seen.
    pub gauss_newton: [f64; 6],
    /// Directions seen, of the free degrees.
    pub rank: usize,
    /// Smallest over largest singular value of the column-scaled `L̂`, over the free degrees, from 0 to 1: what the rank is judged by.
    pub singular_ratio: f64,
    /// Of `L̂` over the free degrees, unscaled; infinite when it is singular.
    pub condition_number: f64,
}

impl NormalEquations {
    /// Whether every number is one.
    pub fn is_finite(&self) -> bool {
        let all = self.matrix.iter().chain(&self.vector).chain([&self.error_squared]);
        all.into_iter().all(|number| number.is_finite())
    }

    /// The Gauss-Newton step over the free degrees; the others leave before the solve.
    pub fn solve(&self, free: [bool; 6]) -> Solution {
        let scale = self.column_scale(free);
        // A degree without a scale keeps its row and column zero: one zero eigenvalue, with nothing along it.
        let scaled = Matrix6::from_fn(|i, j| scale[i] * self.matrix[(i, j)] * scale[j]);
        let eigen = SymmetricEigen::new(scaled);
        let floor = eigen.eigenvalues.max() * SMALLEST_SINGULAR_RATIO * SMALLEST_SINGULAR_RATIO;
        let right = self.vector.component_mul(&scale);

        let (mut step, mut rank) = (Vector6::zeros(), 0);
        for (direction, eigenvalue) in eigen.eigenvectors.column_iter().zip(&eigen.eigenvalues) {
            if *eigenvalue > floor && *eigenvalue > 0.0 {
                step -= direction * (direction.dot(&right) / eigenvalue);
                rank += 1;
            }
        }
        let gauss_newton = step.component_mul(&scale).into();
        let singular_ratio = singular_ratio(eigen.eigenvalues.into(), free);
        Solution { gauss_newton, rank, singular_ratio, condition_number: self.condition_number(free) }
    }

    /// One over each free column's length; 0 for a column that is not free or not seen.
    fn column_scale(&self, free: [bool; 6]) -> Vector6<f64> {
        let length = Vector6::from_fn(|i, _| if free[i] { self.matrix[(i, i)].sqrt() } else { 0.0 });
        let floor = length.max() * SMALLEST_COLUMN_RATIO;
        length.map(|length| if length > floor { 1.0 / length } else { 0.0 })
    }

    fn condition_number(&self, free: [bool; 6]) -> f64 {
        let is_free = |i: usize| free[i];
        let count = free.iter().filter(|free| **free).count() as f64;
        let trace: f64 = (0..6).filter(|i| is_free(*i)).map(|i| self.matrix[(i, i)]).sum();
        // The mean of the free eigenvalues stands in for a degree that is not free: it lies between the extremes and moves neither.
        let matrix = Matrix6::from_fn(|i, j| match (is_free(i) && is_free(j), i == j) {
            (true, _) => self.matrix[(i, j)],
            (false, true) => trace / count,
            (false, false) => 0.0,
        });
        let eigenvalues = SymmetricEigen::new(matrix).eigenvalues;
        let (smallest, largest) = (eigenvalues.min(), eigenvalues.max());
        if smallest > 0.0 { (largest / smallest).sqrt() } else { f64::INFINITY }
    }
}

/// Square root of the smallest over the largest eigenvalue. A degree that is not free has left a zero behind, the smallest of all.
fn singular_ratio(mut eigenvalues: [f64; 6], free: [bool; 6]) -> f64 {
    eigenvalues.sort_by(|a, b| b.total_cmp(a));
    let (largest, smallest) = (eigenvalues[0], eigenvalues[free.iter().filter(|free| **free).count().max(1) - 1]);
    if smallest > 0.0 { (smallest / largest).sqrt() } else { 0.0 }
}

/// Shortens a step so that neither part is longer than its bound, with one scale for both; says whether it had to.
pub fn cap_step(step: [f64; 6], cap: Option<StepCap>) -> ([f64; 6], bool) {
    let Some(StepCap { translation_m, rotation_rad }) = cap else {
        return (step, false);
    };
    let norm = |part: &[f64]| part.iter().fold(0.0, |norm: f64, component| norm.hypot(*component));
    let scale = (translation_m / norm(&step[..3])).min(rotation_rad / norm(&step[3..]));
    if scale < 1.0 { (step.map(|component| scale * component), true) } else { (step, false) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gram::Gram;

    /// Eight rows with known numbers; `e = -L s` for a known step `s`.
    fn equations(step: [f64; 6], column: impl Fn(usize, usize) -> f64) -> NormalEquations {
        let mut gram = Gram::new();
        for i in 0..8 {
            let row: [f64; 6] = std::array::from_fn(|j| column(i, j));
            gram.add(&row, -row.iter().zip(step).map(|(l, s)| l * s).sum::<f64>());
        }
        gram.normal_equations()
    }

    fn wave(i: usize, j: usize) -> f64 {
        (1.3 * (i + 1) as f64 * (j + 1) as f64).sin()
    }

    fn distance(a: [f64; 6], b: [f64; 6]) -> f64 {
        a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
    }

    const STEP: [f64; 6] = [0.1, -0.2, 0.3, 0.05, -0.02, 0.4];
    const ALL: [bool; 6] = [true; 6];

    #[test]
    fn a_step_that_explains_the_error_is_found() {
        let solution = equations(STEP, wave).solve(ALL);
        assert_eq!(solution.rank, 6);
        assert!(distance(solution.gauss_newton, STEP) < 1e-12, "condition number {}", solution.condition_number);
    }

    #[test]
    fn columns_of_very_different_lengths_are_no_lack_of_rank() {
        let solution = equations(STEP, |i, j| wave(i, j) * [1.0, 1e-3, 1e2, 1.0, 1e-2, 1.0][j]).solve(ALL);
        assert_eq!(solution.rank, 6);
        assert!(distance(solution.gauss_newton, STEP) < 1e-8, "the rows' own rounding, divided by the shortest column");
        assert!(solution.condition_number > 1e5);
    }

    #[test]
    fn two_equal_columns_are_a_lack_of_rank() {
        let solution = equations(STEP, |i, j| wave(i, if j == 5 { 0 } else { j })).solve(ALL);
        assert_eq!(solution.rank, 5);
        let shared = STEP[0] + STEP[5];
        assert!(
            (solution.gauss_newton[0] + solution.gauss_newton[5] - shared).abs() < 1e-12,
            "the seen part is solved"
        );
    }

    #[test]
    fn a_column_of_rounding_errors_is_not_seen() {
        let solution = equations([0.0; 6], |i, j| wave(i, j) * if j == 5 { 1e-9 } else { 1.0 }).solve(ALL);
        assert_eq!((solution.rank, solution.gauss_newton[5], solution.singular_ratio), (5, 0.0, 0.0));
    }

    #[test]
    fn the_rank_is_lost_where_the_singular_ratio_says_so() {
        for (apart, full) in [(1e-1, true), (1e-2, true), (1e-6, false)] {
            let solution =
                equations(STEP, |i, j| if j == 5 { wave(i, 0) + apart * wave(i, 5) } else { wave(i, j) }).solve(ALL);
            assert_eq!(solution.rank == 6, full, "{apart}");
            assert_eq!(solution.singular_ratio > SMALLEST_SINGULAR_RATIO, full, "{}", solution.singular_ratio);
        }
        let free = [true, true, false, true, true, false];
        assert!(equations(STEP, wave).solve(free).singular_ratio > 1e-2, "what is not free does not count");
    }

    #[test]
    fn a_degree_that_is_not_free_leaves_before_the_solve() {
        let free = [true, true, false, true, true, false];
        let small = equations(STEP, wave);
        let solution = small.solve(free);
        let only_free = equations(STEP, |i, j| if free[j] { wave(i, j) } else { 0.0 });
        assert_eq!((solution.rank, solution.gauss_newton[2], solution.gauss_newton[5]), (4, 0.0, 0.0));
        // The best step over four columns leaves a residual at right angles to them.
        let step = Vector6::from(solution.gauss_newton);
        let residual = small.vector + small.matrix * step;
        assert!((0..6).filter(|i| free[*i]).all(|i| residual[i].abs() < 1e-12), "numbers near 1");
        assert!(solution.condition_number.is_finite() && !only_free.solve(ALL).condition_number.is_finite());
    }

    #[test]
    fn nothing_seen_is_a_zero_step_of_rank_zero() {
        let solution = equations([0.0; 6], |_, _| 0.0).solve(ALL);
        assert_eq!((solution.gauss_newton, solution.rank, solution.condition_number), ([0.0; 6], 0, f64::INFINITY));
        assert_eq!(solution.singular_ratio, 0.0);
    }

    #[test]
    fn the_cap_keeps_the_direction_and_bounds_both_parts() {
        let cap = Some(StepCap { translation_m: 0.25, rotation_rad: 0.25 });
        let (capped, is_capped) = cap_step([0.3, 0.0, 0.4, 0.0, 1.0, 0.0], cap);
        assert!(is_capped && distance(capped, [0.075, 0.0, 0.1, 0.0, 0.25, 0.0]) < 1e-15, "one scale of a quarter");
        assert_eq!(cap_step([0.1; 6], cap), ([0.1; 6], false));
        assert_eq!(cap_step([0.0; 6], cap), ([0.0; 6], false));
        assert_eq!(cap_step([9.0; 6], None), ([9.0; 6], false));
    }
}
