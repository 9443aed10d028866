//! A page of results in one file that loads nothing, in the reader's light or dark theme. Without its script the charts are
//! static. It is well-formed XML.

pub(crate) use geu_chart::escape;
use geu_protocol::template::{self, Value};

pub(crate) use crate::calendar::date;

const STYLE: &str = include_str!("style.css");

/// The page from its title and body.
pub(crate) fn html(title: &str, body: &str) -> String {
    format!(
        r#"<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8"/>
<meta name="viewport" content="width=device-width, initial-scale=1"/>
<title>{title}</title>
<style>
{STYLE}{chart_style}</style>
</head>
<body>
<main>
{body}</main>
<script>
//<![CDATA[
{script}//]]>
</script>
</body>
</html>
"#,
        title = escape(title),
        chart_style = geu_chart::STYLE,
        script = geu_chart::SCRIPT
    )
}

/// Operation of the charts.
pub(crate) const CHART_HINT: &str = "<p class=\"soft hint\">In a chart: drag to zoom, double-click to reset, Shift and drag to \
    move, Ctrl and wheel to zoom about the pointer; the pointer shows values. With the keyboard: +, −, arrows, 0.</p>\n";

/// A table, which scrolls on narrow screens. The first cell of a row is its header.
pub(crate) fn table(caption: &str, header: &[&str], rows: impl IntoIterator<Item = Vec<String>>) -> String {
    let mut text = format!(
        "<div class=\"wide\" role=\"region\" tabindex=\"0\" aria-label=\"{caption}\">\n<table>\n<caption><span>{caption}</span></caption>\n<thead><tr>",
        caption = escape(caption)
    );
    for name in header {
        text += &format!("<th scope=\"col\">{}</th>", escape(name));
    }
    text += "</tr></thead>\n<tbody>\n";
    for row in rows {
        text += "<tr>";
        for (index, cell) in row.iter().enumerate() {
            text += &match index {
                0 => format!("<th scope=\"row\">{cell}</th>"),
                _ => format!("<td>{cell}</td>"),
            };
        }
        text += "</tr>\n";
    }
    text + "</tbody>\n</table>\n</div>\n"
}

/// A table; `None` without rows.
pub(crate) fn table_if_any(caption: &str, header: &[&str], rows: impl Iterator<Item = Vec<String>>) -> Option<String> {
    let mut rows = rows.peekable();
    rows.peek().is_some().then(|| table(caption, header, rows))
}

/// A cell of prose.
pub(crate) fn prose(text: &str) -> String {
    format!("<span class=\"prose\">{}</span>", escape(text))
}

/// Provenance of a page.
pub struct Provenance<'a> {
    /// The command line, quoted for a shell.
    pub command: String,
    pub version: &'a str,
    /// Kind and name of each input.
    pub inputs: Vec<(&'static str, String)>,
    /// The configuration's name, text and overrides.
    pub configuration: (String, String, &'a [String]),
}

impl Provenance<'_> {
    pub(crate) fn html(&self, further: impl Iterator<Item = (&'static str, String)>) -> String {
        let mut text = String::from("<h2>Provenance</h2>\n<dl>\n");
        let mut item = |name: &str, value: &str| {
            text += &format!("<dt>{}</dt><dd><code>{}</code></dd>\n", escape(name), escape(value));
        };
        let (name, configuration, overrides) = &self.configuration;
        item("command", &self.command);
        item("geu", self.version);
        self.inputs.iter().for_each(|(kind, name)| item(kind, name));
        further.for_each(|(kind, name)| item(kind, &name));
        item("configuration", name);
        overrides.iter().for_each(|value| item("override", value));
        let configuration = escape(configuration);
        text + &format!("</dl>\n<details>\n<summary>Configuration</summary>\n<pre>{configuration}</pre>\n</details>\n")
    }
}

/// `template` filled, with the filters of pages: `significant: n`, `signed: n`, `sigmas`, `escape`.
pub(crate) fn filled(template: &str, values: &Value) -> String {
    let mut engine = template::engine();
    engine.add_filter("significant", significant);
    engine.add_filter("signed", signed);
    engine.add_filter("sigmas", sigmas);
    engine.add_filter("escape", |text: &str| escape(text));
    template::filled(&engine, template, values)
}

/// A number with `digits` significant digits and without an exponent.
pub(crate) fn significant(value: f64, digits: i32) -> String {
    let decimals = if value == 0.0 { 0 } else { (digits - 1 - value.abs().log10().floor() as i32).clamp(0, 12) };
    format!("{value:.*}", decimals as usize).replace('-', "−")
}

/// A number with its sign.
pub(crate) fn signed(value: f64, digits: i32) -> String {
    let text = significant(value, digits);
    if value > 0.0 { format!("+{text}") } else { text }
}

/// A number with its sign and `decimals`.
pub(crate) fn fixed(value: f64, decimals: usize) -> String {
    let text = format!("{value:+.decimals$}");
    let is_zero = text.bytes().all(|byte| !(b'1'..=b'9').contains(&byte));
    if is_zero { text.replace(['+', '-'], "") } else { text.replace('-', "−") }
}

/// A number of sigmas.
pub(crate) fn sigmas(value: f64) -> String {
    format!("{} σ", fixed(value, 1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_keep_their_significant_digits() {
        let cases = [(1.2345e-5, "0.0000123"), (-0.5, "−0.500"), (1234.5, "1234"), (0.0, "0"), (99.96, "100.0")];
        for (value, text) in cases {
            assert_eq!(significant(value, 3), text);
        }
        assert_eq!(signed(0.25, 2), "+0.25");
        assert_eq!([sigmas(-0.04), sigmas(-1.25), fixed(0.5, 2)], ["0.0 σ", "−1.2 σ", "+0.50"]);
    }
}
