//! The polynomial rows that make the moments: orthonormal on the pixels of one axis, highest coefficient positive.
//!
//! The paper walks along `u` from 0 (Eq. (5), Tables I and II), which grows without bound past the weight's mode. Here (deviation D1):
//!
//! 1. `q_0 = √w`, multiplied outwards from the mode by `√(w(u)/w(u-1))` of Table I, so an underflow only ever drops nothing;
//! 2. Stieltjes: `z = (t - α_n) q_n - β_n q_{n-1}`, `q_{n+1} = z/β_{n+1}`, with `u` scaled to `t` in `[-1, 1]`;
//! 3. every `z` is made orthogonal twice to all rows before it.
//!
//! The recurrence `t q_n = β_n q_{n-1} + α_n q_n + β_{n+1} q_{n+1}` is kept: it turns moments of `p_n` into moments of `x p_n`.
//! Rows in closed form (cosines) are taken as they are and have no such recurrence.

use fearless_simd::{Simd, dispatch};

use crate::dense::{add_multiple, dot, dot3};
use crate::family::{Family, Polynomial, Rows};
use crate::path::Path;

/// Shortest and longest axis a basis is made for, in pixels.
pub const LENGTHS: std::ops::RangeInclusive<usize> = 8..=4096;

/// Above this the rows are not orthonormal enough to be used.
const LARGEST_DEFECT: f64 = 1e-9;

/// Why there is no such basis.
#[derive(Debug, thiserror::Error, PartialEq)]
#[non_exhaustive]
pub enum BasisError {
    /// An axis is too short or too long.
    #[error("an axis has {} to {} pixels, got {length}", LENGTHS.start(), LENGTHS.end())]
    Length {
        /// Pixels.
        length: usize,
    },
    /// More rows than pixels.
    #[error("an axis of {length} pixels has {length} independent rows at most, got {rows}")]
    Rows {
        /// Pixels.
        length: usize,
        /// Rows asked for.
        rows: usize,
    },
    /// A parameter is outside its range.
    #[error("basis parameters are out of range: {polynomial:?}")]
    Parameter {
        /// As given.
        polynomial: Polynomial,
    },
    /// The rows are not orthonormal: the window is too narrow for that many of them.
    #[error("expected rows orthonormal to {LARGEST_DEFECT:e}, got a defect of {defect:e} for {polynomial:?}")]
    Defect {
        /// Largest deviation of the rows' products from the identity.
        defect: f64,
        /// As given.
        polynomial: Polynomial,
    },
}

/// The rows `p_0 … p_{rows-1}` on the pixels of one axis, and their recurrence.
#[derive(Debug, Clone)]
pub struct Basis {
    length: usize,
    /// Row `n` starts at `n * (length + 1)`: the paper's Krawtchouk lattice has one point more than pixels.
    values: Vec<f64>,
    scaled_u: Vec<f64>,
    diagonal: Vec<f64>,
    off_diagonal: Vec<f64>,
    points: usize,
    polynomial: Polynomial,
    defect: f64,
    path: Path,
}

/// `t q_n = off_diagonal[n] q_{n-1} + diagonal[n] q_n + off_diagonal[n + 1] q_{n+1}`, with `t = 2u/(points - 1) - 1`.
#[derive(Debug, Clone, Copy)]
pub struct Recurrence<'a> {
    /// `α_n`, for every row but the last.
    pub diagonal: &'a [f64],
    /// `β_n`, for every row; `β_0 = 0`.
    pub off_diagonal: &'a [f64],
    /// Points of the lattice.
    pub points: usize,
}

