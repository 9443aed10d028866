//! Our model against measured recordings that an independent implementation made: with what was hidden put in and the
//! sixteen calibration parameters refitted, nothing but noise is left.

mod whitening;

use std::path::PathBuf;

use geu_model::attitude::Motion;
use geu_model::{Configuration, Truth, Unit};
use geu_protocol::Gyro;
use geu_recording::{Defect, InputReader, Options, Reference, Row, Sink, Stop};
use geu_tests::{root, skipped};
use nalgebra::{DMatrix, DVector};
use toml_edit::DocumentMut;
use whitening::Whitening;

/// Largest accumulated residual, arcsec: rounding of a count at both ends and what the drift walks in three hours.
const RESIDUAL_ARCSEC: f64 = 3.2;
/// Five sigma: an effect that is not there lowers χ² by more, with its amplitude free, once in two million times.
const SIGNIFICANT: f64 = 25.0;
/// χ² per degree of freedom that noise leaves: three deviations of what 21 600 half seconds allow, 1 ± √(2/21 600). What is
/// measured is 0.983…1.011; rounding is not quite white while a gyro rests.
const NOISE_LIKE: std::ops::Range<f64> = 0.97..1.03;

fn recordings() -> Option<PathBuf> {
    let directory = root().join("../shared/recordings");
    if directory.join("answers.toml").exists() {
        return Some(directory);
    }
    skipped(&format!("{} is not there: no measured recordings to compare with", directory.display()));
    None
}

#[derive(Default)]
struct Rows(Vec<Row>);

impl Sink for Rows {
    fn row(&mut self, row: &Row) {
        self.0.push(*row);
    }
    fn defect(&mut self, defect: &Defect) {
        panic!("{}", defect.place_text());
    }
}

/// One recording: what was measured, and what moved.
struct Recording {
    rows: Vec<Row>,
    reference: Reference,
}

impl Recording {
    fn read(directory: &std::path::Path) -> Recording {
        let (mut reader, mut rows) = (InputReader::new(Options::default(), Stop::default()), Rows::default());
        reader.read(&directory.join("link.log.gz").to_string_lossy(), &mut rows).expect("a recording");
        reader.finish(&mut rows).1.expect("a recording");
        let reference = Reference::read(&directory.join("reference.csv.gz").to_string_lossy()).expect("a reference");
        Recording { rows: rows.0, reference }
    }

    /// Measured against the reference unit with these overrides.
    fn against(&self, overrides: &[String]) -> Comparison {
        let mut configuration = Configuration::reference_with(overrides).expect("valid");
        configuration.electronics = Default::default();
        configuration.electronics.table = self
            .rows
            .iter()
            .enumerate()
            .map(|(index, row)| ((index + 1) as f64 * 0.5, f64::from(row.half_second.electronics_centi_c) * 0.01))
            .collect();
        for gyro in &mut configuration.gyros {
            gyro.effects.constant.angle_random_walk = Default::default();
            gyro.effects.constant.drift_random_walk = Default::default();
        }
        let truth = Truth::Recorded(self.reference.truth.clone());
        let mut unit = Unit::on(&configuration, &truth);
        let mut motion = Motion::recorded(self.reference.truth.clone(), 0.0);
        let (mut difference, mut turned, mut end_s) = ([0.0; 4], [0.0; 3], 0.0);
        let (mut residuals, mut regressors): ([Vec<f64>; 4], Vec<f64>) = Default::default();
        for row in &self.rows {
            let (ended, traces) = unit.end_half_second_traced();
            let step = motion.advance(ended.end_ns as f64 * 1e-9);
            for (sum, angle) in turned.iter_mut().zip(step.angle_control_arcsec) {
                *sum += angle;
            }
            end_s += step.length_s;
            // Radian and hour, so that the columns are of one size.
            regressors.extend(turned.map(|angle| angle / 206_265.0));
            regressors.push(end_s / 3600.0);
            for gyro in 0..4 {
                difference[gyro] += f64::from(row.half_second.increments[gyro]) - traces[gyro].unquantised;
                residuals[gyro].push(difference[gyro]);
            }
        }
        Comparison { residuals, regressors: DMatrix::from_row_slice(self.rows.len(), 4, &regressors) }
    }
}

/// Accumulated counts measured less those of the model, for each gyro and half second; and what the sixteen parameters can
/// do to them: the turns about the three axes and the time, free for each gyro.
struct Comparison {
    residuals: [Vec<f64>; 4],
    regressors: DMatrix<f64>,
}

impl Comparison {
    /// What is left of each gyro's residual after the refit.
    fn refitted(&self) -> [Vec<f64>; 4] {
        self.residuals.each_ref().map(|residual| left(residual, &self.regressors))
    }

    /// χ² of an accumulated angle beside the sixteen parameters.
    fn chi2(&self, whitening: &Whitening, accumulated: &[f64]) -> f64 {
        let whitened: Vec<f64> =
            self.regressors.column_iter().flat_map(|column| whitening.apply(column.clone_owned().as_slice())).collect();
        let regressors = DMatrix::from_vec(accumulated.len(), 4, whitened);
        squares(&left(&whitening.apply(accumulated), &regressors))
    }
}

