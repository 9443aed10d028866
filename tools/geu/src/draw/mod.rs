//! Figures of a unit, as SVG: one or two panels, one above the other.

mod figures;

use std::path::Path;

use geu_model::Configuration;
use plotters::coord::Shift;
use plotters::prelude::*;

use crate::failure::Failure;
use crate::outputs::write;

/// Width and height of a figure, pixels.
const SIZE: (u32, u32) = (1000, 720);
/// Colours of the series in order, told apart by eyes that see red and green alike (Okabe and Ito).
const COLOURS: [RGBColor; 4] =
    [RGBColor(0, 114, 178), RGBColor(213, 94, 0), RGBColor(0, 158, 115), RGBColor(204, 121, 167)];
const FONT: &str = "sans-serif";

/// An axis: what it tells, with its unit.
pub type Axis = &'static str;

/// How points are shown.
#[derive(Clone, Copy, PartialEq)]
pub enum Mark {
    /// Joined by lines.
    Line,
    /// Each by itself.
    Points,
    /// Held from point to point.
    Steps,
}

/// Points with a name.
pub struct Series {
    /// Name in the legend.
    pub name: String,
    /// How they are shown.
    pub mark: Mark,
    /// The points.
    pub points: Vec<(f64, f64)>,
}

/// One diagram.
pub struct Panel {
    /// Above it.
    pub title: String,
    /// Below it.
    pub x: Axis,
    /// Beside it.
    pub y: Axis,
    /// What is drawn.
    pub series: Vec<Series>,
    /// Levels to compare with, dashed, with a name.
    pub levels: Vec<(f64, String)>,
}

/// The files that [`draw`] writes.
pub fn names() -> impl Iterator<Item = &'static str> {
    figures::FIGURES.iter().map(|(name, _)| *name)
}

/// Draws every figure of the unit into a directory, which is made if it is not there.
///
/// # Errors
/// A directory or file that cannot be written.
pub fn draw(directory: &Path, configuration: &Configuration) -> Result<(), Failure> {
    let failed = |path: &Path, error: &dyn std::fmt::Display| {
        Failure::failed(format!("cannot write {}: {error}", path.display()))
    };
    std::fs::create_dir_all(directory).map_err(|error| failed(directory, &error))?;
    for (name, figure) in figures::FIGURES {
        let path = directory.join(name);
        let mut text = String::new();
        svg(&mut text, &figure(configuration)).map_err(|error| failed(&path, &error))?;
        write(&path, text)?;
        crate::failure::note(format_args!("{}\n", path.display()));
    }
    Ok(())
}

type Drawn = Result<(), Box<dyn std::error::Error>>;

fn svg(text: &mut String, panels: &[Panel]) -> Drawn {
    let area = SVGBackend::with_string(text, SIZE).into_drawing_area();
    area.fill(&WHITE)?;
    for (panel, area) in panels.iter().zip(area.margin(8, 8, 8, 16).split_evenly((panels.len(), 1))) {
        draw_panel(panel, &area)?;
    }
    area.present()?;
    Ok(())
}

fn draw_panel(panel: &Panel, area: &DrawingArea<SVGBackend, Shift>) -> Drawn {
    let xs = panel.series.iter().flat_map(|series| series.points.iter().map(|point| point.0));
    let ys = panel.series.iter().flat_map(|series| series.points.iter().map(|point| point.1));
    let (x, y) = (extent(xs, 0.01), extent(ys.chain(panel.levels.iter().map(|level| level.0)), 0.08));
    // Room for the legend above what is drawn.
    let entries = panel.series.len() + usize::from(!panel.levels.is_empty());
    let y = (y.0, y.1 + (y.1 - y.0) * (0.1 * entries as f64));
    let mut chart = ChartBuilder::on(area)
        .caption(&panel.title, (FONT, 19))
        .margin(6)
        .x_label_area_size(42)
        .y_label_area_size(76)
        .build_cartesian_2d(x.0..x.1, y.0..y.1)?;
    let (x_decimals, y_decimals) = (decimals(x), decimals(y));
    chart
        .configure_mesh()
        .x_desc(panel.x)
        .y_desc(panel.y)
        .x_labels(12)
        .y_labels(8)
        .x_label_formatter(&|value| tick(*value, x_decimals))
        .y_label_formatter(&|value| tick(*value, y_decimals))
        .axis_desc_style((FONT, 15))
        .label_style((FONT, 13))
        .light_line_style(WHITE)
        .bold_line_style(RGBColor(225, 225, 225))
        .draw()?;
    for (index, (level, name)) in panel.levels.iter().enumerate() {
        let line = DashedLineSeries::new([(x.0, *level), (x.1, *level)], 6, 5, RGBColor(110, 110, 110).into());
        let drawn = chart.draw_series(line)?;
        // Levels of one name are told once.
        if panel.levels[..index].iter().all(|(_, before)| before != name) {
            drawn.label(name).legend(|(x, y)| PathElement::new([(x, y), (x + 22, y)], RGBColor(110, 110, 110)));
        }
    }
    for (series, colour) in panel.series.iter().zip(COLOURS.iter().cycle()) {
        let points = series.points.iter().copied();
        let drawn = match series.mark {
            Mark::Points => chart.draw_series(points.map(|point| Circle::new(point, 4, colour.filled())))?,
            Mark::Line => chart.draw_series(LineSeries::new(points, colour.stroke_width(2)))?,
            Mark::Steps => {
                let held = series.points.windows(2).flat_map(|pair| [pair[0], (pair[1].0, pair[0].1)]);
                chart.draw_series(LineSeries::new(held, colour.stroke_width(2)))?
            }
        };
        drawn.label(&series.name).legend(move |(x, y)| PathElement::new([(x, y), (x + 22, y)], colour.stroke_width(3)));
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperRight)
        .background_style(WHITE.mix(0.85))
        .border_style(RGBColor(200, 200, 200))
        .label_font((FONT, 13))
        .legend_area_size(28)
        .draw()?;
    Ok(())
}

/// Least and greatest, and a share of room beyond them.
fn extent(values: impl Iterator<Item = f64>, room: f64) -> (f64, f64) {
    let (least, greatest) = values
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(least, greatest), value| (least.min(value), greatest.max(value)));
    if least > greatest {
        return (0.0, 1.0);
    }
    let room = room * (greatest - least);
    if greatest - least < 1e-9 { (least - 1.0, greatest + 1.0) } else { (least - room, greatest + room) }
}

/// Decimals that tell ticks a tenth of the range apart.
fn decimals(range: (f64, f64)) -> usize {
    (1.0 - (range.1 - range.0).log10().floor()).clamp(0.0, 9.0) as usize
}

/// A tick's text, without the sign of zero and without decimals that say nothing.
fn tick(value: f64, decimals: usize) -> String {
    let text = format!("{value:.decimals$}");
    let text = if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
    if text == "-0" { "0".to_owned() } else { text.replace('-', "−") }
}
