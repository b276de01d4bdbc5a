//! A page of one's own for an experiment: one HTML file with its plots and images inside, readable without scripts or network.

use std::fmt::Write;

use super::cells::Cell;
use super::outcome::Outcome;
use super::spec::{Experiment, Tolerance};
use crate::report::plots::Plot;
use crate::report::{base64, number};

const STYLE: &str = "\
:root{color-scheme:light}\
body{font:16px/1.5 system-ui,sans-serif;max-width:72rem;margin:2rem auto;padding:0 1rem;color:#222}\
table{border-collapse:collapse;margin:1rem 0}th,td{padding:.25rem .8rem;border-bottom:1px solid #ddd;text-align:right}\
th:first-child,td:first-child{text-align:left}\
.good{color:#0a6b3d}.bad{color:#a62b00}\
figure{margin:1rem 0}figcaption{color:#555;font-size:.9rem}svg{max-width:100%;height:auto}\
img{max-width:100%;image-rendering:pixelated}details{margin:.5rem 0}summary{cursor:pointer}\
.pair{display:grid;grid-template-columns:repeat(auto-fit,minmax(24rem,1fr));gap:1rem}\
code{background:#f3f3f3;padding:.1rem .3rem}";

/// A page that grows from top to bottom.
pub struct Page {
    html: String,
}

impl Page {
    /// A page with its heading.
    pub fn new(title: &str) -> Page {
        let title = escaped(title);
        let html = format!(
            "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
             <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n<title>{title}</title>\n\
             <style>{STYLE}</style>\n</head>\n<body>\n<h1>{title}</h1>\n"
        );
        Page { html }
    }

    /// What the file says of itself, and where the rest is.
    pub fn introduction(&mut self, experiment: &Experiment) {
        if !experiment.about.is_empty() {
            self.text(&experiment.about);
        }
        let Tolerance { error_mm, error_deg } = experiment.tolerance;
        self.text(&format!(
            "domvs {}, seed {}. Converged: the camera ends within {error_mm} mm and {error_deg}° (where nothing else is said) by \
             the simulator's truth. Images: after how many it stayed there. Settled: the median error over the last images. \
             Path: its length over the straight line.",
            env!("CARGO_PKG_VERSION"),
            experiment.seed
        ));
    }

    /// A paragraph of plain text.
    pub fn text(&mut self, text: &str) {
        self.push(&format!("<p>{}</p>", escaped(text)));
    }

    /// How it was made: a command line.
    pub fn command(&mut self, command: &str) {
        self.push(&format!("<p><code>{}</code></p>", escaped(command)));
    }

    /// A heading of the second level.
    pub fn heading(&mut self, text: &str) {
        self.push(&format!("<h2>{}</h2>", escaped(text)));
    }

    /// A gray PNG with a caption.
    pub fn image(&mut self, png: &[u8], caption: &str) {
        let (data, caption) = (base64(png), escaped(caption));
        self.push(&format!(
            "<figure><img src=\"data:image/png;base64,{data}\" alt=\"{caption}\">\
             <figcaption>{caption}</figcaption></figure>"
        ));
    }

    /// Plots beside each other.
    pub fn plots<'a>(&mut self, plots: impl IntoIterator<Item = &'a Plot>) {
        self.push("<div class=\"pair\">");
        for plot in plots {
            self.push(&plot.svg);
        }
        self.push("</div>");
    }

    /// Plots under each other, each as wide as it is.
    pub fn wide<'a>(&mut self, plots: impl IntoIterator<Item = &'a Plot>) {
        for plot in plots {
            self.push(&format!("<figure>{}</figure>", plot.svg));
        }
    }

    /// Plots that are folded away until they are asked for.
    pub fn folded<'a>(&mut self, summary: &str, plots: impl IntoIterator<Item = &'a Plot>) {
        self.push(&format!("<details><summary>{}</summary>", escaped(summary)));
        self.plots(plots);
        self.push("</details>");
    }

    /// How each run ended.
    pub fn runs(&mut self, outcomes: &[&Outcome]) {
        let headings = ["method", "seed", "verdict", "status", "images", "error mm", "error °", "settled mm", "path"];
        self.table(
            &headings,
            outcomes.iter().map(|run| {
                let verdict = if run.converged { "converged" } else { "not converged" };
                let class = if run.converged { "good" } else { "bad" };
                [
                    escaped(&run.method),
                    run.seed.to_string(),
                    format!("<span class=\"{class}\">{verdict}</span>"),
                    escaped(&run.status),
                    run.images.map_or("–".into(), |images| images.to_string()),
                    number(run.error_mm),
                    number(run.error_deg),
                    number(run.settled_mm),
                    run.path_ratio.map_or("–".into(), |ratio| format!("{ratio:.2}")),
                ]
            }),
        );
    }

    /// Rates with their intervals.
    pub fn cells(&mut self, cells: &[Cell]) {
        let headings = ["scene", "disturbance", "method", "converged", "rate", "95 % interval", "images", "path"];
        self.table(
            &headings,
            cells.iter().map(|cell| {
                [
                    escaped(&cell.scene),
                    escaped(&cell.disturbance),
                    escaped(&cell.method),
                    format!("{}/{}", cell.successes, cell.runs),
                    format!("{:.1} %", 100.0 * cell.success_rate),
                    format!("{:.1}–{:.1} %", 100.0 * cell.wilson_low, 100.0 * cell.wilson_high),
                    cell.median_images.map_or("–".into(), |images| format!("{images:.0}")),
                    cell.median_path_ratio.map_or("–".into(), |ratio| format!("{ratio:.2}")),
                ]
            }),
        );
    }

    fn table<const N: usize>(&mut self, headings: &[&str; N], rows: impl Iterator<Item = [String; N]>) {
        let row = |tag: &str, cells: &[String]| {
            let cells: String = cells.iter().fold(String::new(), |mut row, cell| {
                let _ = write!(row, "<{tag}>{cell}</{tag}>");
                row
            });
            format!("<tr>{cells}</tr>")
        };
        self.push("<table>");
        self.push(&row("th", &headings.map(str::to_owned)));
        for cells in rows {
            self.push(&row("td", &cells));
        }
        self.push("</table>");
    }

    fn push(&mut self, html: &str) {
        self.html.push_str(html);
        self.html.push('\n');
    }

    /// The whole text.
    pub fn finish(mut self) -> String {
        self.push("</body>\n</html>");
        self.html
    }
}

/// Text that stays text in HTML.
pub(super) fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::super::cells::cells;
    use super::super::outcome::synthetic::outcome;
    use super::*;

    #[test]
    fn a_page_asks_for_nothing_from_outside_and_escapes_names() {
        let mut page = Page::new("A & <b>");
        let runs = [outcome("a")];
        page.runs(&[&runs[0]]);
        page.cells(&cells(&runs));
        page.image(b"png", "film");
        page.plots(&[Plot { name: "p", svg: "<svg></svg>".into() }]);
        let html = page.finish();
        assert!(html.contains("A &amp; &lt;b&gt;") && html.ends_with("</html>\n"));
        assert!(html.contains("data:image/png;base64,cG5n") && html.contains("<svg></svg>"));
        for outside in ["http:", "https:", "<script", "<link", "url("] {
            assert!(!html.contains(outside), "{outside}");
        }
    }
}