/// What least squares leave of `measured`.
fn left(measured: &[f64], regressors: &DMatrix<f64>) -> Vec<f64> {
    let measured = DVector::from_column_slice(measured);
    let solved = regressors.clone().svd(true, true).solve(&measured, 1e-12).expect("computed with both sides");
    (measured - regressors * solved).as_slice().to_vec()
}

fn squares(residual: &[f64]) -> f64 {
    residual.iter().map(|value| value * value).sum()
}

fn largest(residual: &[f64]) -> f64 {
    residual.iter().fold(0.0, |largest, value| value.abs().max(largest))
}

/// A recording whose effects our model has, against the reference unit without what is hidden in it and with it; and the
/// gyros that are named.
struct Case {
    name: &'static str,
    gyros: Vec<String>,
    without: Comparison,
    with: Comparison,
}

fn cases() -> impl Iterator<Item = Case> {
    recordings().into_iter().flat_map(|directory| {
        let answers: DocumentMut =
            std::fs::read_to_string(directory.join("answers.toml")).expect("answers").parse().expect("TOML");
        ["01", "02", "03", "04", "05", "06", "07", "08", "10"].into_iter().map(move |name| {
            let (mut overrides, mut named) = (Vec::new(), Vec::new());
            let hidden = answers["hidden"].as_array_of_tables().expect("a list");
            for entry in hidden.iter().filter(|entry| entry["recording"].as_str() == Some(name)) {
                let code = entry["effect"].as_str().expect("a code");
                let list = entry.get("gyros").and_then(|item| item.as_array());
                let gyros: Vec<&str> = list.into_iter().flatten().filter_map(|gyro| gyro.as_str()).collect();
                let places: Vec<String> = if gyros.is_empty() {
                    vec!["unit".to_owned()]
                } else {
                    gyros.iter().map(|gyro| format!("gyro.{gyro}")).collect()
                };
                named.extend(gyros.into_iter().map(str::to_owned));
                for (key, value) in entry.iter().filter(|(key, _)| !["recording", "effect", "gyros"].contains(key)) {
                    overrides.extend(places.iter().map(|place| format!("{place}.{code}.{key}={value}")));
                }
            }
            let recording = Recording::read(&directory.join(name));
            Case { name, gyros: named, without: recording.against(&[]), with: recording.against(&overrides) }
        })
    })
}

#[test]
fn two_independent_implementations_agree() {
    for Case { name, without, with, .. } in cases() {
        let (without, with) = (without.refitted(), with.refitted());
        for gyro in Gyro::ALL {
            let (before, after) = (&without[gyro as usize], &with[gyro as usize]);
            assert!(largest(after) < RESIDUAL_ARCSEC, "{name} {}: {:.2} arcsec left", gyro.name(), largest(after));
            // What is hidden is seen where it moves a gyro by more than noise and rounding do; then it is explained.
            if largest(before) > 2.0 * RESIDUAL_ARCSEC {
                assert!(squares(after) < 0.1 * squares(before), "{name} {}", gyro.name());
            }
        }
    }
}

#[test]
fn what_is_hidden_lowers_chi_squared_by_what_the_model_predicts_and_leaves_noise() {
    let configuration = Configuration::reference();
    println!("recording gyro   chi2/dof without      with  fall of chi2  predicted");
    for Case { name, gyros, without, with } in cases() {
        for gyro in Gyro::ALL {
            let (before, after) = (&without.residuals[gyro as usize], &with.residuals[gyro as usize]);
            let whitening = Whitening::of(&configuration.gyros[gyro as usize].effects.constant, after.len());
            let signature: Vec<f64> = before.iter().zip(after).map(|(before, after)| before - after).collect();
            let predicted = with.chi2(&whitening, &signature);
            let (before, after) = (without.chi2(&whitening, before), with.chi2(&whitening, after));
            let (fall, dof) = (before - after, (signature.len() - 4) as f64);
            let gyro = gyro.name();
            println!("{name} {gyro:9} {:20.3} {:9.3} {fall:13.1} {predicted:10.1}", before / dof, after / dof);
            // A gyro that an answer names; by an effect of the unit, which names none, a gyro that it moves enough.
            if gyros.iter().any(|named| named == gyro) || predicted > 2.0 * SIGNIFICANT {
                assert!(fall > SIGNIFICANT, "{name} {gyro}: chi2 falls by {fall:.1} only");
            }
            // (s + e)² − e² is s² + 2 s·e: for white e of variance 1 it is s² with a deviation of 2|s|. Five of them.
            assert!(
                (fall - predicted).abs() <= 10.0 * predicted.sqrt(),
                "{name} {gyro}: {fall:.1}, not {predicted:.1}"
            );
            assert!(NOISE_LIKE.contains(&(after / dof)), "{name} {gyro}: chi2/dof {:.3} left", after / dof);
        }
    }
}
