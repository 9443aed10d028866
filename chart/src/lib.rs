//! Charts as SVG. One description serves pages, where [`SCRIPT`] adds zoom, pan and values under the pointer, and SVG files.
//!
//! Data keep their own coordinates below one transform, which the script changes to zoom. Colours are classes of [`STYLE`]
//! for the light and the dark theme.

mod decimate;
mod file;
mod text;
mod ticks;

use std::fmt::Write;

pub use decimate::min_max;
pub use file::{Panel, svg_file};
pub use text::escape;
use ticks::{Resolution, ticks};

/// Makes each `svg.chart` of a page interactive; `geuChart(svg)` does this for a later chart.
pub const SCRIPT: &str = include_str!("chart.js");
/// Style of charts, from the colours `--first`, `--second`, `--third`, `--bad`, `--soft`, `--rule` and `--raised`.
pub const STYLE: &str = include_str!("chart.css");

/// Largest number of columns of a series: a few per pixel, so that zooming shows more detail.
pub const MAX_COLUMNS: usize = 3000;

/// Margins around the frame, pixels.
const LEFT: f64 = 52.0;
const RIGHT: f64 = 8.0;
const TOP: f64 = 19.0;
const LINE_HEIGHT: f64 = 15.0;
/// Largest width of a character of a label, on a narrow screen, pixels.
const CHARACTER_PX: f64 = 8.5;

/// Path of a diamond, a cross, and an arrowhead that points to the right and ends at the origin.
pub const DIAMOND: &str = "M-5 0L0 -5L5 0L0 5Z";
pub const CROSS: &str = "M-4 -4L4 4M-4 4L4 -4";
pub const ARROW: &str = "M0 0L-10 -4.5L-10 4.5Z";

#[derive(Clone, Copy)]
enum Axis {
    X,
    Y,
}

/// A chart under construction.
pub struct Chart {
    label: String,
    size: (f64, f64),
    left: f64,
    x: (f64, f64),
    y: (f64, f64),
    bottom: f64,
    /// True if `y` is zoomed too.
    zooms_y: bool,
    /// Charts of one group share the range of `x`.
    group: Option<&'static str>,
    /// Smallest distance of different values of `x`.
    x_step: f64,
    units: [&'static str; 2],
    x_title: String,
    y_title: String,
    x_axis: String,
    y_axis: String,
    data: String,
    marks: String,
}

impl Chart {
    /// An empty chart over ranges with a descriptive `label`, and space for `lines` of text below it.
    pub fn new(label: &str, size: (f64, f64), x: (f64, f64), y: (f64, f64), lines: u8) -> Chart {
        Chart {
            label: label.to_owned(),
            size,
            left: LEFT,
            x,
            y,
            bottom: size.1 - 4.0 - LINE_HEIGHT * f64::from(lines),
            zooms_y: true,
            group: None,
            x_step: 0.0,
            units: [""; 2],
            x_title: String::new(),
            y_title: String::new(),
            x_axis: String::new(),
            y_axis: String::new(),
            data: String::new(),
            marks: String::new(),
        }
    }

    /// Sets the left margin.
    #[must_use]
    pub fn with_left(self, left: f64) -> Chart {
        Chart { left, ..self }
    }

    /// Zooms only along `x`.
    #[must_use]
    pub fn zooming_x(self) -> Chart {
        Chart { zooms_y: false, ..self }
    }

    /// Shares the zoomed range of `x` with the charts of one group.
    #[must_use]
    pub fn in_group(self, group: &'static str) -> Chart {
        Chart { group: Some(group), ..self }
    }

    /// `x` is an index: ticks are integers.
    #[must_use]
    pub fn counting_x(self) -> Chart {
        Chart { x_step: 1.0, ..self }
    }

    /// Units of the values under the pointer.
    #[must_use]
    pub fn units(self, x: &'static str, y: &'static str) -> Chart {
        Chart { units: [x, y], ..self }
    }

