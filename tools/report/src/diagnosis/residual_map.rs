//! Residual by variable and manoeuvre.

use std::fmt::Write;

use geu_diagnosis::residual_map::{SIGNIFICANT, VARIABLES, strongest};
use geu_protocol::Gyro;

use super::charts::heat_map;
use super::{DiagnosisPage, in_sigmas};
use crate::page::{escape, table};

/// Manoeuvres shown with a significant residual.
const PLACES: usize = 12;

impl DiagnosisPage<'_> {
    pub(super) fn residual_map(&self) -> String {
        let [before, after] = &self.diagnosis.residual_maps;
        let gyros = self.diagnosis.gyros();
        let rows = (1..VARIABLES.len()).map(|variable| {
            let cell = |gyro: Gyro| {
                let [before, after] = [before, after].map(|model| model.whole[gyro.index()][variable]);
                match (before, after) {
                    (None, None) => "–".to_owned(),
                    _ => format!("{} → {}", in_sigmas(before), in_sigmas(after)),
                }
            };
            std::iter::once(escape(VARIABLES[variable])).chain(gyros.iter().copied().map(cell)).collect()
        });
        let header: Vec<&str> = ["variable"].into_iter().chain(gyros.iter().map(|gyro| gyro.name())).collect();
        let caption = "An error of rate in proportion to each variable, before → after, in sigmas, over the whole recording, beside \
                       the calibration parameters, with the lag found; – if it is not independent of these";
        let mut text = format!(
            "<h2>Residual by variable</h2>\n<p>Error of rate in proportion to each variable, in \
             its sigmas. Beyond 3 it is coloured, stronger beyond {SIGNIFICANT:.0} and 10; one colour for each sign. Variables that are \
             correlated on this motion are coloured together. Corrections of exact checks are applied.</p>\n{}",
            table(caption, &header, rows)
        );
        text += &self.places();
        let stands_out = |gyro: &Gyro| {
            let all = [before, after].into_iter().flat_map(|model| &model.segments[gyro.index()]);
            all.filter_map(strongest).any(|(_, sigmas)| sigmas.abs() > SIGNIFICANT)
        };
        let (shown, others): (Vec<Gyro>, Vec<Gyro>) = gyros.iter().copied().partition(stands_out);
        if !shown.is_empty() {
            text += "<p>The same in each manoeuvre, over time. Of this number of cells noise exceeds 3 sigma sometimes, 5 almost \
                     never. A cell is empty below 3, or if a manoeuvre does not determine a variable.</p>\n<div class=\"figures heats\">\n";
            for gyro in shown {
                for (model, when) in self.diagnosis.residual_maps.iter().zip(["before", "after"]) {
                    text += &heat_map(self.diagnosis, model, gyro, when);
                }
            }
            text += "</div>\n";
        }
        if !others.is_empty() {
            let names: Vec<&str> = others.into_iter().map(Gyro::name).collect();
            let _ = writeln!(text, "<p>{}: no cell beyond {SIGNIFICANT:.0} sigma.</p>", names.join(", "));
        }
        text
    }

    /// The manoeuvres with the largest residuals.
    fn places(&self) -> String {
        let [before, after] = &self.diagnosis.residual_maps;
        let mut places: Vec<(Gyro, usize, usize, f64)> = self
            .diagnosis
            .gyros()
            .into_iter()
            .flat_map(|gyro| {
                before.segments[gyro.index()].iter().enumerate().map(move |(number, own)| (gyro, number, own))
            })
            .filter_map(|(gyro, number, own)| strongest(own).map(|(variable, sigmas)| (gyro, number, variable, sigmas)))
            .filter(|(.., sigmas)| sigmas.abs() > SIGNIFICANT)
            .collect();
        if places.is_empty() {
            return String::new();
        }
        places.sort_by(|one, other| other.3.abs().total_cmp(&one.3.abs()));
        let count = places.len();
        let rows = places.into_iter().take(PLACES).map(|(gyro, number, variable, sigmas)| {
            let later = after.segments[gyro.index()].get(number).and_then(|own| own[variable]);
            let segment = &self.diagnosis.segments[number];
            vec![
                format!("{} {}", number + 1, escape(&segment.name)),
                format!("{:.0}", segment.from_s),
                gyro.name().to_owned(),
                escape(VARIABLES[variable]),
                in_sigmas(Some(sigmas)),
                in_sigmas(later),
            ]
        });
        let caption = format!(
            "The manoeuvres with the largest residuals, each with the most significant variable: {} of {count}",
            count.min(PLACES)
        );
        table(&caption, &["manoeuvre", "start, s", "gyro", "variable", "before, σ", "after, σ"], rows)
    }
}
