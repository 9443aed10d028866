//! The charts of a diagnosis: residuals over time, by manoeuvre and by variable.

use geu_chart::{Chart, MAX_COLUMNS, min_max};
use geu_diagnosis::motion_segments::MotionSegment;
use geu_diagnosis::outcome::Diagnosis;
use geu_diagnosis::residual_map::{ResidualMap, SIGNIFICANT, VARIABLES};
use geu_diagnosis::residual_stats::WINDOW;
use geu_protocol::Gyro;

use crate::page::{escape, fixed, significant};

/// Width of a digit, pixels.
const DIGIT_PX: f64 = 7.5;
/// Largest number of labels below a chart.
const MAX_LABELS: usize = 14;
/// Classes of the control axes.
const AXES: [(&str, &str); 3] = [("turn-x", "X"), ("turn-y", "Y"), ("turn-z", "Z")];

/// Class of a number of sigmas; `None` up to 3 sigma.
pub(super) fn strength(sigmas: f64) -> Option<&'static str> {
    let level = [10.0, SIGNIFICANT, 3.0].iter().position(|level| sigmas.abs() > *level)?;
    let classes = if sigmas > 0.0 {
        ["plus strong", "plus middling", "plus weak"]
    } else {
        ["minus strong", "minus middling", "minus weak"]
    };
    Some(classes[level])
}

/// Key of the colours of the strip of manoeuvres.
pub(super) fn axes_key() -> String {
    AXES.iter()
        .map(|(class, axis)| {
            format!("<span><svg viewBox=\"0 0 22 14\"><rect class=\"{class}\" width=\"22\" height=\"14\"/></svg>turns about {axis}</span>\n")
        })
        .collect()
}

/// End of the recording, s.
fn end_s(diagnosis: &Diagnosis) -> f64 {
    let nodes = diagnosis.windowed.iter().flatten().map(Vec::len).max().unwrap_or(0);
    (nodes.saturating_sub(1).max(1)) as f64 * diagnosis.interval_s()
}

/// The residual of a gyro before and after, over time.
pub(super) fn residuals(diagnosis: &Diagnosis, gyro: Gyro) -> String {
    let name = gyro.name();
    let angle = diagnosis.configuration.device.angle_unit();
    let [before, after] = diagnosis
        .windowed
        .each_ref()
        .map(|all| -> Vec<f64> { all[gyro.index()].iter().map(|residual| residual / angle.arcsec).collect() });
    let series = [("before", &before), ("after", &after)];
    let known = series.iter().flat_map(|(_, values)| values.iter()).filter(|value| value.is_finite());
    let (min, max) = known.fold((0.0f64, 0.0f64), |(min, max), value| (min.min(*value), max.max(*value)));
    let span = (max - min).max(2.0 / angle.arcsec);
    let end_s = end_s(diagnosis);
    // The strip of manoeuvres lies below the residual, inside the frame.
    let strip = (min - 0.24 * span, min - 0.1 * span);
    let label = format!("Residual of {name} before and after, {} over seconds", angle.name);
    let mut chart = Chart::new(&label, (860.0, 220.0), (0.0, end_s), (strip.0, max + 0.06 * span), 2)
        .in_group("time")
        .units("s", angle.name);
    chart.y_ticks_from(min, 6);
    chart.y_title(angle.name);
    let left = diagnosis.unexplained.as_ref().filter(|left| left.gyros[gyro.index()]);
    if let Some(left) = left {
        let [from_s, to_s] = left.interval_s.map(|at_s| at_s.clamp(0.0, end_s));
        let title = format!("left unexplained, {from_s:.0}…{to_s:.0} s");
        chart.rectangle("left", (from_s, strip.1), (to_s, max + 0.06 * span), &title);
    }
    windows(&mut chart, end_s, WINDOW as f64 * diagnosis.interval_s(), (strip.0, max + 0.06 * span));
    for (name, values) in series {
        chart.series(name, name, &runs(values, end_s, diagnosis.interval_s()));
    }
    for (index, segment) in diagnosis.segments.iter().enumerate() {
        let class = segment.axis.map_or("rest", |axis| AXES[axis.min(2)].0);
        let (from_s, to_s) = (segment.from_s, segment.to_s.min(end_s));
        chart.rectangle(class, (from_s, strip.0), (to_s, strip.1), &label_of(index, segment));
        let number = (index + 1).to_string();
        if chart.width_px(to_s - from_s) >= DIGIT_PX * number.len() as f64 {
            chart.within((0.5 * (from_s + to_s), 0.5 * (strip.0 + strip.1)), &number);
        }
    }
    chart.x_title(&format!("s since the start; lines at the ends of windows of {}", diagnosis.window()));
    let rms = |values: &[f64]| {
        let (sum, count) = values
            .iter()
            .filter(|value| value.is_finite())
            .fold((0.0, 0usize), |(sum, count), value| (sum + value * value, count + 1));
        if count == 0 {
            "unknown".to_owned()
        } else {
            format!("{} {} rms", significant((sum / count as f64).sqrt(), 3), angle.name)
        }
    };
    let left = left.map_or(String::new(), |left| {
        format!("; shaded: left unexplained, {:.0}…{:.0} s", left.interval_s[0], left.interval_s[1])
    });
    format!(
        "<figure class=\"broad\">\n<figcaption><b>{name}</b> before {}, after {}{left}</figcaption>\n<div class=\"wide\" role=\"region\" tabindex=\"0\" aria-label=\"{}\">\n{}</div>\n</figure>\n",
        rms(series[0].1),
        rms(series[1].1),
        escape(&label),
        chart.finish()
    )
}