    fn x_px(&self, x: f64) -> f64 {
        self.left + (x - self.x.0) * self.x_scale()
    }

    fn y_px(&self, y: f64) -> f64 {
        self.bottom - (y - self.y.0) * self.y_scale()
    }

    /// Pixels per unit of `x`.
    fn x_scale(&self) -> f64 {
        (self.size.0 - self.left - RIGHT) / (self.x.1 - self.x.0)
    }

    fn y_scale(&self) -> f64 {
        (self.bottom - TOP) / (self.y.1 - self.y.0)
    }

    /// Width of a range of `x`, pixels.
    pub fn width_px(&self, x: f64) -> f64 {
        x * self.x_scale()
    }

    /// About `count` round ticks at the left, with lines across.
    pub fn y_ticks(&mut self, count: usize) {
        self.y_ticks_from(self.y.0, count);
    }

    /// Round ticks at the left from `min` on.
    pub fn y_ticks_from(&mut self, min: f64, count: usize) {
        for (at, text) in ticks((min, self.y.1), count) {
            self.tick(Axis::Y, at, &text, true);
        }
    }

    /// About `count` round ticks below, with lines across.
    pub fn x_ticks(&mut self, count: usize) {
        for (at, text) in ticks(self.x, count) {
            self.tick(Axis::X, at, &text, true);
        }
    }

    /// A text below at `x`; at an end of the axis it moves inwards, so that it is not cut.
    pub fn below(&mut self, x: f64, text: &str) {
        self.tick(Axis::X, x, text, false);
    }

    /// A text at the left at `y`.
    pub fn beside(&mut self, y: f64, text: &str) {
        self.tick(Axis::Y, y, text, false);
    }

    fn tick(&mut self, axis: Axis, at: f64, text: &str, has_line: bool) {
        let right = self.size.0 - RIGHT;
        let (line, label_px) = match axis {
            Axis::X => {
                let px = self.x_px(at);
                let half = 0.5 * CHARACTER_PX * text.chars().count() as f64;
                ([px, px, TOP, self.bottom], (px.min(self.size.0 - half).max(half), self.bottom + LINE_HEIGHT - 1.0))
            }
            Axis::Y => {
                let px = self.y_px(at);
                ([self.left, right, px, px], (self.left - 5.0, px + 4.0))
            }
        };
        let (anchor, out) = match axis {
            Axis::X => ("middle", &mut self.x_axis),
            Axis::Y => ("end", &mut self.y_axis),
        };
        if has_line {
            let class = if at == 0.0 { "zero" } else { "rule" };
            let [x1, x2, y1, y2] = line;
            let _ =
                writeln!(out, "<line class=\"{class}\" x1=\"{x1:.1}\" y1=\"{y1:.1}\" x2=\"{x2:.1}\" y2=\"{y2:.1}\"/>");
        }
        *out += &text_at(label_px, anchor, text);
    }

    /// Title of the x axis, in the second line.
    pub fn x_title(&mut self, text: &str) {
        text.clone_into(&mut self.x_title);
    }

    /// Title of the y axis, above it.
    pub fn y_title(&mut self, text: &str) {
        text.clone_into(&mut self.y_title);
    }

    fn resolution(&self) -> (Resolution, Resolution) {
        (Resolution::new(self.x), Resolution::new(self.y))
    }

    /// A straight line.
    pub fn line(&mut self, class: &str, from: (f64, f64), to: (f64, f64)) {
        let (x, y) = self.resolution();
        let _ = writeln!(
            self.data,
            "<line class=\"{class}\" x1=\"{}\" y1=\"{}\" x2=\"{}\" y2=\"{}\"/>",
            x.text(from.0),
            y.text(from.1),
            x.text(to.0),
            y.text(to.1)
        );
    }

