//! Words and numbers that several subcommands read alike: method, order, window, camera, depth.
//! Each type parses one option value and says in its error what was expected.
//!
//! Ranges that depend on the images (the largest order, say) are left to the crate that knows them.

use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;

use clap::ValueEnum;
use domvs_vision::{KrawtchoukP, Lattice, Method, Window};

/// `--method`: the orthogonal polynomials that make the moments.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum MethodOption {
    /// Hahn polynomials, under a window that may move with the object
    #[default]
    Hahn,
    /// Krawtchouk polynomials: a narrow window around the object
    Krawtchouk,
    /// Tchebichef polynomials: the whole image, evenly
    Tchebichef,
    /// Cosines: the whole image, evenly
    Cosine,
}

impl MethodOption {
    /// Every method, in the order of `--help`.
    pub const ALL: [MethodOption; 4] =
        [MethodOption::Hahn, MethodOption::Krawtchouk, MethodOption::Tchebichef, MethodOption::Cosine];

    /// The word on the command line and on the wire.
    pub fn word(self) -> &'static str {
        match self {
            MethodOption::Hahn => "hahn",
            MethodOption::Krawtchouk => "krawtchouk",
            MethodOption::Tchebichef => "tchebichef",
            MethodOption::Cosine => "cosine",
        }
    }
}

impl fmt::Display for MethodOption {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.word())
    }
}

impl From<MethodOption> for Method {
    fn from(method: MethodOption) -> Method {
        match method {
            MethodOption::Hahn => Method::Hahn,
            MethodOption::Krawtchouk => Method::Krawtchouk,
            MethodOption::Tchebichef => Method::Tchebichef,
            MethodOption::Cosine => Method::Cosine,
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

/// `--order N` or `--order MIN..MAX`, both ends included.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OrderOption {
    /// The order far from the goal.
    pub min: usize,
    /// The order near the goal; equal to `min` for a fixed order.
    pub max: usize,
}

impl Default for OrderOption {
    fn default() -> OrderOption {
        OrderOption { min: 4, max: 16 }
    }
}

impl FromStr for OrderOption {
    type Err = String;

    fn from_str(text: &str) -> Result<OrderOption, String> {
        let number = |part: &str| part.trim().parse().map_err(|_| order_expected(text));
        let (min, max) = match text.split_once("..") {
            Some((min, max)) => (number(min)?, number(max.strip_prefix('=').unwrap_or(max))?),
            None => (number(text)?, number(text)?),
        };
        if min > max {
            return Err(format!("the smallest order comes first, got {min}..{max}"));
        }
        Ok(OrderOption { min, max })
    }
}

fn order_expected(text: &str) -> String {
    format!("expected a whole number or MIN..MAX such as 4..16, got '{text}'")
}

impl fmt::Display for OrderOption {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.min == self.max {
            true => write!(f, "{}", self.min),
            false => write!(f, "{}..{}", self.min, self.max),
        }
    }
}

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

/// `--camera fx,fy,cx,cy`, all in pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraOption {
    /// Focal lengths along u and v, positive.
    pub focal_px: [f64; 2],
    /// The principal point; pixel (0, 0) has its centre at (0, 0).
    pub center_px: [f64; 2],
}

impl FromStr for CameraOption {
    type Err = String;

    fn from_str(text: &str) -> Result<CameraOption, String> {
        let wanted = || format!("expected fx,fy,cx,cy in pixels, got '{text}'");
        let Some(&[fx, fy, cx, cy]) = numbers(text).as_deref() else { return Err(wanted()) };
        if fx <= 0.0 || fy <= 0.0 {
            return Err(format!("focal lengths must be positive, got {fx},{fy} px"));
        }
        Ok(CameraOption { focal_px: [fx, fy], center_px: [cx, cy] })
    }
}

/// `--desired-depth`, `--current-depth`: one distance for all pixels, or a file with one for each.
#[derive(Clone, Debug, PartialEq)]
pub enum DepthOption {
    /// The same depth everywhere, in metres, positive.
    Metres(f64),
    /// A 16-bit PNG, or a 32-bit float TIFF in metres.
    File(PathBuf),
}

impl FromStr for DepthOption {
    type Err = String;

    fn from_str(text: &str) -> Result<DepthOption, String> {
        match text.trim().parse::<f64>() {
            Ok(metres) if metres.is_finite() && metres > 0.0 => Ok(DepthOption::Metres(metres)),
            Ok(metres) => Err(format!("a depth must be a positive number of metres, got {metres}")),
            Err(_) => Ok(DepthOption::File(PathBuf::from(text))),
        }
    }
}

/// A number above 0, for example a gain or a unit.
///
/// # Errors
/// Says what was expected when `text` is no number, not finite, zero or negative.
pub fn positive(text: &str) -> Result<f64, String> {
    match text.trim().parse::<f64>() {
        Ok(number) if number.is_finite() && number > 0.0 => Ok(number),
        _ => Err(format!("expected a number above 0, got '{text}'")),
    }
}

/// Any finite number.
///
/// # Errors
/// Says what was expected when `text` is no number or not finite.
pub fn finite(text: &str) -> Result<f64, String> {
    match text.trim().parse::<f64>() {
        Ok(number) if number.is_finite() => Ok(number),
        _ => Err(format!("expected a finite number, got '{text}'")),
    }
}

/// Finite numbers with commas between them, or `None`.
pub fn numbers(text: &str) -> Option<Vec<f64>> {
    text.split(',').map(|part| finite(part).ok()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_order_is_a_number_or_a_range() {
        assert_eq!("8".parse(), Ok(OrderOption { min: 8, max: 8 }));
        assert_eq!("6..16".parse(), Ok(OrderOption { min: 6, max: 16 }));
        assert_eq!("6..=16".parse(), Ok(OrderOption { min: 6, max: 16 }));
        for bad in ["", "16..6", "6..", "..6", "6-16", "six", "-3"] {
            assert!(bad.parse::<OrderOption>().is_err(), "'{bad}'");
        }
    }

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
    fn what_is_shown_parses_again() {
        for window in ["adaptive", "adaptive_paper", "8,8", "6,6,4,5"] {
            assert_eq!(window.parse::<WindowOption>().expect("a window").to_string(), window);
        }
        for order in ["8", "4..16"] {
            assert_eq!(order.parse::<OrderOption>().expect("an order").to_string(), order);
        }
        for method in MethodOption::ALL {
            assert_eq!(MethodOption::from_str(method.word(), false), Ok(method));
        }
    }

    #[test]
    fn a_camera_has_four_numbers_and_positive_focal_lengths() {
        let camera = "6e2,601.5,-3,239.5".parse();
        assert_eq!(camera, Ok(CameraOption { focal_px: [600.0, 601.5], center_px: [-3.0, 239.5] }));
        for bad in ["600,600,320", "0,600,320,240", "600,-1,320,240", "a,b,c,d", "600,600,320,inf"] {
            assert!(bad.parse::<CameraOption>().is_err(), "'{bad}'");
        }
    }

    #[test]
    fn a_depth_is_metres_or_a_file_and_never_zero() {
        assert_eq!("0.5".parse(), Ok(DepthOption::Metres(0.5)));
        assert_eq!("5e-1".parse(), Ok(DepthOption::Metres(0.5)));
        assert_eq!("depth.png".parse(), Ok(DepthOption::File(PathBuf::from("depth.png"))));
        for bad in ["0", "-1", "nan", "inf"] {
            assert!(bad.parse::<DepthOption>().is_err(), "'{bad}'");
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
