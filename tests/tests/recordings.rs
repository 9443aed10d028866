//! Our model against measured recordings that an independent implementation made: with what was hidden put in and the
//! sixteen calibration parameters refitted, nothing is left.

use std::path::PathBuf;

use geu_model::attitude::Motion;
use geu_model::{Configuration, Truth, Unit};
use geu_protocol::Gyro;
use geu_recording::{Defect, InputReader, Options, Reference, Row, Sink, Stop};
use geu_tests::{root, skipped};
use nalgebra::{DMatrix, DVector};
use toml_edit::DocumentMut;

/// Largest accumulated residual, arcsec: rounding of a count at both ends and what the drift walks in three hours.
const RESIDUAL_ARCSEC: f64 = 3.2;

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

    /// Accumulated counts measured less those of the model, after the refit, for each gyro and half second.
    fn residuals(&self, overrides: &[String]) -> [Vec<f64>; 4] {
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
        let regressors = DMatrix::from_row_slice(self.rows.len(), 4, &regressors);
        let svd = regressors.clone().svd(true, true);
        residuals.map(|residual| {
            let measured = DVector::from_vec(residual);
            let solved = svd.solve(&measured, 1e-12).expect("computed with both sides");
            (measured - &regressors * solved).as_slice().to_vec()
        })
    }
}

fn largest(residual: &[f64]) -> f64 {
    residual.iter().fold(0.0, |largest, value| value.abs().max(largest))
}

#[test]
fn two_independent_implementations_agree() {
    let Some(directory) = recordings() else { return };
    let answers: DocumentMut =
        std::fs::read_to_string(directory.join("answers.toml")).expect("answers").parse().expect("TOML");
    let hidden = answers["hidden"].as_array_of_tables().expect("a list");
    for name in ["01", "02", "03", "04", "05", "06", "07", "08", "10"] {
        let recording = Recording::read(&directory.join(name));
        let mut overrides = Vec::new();
        for entry in hidden.iter().filter(|entry| entry["recording"].as_str() == Some(name)) {
            let code = entry["effect"].as_str().expect("a code");
            let gyros: Vec<String> =
                entry.get("gyros").and_then(|item| item.as_array()).map_or_else(Vec::new, |list| {
                    list.iter().filter_map(|gyro| gyro.as_str().map(str::to_owned)).collect()
                });
            let places = if gyros.is_empty() {
                vec!["unit".to_owned()]
            } else {
                gyros.iter().map(|g| format!("gyro.{g}")).collect()
            };
            for (key, value) in entry.iter().filter(|(key, _)| !["recording", "effect", "gyros"].contains(key)) {
                overrides.extend(places.iter().map(|place| format!("{place}.{code}.{key}={value}")));
            }
        }
        let (without, with) = (recording.residuals(&[]), recording.residuals(&overrides));
        for gyro in Gyro::ALL {
            let (before, after) = (&without[gyro as usize], &with[gyro as usize]);
            let squares = |residual: &[f64]| residual.iter().map(|value| value * value).sum::<f64>();
            assert!(largest(after) < RESIDUAL_ARCSEC, "{name} {}: {:.2} arcsec left", gyro.name(), largest(after));
            // What is hidden is seen where it moves a gyro by more than noise and rounding do; then it is explained.
            if largest(before) > 2.0 * RESIDUAL_ARCSEC {
                assert!(squares(after) < 0.1 * squares(before), "{name} {}", gyro.name());
            }
        }
    }
}