    /// A box between two corners with a title.
    pub fn rectangle(&mut self, class: &str, from: (f64, f64), to: (f64, f64), title: &str) {
        let (x, y) = self.resolution();
        let (left, right) = (from.0.min(to.0), from.0.max(to.0));
        let (low, high) = (from.1.min(to.1), from.1.max(to.1));
        let _ = writeln!(
            self.data,
            "<rect class=\"{class}\" x=\"{}\" y=\"{}\" width=\"{}\" height=\"{}\"><title>{}</title></rect>",
            x.text(left),
            y.text(low),
            x.text((right - left).max(0.5 / self.x_scale())),
            y.text(high - low),
            escape(title)
        );
    }

    /// A closed line.
    pub fn polygon(&mut self, class: &str, points: impl IntoIterator<Item = (f64, f64)>) {
        let path = self.path_of(points);
        let _ = writeln!(self.data, "<path class=\"{class}\" d=\"{path}Z\"/>");
    }

    /// A series in runs with gaps between them; the pointer shows its values with its name.
    pub fn series(&mut self, class: &str, name: &str, runs: &[Vec<(f64, f64)>]) {
        let path: String = runs.iter().map(|run| self.path_of(run.iter().copied())).collect();
        let name = escape(name);
        let _ = writeln!(self.data, "<path class=\"{class}\" data-series=\"{name}\" d=\"{path}\"/>");
    }

    fn path_of(&self, points: impl IntoIterator<Item = (f64, f64)>) -> String {
        let (x, y) = self.resolution();
        let mut path = String::new();
        for (index, point) in points.into_iter().enumerate() {
            path.push(if index == 0 { 'M' } else { 'L' });
            let _ = write!(path, "{} {}", x.text(point.0), y.text(point.1));
        }
        path
    }

    /// A disc with what it is.
    pub fn dot(&mut self, class: &str, at: (f64, f64), title: &str) {
        self.put(at, &format!("<circle class=\"{class}\" r=\"3.2\"><title>{}</title></circle>", escape(title)));
    }

    /// A text centred at a place.
    pub fn within(&mut self, at: (f64, f64), text: &str) {
        self.put(at, &text_at((0.0, 4.0), "middle", text));
    }

    /// A mark with what it is, from its path about the origin; where it lies beyond the frame, an arrowhead of class
    /// `arrow` at the frame points to it.
    pub fn mark(&mut self, path: &str, class: &str, arrow: &str, at: (f64, f64), title: &str) {
        let (middle_x, middle_y) = ((self.x.0 + self.x.1) / 2.0, (self.y.0 + self.y.1) / 2.0);
        let (dx, dy) = (at.0 - middle_x, at.1 - middle_y);
        let beyond = (dx / (self.x.1 - self.x.0)).abs().max((dy / (self.y.1 - self.y.0)).abs()) * 2.0;
        let title = escape(title);
        if beyond <= 1.0 {
            return self.put(at, &format!("<path class=\"{class}\" d=\"{path}\"><title>{title}</title></path>"));
        }
        let degrees = (-dy * self.y_scale()).atan2(dx * self.x_scale()).to_degrees();
        let turned = format!("transform=\"rotate({degrees:.1})\"");
        let shape = format!("<path class=\"{arrow}\" d=\"{ARROW}\" {turned}><title>{title}</title></path>");
        self.put((middle_x + dx / beyond, middle_y + dy / beyond), &shape);
    }

    /// Something that keeps its size when the chart is zoomed.
    fn put(&mut self, at: (f64, f64), shape: &str) {
        let (x, y) = self.resolution();
        let (x_text, y_text) = (x.text(at.0), y.text(at.1));
        let (x_px, y_px) = (self.x_px(at.0), self.y_px(at.1));
        let shape = shape.trim_end();
        let _ = writeln!(
            self.marks,
            "<g data-at=\"{x_text} {y_text}\" transform=\"translate({x_px:.1} {y_px:.1})\">{shape}</g>"
        );
    }