/// Lines at the ends of windows, with their times below.
fn windows(chart: &mut Chart, end_s: f64, window_s: f64, y: (f64, f64)) {
    let count = (end_s / window_s) as usize;
    let every = count.div_ceil(MAX_LABELS).max(1);
    for window in 0..=count {
        let at_s = window as f64 * window_s;
        chart.line("window", (at_s, y.0), (at_s, y.1));
        if window % every == 0 {
            chart.below(at_s, &format!("{at_s:.0}"));
        }
    }
}

/// The points of a residual in runs that neither a gap nor the end of a window interrupts, decimated.
fn runs(values: &[f64], end_s: f64, interval_s: f64) -> Vec<Vec<(f64, f64)>> {
    let nodes: Vec<(usize, f64)> = values.iter().copied().enumerate().filter(|(_, value)| value.is_finite()).collect();
    let window = |node: usize| node.saturating_sub(1) / WINDOW;
    let runs = nodes.chunk_by(|one, next| next.0 == one.0 + 1 && window(one.0) == window(next.0));
    let of_run = |run: &[(usize, f64)]| {
        let points: Vec<_> = run.iter().map(|&(node, value)| (node as f64 * interval_s, value)).collect();
        let (from_s, to_s) = (points[0].0, points[points.len() - 1].0 + interval_s);
        let columns = (MAX_COLUMNS as f64 * (to_s - from_s) / end_s).ceil() as usize;
        min_max(&points, (from_s, to_s), columns.max(1))
    };
    runs.map(of_run).collect()
}

/// The gap of a gyro in each manoeuvre, before and after.
pub(super) fn gap_bars(diagnosis: &Diagnosis, gyro: Gyro) -> String {
    let (name, segments) = (gyro.name(), &diagnosis.segments);
    let angle = diagnosis.configuration.device.angle_unit();
    let [before, after] = diagnosis
        .segment_rms_arcsec
        .each_ref()
        .map(|all| -> Vec<f64> { all.iter().map(|rms| rms[gyro.index()] / angle.arcsec).collect() });
    let max =
        before.iter().chain(&after).copied().filter(|rms| rms.is_finite()).fold(angle.arcsec.recip(), f64::max) * 1.06;
    let label = format!("Gap of {name} in each manoeuvre before and after, {}", angle.name);
    let mut chart = Chart::new(&label, (480.0, 190.0), (0.4, segments.len() as f64 + 0.6), (0.0, max), 2)
        .counting_x()
        .in_group("manoeuvre");
    chart.y_ticks(5);
    chart.y_title(&format!("{} rms", angle.name));
    for (index, segment) in segments.iter().enumerate() {
        let at = (index + 1) as f64;
        for (class, rms, left, right) in [("before", &before, at - 0.42, at), ("after", &after, at, at + 0.42)] {
            let Some(rms) = rms.get(index).filter(|rms| rms.is_finite()) else { continue };
            chart.rectangle(
                class,
                (left, 0.0),
                (right, *rms),
                &format!("{}, {class}: {rms:.*} {}", label_of(index, segment), angle.decimals(2), angle.name),
            );
        }
    }
    let every = segments.len().div_ceil(MAX_LABELS).max(1);
    (1..=segments.len())
        .filter(|number| (number - 1) % every == 0)
        .for_each(|number| chart.below(number as f64, &number.to_string()));
    chart.x_title("number of the manoeuvre");
    format!("<figure>\n<figcaption><b>{name}</b></figcaption>\n{}</figure>\n", chart.finish())
}