impl Basis {
    /// `rows` orthonormal rows on `length` pixels.
    ///
    /// # Errors
    /// A length outside [`LENGTHS`], more rows than pixels, a parameter out of range, or a defect above 1e-9.
    pub fn new(length: usize, rows: usize, polynomial: impl Into<Polynomial>) -> Result<Basis, BasisError> {
        let polynomial = polynomial.into();
        if !LENGTHS.contains(&length) {
            return Err(BasisError::Length { length });
        }
        if rows == 0 || rows > length {
            return Err(BasisError::Rows { length, rows });
        }
        let mut basis = Basis {
            length,
            values: vec![0.0; rows * (length + 1)],
            scaled_u: vec![0.0; length + 1],
            diagonal: vec![0.0; rows - 1],
            off_diagonal: vec![0.0; rows],
            points: length,
            polynomial,
            defect: f64::INFINITY,
            path: Path::best(),
        };
        basis.remake(polynomial)?;
        Ok(basis)
    }

    /// Other rows of the same number and length, in place, without allocating. After an error the rows are of no use.
    ///
    /// # Errors
    /// A parameter out of range, or a defect above 1e-9 (the paper's lattice, cut to the pixels, only reports its defect).
    pub fn remake(&mut self, polynomial: Polynomial) -> Result<(), BasisError> {
        if !polynomial.is_in_range() {
            return Err(BasisError::Parameter { polynomial });
        }
        self.polynomial = polynomial;
        self.points = self.length + usize::from(polynomial.has_extra_point());
        polynomial.fill(self);
        // On its own lattice every basis must prove itself; the cut to the pixels comes after that.
        let defect = self.products_defect(self.points);
        if defect > LARGEST_DEFECT || defect.is_nan() {
            return Err(BasisError::Defect { defect, polynomial });
        }
        self.defect = if self.points == self.length { defect } else { self.products_defect(self.length) };
        Ok(())
    }

    /// Other rows are made with these instructions from now on.
    pub(crate) fn set_path(&mut self, path: Path) {
        self.path = path;
    }

    /// Row `n`: `p_n(u)` for `u = 0 … length - 1`; panics beyond the last row.
    pub fn row(&self, n: usize) -> &[f64] {
        &self.lattice_row(n)[..self.length]
    }

    /// How many rows.
    pub fn rows(&self) -> usize {
        self.off_diagonal.len()
    }

    /// How many pixels.
    pub fn length(&self) -> usize {
        self.length
    }

    /// What the rows are.
    pub fn polynomial(&self) -> Polynomial {
        self.polynomial
    }

    /// Largest deviation of the rows' products, over the pixels, from the identity.
    pub fn defect(&self) -> f64 {
        self.defect
    }

