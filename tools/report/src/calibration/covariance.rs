//! Pairs of parameters with their one and two sigma ellipses.

use std::f64::consts::TAU;
use std::fmt::Write;

use geu_calibration::solve::{CalibrationParameter, PER_GYRO};
use geu_chart::{ARROW, CROSS, Chart, DIAMOND};
use geu_protocol::map;

use super::CalibrationPage;
use crate::page::{filled, fixed, sigmas as in_sigmas};

impl CalibrationPage<'_> {
    pub(super) fn ellipses(&self) -> String {
        let (covariance, parameters) = (&self.solution().covariance, &self.solution().parameters);
        let correlation = |a: usize, b: usize| {
            covariance[(a, b)] / (covariance[(a, a)] * covariance[(b, b)]).sqrt().max(f64::MIN_POSITIVE)
        };
        let pairs = (0..parameters.len()).flat_map(|a| (a + 1..parameters.len()).map(move |b| (a, b)));
        let is_determined = |index: usize| self.solution().is_determined(parameters[index]);
        let known = pairs.filter(|&(a, b)| is_determined(a) && is_determined(b));
        let strongest = known.max_by(|&(a, b), &(c, d)| correlation(a, b).abs().total_cmp(&correlation(c, d).abs()));
        let words: Vec<String> = parameters.iter().map(|own| own.label()).collect();
        let strongest = strongest.map(|(a, b)| {
            map! { one: words[a].as_str(), other: words[b].as_str(), rho: fixed(correlation(a, b), 2) }
        });
        let pairs = parameters.chunks(PER_GYRO / 2);
        let known = pairs.filter(|pair| pair.iter().all(|own| self.solution().is_determined(*own)));
        let ellipses: String = known.map(|pair| self.ellipse([pair[0], pair[1]], &correlation)).collect();
        let values = map! { strongest: strongest, diamond: DIAMOND, cross: CROSS, arrow: ARROW, ellipses: ellipses };
        filled(include_str!("covariance.html"), &values)
    }

    fn ellipse(&self, pair: [CalibrationParameter; 2], correlation: &dyn Fn(usize, usize) -> f64) -> String {
        let [a, b] = pair.map(CalibrationParameter::position);
        let (sigmas, solved) = (self.solution().sigmas(), self.solution().values());
        let forms = pair.map(|parameter| self.sigma_unit(parameter));
        let scales = [sigmas[a] * forms[0].0, sigmas[b] * forms[1].0];
        let rho = correlation(a, b).clamp(-1.0, 1.0);
        let across = (1.0 - rho * rho).sqrt();
        let contour = |size: f64| {
            (0..72).map(move |step| {
                let (sin, cos) = (TAU * f64::from(step) / 72.0).sin_cos();
                (size * scales[0] * cos, size * scales[1] * (rho * cos + across * sin))
            })
        };
        let [x, y] = scales.map(|scale| (-2.7 * scale, 2.7 * scale));
        let names = pair.map(|parameter| {
            let words = parameter.label();
            words.split_once(' ').map_or(words.clone(), |(_, what)| what.to_owned())
        });
        let label = format!("{} of {} against {}, 1 and 2 sigma", names[1], pair[0].gyro.name(), names[0]);
        let mut chart = Chart::new(&label, (250.0, 246.0), x, y, 2);
        chart.x_ticks(5);
        chart.y_ticks(6);
        chart.x_title(&format!("{}, {}", names[0], forms[0].1));
        chart.y_title(&format!("{}, {}", names[1], forms[1].1));
        chart.polygon("band", contour(1.0));
        chart.polygon("first", contour(1.0));
        chart.polygon("faint", contour(2.0));
        let mut caption = format!("<b>{}</b> correlation {}", pair[0].gyro.name(), fixed(rho, 2));
        let prior = ("prior", DIAMOND, "diamond", "diamond", Some(self.prior_values()));
        let hand = ("hand method", CROSS, "cross", "cross-arrow", self.hand_values());
        for (kind, path, class, arrow, values) in [prior, hand] {
            let Some(values) = values else { continue };
            let away = [a, b].map(|index| (values[index] - solved[index]) / sigmas[index]);
            let at = (away[0] * scales[0], away[1] * scales[1]);
            let title = format!("{kind} {}, {}", in_sigmas(away[0]), in_sigmas(away[1]));
            chart.mark(path, class, arrow, at, &title);
            let _ = write!(caption, "; {title}");
        }
        format!("<figure>\n{}<figcaption>{caption}</figcaption>\n</figure>\n", chart.finish())
    }
}
