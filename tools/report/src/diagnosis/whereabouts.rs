//! Where the data leave the model: along which variable, and in which manoeuvres.

use std::fmt::Write;

use geu_diagnosis::whereabouts::{STANDS_OUT, VARIABLES, strongest};
use geu_protocol::Gyro;

use super::charts::heat_map;
use super::{DiagnosisPage, in_sigmas};
use crate::page::{escape, table};

/// Places shown of those where the data leave the model.
const PLACES: usize = 12;

impl DiagnosisPage<'_> {
    pub(super) fn whereabouts(&self) -> String {
        let [before, after] = &self.diagnosis.whereabouts;
        let rows = (1..VARIABLES.len()).map(|variable| {
            let of_gyro = |gyro: Gyro| {
                let [before, after] = [before, after].map(|model| model.whole[gyro as usize][variable]);
                match (before, after) {
                    (None, None) => "–".to_owned(),
                    _ => format!("{} → {}", in_sigmas(before), in_sigmas(after)),
                }
            };
            std::iter::once(escape(VARIABLES[variable])).chain(Gyro::ALL.map(of_gyro)).collect()
        });
        let header = ["variable", "GYRX", "GYRY", "GYRZA", "GYRZB"];
        let caption = "An error of rate in proportion to each variable, before → after, in sigmas, over the whole recording, beside \
                       the sixteen calibration parameters, with the lag found; – where these leave nothing of it";
        let mut text = format!(
            "<h2>Where the data leave the model</h2>\n<p>Along which variable: how large an error of rate in proportion to it is, in \
             its sigmas. Beyond 3 it is coloured, more beyond {STANDS_OUT:.0} and 10; one colour for each sign. Variables that go \
             together on this motion stand out together. What exact checks mended is taken as mended.</p>\n{}",
            table(caption, &header, rows)
        );
        text += &self.places();
        let stands_out = |gyro: &Gyro| {
            let all = [before, after].into_iter().flat_map(|model| &model.stretches[*gyro as usize]);
            all.filter_map(strongest).any(|(_, sigmas)| sigmas.abs() > STANDS_OUT)
        };
        let (shown, others): (Vec<Gyro>, Vec<Gyro>) = Gyro::ALL.into_iter().partition(stands_out);
        if !shown.is_empty() {
            text += "<p>The same in each manoeuvre, over time. Among so many places chance reaches 3 sigma now and then, 5 hardly \
                     ever. Empty is below 3, or where a manoeuvre tells nothing of a variable.</p>\n<div class=\"figures heats\">\n";
            for gyro in shown {
                for (model, when) in self.diagnosis.whereabouts.iter().zip(["before", "after"]) {
                    text += &heat_map(self.diagnosis, model, gyro, when);
                }
            }
            text += "</div>\n";
        }
        if !others.is_empty() {
            let names: Vec<&str> = others.into_iter().map(Gyro::name).collect();
            let _ =
                writeln!(text, "<p>{}: nothing beyond {STANDS_OUT:.0} sigma in any manoeuvre.</p>", names.join(", "));
        }
        text
    }

    /// The manoeuvres in which the data leave the model most.
    fn places(&self) -> String {
        let [before, after] = &self.diagnosis.whereabouts;
        let mut places: Vec<(Gyro, usize, usize, f64)> = Gyro::ALL
            .into_iter()
            .flat_map(|gyro| {
                before.stretches[gyro as usize].iter().enumerate().map(move |(number, own)| (gyro, number, own))
            })
            .filter_map(|(gyro, number, own)| strongest(own).map(|(variable, sigmas)| (gyro, number, variable, sigmas)))
            .filter(|(.., sigmas)| sigmas.abs() > STANDS_OUT)
            .collect();
        if places.is_empty() {
            return String::new();
        }
        places.sort_by(|one, other| other.3.abs().total_cmp(&one.3.abs()));
        let count = places.len();
        let rows = places.into_iter().take(PLACES).map(|(gyro, number, variable, sigmas)| {
            let later = after.stretches[gyro as usize].get(number).and_then(|own| own[variable]);
            let stretch = &self.diagnosis.stretches[number];
            vec![
                format!("{} {}", number + 1, escape(&stretch.name)),
                format!("{:.0}", stretch.from_s),
                gyro.name().to_owned(),
                escape(VARIABLES[variable]),
                in_sigmas(Some(sigmas)),
                in_sigmas(later),
            ]
        });
        let caption = format!(
            "The manoeuvres in which the data leave the model most, each with the variable that shows it best: {} of {count}",
            count.min(PLACES)
        );
        table(&caption, &["manoeuvre", "start, s", "gyro", "variable", "before, σ", "after, σ"], rows)
    }
}
