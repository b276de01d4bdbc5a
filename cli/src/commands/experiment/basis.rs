//! `domvs experiment basis`: the polynomials and the operators they make, drawn.

use std::fmt;
use std::path::PathBuf;
use std::process::ExitCode;
use std::str::FromStr;

use anyhow::Context;
use clap::Args;
use domvs_vision::basis::Basis;
use domvs_vision::family::{Cosine, Hahn, Krawtchouk, Tchebichef};
use domvs_vision::{Lattice, Polynomial};

use crate::exit;
use crate::experiment::page::Page;
use crate::options::numbers;
use crate::paint::{Paint, print_line};
use crate::report::plots::{Colors, Heat, Panel, Plot, Scale, Series, charts, heats, write_plots};

/// Largest n + m of the operators drawn, and their pixels.
const OPERATOR_ORDER: usize = 3;
const OPERATOR_PIXELS: usize = 96;

/// Draw the polynomials and the operators that make the moments
///
/// Without options: those of the paper, N = 512 and n = 0 … 5.
#[derive(Args, Clone, Debug)]
#[command(after_help = AFTER_HELP)]
pub struct BasisArgs {
    /// Which: tchebichef, cosine, krawtchouk:P with P in 0..1, hahn:A,B; more than once for several
    /// [default: the paper's six]
    #[arg(long = "polynomial", value_name = "NAME[:PARAMETERS]")]
    polynomials: Vec<PolynomialOption>,

    /// Pixels of the axis
    #[arg(long, value_name = "N", default_value_t = 512, value_parser = clap::value_parser!(u16).range(8..=4096))]
    length: u16,

    /// Highest degree drawn
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u16).range(0..=40))]
    degree: u16,

    /// A folder for the plots
    #[arg(long, value_name = "FOLDER", default_value = "runs/experiments/basis")]
    out: PathBuf,
}

const AFTER_HELP: &str = "\
The folder holds polynomials.svg, operators.svg (p_n(u) p_m(v) for n + m up to 3; blue below zero, red above), basis.csv \
(polynomial, n, u, value) and index.html.

Exit codes: 0 done, 1 an error (for example a window too narrow for that many polynomials), 2 the command line was not understood.";

/// A family with its parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
struct PolynomialOption(Polynomial);

impl FromStr for PolynomialOption {
    type Err = String;

    fn from_str(text: &str) -> Result<PolynomialOption, String> {
        let (family, parameters) = text.split_once(':').unwrap_or((text, ""));
        let parameters = if parameters.is_empty() { Some(Vec::new()) } else { numbers(parameters) };
        let polynomial = match (family, parameters.as_deref()) {
            ("tchebichef", Some([])) => Tchebichef.into(),
            ("cosine", Some([])) => Cosine.into(),
            ("krawtchouk", Some(&[p])) => Krawtchouk { p, lattice: Lattice::Exact }.into(),
            ("hahn", Some(&[a, b])) => Hahn { a, b }.into(),
            _ => return Err(format!("expected tchebichef, cosine, krawtchouk:P or hahn:A,B, got '{text}'")),
        };
        Ok(PolynomialOption(polynomial))
    }
}

impl fmt::Display for PolynomialOption {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0 {
            Polynomial::Hahn(Hahn { a, b }) => write!(f, "Hahn (a = {a}, b = {b})"),
            Polynomial::Krawtchouk(Krawtchouk { p, .. }) => write!(f, "Krawtchouk (p = {p})"),
            Polynomial::Tchebichef(_) => f.write_str("Tchebichef"),
            Polynomial::Cosine(_) => f.write_str("cosine"),
        }
    }
}

/// Those of the paper's figures of Section II.
fn of_the_paper() -> Vec<PolynomialOption> {
    let words = ["tchebichef", "krawtchouk:0.25", "krawtchouk:0.75", "hahn:0,0", "hahn:7680,2560", "hahn:2560,7680"];
    words.iter().map(|word| word.parse().expect("a test parses them")).collect()
}