/// Width of the names of the variables, pixels: a character takes up to 7.3 px on a narrow screen.
fn names_px() -> f64 {
    let longest = VARIABLES.iter().map(|name| name.chars().count()).max().unwrap_or(0);
    7.3 * longest as f64 + 8.0
}

/// Residual of a gyro by variable, over time.
pub(super) fn heat_map(diagnosis: &Diagnosis, model: &ResidualMap, gyro: Gyro, when: &str) -> String {
    let (name, rows) = (gyro.name(), VARIABLES.len() as f64);
    let label = format!("Residual of {name} by variable {when}, over seconds");
    let end_s = end_s(diagnosis);
    let mut chart = Chart::new(&label, (480.0, 340.0), (0.0, end_s), (0.0, rows), 2)
        .with_left(names_px())
        .zooming_x()
        .in_group("time");
    for (index, variable) in VARIABLES.iter().enumerate() {
        let bottom = rows - 1.0 - index as f64;
        chart.beside(bottom + 0.5, variable);
        chart.line("faintly", (0.0, bottom), (end_s, bottom));
        for (number, (segment, sigmas)) in diagnosis.segments.iter().zip(&model.segments[gyro.index()]).enumerate() {
            let Some((sigmas, class)) = sigmas[index].and_then(|sigmas| Some((sigmas, strength(sigmas)?))) else {
                continue;
            };
            let title = format!("{}: {variable} {} σ", label_of(number, segment), fixed(sigmas, 1));
            let corners = ((segment.from_s, bottom), (segment.to_s.min(end_s), bottom + 1.0));
            chart.rectangle(&format!("heat {class}"), corners.0, corners.1, &title);
        }
    }
    windows(&mut chart, end_s, WINDOW as f64 * diagnosis.interval_s(), (0.0, rows));
    chart.x_title("s since the start");
    format!("<figure>\n<figcaption><b>{name}</b> {when}</figcaption>\n{}</figure>\n", chart.finish())
}

/// A manoeuvre with its number and times.
fn label_of(index: usize, segment: &MotionSegment) -> String {
    format!("{} {}, {:.0}…{:.0} s", index + 1, segment.name, segment.from_s, segment.to_s)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn residuals_are_interrupted_by_gaps_and_windows() {
        let mut values: Vec<f64> = (0..=4 * WINDOW).map(|node| if node % 2 == 0 { 1.0 } else { -1.0 }).collect();
        values[0] = f64::NAN;
        values[100] = f64::NAN;
        let runs = runs(&values, 2.0 * WINDOW as f64, 0.5);
        assert_eq!(runs.iter().map(Vec::len).collect::<Vec<_>>(), [42, 1460, 1500, 1500, 1500]);
        assert!(super::runs(&[f64::NAN; 4], 1.0, 0.5).is_empty());
    }

    #[test]
    fn strength_begins_at_3_sigma() {
        assert_eq!(
            [2.9, 3.1, -6.0, 11.0].map(strength),
            [None, Some("plus weak"), Some("minus middling"), Some("plus strong")]
        );
        assert_eq!(strength(f64::NAN), None);
    }
}
