//! An SVG file: panels one above the other, on white, with their titles and legends.

use std::fmt::Write;

use crate::{Chart, LINE_HEIGHT, TOP, escape};

/// Colours of series that are distinguishable with red-green colour blindness (Okabe and Ito).
const COLOURS: &str = ":root { --first: #0072b2; --second: #d55e00; --third: #009e73; --fourth: #cc79a7; --bad: #b3261e; \
                       --soft: #4a5058; --rule: #e1e1e1; --raised: #f4f6f8; }";
/// Space around a panel, pixels.
const MARGIN: f64 = 12.0;

/// A chart with its heading.
pub struct Panel {
    pub title: String,
    pub chart: Chart,
    /// Classes and names of what is drawn.
    pub legend: Vec<(&'static str, String)>,
}

/// The file's text.
pub fn svg_file(panels: Vec<Panel>) -> String {
    let width = panels.iter().map(|panel| panel.chart.size.0).fold(0.0, f64::max) + 2.0 * MARGIN;
    let (mut body, mut top) = (String::new(), MARGIN);
    for Panel { title, chart, legend } in panels {
        let _ =
            writeln!(body, "<text class=\"title\" x=\"{MARGIN}\" y=\"{:.1}\">{}</text>", top + 14.0, escape(&title));
        top += 14.0 + 8.0;
        for (class, name) in legend {
            let y = top + 0.5 * LINE_HEIGHT;
            let _ = writeln!(
                body,
                "<line class=\"{class}\" x1=\"{MARGIN}\" y1=\"{y:.1}\" x2=\"{:.1}\" y2=\"{y:.1}\"/>\n\
                 <text x=\"{:.1}\" y=\"{:.1}\">{}</text>",
                MARGIN + 22.0,
                MARGIN + 30.0,
                y + 4.0,
                escape(&name)
            );
            top += LINE_HEIGHT;
        }
        let (chart_width, chart_height) = chart.size;
        let place = format!("<svg x=\"{MARGIN}\" y=\"{top:.1}\" width=\"{chart_width}\" height=\"{chart_height}\" ");
        body += &chart.finish().replacen("<svg ", &place, 1);
        top += chart_height + TOP;
    }
    let style =
        format!("{COLOURS}\n{}svg.chart .title {{ font-size: 15px; font-weight: 600; fill: #1b1f24; }}", crate::STYLE);
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" class=\"chart\" width=\"{width}\" height=\"{top}\" viewBox=\"0 0 {width} {top}\">\n\
         <style>\n{style}\n</style>\n<rect width=\"{width}\" height=\"{top}\" fill=\"#ffffff\"/>\n{body}</svg>\n"
    )
}
