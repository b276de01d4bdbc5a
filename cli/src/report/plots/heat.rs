//! Heat maps beside each other with contour lines, as one SVG: the values are a small PNG inside it, stretched, and the
//! contours are found by marching squares.

use std::fmt::Write;
use std::io::Cursor;

use anyhow::Context;
use image::{ImageFormat, Rgb, RgbImage};

use super::chart::plain;
use crate::report::base64;

/// Side of a map, and room around it, in pixels.
const SIDE: f64 = 300.0;
const LEFT: f64 = 58.0;
const ABOVE: f64 = 34.0;
const BELOW: f64 = 46.0;
const RIGHT: f64 = 18.0;
/// Contour lines between the least and the largest value.
const LEVELS: usize = 12;

/// One map, rows from top to bottom. What is not finite is white.
pub struct Heat {
    /// Above it.
    pub title: String,
    /// Values in a row.
    pub width: usize,
    /// Row by row.
    pub values: Vec<f64>,
    /// From the first to the last value of a row, and of a column.
    pub ranges: [[f64; 2]; 2],
    /// Under and beside it.
    pub labels: [String; 2],
    /// What its colours mean.
    pub colors: Colors,
}

/// How values become colours.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Colors {
    /// Dark blue for the least to yellow for the largest, with contour lines.
    Landscape,
    /// Blue below zero, white at it, red above.
    Signed,
}

/// The maps in rows of `columns`.
pub fn heats(maps: &[Heat], columns: usize) -> anyhow::Result<String> {
    let (cell_width, cell_height) = (LEFT + SIDE + RIGHT, ABOVE + SIDE + BELOW);
    let rows = maps.len().div_ceil(columns.max(1)).max(1);
    let (width, height) = (cell_width * columns.min(maps.len().max(1)) as f64, cell_height * rows as f64);
    let mut svg = format!(
        "<svg width=\"{width}\" height=\"{height}\" viewBox=\"0 0 {width} {height}\" \
         xmlns=\"http://www.w3.org/2000/svg\" font-family=\"sans-serif\" fill=\"#2d2d2d\">\n\
         <rect width=\"{width}\" height=\"{height}\" fill=\"#fff\"/>\n"
    );
    for (index, map) in maps.iter().enumerate() {
        let (column, row) = (index % columns, index / columns);
        let (x, y) = (column as f64 * cell_width + LEFT, row as f64 * cell_height + ABOVE);
        writeln!(svg, "<g transform=\"translate({x} {y})\">")?;
        draw(&mut svg, map)?;
        svg.push_str("</g>\n");
    }
    svg.push_str("</svg>\n");
    Ok(svg)
}

fn draw(svg: &mut String, map: &Heat) -> anyhow::Result<()> {
    let data = base64(&png(map)?);
    writeln!(svg, "<text x=\"0\" y=\"-12\" font-size=\"15\">{}</text>", map.title)?;
    writeln!(
        svg,
        "<image width=\"{SIDE}\" height=\"{SIDE}\" preserveAspectRatio=\"none\" image-rendering=\"pixelated\" \
         href=\"data:image/png;base64,{data}\"/>"
    )?;
    if map.colors == Colors::Landscape {
        writeln!(svg, "<path d=\"{}\" fill=\"none\" stroke=\"#fff\" stroke-width=\".8\"/>", contours(map))?;
    }
    writeln!(svg, "<rect width=\"{SIDE}\" height=\"{SIDE}\" fill=\"none\" stroke=\"#888\"/>")?;
    let [[left, right], [top, bottom]] = map.ranges;
    let marks = [0.0, 0.5, 1.0];
    for mark in marks {
        let (u, v) = (plain(left + mark * (right - left)), plain(top + mark * (bottom - top)));
        let at = mark * SIDE;
        writeln!(svg, "<text x=\"{at}\" y=\"{}\" font-size=\"12\" text-anchor=\"middle\">{u}</text>", SIDE + 16.0)?;
        writeln!(svg, "<text x=\"-6\" y=\"{}\" font-size=\"12\" text-anchor=\"end\">{v}</text>", at + 4.0)?;
    }
    let [along, down] = &map.labels;
    let (middle, under) = (SIDE / 2.0, SIDE + 34.0);
    writeln!(svg, "<text x=\"{middle}\" y=\"{under}\" font-size=\"13\" text-anchor=\"middle\">{along}</text>")?;
    writeln!(
        svg,
        "<text transform=\"translate(-44 {middle}) rotate(-90)\" font-size=\"13\" text-anchor=\"middle\">{down}</text>"
    )?;
    Ok(())
}

fn png(map: &Heat) -> anyhow::Result<Vec<u8>> {
    let height = map.values.len() / map.width.max(1);
    let (least, largest) = extremes(&map.values);
    let color = |value: f64| match map.colors {
        _ if !value.is_finite() => Rgb([255; 3]),
        Colors::Landscape => ramp((value - least) / (largest - least).max(f64::MIN_POSITIVE), &VIRIDIS),
        Colors::Signed => ramp(0.5 + 0.5 * value / least.abs().max(largest.abs()).max(f64::MIN_POSITIVE), &SIGNED),
    };
    let image = RgbImage::from_fn(map.width as u32, height as u32, |u, v| {
        color(map.values[v as usize * map.width + u as usize])
    });
    let mut bytes = Cursor::new(Vec::new());
    image.write_to(&mut bytes, ImageFormat::Png).context("cannot make a PNG")?;
    Ok(bytes.into_inner())
}