    /// The three-term recurrence of the rows; those in closed form have none.
    pub fn recurrence(&self) -> Option<Recurrence<'_>> {
        self.polynomial.has_recurrence().then_some(Recurrence {
            diagonal: &self.diagonal,
            off_diagonal: &self.off_diagonal,
            points: self.points,
        })
    }

    /// Whether `p_n(length - 1 - u) = (-1)^n p_n(u)`, up to rounding.
    pub(crate) fn is_even_and_odd_in_turn(&self) -> bool {
        (0..self.rows()).all(|n| {
            let (row, sign) = (self.row(n), if n % 2 == 0 { 1.0 } else { -1.0 });
            let largest = row.iter().fold(0.0, |largest: f64, value| largest.max(value.abs()));
            let half = self.length.div_ceil(2);
            row[..half].iter().zip(row.iter().rev()).all(|(left, right)| (left - sign * right).abs() <= 1e-13 * largest)
        })
    }

    fn lattice_row(&self, n: usize) -> &[f64] {
        &self.values[n * (self.length + 1)..][..self.points]
    }

    /// The rows of this family, not checked yet.
    pub(crate) fn fill<F: Family>(&mut self, family: &F) {
        match F::ROWS {
            Rows::UnderWeight(ratio) => self.fill_polynomials(|u, points| ratio(family, u, points)),
            Rows::ClosedForm(value) => self.fill_closed_form(|n, u, length| value(family, n, u, length)),
        }
    }

    fn fill_closed_form(&mut self, value_at: impl Fn(usize, usize, usize) -> f64) {
        for (n, row) in self.values.chunks_exact_mut(self.length + 1).enumerate() {
            for (u, value) in row[..self.length].iter_mut().enumerate() {
                *value = value_at(n, u, self.length);
            }
        }
    }

    fn fill_polynomials(&mut self, weight_ratio: impl Fn(f64, f64) -> f64) {
        let points = self.points;
        for (u, t) in self.scaled_u[..points].iter_mut().enumerate() {
            *t = 2.0 * u as f64 / (points - 1) as f64 - 1.0;
        }
        fill_root_weight(weight_ratio, &mut self.values[..points]);
        dispatch!(self.path.level(), simd => self.orthogonalise(simd));
    }

    /// Rows 1 and on from row 0, by Stieltjes' procedure.
    #[inline(always)]
    fn orthogonalise<S: Simd>(&mut self, simd: S) {
        let (points, stride) = (self.points, self.length + 1);
        let t = &self.scaled_u[..points];
        for n in 0..self.off_diagonal.len() - 1 {
            let (made, next) = self.values.split_at_mut((n + 1) * stride);
            let z = &mut next[..points];
            let q = &made[n * stride..][..points];
            let alpha = dot3(simd, q, q, Some(t));
            for ((z, t), q) in z.iter_mut().zip(t).zip(q) {
                *z = (t - alpha) * q;
            }
            // The first round also takes out `β_n q_{n-1}`; the second what rounding left of the first.
            for _ in 0..2 {
                for row in (0..=n).rev() {
                    let row = &made[row * stride..][..points];
                    add_multiple(simd, z, -dot(simd, z, row), row);
                }
            }
            self.diagonal[n] = alpha;
            let length = dot(simd, z, z).sqrt();
            z.iter_mut().for_each(|z| *z /= length);
            self.off_diagonal[n + 1] = length;
        }
    }

    fn products_defect(&self, points: usize) -> f64 {
        dispatch!(self.path.level(), simd => self.products_defect_on(simd, points))
    }

    #[inline(always)]
    fn products_defect_on<S: Simd>(&self, simd: S, points: usize) -> f64 {
        let mut worst: f64 = 0.0;
        for n in 0..self.rows() {
            for m in 0..=n {
                let product = dot(simd, &self.lattice_row(n)[..points], &self.lattice_row(m)[..points]);
                let deviation = (product - f64::from(u8::from(n == m))).abs();
                // `f64::max` would swallow a NaN; a row that is not a number must fail.
                worst = if deviation > worst || deviation.is_nan() { deviation } else { worst };
            }
        }
        worst
    }
}

