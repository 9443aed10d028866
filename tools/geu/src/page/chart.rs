//! Diagrams of a page as inline SVG. Colours are classes of the page's style, so that they follow light and dark.

use std::fmt::Write;

use super::escape;

/// Room for numbers at the left, pixels.
const LEFT: f64 = 52.0;
/// Room for other labels.
const RIGHT: f64 = 8.0;
/// Room that a character of a label takes at most, pixels: in the larger letters that a narrow screen has.
const CHARACTER_PX: f64 = 8.5;
const TOP: f64 = 19.0;
const LINE: f64 = 15.0;

/// A diagram that grows.
pub struct Chart {
    size: (f64, f64),
    left: f64,
    x: (f64, f64),
    y: (f64, f64),
    bottom: f64,
    text: String,
}

/// Where a text stands by its point.
#[derive(Clone, Copy)]
pub enum Anchor {
    Start,
    Middle,
    End,
}

impl Chart {
    /// An empty diagram over ranges; `label` says in words what it shows. Room for `lines` of text is kept below.
    pub fn new(label: &str, size: (f64, f64), x: (f64, f64), y: (f64, f64), lines: u8) -> Chart {
        Chart::with_left(LEFT, label, size, x, y, lines)
    }

    /// The same with so much room at the left, where words stand there.
    pub fn with_left(left: f64, label: &str, size: (f64, f64), x: (f64, f64), y: (f64, f64), lines: u8) -> Chart {
        let (width, height) = size;
        let label = escape(label);
        let text = format!("<svg viewBox=\"0 0 {width} {height}\" role=\"img\" aria-label=\"{label}\">\n");
        let mut chart = Chart { size, left, x, y, bottom: height - 4.0 - LINE * f64::from(lines), text };
        let (left, right) = (chart.x_px(x.0), chart.x_px(x.1));
        let _ = writeln!(
            chart.text,
            "<rect class=\"frame\" x=\"{left:.1}\" y=\"{TOP}\" width=\"{:.1}\" height=\"{:.1}\"/>",
            right - left,
            chart.bottom - TOP
        );
        chart
    }

    fn x_px(&self, x: f64) -> f64 {
        self.left + (x - self.x.0) / (self.x.1 - self.x.0) * (self.size.0 - self.left - RIGHT)
    }

    fn y_px(&self, y: f64) -> f64 {
        self.bottom - (y - self.y.0) / (self.y.1 - self.y.0) * (self.bottom - TOP)
    }

    /// Ticks beside it, about `count`, with lines across.
    pub fn y_ticks(&mut self, count: usize) {
        self.y_lines(ticks(self.y, count));
    }

    /// The same from some value on.
    pub fn y_ticks_from(&mut self, least: f64, count: usize) {
        self.y_lines(ticks((least, self.y.1), count));
    }

    fn y_lines(&mut self, ticks: Vec<(f64, String)>) {
        for (tick, name) in ticks {
            self.line(if tick == 0.0 { "zero" } else { "rule" }, (self.x.0, tick), (self.x.1, tick));
            self.beside(tick, &name);
        }
    }

    /// Ticks below it, about `count`, with lines across.
    pub fn x_ticks(&mut self, count: usize) {
        for (tick, name) in ticks(self.x, count) {
            self.line(if tick == 0.0 { "zero" } else { "rule" }, (tick, self.y.0), (tick, self.y.1));
            self.below(tick, &name);
        }
    }

    /// A text below at `x`; at an end of the axis it moves inwards, so that nothing of it is cut.
    pub fn below(&mut self, x: f64, text: &str) {
        let half = 0.5 * CHARACTER_PX * text.chars().count() as f64;
        let x = self.x_px(x).min(self.size.0 - half).max(half);
        self.put(x, self.bottom + LINE - 1.0, Anchor::Middle, text);
    }

