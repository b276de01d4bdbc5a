//! Line charts under each other, drawn by plotters: one style, a title and a legend above each panel, never on the data.

use std::ops::Range;

use anyhow::anyhow;
use plotters::coord::Shift;
use plotters::prelude::*;

/// Pixels of one panel; panels stand under each other.
const PANEL_SIZE: (u32, u32) = (860, 330);
/// Height of the strip above the axes that holds the title and the legend.
const HEAD_PX: i32 = 40;
/// Beyond this many points the line alone is drawn.
const MOST_DOTS: usize = 150;
pub const FONT: &str = "sans-serif";
pub const TEXT: RGBColor = RGBColor(45, 45, 45);
pub const GRID: RGBColor = RGBColor(228, 228, 228);
/// Okabe and Ito's colours, which people who see fewer colours can still tell apart.
pub const COLORS: [RGBColor; 8] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(230, 159, 0),
    RGBColor(86, 180, 233),
    RGBColor(90, 90, 90),
    RGBColor(140, 86, 40),
];

/// One set of axes.
pub struct Panel {
    /// Above the axes, on the left.
    pub title: String,
    /// Under the horizontal axis.
    pub x_label: String,
    /// Beside the vertical axis.
    pub y_label: String,
    /// Of the vertical axis.
    pub scale: Scale,
    /// What is drawn.
    pub series: Vec<Series>,
}

/// How the vertical axis runs.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Scale {
    /// Evenly.
    Linear,
    /// Whole numbers, ticks included.
    Whole,
    /// Powers of ten; values that are not above 0 are left out.
    Log,
}

/// One line. Points that are not finite interrupt it.
pub struct Series {
    /// In the legend; empty for none.
    pub label: String,
    /// From left to right.
    pub points: Vec<(f64, f64)>,
}

pub type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
type Failed = anyhow::Error;

/// Draws `panels` under each other; returns the text of an SVG.
pub fn charts(panels: &[Panel]) -> anyhow::Result<String> {
    let (width, height) = PANEL_SIZE;
    svg((width, height * panels.len() as u32), |root| {
        for (area, panel) in root.split_evenly((panels.len(), 1)).iter().zip(panels) {
            draw_panel(area, panel)?;
        }
        Ok(())
    })
}

/// The text of an SVG of this size in pixels, drawn on white.
pub fn svg(size: (u32, u32), draw: impl FnOnce(&Area<'_>) -> Result<(), Failed>) -> Result<String, Failed> {
    let mut text = String::new();
    {
        let root = SVGBackend::with_string(&mut text, size).into_drawing_area();
        root.fill(&WHITE).map_err(drawing)?;
        draw(&root)?;
        root.present().map_err(drawing)?;
    }
    Ok(text)
}

/// plotters' errors borrow from the drawing area; their words are all that is kept.
pub fn drawing(error: impl std::fmt::Display) -> anyhow::Error {
    anyhow!("{error}")
}

fn draw_panel(area: &Area<'_>, panel: &Panel) -> Result<(), Failed> {
    let labels = panel.series.iter().map(|series| series.label.as_str());
    let body = draw_head(area, &panel.title, labels)?;
    let drawn: Vec<Series> = panel.series.iter().map(|series| on_scale(series, panel.scale)).collect();
    let points = || drawn.iter().flat_map(|series| &series.points).filter(|point| point.1.is_finite());
    let x_range = span(panel.series.iter().flat_map(|series| &series.points).map(|point| point.0));
    let y_range = match panel.scale {
        Scale::Linear => padded(span(points().map(|point| point.1))),
        Scale::Whole => whole(span(points().map(|point| point.1))),
        Scale::Log => decades(span(points().map(|point| point.1))),
    };
    let mut chart = ChartBuilder::on(&body)
        .margin_left(14)
        .margin_right(24)
        .margin_bottom(6)
        .x_label_area_size(42)
        .y_label_area_size(84)
        .build_cartesian_2d(at_least_one(x_range), y_range.clone())
        .map_err(drawing)?;
    chart
        .configure_mesh()
        .x_desc(&panel.x_label)
        .y_desc(&panel.y_label)
        .x_label_formatter(&|value| plain(*value))
        .y_label_formatter(&|value| {
            if panel.scale == Scale::Log { power(*value) } else { plain(*value) }
        })
        .x_labels(10)
        .y_labels(tick_count(panel.scale, &y_range))
        .axis_style(TEXT.mix(0.6))
        .bold_line_style(GRID)
        .light_line_style(TRANSPARENT)
        .label_style((FONT, 14).into_font().color(&TEXT))
        .axis_desc_style((FONT, 15).into_font().color(&TEXT))
        .draw()
        .map_err(drawing)?;
    for (series, color) in drawn.iter().zip(COLORS.iter().cycle()) {
        for piece in pieces(&series.points) {
            chart.draw_series(LineSeries::new(piece.iter().copied(), color.stroke_width(2))).map_err(drawing)?;
        }
        let dense = series.points.len() > MOST_DOTS;
        let known = series.points.iter().filter(|point| point.1.is_finite() && !dense);
        let dots = known.map(|point| Circle::new(*point, 2, color.filled()));
        chart.draw_series(dots).map_err(drawing)?;
    }
    Ok(())
}

/// Writes the title on the left and the legend on the right; returns the area below them.
fn draw_head<'a, 'l>(area: &Area<'a>, title: &str, labels: impl Iterator<Item = &'l str>) -> Result<Area<'a>, Failed> {
    let (head, body) = area.split_vertically(HEAD_PX);
    let style = (FONT, 18).into_font().color(&TEXT);
    head.draw(&Text::new(title.to_owned(), (20, 13), style)).map_err(drawing)?;
    let labels: Vec<&str> = labels.filter(|label| !label.is_empty()).collect();
    let entry_px = |label: &str| 46 + 8 * label.chars().count() as i32;
    let mut x = head.dim_in_pixel().0 as i32 - 24 - labels.iter().map(|label| entry_px(label)).sum::<i32>();
    for (label, color) in labels.iter().zip(COLORS.iter().cycle()) {
        head.draw(&PathElement::new(vec![(x, 22), (x + 24, 22)], color.stroke_width(3))).map_err(drawing)?;
        let style = (FONT, 15).into_font().color(&TEXT);
        head.draw(&Text::new((*label).to_owned(), (x + 31, 14), style)).map_err(drawing)?;
        x += entry_px(label);
    }
    Ok(body)
}

