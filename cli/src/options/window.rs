//! Where the moments look: `--window` for Hahn, `--krawtchouk-p` and `--lattice` for Krawtchouk.

use std::fmt;
use std::str::FromStr;

use clap::ValueEnum;
use domvs_vision::{KrawtchoukP, Lattice, Window};

use super::numbers;

/// `--window`: the Hahn window.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum WindowOption {
    /// From both images, by the rule of the authors' program.
    Adaptive,
    /// From both images, by the rule printed in the paper.
    AdaptivePaper,
    /// `[a, b]` per axis.
    Fixed {
        /// a and b along u.
        x: [f64; 2],
        /// a and b along v.
        y: [f64; 2],
    },
}

impl Default for WindowOption {
    fn default() -> WindowOption {
        WindowOption::Fixed { x: [8.0, 8.0], y: [8.0, 8.0] }
    }
}

impl FromStr for WindowOption {
    type Err = String;

    fn from_str(text: &str) -> Result<WindowOption, String> {
        let wanted = || format!("expected adaptive, adaptive_paper, a,b or ax,bx,ay,by with numbers ≥ 0, got '{text}'");
        match text {
            "adaptive" => return Ok(WindowOption::Adaptive),
            "adaptive_paper" | "adaptive-paper" => return Ok(WindowOption::AdaptivePaper),
            _ => {}
        }
        let numbers = numbers(text).ok_or_else(wanted)?;
        if numbers.iter().any(|&number| number < 0.0) {
            return Err(wanted());
        }
        match numbers[..] {
            [a, b] => Ok(WindowOption::Fixed { x: [a, b], y: [a, b] }),
            [ax, bx, ay, by] => Ok(WindowOption::Fixed { x: [ax, bx], y: [ay, by] }),
            _ => Err(wanted()),
        }
    }
}

impl fmt::Display for WindowOption {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            WindowOption::Adaptive => f.write_str("adaptive"),
            WindowOption::AdaptivePaper => f.write_str("adaptive_paper"),
            WindowOption::Fixed { x, y } if x == y => write!(f, "{},{}", x[0], x[1]),
            WindowOption::Fixed { x, y } => write!(f, "{},{},{},{}", x[0], x[1], y[0], y[1]),
        }
    }
}

impl From<WindowOption> for Window {
    fn from(window: WindowOption) -> Window {
        match window {
            WindowOption::Adaptive => Window::Adaptive,
            WindowOption::AdaptivePaper => Window::AdaptivePaper,
            WindowOption::Fixed { x, y } => Window::Fixed { x, y },
        }
    }
}

/// `--krawtchouk-p`: where the Krawtchouk window sits, as a fraction of the image.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum KrawtchoukOption {
    /// At the mean centroid of both images.
    #[default]
    Adaptive,
    /// `[p_x, p_y]`, each between 0 and 1.
    Fixed([f64; 2]),
}

impl FromStr for KrawtchoukOption {
    type Err = String;

    fn from_str(text: &str) -> Result<KrawtchoukOption, String> {
        if text == "adaptive" {
            return Ok(KrawtchoukOption::Adaptive);
        }
        match numbers(text).as_deref() {
            Some(&[x, y]) if x > 0.0 && x < 1.0 && y > 0.0 && y < 1.0 => Ok(KrawtchoukOption::Fixed([x, y])),
            _ => Err(format!("expected adaptive or px,py with both between 0 and 1, got '{text}'")),
        }
    }
}

impl fmt::Display for KrawtchoukOption {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            KrawtchoukOption::Adaptive => f.write_str("adaptive"),
            KrawtchoukOption::Fixed([x, y]) => write!(f, "{x},{y}"),
        }
    }
}

impl From<KrawtchoukOption> for KrawtchoukP {
    fn from(p: KrawtchoukOption) -> KrawtchoukP {
        match p {
            KrawtchoukOption::Adaptive => KrawtchoukP::Adaptive,
            KrawtchoukOption::Fixed(p) => KrawtchoukP::Fixed(p),
        }
    }
}

/// `--lattice`: how many points the Krawtchouk polynomials live on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum LatticeOption {
    /// N + 1 points, cut to the N pixels, as the paper prints it
    #[default]
    Paper,
    /// N points, orthonormal on the pixels
    Exact,
}

impl From<LatticeOption> for Lattice {
    fn from(lattice: LatticeOption) -> Lattice {
        match lattice {
            LatticeOption::Paper => Lattice::Paper,
            LatticeOption::Exact => Lattice::Exact,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_window_is_a_rule_or_two_or_four_numbers() {
        assert_eq!("adaptive".parse(), Ok(WindowOption::Adaptive));
        assert_eq!("adaptive_paper".parse(), Ok(WindowOption::AdaptivePaper));
        assert_eq!("8,7".parse(), Ok(WindowOption::Fixed { x: [8.0, 7.0], y: [8.0, 7.0] }));
        assert_eq!("6,6,4,5.5".parse(), Ok(WindowOption::Fixed { x: [6.0, 6.0], y: [4.0, 5.5] }));
        for bad in ["", "8", "8,8,8", "8,-1", "8,nan", "wide"] {
            assert!(bad.parse::<WindowOption>().is_err(), "'{bad}'");
        }
    }

    #[test]
    fn a_krawtchouk_p_lies_inside_the_image() {
        assert_eq!("adaptive".parse(), Ok(KrawtchoukOption::Adaptive));
        assert_eq!("0.4,0.6".parse(), Ok(KrawtchoukOption::Fixed([0.4, 0.6])));
        for bad in ["0,0.5", "0.5,1", "0.5", "8,8"] {
            assert!(bad.parse::<KrawtchoukOption>().is_err(), "'{bad}'");
        }
    }
}