    /// What the axis below tells, in the second line.
    pub fn x_name(&mut self, text: &str) {
        let (x, y) = (self.x_px((self.x.0 + self.x.1) / 2.0), self.bottom + 2.0 * LINE - 1.0);
        self.put(x, y, Anchor::Middle, text);
    }

    /// What the axis beside tells, above it.
    pub fn y_name(&mut self, text: &str) {
        self.put(self.left, TOP - 6.0, Anchor::Start, text);
    }

    fn put(&mut self, x: f64, y: f64, anchor: Anchor, text: &str) {
        let anchor = match anchor {
            Anchor::Start => "start",
            Anchor::Middle => "middle",
            Anchor::End => "end",
        };
        let text = escape(text);
        let _ = writeln!(self.text, "<text x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"{anchor}\">{text}</text>");
    }

    /// A straight line.
    pub fn line(&mut self, class: &str, from: (f64, f64), to: (f64, f64)) {
        let _ = writeln!(
            self.text,
            "<line class=\"{class}\" x1=\"{:.1}\" y1=\"{:.1}\" x2=\"{:.1}\" y2=\"{:.1}\"/>",
            self.x_px(from.0),
            self.y_px(from.1),
            self.x_px(to.0),
            self.y_px(to.1)
        );
    }

    /// A text beside it at `y`.
    pub fn beside(&mut self, y: f64, text: &str) {
        let y = self.y_px(y) + 4.0;
        self.put(self.left - 5.0, y, Anchor::End, text);
    }

    /// A text in the middle of a place.
    pub fn within(&mut self, at: (f64, f64), text: &str) {
        let (x, y) = (self.x_px(at.0), self.y_px(at.1) + 4.0);
        self.put(x, y, Anchor::Middle, text);
    }

    /// How wide so much of `x` is, pixels.
    pub fn width_px(&self, of_x: f64) -> f64 {
        self.x_px(self.x.0 + of_x) - self.x_px(self.x.0)
    }

    /// A box between two corners with what it is.
    pub fn rectangle(&mut self, class: &str, from: (f64, f64), to: (f64, f64), title: &str) {
        let (left, right) = (self.x_px(from.0), self.x_px(to.0));
        let (top, bottom) = (self.y_px(to.1), self.y_px(from.1));
        let _ = writeln!(
            self.text,
            "<rect class=\"{class}\" x=\"{left:.1}\" y=\"{top:.1}\" width=\"{:.1}\" height=\"{:.1}\"><title>{}</title></rect>",
            (right - left).max(0.5),
            (bottom - top).max(0.0),
            escape(title)
        );
    }

    /// A closed line; what lies beyond the frame is not seen.
    pub fn polygon(&mut self, class: &str, points: impl IntoIterator<Item = (f64, f64)>) {
        let mut all = String::new();
        for point in points {
            let _ = write!(all, "{:.1},{:.1} ", self.x_px(point.0), self.y_px(point.1));
        }
        let (left, width, height) = (self.left, self.size.0 - self.left - RIGHT, self.bottom - TOP);
        let _ = writeln!(
            self.text,
            "<svg x=\"{left}\" y=\"{TOP}\" width=\"{width}\" height=\"{height}\" viewBox=\"{left} {TOP} {width} {height}\"><polygon class=\"{class}\" points=\"{}\"/></svg>",
            all.trim_end()
        );
    }

    /// A disc with what it is.
    pub fn dot(&mut self, class: &str, at: (f64, f64), title: &str) {
        let (x, y) = (self.x_px(at.0), self.y_px(at.1));
        let title = escape(title);
        let _ = writeln!(
            self.text,
            "<circle class=\"{class}\" cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"3.2\"><title>{title}</title></circle>"
        );
    }