/// `q_0 = √w`, normalized: the weight falls on both sides of its mode, so start there with 1 and multiply outwards.
fn fill_root_weight(weight_ratio: impl Fn(f64, f64) -> f64, q: &mut [f64]) {
    let points = q.len();
    let ratio = |u: usize| weight_ratio(u as f64, points as f64);
    let mode = (1..points).take_while(|u| ratio(*u) >= 1.0).last().unwrap_or(0);
    q[mode] = 1.0;
    for u in mode + 1..points {
        q[u] = q[u - 1] * ratio(u).sqrt();
    }
    for u in (0..mode).rev() {
        q[u] = q[u + 1] / ratio(u + 1).sqrt();
    }
    let length = q.iter().map(|q| q * q).sum::<f64>().sqrt();
    q.iter_mut().for_each(|q| *q /= length);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::family::krawtchouk::Lattice;
    use crate::family::{Cosine, Hahn, Krawtchouk, Tchebichef};
    use crate::law::Law;
    use crate::window::{Brightness, NoBrightness};

    #[test]
    fn hahn_without_a_window_is_tchebichef() {
        let hahn = Basis::new(100, 20, Hahn { a: 0.0, b: 0.0 }).expect("valid");
        let tchebichef = Basis::new(100, 20, Tchebichef).expect("valid");
        let worst = (0..20).flat_map(|n| hahn.row(n).iter().zip(tchebichef.row(n))).map(|(a, b)| (a - b).abs());
        assert!(worst.fold(0.0, f64::max) < 1e-12, "both are made by the same steps, from equal weights");
    }

    #[test]
    fn the_recurrence_multiplies_by_u_in_wide_and_narrow_windows() {
        let krawtchouk = |p| Polynomial::from(Krawtchouk { p, lattice: Lattice::Paper });
        let hahn = |a, b| Polynomial::from(Hahn { a, b });
        for polynomial in [hahn(3.5, 9.0), hahn(10.0, 1e5), hahn(1e9, 0.0), krawtchouk(1e-3), krawtchouk(0.9999)] {
            let (length, rows) = (640, 43);
            let basis = Basis::new(length, rows, polynomial).expect("valid");
            let by = basis.recurrence().expect("polynomials have one");
            for (n, u) in (1..rows - 1).flat_map(|n| (0..length).map(move |u| (n, u))) {
                let t = 2.0 * u as f64 / (by.points - 1) as f64 - 1.0;
                let right = by.off_diagonal[n] * basis.row(n - 1)[u]
                    + by.diagonal[n] * basis.row(n)[u]
                    + by.off_diagonal[n + 1] * basis.row(n + 1)[u];
                let difference = (t * basis.row(n)[u] - right).abs();
                assert!(difference < 1e-14, "{polynomial:?}, row {n}: unit rows, |t| <= 1, a few rounding errors");
            }
        }
    }

    #[test]
    fn the_papers_krawtchouk_lattice_reports_its_defect_on_the_pixels() {
        let at = |p, lattice| Basis::new(128, 17, Krawtchouk { p, lattice }).expect("valid").defect();
        assert!(at(0.97, Lattice::Paper) > 0.1, "the cut point carries much of the weight");
        assert!(at(0.5, Lattice::Paper) < 1e-12 && at(0.97, Lattice::Exact) < 1e-12);
    }

    /// A family of nobody's: a weight that falls by a tenth from pixel to pixel.
    #[derive(Debug, Clone, Copy, PartialEq)]
    struct Falling;

    impl Family for Falling {
        const WORD: &'static str = "falling";
        const ROWS: Rows<Falling> = Rows::UnderWeight(|_, _, _| 0.9);

        fn choose(_: &Law, _: &Brightness, _: &Brightness) -> Result<[Falling; 2], NoBrightness> {
            Ok([Falling; 2])
        }
    }

    #[test]
    fn a_family_that_only_names_its_weight_has_rows_orthonormal_under_it() {
        let mut basis = Basis::new(60, 12, Tchebichef).expect("valid");
        basis.fill(&Falling);
        assert!(basis.products_defect(60) < 1e-13, "re-orthogonalised twice");
        for u in 1..60 {
            let ratio = (basis.row(0)[u] / basis.row(0)[u - 1]).powi(2);
            assert!((ratio - 0.9).abs() < 1e-14, "row 0 is the root of the weight");
        }
    }

    #[test]
    fn a_basis_that_cannot_be_is_refused() {
        assert_eq!(Basis::new(7, 3, Tchebichef).err(), Some(BasisError::Length { length: 7 }));
        assert_eq!(Basis::new(8, 9, Cosine).err(), Some(BasisError::Rows { length: 8, rows: 9 }));
        let bad = [
            Polynomial::from(Hahn { a: -0.5, b: 0.0 }),
            Hahn { a: 0.0, b: f64::NAN }.into(),
            Krawtchouk { p: 1.0, lattice: Lattice::Exact }.into(),
        ];
        assert!(bad.iter().all(|p| matches!(Basis::new(32, 5, *p), Err(BasisError::Parameter { .. }))));
    }
}
