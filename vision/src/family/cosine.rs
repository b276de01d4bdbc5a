//! Cosines (DCT-II): `p_0 = √(1/N)`, `p_n(u) = √(2/N) cos(π n (2u + 1) / 2N)`: no window, and not polynomials in `u` (deviation D15).

use crate::family::{Family, Rows};
use crate::law::Law;
use crate::window::{Brightness, NoBrightness};

/// Orthonormal cosines.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cosine;

impl Family for Cosine {
    const WORD: &'static str = "cosine";
    const ROWS: Rows<Cosine> = Rows::ClosedForm(|_, n, u, length| cosine(n, u, length));

    fn choose(_: &Law, _: &Brightness, _: &Brightness) -> Result<[Cosine; 2], NoBrightness> {
        Ok([Cosine; 2])
    }
}

fn cosine(n: usize, u: usize, length: usize) -> f64 {
    let scale = (if n == 0 { 1.0 } else { 2.0 } / length as f64).sqrt();
    // The angle's period is 4N: reducing the whole numbers first keeps the cosine exact to its last digits.
    let quarter_steps = (n * (2 * u + 1)) % (4 * length);
    scale * (std::f64::consts::PI * quarter_steps as f64 / (2.0 * length as f64)).cos()
}
