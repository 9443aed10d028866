//! The page of `geu calibrate --html`: solution, accuracy, provenance and history.

mod covariance;
mod history;
mod text;

use geu_calibration::compare::{Comparison, MIN_PROBABILITY, PreviousCalibration};
use geu_calibration::solve::{CalibrationParameter, Solution, values_of};
use geu_calibration::{Calibrated, solve};
use geu_model::Configuration;
use geu_model::units::{AngleUnit, SAMPLE_INTERVAL_S};
use geu_protocol::{Gyro, map};

use geu_chart::Chart;

use text::{calibrations, described_lines, gyros};
pub use text::{comparison_table, table as terminal_table};

use crate::page::{
    CHART_HINT, Provenance, date, escape, filled, fixed, html, prose, sigmas as in_sigmas, signed, significant, table,
    table_if_any,
};

/// A larger residual is marked; with a hundred equations noise exceeds it in a quarter of calibrations.
const MARKED_SIGMA: f64 = 3.0;

/// Content of the page.
pub struct CalibrationPage<'a> {
    pub prior: &'a Configuration,
    pub calibrated: &'a Calibrated,
    /// Earlier calibrations in the order of time.
    pub earlier: &'a [PreviousCalibration],
    /// `None` without earlier calibrations.
    pub comparison: Option<&'a Comparison>,
    pub provenance: Provenance<'a>,
}

