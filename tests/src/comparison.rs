//! A recording against our model: the residual of each gyro's accumulated counts, beside what the 16 calibration
//! parameters can take.

use std::path::Path;

use geu_model::attitude::Motion;
use geu_model::{Configuration, GyroUnit, Truth};
use geu_protocol::Gyro;
use geu_recording::{DecoderOptions, Defect, InputReader, ReceivedSample, ReferenceAttitude, Sink, Stop};
use nalgebra::{DMatrix, DVector};

use crate::whitening::Whitening;

/// Largest accumulated residual, arcsec: rounding of a count at both ends and what the drift walks in three hours.
pub const RESIDUAL_ARCSEC: f64 = 3.2;
/// Five sigma: an effect that is not there lowers χ² by more, with its amplitude free, once in two million times.
pub const SIGNIFICANT: f64 = 25.0;
/// χ² per degree of freedom that noise leaves: three deviations of what 21 600 samples allow, 1 ± √(2/21 600). What is
/// measured is 0.983…1.011; rounding is not quite white while a gyro rests.
pub const NOISE_LIKE: std::ops::Range<f64> = 0.97..1.03;

/// The samples and defects of a capture.
#[derive(Default)]
pub struct Received {
    /// Each sample.
    pub rows: Vec<ReceivedSample>,
    /// Each defect, without its bytes.
    pub defects: Vec<Defect<'static>>,
}

impl Sink for Received {
    fn row(&mut self, row: &ReceivedSample) {
        self.rows.push(*row);
    }
    fn defect(&mut self, defect: &Defect) {
        self.defects.push(Defect { input: "link.log", bytes: &[], ..*defect });
    }
}

impl Received {
    /// A capture.
    ///
    /// # Panics
    /// If the file cannot be read.
    pub fn read(link: &Path) -> Received {
        let (mut reader, mut received) =
            (InputReader::new(DecoderOptions::default(), Stop::default()), Received::default());
        reader.read(&link.to_string_lossy(), &mut received).expect("a recording");
        reader.finish(&mut received).1.expect("a recording");
        received
    }
}

/// One recording: what was measured, and what moved.
pub struct Recording {
    /// Each sample.
    pub rows: Vec<ReceivedSample>,
    /// The motion.
    pub reference: ReferenceAttitude,
}

impl Recording {
    /// A capture and a reference; a defect in the capture is not expected.
    ///
    /// # Panics
    /// If a file cannot be read, or has a defect.
    pub fn read(link: &Path, reference: &Path) -> Recording {
        let Received { rows, defects } = Received::read(link);
        assert!(defects.is_empty(), "{}", defects[0].place_text());
        let reference = ReferenceAttitude::read(&reference.to_string_lossy()).expect("a reference");
        Recording { rows, reference }
    }

    /// Measured against the reference unit with these overrides.
    ///
    /// # Panics
    /// If an override is not valid.
    pub fn against(&self, overrides: &[String]) -> Comparison {
        self.against_commanded(overrides, f64::INFINITY, &[])
    }

    /// Compares as `against`, with a command to the model in the sample interval that starts at `command_s`.
    ///
    /// # Panics
    /// If an override is not valid.
    pub fn against_commanded(&self, overrides: &[String], command_s: f64, command: &[u8]) -> Comparison {
        let mut configuration = Configuration::reference_with(overrides).expect("valid").without_noise();
        configuration.electronics = Default::default();
        configuration.electronics.table = self
            .rows
            .iter()
            .enumerate()
            .map(|(index, row)| ((index + 1) as f64 * 0.5, f64::from(row.sample.electronics_centi_c) * 0.01))
            .collect();
        let truth = Truth::Recorded(self.reference.truth.clone());
        let mut unit = GyroUnit::on(&configuration, &truth);
        let mut motion = Motion::recorded(self.reference.truth.clone(), 0.0);
        let (mut difference, mut turned, mut end_s) = ([0.0; 4], [0.0; 3], 0.0);
        let (mut residuals, mut regressors): ([Vec<f64>; 4], Vec<f64>) = Default::default();
        for (index, row) in self.rows.iter().enumerate() {
            if index as f64 * 0.5 == command_s {
                let _ = unit.command(command);
            }
            let (ended, traces) = unit.end_sample_traced();
            let step = motion.advance(ended.end_ns as f64 * 1e-9);
            for (sum, angle) in turned.iter_mut().zip(step.angle_control_arcsec) {
                *sum += angle;
            }
            end_s += step.length_s;
            // Radian and hour, so that the columns are of one size.
            regressors.extend(turned.map(|angle| angle / 206_265.0));
            regressors.push(end_s / 3600.0);
            for gyro in 0..4 {
                difference[gyro] += f64::from(row.sample.increments[gyro]) - traces[gyro].unquantised;
                residuals[gyro].push(difference[gyro]);
            }
        }
        Comparison { residuals, regressors: DMatrix::from_row_slice(self.rows.len(), 4, &regressors) }
    }
}