/// Nine colours of matplotlib's viridis, evenly spaced.
const VIRIDIS: [[u8; 3]; 9] = [
    [68, 1, 84],
    [71, 44, 122],
    [59, 81, 139],
    [44, 113, 142],
    [33, 144, 141],
    [39, 173, 129],
    [92, 200, 99],
    [170, 220, 50],
    [253, 231, 37],
];
const SIGNED: [[u8; 3]; 3] = [[33, 102, 172], [247, 247, 247], [178, 24, 43]];

/// The colour at `part` in 0..1 of evenly spaced `colors`.
fn ramp(part: f64, colors: &[[u8; 3]]) -> Rgb<u8> {
    let place = part.clamp(0.0, 1.0) * (colors.len() - 1) as f64;
    let first = (place as usize).min(colors.len() - 2);
    let left = place - first as f64;
    let mix = |a: u8, b: u8| (f64::from(a) + left * (f64::from(b) - f64::from(a))).round() as u8;
    Rgb([0, 1, 2].map(|i| mix(colors[first][i], colors[first + 1][i])))
}

fn extremes(values: &[f64]) -> (f64, f64) {
    let finite = values.iter().copied().filter(|value| value.is_finite());
    finite.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| (low.min(value), high.max(value)))
}

/// The lines of equal value as a path: in each square of four values, from edge to edge.
fn contours(map: &Heat) -> String {
    let height = map.values.len() / map.width.max(1);
    let (least, largest) = extremes(&map.values);
    let mut path = String::new();
    // A value stands for the middle of its pixel.
    let place = |u: f64, count: usize| (u + 0.5) * SIDE / count as f64;
    for level in (1..LEVELS).map(|i| least + (largest - least) * i as f64 / LEVELS as f64) {
        for v in 0..height.saturating_sub(1) {
            for u in 0..map.width - 1 {
                let corners = [(u, v), (u + 1, v), (u + 1, v + 1), (u, v + 1)];
                let at = |(u, v): (usize, usize)| map.values[v * map.width + u] - level;
                let crossings: Vec<(f64, f64)> = (0..4)
                    .filter_map(|i| {
                        crossing((corners[i], at(corners[i])), (corners[(i + 1) % 4], at(corners[(i + 1) % 4])))
                    })
                    .collect();
                for pair in crossings.chunks_exact(2) {
                    let [a, b] = [pair[0], pair[1]].map(|(u, v)| (place(u, map.width), place(v, height)));
                    let _ = write!(path, "M{:.1} {:.1}L{:.1} {:.1}", a.0, a.1, b.0, b.1);
                }
            }
        }
    }
    path
}

/// Where a line between two corners with these values crosses zero.
fn crossing((a, at_a): ((usize, usize), f64), (b, at_b): ((usize, usize), f64)) -> Option<(f64, f64)> {
    let crosses = at_a.is_finite() && at_b.is_finite() && (at_a < 0.0) != (at_b < 0.0);
    let part = at_a / (at_a - at_b);
    let between = |a: usize, b: usize| a as f64 + part * (b as f64 - a as f64);
    crosses.then(|| (between(a.0, b.0), between(a.1, b.1)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bowl(colors: Colors) -> Heat {
        let value = |i: usize| ((i % 9) as f64 - 4.0).powi(2) + ((i / 9) as f64 - 4.0).powi(2);
        Heat {
            title: "bowl".into(),
            width: 9,
            values: (0..81).map(value).collect(),
            ranges: [[-0.2, 0.2], [-0.2, 0.2]],
            labels: ["x (m)".into(), "y (m)".into()],
            colors,
        }
    }

    #[test]
    fn a_map_has_its_title_its_labels_and_its_contours() {
        let svg = heats(&[bowl(Colors::Landscape), bowl(Colors::Signed)], 2).expect("an SVG");
        assert!(svg.starts_with("<svg") && svg.ends_with("</svg>\n"));
        for word in ["bowl", "x (m)", "y (m)", "−0.2", "data:image/png;base64,"] {
            assert!(svg.contains(word), "{word}");
        }
        assert_eq!(svg.matches("<path").count(), 1, "only a landscape has contours");
    }

    #[test]
    fn a_contour_of_a_bowl_is_at_the_distance_of_its_level() {
        let map = bowl(Colors::Landscape);
        // Of the largest value 32, levels are 32/12 apart.
        let path = contours(&map);
        let numbers: Vec<f64> = path
            .split(['M', 'L', ' '])
            .filter(|part| !part.is_empty())
            .map(|part| part.parse().expect("a number"))
            .collect();
        let middle = SIDE / 2.0;
        let pixel = SIDE / 9.0;
        let (x, y) = ((numbers[0] - middle) / pixel, (numbers[1] - middle) / pixel);
        // Interpolation between values one apart is off by less than a quarter in the square.
        assert!(((x * x + y * y) - 32.0 / 12.0).abs() < 0.3, "{x} {y}");
    }

    #[test]
    fn colours_run_from_end_to_end() {
        assert_eq!(ramp(0.0, &VIRIDIS), Rgb([68, 1, 84]));
        assert_eq!(ramp(1.0, &VIRIDIS), Rgb([253, 231, 37]));
        assert_eq!(ramp(0.5, &SIGNED), Rgb([247, 247, 247]));
    }
}