impl CalibrationPage<'_> {
    /// The page.
    pub fn html(&self) -> String {
        let (calibrated, solution) = (self.calibrated, self.solution());
        let span = calibrated.observations.iter().map(|one| one.end_s).fold(0.0, f64::max);
        let described = if solution.is_described() { described_lines(calibrated, self.angle()) } else { Vec::new() };
        let earlier = self.earlier.iter().map(|one| ("earlier calibration", one.name.clone()));
        let values = map! {
            start: date(calibrated.time_s),
            count: calibrated.observations.len() as u32,
            hours: span / 3600.0,
            verdict: self.verdict(),
            parameters: self.parameters(),
            angle: self.angle().name,
            described: described,
            hint: CHART_HINT,
            residuals: gyros(solution).map(|gyro| self.residuals_of(gyro)).collect::<String>(),
            manoeuvres: self.manoeuvres(),
            left_out: self.left_out(),
            ellipses: self.ellipses(),
            history: self.history(),
            provenance: self.provenance.html(earlier),
        };
        html("Calibration of the gyro unit", &filled(include_str!("page.html"), &values))
    }

    fn solution(&self) -> &Solution {
        &self.calibrated.solution
    }

    fn angle(&self) -> AngleUnit {
        self.prior.device.angle_unit()
    }

    /// The factor and unit of sigmas and changes, with the device's unit of angles.
    fn sigma_unit(&self, parameter: CalibrationParameter) -> (f64, String) {
        let (size, unit) = sigma_unit(parameter);
        let (angle, unit) = self.angle().converted(unit);
        (size / angle, unit)
    }

    fn prior_values(&self) -> Vec<f64> {
        values_of(&self.solution().parameters, &calibrations(self.prior))
    }

    fn hand_values(&self) -> Option<Vec<f64>> {
        let hand = self.calibrated.first_order.as_ref().ok()?;
        Some(values_of(&self.solution().parameters, hand))
    }

    fn verdict(&self) -> String {
        let solution = self.solution();
        let probability = solution.probability();
        let largest = self.hand_values().and_then(|hand| {
            let differences = hand.into_iter().zip(solution.values()).zip(solution.sigmas());
            let in_sigmas = differences.map(|((hand, full), sigma)| (hand - full) / sigma);
            in_sigmas.zip(CalibrationParameter::all()).max_by(|a, b| a.0.abs().total_cmp(&b.0.abs()))
        });
        let noise = self.calibrated.reference_sigma_arcsec;
        let values = map! {
            spare: solution.degrees_of_freedom as u32,
            is_unexplained: probability < MIN_PROBABILITY,
            is_too_good: probability > 1.0 - MIN_PROBABILITY,
            chi2: solution.chi2,
            probability: percent(probability),
            condition: solution.condition,
            largest: largest.map(|(sigmas, parameter)| map! { label: parameter.label(), sigmas: sigmas }),
            no_hand: self.calibrated.first_order.as_ref().err().filter(|_| !solution.is_described()).map(ToString::to_string),
            noise: noise.iter().any(|sigma| *sigma > 0.0).then(|| noise.map(|sigma| sigma / self.angle().arcsec)),
            angle: self.angle().name,
        };
        filled(include_str!("verdict.html"), &values)
    }

    fn parameters(&self) -> String {
        let solution = self.solution();
        let (solved, sigmas) = (solution.values(), solution.sigmas());
        let (before, hand) = (self.prior_values(), self.hand_values());
        let rows = solution.parameters.iter().enumerate().map(|(index, &parameter)| {
            let ((size, unit_of_sigma), (value, unit)) =
                (self.sigma_unit(parameter), value_and_unit(parameter, solved[index], self.angle()));
            let change = solved[index] - before[index];
            if !solution.is_determined(parameter) {
                let none = || "–".to_owned();
                return vec![escape(&parameter.label()), none(), unit, none(), none(), none(), none()];
            }
            let hand = hand
                .as_ref()
                .map_or_else(|| "–".to_owned(), |hand| in_sigmas((hand[index] - solved[index]) / sigmas[index]));
            vec![
                escape(&parameter.label()),
                value,
                unit,
                format!("{} {unit_of_sigma}", significant(sigmas[index] * size, 3)),
                format!("{} {unit_of_sigma}", signed(change * size, 3)),
                in_sigmas(change / sigmas[index]),
                hand,
            ]
        });
        let header = ["parameter", "value", "unit", "sigma", "change", "change", "hand method"];
        let caption = "Values, 1 sigma, change from the prior value, and difference of the hand method";
        table(caption, &header, rows)
    }

    fn residuals_of(&self, gyro: Gyro) -> String {
        let (observations, name) = (&self.calibrated.observations, gyro.name());
        let angle = self.angle();
        let own: Vec<&solve::Residual> = self.solution().residuals.iter().filter(|one| one.gyro == gyro).collect();
        let x = (0.4, observations.len() as f64 + 0.6);
        let number = |one: &solve::Residual| (one.manoeuvre + 1) as f64;
        let sigmas = |one: &solve::Residual| if one.sigma_arcsec > 0.0 { one.arcsec / one.sigma_arcsec } else { 0.0 };
        let title = |one: &solve::Residual| {
            format!(
                "{} {}: {} ± {} {}, {}",
                one.manoeuvre + 1,
                observations[one.manoeuvre].name,
                signed(one.arcsec / angle.arcsec, 2),
                significant(one.sigma_arcsec / angle.arcsec, 2),
                angle.name,
                in_sigmas(sigmas(one))
            )
        };
        let every = observations.len().div_ceil(16).max(1);
        let names = |chart: &mut Chart| {
            for index in (1..=observations.len()).filter(|index| (index - 1) % every == 0) {
                chart.below(index as f64, &index.to_string());
            }
        };
        let max = own.iter().map(|one| one.arcsec.abs() + one.sigma_arcsec).fold(1e-9, f64::max) * 1.15 / angle.arcsec;
        let label = format!("Residuals of {name} in {}, manoeuvre by manoeuvre", angle.name);
        let mut above = Chart::new(&label, (420.0, 200.0), x, (-max, max), 1).counting_x();
        above.y_ticks(6);
        above.y_title(angle.name);
        for one in &own {
            let (at, residual, sigma) = (number(one), one.arcsec / angle.arcsec, one.sigma_arcsec / angle.arcsec);
            above.line("first", (at, residual - sigma), (at, residual + sigma));
            above.dot("dot", (at, residual), &title(one));
        }
        names(&mut above);
        let max = own.iter().map(|one| sigmas(one).abs()).fold(2.3, f64::max) * 1.12;
        let label = format!("Residuals of {name} in sigmas, manoeuvre by manoeuvre");
        let mut below = Chart::new(&label, (420.0, 140.0), x, (-max, max), 1).counting_x();
        for level in [2.0, 1.0] {
            below.polygon("band", [(x.0, -level), (x.1, -level), (x.1, level), (x.0, level)]);
        }
        below.y_ticks(4);
        below.y_title("σ");
        for one in &own {
            let (at, value) = (number(one), sigmas(one));
            below.line("first", (at, 0.0), (at, value));
            below.dot("dot", (at, value), &title(one));
        }
        names(&mut below);
        format!("<figure>\n<figcaption><b>{name}</b></figcaption>\n{}{}</figure>\n", above.finish(), below.finish())
    }

    fn manoeuvres(&self) -> String {
        let Calibrated { solution, observations, .. } = self.calibrated;
        let angle = self.angle();
        let rows = observations.iter().enumerate().map(|(index, observation)| {
            let equations = observation.counts.iter().flatten().count();
            let share = solution.leverage[index] / equations.max(1) as f64;
            let mut row = vec![
                format!("{} {}", index + 1, escape(&observation.name)),
                format!("{:.1}", observation.start_s),
                format!("{:.1}", observation.end_s - observation.start_s),
                format!(
                    "{:.2} of {equations} <span class=\"track\"><span class=\"bar\" style=\"width:{:.0}%\"></span></span>",
                    solution.leverage[index],
                    share.clamp(0.0, 1.0) * 100.0
                ),
            ];
            row.extend(gyros(solution).map(|gyro| {
                let residual = solution.residuals.iter().find(|one| one.manoeuvre == index && one.gyro == gyro);
                residual.map_or_else(
                    || "–".to_owned(),
                    |one| {
                        let sigmas = one.arcsec / one.sigma_arcsec;
                        let residual = fixed(one.arcsec / angle.arcsec, angle.decimals(2));
                        // An equation that no other tests has no residual and no scatter.
                        if !sigmas.is_finite() {
                            return residual;
                        }
                        let sigmas_text = format!("({})", in_sigmas(sigmas));
                        match sigmas.abs() > MARKED_SIGMA {
                            true => format!("{residual} <em>{sigmas_text}</em>"),
                            false => format!("{residual} {sigmas_text}"),
                        }
                    },
                )
            }));
            row
        });
        let header = ["manoeuvre", "start, s", "length, s", "leverage"].into_iter();
        let header: Vec<&str> = header.chain(gyros(solution).map(Gyro::name)).collect();
        let caption = format!("Manoeuvres, leverage on their own equations, and residuals in {}", angle.name);
        table(&caption, &header, rows)
    }

    /// The data that were not used.
    fn left_out(&self) -> Option<String> {
        let rows = self.calibrated.left_out.iter().map(|one| {
            let gyro = one.gyro.map_or("all", Gyro::name);
            vec![escape(&one.name), format!("{:.1}", one.start_s), gyro.to_owned(), prose(&one.why)]
        });
        table_if_any("Data that were not used", &["manoeuvre", "start, s", "gyro", "why"], rows)
    }
}