/// Accumulated counts measured less those of the model, for each gyro and sample; and what the 16 parameters can
/// do to them: the turns about the three axes and the time, free for each gyro.
pub struct Comparison {
    /// For each gyro.
    pub residuals: [Vec<f64>; 4],
    /// A row for each sample.
    pub regressors: DMatrix<f64>,
}

impl Comparison {
    /// Residual of each gyro after the refit.
    pub fn refitted(&self) -> [Vec<f64>; 4] {
        self.residuals.each_ref().map(|residual| left(residual, &self.regressors))
    }

    /// χ² of an accumulated angle beside the 16 parameters.
    pub fn chi2(&self, whitening: &Whitening, accumulated: &[f64]) -> f64 {
        let whitened: Vec<f64> =
            self.regressors.column_iter().flat_map(|column| whitening.apply(column.clone_owned().as_slice())).collect();
        let regressors = DMatrix::from_vec(accumulated.len(), 4, whitened);
        squares(&left(&whitening.apply(accumulated), &regressors))
    }
}

/// A recording against the reference unit without and with the injected effects.
pub struct Case {
    /// In messages.
    pub name: String,
    /// Gyros of the injected effects; empty for an effect of the unit.
    pub gyros: Vec<String>,
    /// The reference unit alone.
    pub without: Comparison,
    /// With the injected effects.
    pub with: Comparison,
}

impl Case {
    /// The injected effects lower χ² as the model predicts, and the rest is noise.
    ///
    /// # Panics
    /// If χ² does not fall as predicted or the rest is not noise.
    pub fn assert_chi_squared_falls_as_predicted(&self) {
        let Case { name, gyros, without, with } = self;
        let configuration = Configuration::reference();
        for gyro in Gyro::ALL {
            let (before, after) = (&without.residuals[gyro.index()], &with.residuals[gyro.index()]);
            let whitening = Whitening::of(&configuration.gyros[gyro.index()].effects.constant, after.len());
            let signature: Vec<f64> = before.iter().zip(after).map(|(before, after)| before - after).collect();
            let predicted = with.chi2(&whitening, &signature);
            let (before, after) = (without.chi2(&whitening, before), with.chi2(&whitening, after));
            let (fall, dof) = (before - after, (signature.len() - 4) as f64);
            let left = largest(&with.refitted()[gyro.index()]);
            let gyro = gyro.name();
            println!(
                "{name:32} {gyro:5} {:12.3} {:9.3} {fall:14.1} {predicted:14.1} {left:8.2}",
                before / dof,
                after / dof
            );
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

    /// The columns of what [`Case::assert_chi_squared_falls_as_predicted`] prints.
    pub const COLUMNS: &str =
        "recording                        gyro  chi2: without      with           fall      predicted   arcsec left";
}

/// What least squares leave of `measured`.
///
/// # Panics
/// Where the regressors cannot be decomposed.
pub fn left(measured: &[f64], regressors: &DMatrix<f64>) -> Vec<f64> {
    let measured = DVector::from_column_slice(measured);
    let solved = regressors.clone().svd(true, true).solve(&measured, 1e-12).expect("computed with both sides");
    (measured - regressors * solved).as_slice().to_vec()
}

/// The sum of squares.
pub fn squares(residual: &[f64]) -> f64 {
    residual.iter().map(|value| value * value).sum()
}

/// The largest departure from 0.
pub fn largest(residual: &[f64]) -> f64 {
    residual.iter().fold(0.0, |largest, value| value.abs().max(largest))
}