/// The points as they are drawn: on a log axis, the logarithm to the base 10.
fn on_scale(series: &Series, scale: Scale) -> Series {
    let draw = |value: f64| match scale {
        Scale::Log if value > 0.0 => value.log10(),
        Scale::Log => f64::NAN,
        Scale::Linear | Scale::Whole => value,
    };
    let points = series.points.iter().map(|&(x, y)| (x, draw(y))).collect();
    Series { label: series.label.clone(), points }
}

/// Runs of points without a gap.
fn pieces(points: &[(f64, f64)]) -> impl Iterator<Item = &[(f64, f64)]> {
    points.split(|point| !point.1.is_finite()).filter(|piece| !piece.is_empty())
}

/// The smallest range that holds every finite value; 0..1 when there is none.
pub fn span(values: impl Iterator<Item = f64>) -> Range<f64> {
    let values = values.filter(|value| value.is_finite());
    let (low, high) =
        values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| (low.min(value), high.max(value)));
    if low <= high { low..high } else { 0.0..1.0 }
}

/// A little room above and below, and a height for what is flat.
fn padded(range: Range<f64>) -> Range<f64> {
    let height = range.end - range.start;
    let room = if height > 0.0 { 0.06 * height } else { (0.1 * range.end.abs()).max(1e-3) };
    range.start - room..range.end + room
}

fn whole(range: Range<f64>) -> Range<f64> {
    (range.start - 1.0).floor().max(0.0)..(range.end + 1.0).ceil()
}

/// Whole decades.
fn decades(range: Range<f64>) -> Range<f64> {
    let (low, high) = (range.start.floor(), range.end.ceil());
    if low < high { low..high } else { low..low + 1.0 }
}

fn at_least_one(range: Range<f64>) -> Range<f64> {
    range.start..range.end.max(range.start + 1.0)
}

fn tick_count(scale: Scale, range: &Range<f64>) -> usize {
    match scale {
        Scale::Linear | Scale::Whole => 7,
        Scale::Log => (range.end - range.start) as usize + 1,
    }
}

/// 0.25, 12, −0.001: no trailing zeros, no rounding noise.
pub fn plain(value: f64) -> String {
    let rounded = (value * 1e6).round() / 1e6;
    let text = if rounded == 0.0 { "0".to_owned() } else { rounded.to_string() };
    text.replace('-', "−")
}

/// The label of 10^`exponent`; nothing between whole decades.
fn power(exponent: f64) -> String {
    let whole = exponent.round();
    if (exponent - whole).abs() > 1e-6 {
        return String::new();
    }
    match whole as i32 {
        small @ -3..=3 => plain(10f64.powi(small)),
        other => format!("1e{other}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_gap_splits_a_line() {
        let points = [(0.0, 1.0), (1.0, f64::NAN), (2.0, 3.0), (3.0, 4.0)];
        let lengths: Vec<usize> = pieces(&points).map(<[_]>::len).collect();
        assert_eq!(lengths, [1, 2]);
    }

    #[test]
    fn ranges_are_never_empty() {
        assert_eq!(span([f64::NAN].into_iter()), 0.0..1.0);
        for range in [padded(0.0..0.0), padded(5.0..5.0), whole(4.0..4.0), decades(-2.0..-2.0), at_least_one(0.0..0.0)]
        {
            assert!(range.start < range.end, "{range:?}");
        }
        assert_eq!(decades(-3.2..-1.1), -4.0..-1.0);
    }

    #[test]
    fn labels_have_no_rounding_noise() {
        assert_eq!(plain(0.1 + 0.2), "0.3");
        assert_eq!(plain(-1e-18), "0");
        assert_eq!(plain(-0.05), "−0.05");
        assert_eq!(power(-2.0), "0.01");
        assert_eq!(power(-5.0), "1e-5");
        assert_eq!(power(-2.5), "");
    }
}
