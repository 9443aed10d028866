//! Earlier calibrations beside this one.

use geu_calibration::Comparison;
use geu_calibration::compare::stability_per_day;
use geu_calibration::solve::{CalibrationParameter, UNKNOWNS};
use geu_chart::Chart;
use geu_protocol::map;

use super::{CalibrationPage, moved_words, percent, sigma_unit, value_and_unit};
use crate::extent;
use crate::page::{date, escape, filled, prose, sigmas as in_sigmas, signed, significant, table};

const S_PER_DAY: f64 = 86_400.0;

impl CalibrationPage<'_> {
    pub(super) fn history(&self) -> String {
        let values = self.comparison.map(|comparison| {
            map! {
                is_compatible: comparison.is_compatible(),
                moved: moved_words(comparison),
                chi2: comparison.joint_chi2,
                freedom: (UNKNOWNS * comparison.pairs) as u32,
                probability: percent(comparison.joint_probability()),
                parameters: self.changes(comparison),
                dates: self.dates(),
                figures: CalibrationParameter::all().map(|own| self.history_of(own, comparison)).collect::<String>(),
            }
        });
        filled(include_str!("history.html"), &map! { comparison: values })
    }

    /// The change of each parameter.
    fn changes(&self, comparison: &Comparison) -> String {
        let moved = comparison.moved();
        let merged = comparison.combined.values();
        let merged_sigmas = comparison.combined.sigmas();
        let days = self.earlier.last().map_or(0.0, |last| (self.calibrated.time_s - last.time_s).abs() / S_PER_DAY);
        let rows = CalibrationParameter::all().enumerate().map(|(index, parameter)| {
            let (size, unit) = sigma_unit(parameter);
            let probability = percent(comparison.probability(index));
            let allowed = stability_per_day(parameter)
                .map_or_else(|| "–".to_owned(), |rate| format!("±{} {unit}", significant(rate * days * size, 2)));
            vec![
                escape(&parameter.label()),
                format!("{} {unit}", signed(comparison.change[index] * size, 3)),
                format!("{} {unit}", significant(comparison.sigmas[index] * size, 3)),
                in_sigmas(comparison.change[index] / comparison.sigmas[index]),
                significant(comparison.chi2[index], 2),
                if moved.contains(&parameter) { format!("<em>{probability}, moved</em>") } else { probability },
                allowed,
                if comparison.is_compatible() {
                    let (value, whole) = value_and_unit(parameter, merged[index], self.angle());
                    format!("{value} {whole} ± {} {unit}", significant(merged_sigmas[index] * size, 2))
                } else {
                    "–".to_owned()
                },
            ]
        });
        let chi2 = format!("χ² of {}", comparison.pairs);
        let header = ["parameter", "change", "sigma", "change", &chi2, "probability", "stability", "merged"];
        let caption =
            "This calibration less the mean of the earlier ones; the change since the last that the paper allows";
        table(caption, &header, rows)
    }

    fn dates(&self) -> String {
        let earlier = self.earlier.iter().map(|one| vec![date(one.time_s), prose(&one.name)]);
        let dates = earlier.chain([vec![date(self.calibrated.time_s), prose("this one")]]);
        table("Calibrations", &["start of the recording", "result"], dates)
    }

    fn history_of(&self, parameter: CalibrationParameter, comparison: &Comparison) -> String {
        let (index, (size, unit)) = (parameter.position(), sigma_unit(parameter));
        let solved = self.solution().values()[index];
        let mut points: Vec<(f64, f64, f64)> = self
            .earlier
            .iter()
            .map(|one| {
                let day = (one.time_s - self.calibrated.time_s) / S_PER_DAY;
                (day, (one.solution.values()[index] - solved) * size, one.solution.sigmas()[index] * size)
            })
            .collect();
        points.push((0.0, 0.0, self.solution().sigmas()[index] * size));
        let x = extent(points.iter().map(|point| point.0), 0.08);
        let y = extent(points.iter().flat_map(|point| [point.1 - point.2, point.1 + point.2]), 0.2);
        let words = parameter.label();
        let mut chart = Chart::new(&format!("{words} over time"), (250.0, 176.0), x, y, 2);
        if let Some(rate) = stability_per_day(parameter) {
            let (before, after) = (x.0 * rate * size, x.1 * rate * size);
            chart.polygon("band", [(0.0, 0.0), (x.0, before), (x.0, -before)]);
            chart.polygon("band", [(0.0, 0.0), (x.1, after), (x.1, -after)]);
        }
        chart.x_ticks(4);
        chart.y_ticks(5);
        chart.x_title("days from this one");
        chart.y_title(unit);
        if comparison.is_compatible() {
            let mean = (comparison.combined.values()[index] - solved) * size;
            chart.line("mean", (x.0, mean), (x.1, mean));
        }
        for &(day, value, sigma) in &points {
            chart.line("first", (day, value - sigma), (day, value + sigma));
            let title = format!("{} ± {} {unit}", signed(value, 3), significant(sigma, 3));
            chart.dot("dot", (day, value), &title);
        }
        format!("<figure>\n<figcaption><b>{words}</b></figcaption>\n{}</figure>\n", chart.finish())
    }
}