/// Draws and writes.
///
/// # Errors
/// Fails when a basis cannot be, or the folder cannot be written.
pub fn run(args: &BasisArgs, _: Paint) -> anyhow::Result<ExitCode> {
    let chosen = if args.polynomials.is_empty() { of_the_paper() } else { args.polynomials.clone() };
    let (length, rows) = (usize::from(args.length), usize::from(args.degree) + 1);
    let bases = chosen
        .iter()
        .map(|one| Basis::new(length, rows, one.0).map(|basis| (one.to_string(), basis)).context(one.to_string()))
        .collect::<anyhow::Result<Vec<_>>>()?;
    let panels: Vec<Panel> = bases.iter().map(|(name, basis)| panel(name, basis)).collect();
    let operators = chosen
        .iter()
        .map(|one| operators(*one))
        .collect::<anyhow::Result<Vec<_>>>()?
        .into_iter()
        .flatten()
        .collect::<Vec<_>>();
    let per_row = (0..=OPERATOR_ORDER).map(|order| order + 1).sum();
    let plots = [
        Plot { name: "polynomials", svg: charts(&panels)? },
        Plot { name: "operators", svg: heats(&operators, per_row)? },
    ];
    std::fs::create_dir_all(&args.out).with_context(|| format!("cannot make {}", args.out.display()))?;
    write_plots(&args.out, &plots)?;
    write_csv(&args.out.join("basis.csv"), &bases)?;
    let mut page = Page::new("Polynomials and operators");
    page.text(&format!("Orthonormal on N = {length} pixels, degrees 0 to {}.", args.degree));
    page.wide(&plots);
    let path = args.out.join("index.html");
    std::fs::write(&path, page.finish()).with_context(|| format!("cannot write {}", path.display()))?;
    print_line(&format!("plots: {}", path.display())).context("cannot write the result")?;
    Ok(exit::done())
}

fn panel(name: &str, basis: &Basis) -> Panel {
    let series = (0..basis.rows()).map(|n| Series {
        label: format!("n={n}"),
        points: basis.row(n).iter().enumerate().map(|(u, value)| (u as f64, *value)).collect(),
    });
    Panel {
        title: name.to_owned(),
        x_label: "u (pixels)".into(),
        y_label: "normalized polynomial".into(),
        scale: Scale::Linear,
        series: series.collect(),
    }
}

/// `p_n(u) p_m(v)` for the lowest orders.
fn operators(one: PolynomialOption) -> anyhow::Result<Vec<Heat>> {
    let basis = Basis::new(OPERATOR_PIXELS, OPERATOR_ORDER + 1, one.0).with_context(|| one.to_string())?;
    let mut maps = Vec::new();
    for order in 0..=OPERATOR_ORDER {
        for n in (0..=order).rev() {
            let m = order - n;
            let values = basis.row(m).iter().flat_map(|v| basis.row(n).iter().map(move |u| u * v)).collect();
            let end = (OPERATOR_PIXELS - 1) as f64;
            maps.push(Heat {
                title: format!("{one}: n = {n}, m = {m}"),
                width: OPERATOR_PIXELS,
                values,
                ranges: [[0.0, end]; 2],
                labels: ["u (pixels)".into(), "v (pixels)".into()],
                colors: Colors::Signed,
            });
        }
    }
    Ok(maps)
}

fn write_csv(path: &std::path::Path, bases: &[(String, Basis)]) -> anyhow::Result<()> {
    let failed = || format!("cannot write {}", path.display());
    let mut writer = csv::Writer::from_path(path).with_context(failed)?;
    writer.write_record(["polynomial", "n", "u", "value"]).with_context(failed)?;
    for (name, basis) in bases {
        for n in 0..basis.rows() {
            for (u, value) in basis.row(n).iter().enumerate() {
                let cells = [name.clone(), n.to_string(), u.to_string(), value.to_string()];
                writer.write_record(cells).with_context(failed)?;
            }
        }
    }
    writer.flush().with_context(failed)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_papers_six_parse_and_have_bases() {
        let six = of_the_paper();
        assert_eq!(six.len(), 6);
        assert!(six.iter().all(|one| Basis::new(512, 6, one.0).is_ok()));
        assert_eq!(six[4].to_string(), "Hahn (a = 7680, b = 2560)");
    }

    #[test]
    fn what_is_no_polynomial_is_refused() {
        for bad in ["hahn", "hahn:1", "krawtchouk:x", "legendre", "cosine:2"] {
            assert!(bad.parse::<PolynomialOption>().is_err(), "{bad}");
        }
    }
}