/// The factor and unit in which sigmas and changes of a parameter are given.
pub fn sigma_unit(parameter: CalibrationParameter) -> (f64, &'static str) {
    match parameter.index {
        0 => (1e6, "ppm"),
        1 => (3600.0 / SAMPLE_INTERVAL_S, "arcsec/h"),
        _ => (1.0, "arcsec"),
    }
}

/// The parameters that moved, as text.
pub fn moved_words(comparison: &Comparison) -> String {
    let moved: Vec<String> = comparison.moved().into_iter().map(CalibrationParameter::label).collect();
    match moved.as_slice() {
        [] => "no parameter alone, but all together".to_owned(),
        [one] => format!("{one} moved"),
        many => format!("{} moved", many.join(", ")),
    }
}

/// A value and its unit: that of its sigma, except for a scale factor, which is a ratio.
fn value_and_unit(parameter: CalibrationParameter, value: f64, angle: AngleUnit) -> (String, String) {
    let (number, unit) = number_and_unit(parameter, value, angle);
    (number.replace('-', "−"), unit)
}

/// Value and unit for a terminal.
fn number_and_unit(parameter: CalibrationParameter, value: f64, angle: AngleUnit) -> (String, String) {
    let (size, unit) = sigma_unit(parameter);
    match parameter.index {
        0 => (format!("{value:.7}"), String::new()),
        1 => (angle.fixed(value * size, 2), angle.converted(unit).1),
        _ => (angle.fixed(value * size, 3), angle.converted(unit).1),
    }
}

fn percent(probability: f64) -> String {
    match probability * 100.0 {
        percent if percent < 0.1 => "less than 0.1 %".to_owned(),
        percent if percent > 99.9 => "more than 99.9 %".to_owned(),
        percent => format!("{} %", significant(percent, 2)),
    }
}