    /// The finished SVG.
    pub fn finish(self) -> String {
        let ((width, height), left, bottom) = (self.size, self.left, self.bottom);
        let (frame_width, frame_height) = (width - left - RIGHT, bottom - TOP);
        let (x_scale, y_scale) = (self.x_scale(), self.y_scale());
        let matrix = [x_scale, 0.0, 0.0, -y_scale, left - self.x.0 * x_scale, bottom + self.y.0 * y_scale];
        let matrix = matrix.map(|value| format!("{value:.9e}")).join(" ");
        let group = self.group.map_or(String::new(), |group| format!(" data-group=\"{group}\""));
        let zoom = if self.zooms_y { "xy" } else { "x" };
        let mut text = format!(
            "<svg class=\"chart\" viewBox=\"0 0 {width} {height}\" data-frame=\"{left} {TOP} {} {bottom}\" data-x=\"{} {}\" \
             data-y=\"{} {}\" data-step=\"{}\" data-zoom=\"{zoom}\"{group} \
             data-x-unit=\"{}\" data-y-unit=\"{}\" role=\"img\" aria-label=\"{}\">\n",
            width - RIGHT,
            self.x.0,
            self.x.1,
            self.y.0,
            self.y.1,
            self.x_step,
            self.units[0],
            self.units[1],
            escape(&self.label)
        );
        let frame = format!("x=\"{left}\" y=\"{TOP}\" width=\"{frame_width:.1}\" height=\"{frame_height:.1}\"");
        let _ = write!(
            text,
            "<g class=\"y axis\">\n{}</g>\n<g class=\"x axis\">\n{}</g>\n<svg class=\"inside\" {frame} \
             viewBox=\"{left} {TOP} {frame_width:.1} {frame_height:.1}\">\n<g class=\"data\" transform=\"matrix({matrix})\">\n{}</g>\n\
             <g class=\"marks\">\n{}</g>\n</svg>\n<rect class=\"frame\" {frame}/>\n",
            self.y_axis, self.x_axis, self.data, self.marks
        );
        if !self.y_title.is_empty() {
            text += &text_at((left, TOP - 6.0), "start", &self.y_title);
        }
        if !self.x_title.is_empty() {
            let middle = left + 0.5 * frame_width;
            text += &text_at((middle, bottom + 2.0 * LINE_HEIGHT - 1.0), "middle", &self.x_title);
        }
        text + "</svg>\n"
    }
}

fn text_at((x, y): (f64, f64), anchor: &str, text: &str) -> String {
    format!("<text x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"{anchor}\">{}</text>\n", escape(text))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_at_the_ends_of_an_axis_lie_within_the_chart() {
        let mut chart = Chart::new("times", (480.0, 200.0), (0.0, 10_800.0), (0.0, 1.0), 2);
        chart.below(10_800.0, "10800");
        chart.below(5400.0, "5400");
        let text = chart.finish();
        let x = |label: &str| -> f64 {
            let line = text.lines().find(|line| line.contains(&format!(">{label}<"))).expect("a label");
            line.split('"').nth(1).and_then(|x| x.parse().ok()).expect("a number")
        };
        // In letters of 14 px, which a narrow screen has, a digit takes up to 8.5 px of the chart.
        assert!(x("10800") + 2.5 * 8.5 < 480.1, "{}", x("10800"));
        assert!((x("5400") - (LEFT + 0.5 * (480.0 - LEFT - RIGHT))).abs() < 0.1, "{}", x("5400"));
    }

    #[test]
    fn marks_beyond_the_frame_become_arrows_at_the_frame() {
        let mut chart = Chart::new("marks", (200.0, 200.0), (-1.0, 1.0), (-1.0, 1.0), 1);
        chart.mark(DIAMOND, "inside", "outside", (0.5, 0.5), "one");
        chart.mark(DIAMOND, "inside", "outside", (4.0, 0.0), "two");
        let text = chart.finish();
        assert!(text.contains("data-at=\"0.5 0.5\"") && text.contains("class=\"inside\""));
        assert!(text.contains("data-at=\"1 0\"") && text.contains("class=\"outside\""));
    }
}
