//! Residual by variable and manoeuvre.

use geu_diagnosis::residual_map::{SIGNIFICANT, VARIABLES, strongest};
use geu_protocol::template::Value;
use geu_protocol::{Gyro, map};

use super::charts::heat_map;
use super::{DiagnosisPage, in_sigmas};
use crate::page::{escape, table, table_if_any};

/// Manoeuvres shown with a significant residual.
const PLACES: usize = 12;

impl DiagnosisPage<'_> {
    pub(super) fn residual_map(&self) -> Value {
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
        let stands_out = |gyro: &Gyro| {
            let all = [before, after].into_iter().flat_map(|model| &model.segments[gyro.index()]);
            all.filter_map(strongest).any(|(_, sigmas)| sigmas.abs() > SIGNIFICANT)
        };
        let (shown, others): (Vec<Gyro>, Vec<Gyro>) = gyros.iter().copied().partition(stands_out);
        let models = || self.diagnosis.residual_maps.iter().zip(["before", "after"]);
        let heats = shown
            .into_iter()
            .flat_map(|gyro| models().map(move |(model, when)| heat_map(self.diagnosis, model, gyro, when)));
        map! {
            limit: SIGNIFICANT,
            whole: table(caption, &header, rows),
            places: self.places(),
            heats: heats.collect::<String>(),
            others: others.into_iter().map(Gyro::name).collect::<Vec<_>>().join(", "),
        }
    }

    /// The manoeuvres with the largest residuals.
    fn places(&self) -> Option<String> {
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
        table_if_any(&caption, &["manoeuvre", "start, s", "gyro", "variable", "before, σ", "after, σ"], rows)
    }
}