    /// A mark with what it is, from its path about the origin; where it lies beyond the frame, an arrowhead of class
    /// `arrow` at the frame shows where.
    pub fn mark(&mut self, path: &str, class: &str, arrow: &str, at: (f64, f64), title: &str) {
        let (middle_x, middle_y) = ((self.x.0 + self.x.1) / 2.0, (self.y.0 + self.y.1) / 2.0);
        let (dx, dy) = (at.0 - middle_x, at.1 - middle_y);
        let beyond = (dx / (self.x.1 - self.x.0)).abs().max((dy / (self.y.1 - self.y.0)).abs()) * 2.0;
        let title = escape(title);
        let (shown, shape) = if beyond <= 1.0 {
            (at, format!("<path class=\"{class}\" d=\"{path}\">"))
        } else {
            let degrees = (-dy * (self.bottom - TOP) / (self.y.1 - self.y.0))
                .atan2(dx * (self.size.0 - self.left - RIGHT) / (self.x.1 - self.x.0))
                .to_degrees();
            let shape = format!("<path class=\"{arrow}\" d=\"{ARROW}\" transform=\"rotate({degrees:.1})\">");
            ((middle_x + dx / beyond, middle_y + dy / beyond), shape)
        };
        let (x, y) = (self.x_px(shown.0), self.y_px(shown.1));
        let _ =
            writeln!(self.text, "<g transform=\"translate({x:.1} {y:.1})\">{shape}<title>{title}</title></path></g>");
    }

    /// The finished SVG.
    pub fn finish(self) -> String {
        self.text + "</svg>\n"
    }
}

/// A diamond.
pub const DIAMOND: &str = "M-5 0L0 -5L5 0L0 5Z";
/// A cross.
pub const CROSS: &str = "M-4 -4L4 4M-4 4L4 -4";
/// An arrowhead that points to the right and ends at the origin.
pub const ARROW: &str = "M0 0L-10 -4.5L-10 4.5Z";

/// Round numbers within a range, about `count`, and their texts.
fn ticks(range: (f64, f64), count: usize) -> Vec<(f64, String)> {
    let rough = (range.1 - range.0) / count.max(1) as f64;
    let decade = 10f64.powf(rough.log10().floor());
    let step = decade * [1.0, 2.0, 5.0, 10.0].into_iter().find(|step| step * decade >= rough).unwrap_or(10.0);
    let decimals = (-step.log10() - 1e-9).ceil().clamp(0.0, 12.0) as usize;
    let (first, last) = ((range.0 / step).ceil() as i64, (range.1 / step).floor() as i64);
    (first..=last)
        .map(|index| {
            let tick = index as f64 * step;
            (tick, format!("{tick:.decimals$}").replace('-', "−"))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_label_at_an_end_of_the_axis_lies_within_the_diagram() {
        let mut chart = Chart::new("times", (480.0, 200.0), (0.0, 10_800.0), (0.0, 1.0), 2);
        chart.below(10_800.0, "10800");
        chart.below(5400.0, "5400");
        let text = chart.finish();
        let x = |label: &str| -> f64 {
            let line = text.lines().find(|line| line.contains(&format!(">{label}<"))).expect("a label");
            line.split('"').nth(1).and_then(|x| x.parse().ok()).expect("a number")
        };
        // In letters of 14 px, which a narrow screen has, a digit takes up to 8.5 px of the diagram.
        assert!(x("10800") + 2.5 * 8.5 < 480.1, "{}", x("10800"));
        assert!((x("5400") - (LEFT + 0.5 * (480.0 - LEFT - RIGHT))).abs() < 0.1, "{}", x("5400"));
    }

    #[test]
    fn ticks_are_round_and_within() {
        let texts = |range, count| ticks(range, count).into_iter().map(|(_, text)| text).collect::<Vec<_>>();
        assert_eq!(texts((-0.23, 0.21), 4), ["−0.2", "0.0", "0.2"]);
        assert_eq!(texts((0.0, 30.0), 6), ["0", "5", "10", "15", "20", "25", "30"]);
        assert_eq!(texts((-1e-3, 1e-3), 2), ["−0.001", "0.000", "0.001"]);
    }
}
