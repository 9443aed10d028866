//! The counts beside what the reference and the configured calibration predict, sample by sample.

use geu_calibration::transfer::misalignment_matrix;
use geu_model::Configuration;
use geu_model::course::Interval;
use geu_model::effect::WiringEffects;
use geu_protocol::Gyro;
use geu_protocol::continuity::SequenceStep;
use geu_protocol::field::unit_flag;
use geu_recording::{ReceivedSample, ReferenceAttitude};
use nalgebra::Vector3;

use super::timeline::SampleTimes;
use super::told::FindingCollector;

/// What stamps and the ends of a reference may miss of each other, s.
const COVERED_S: f64 = 0.02;
/// A reference that ends with the recording may miss the samples at the ends; more is told.
const MOST_UNCOVERED: usize = 2;
/// A count so many times beyond anything predicted is of no wiring, where there are few of them.
const OUTLIER: f64 = 2.0;
const OUTLIER_COUNTS: f64 = 100.0;
const FEW_OUTLIERS: f64 = 0.01;

/// One sample. Counts in the order of [`Gyro::ALL`].
#[derive(Debug, Clone)]
pub struct SampleComparison {
    /// Index of its row.
    pub row: usize,
    /// What the gyros would count, unquantised and before their wiring.
    pub predicted: [f64; 4],
    /// What was counted.
    pub measured: [f64; 4],
    /// Whether the two can be compared.
    pub is_used: [bool; 4],
    /// Wiring as it is believed.
    pub wiring: [WiringEffects; 4],
}

/// All samples, repeats left out.
#[derive(Debug, Clone)]
pub struct CountComparison {
    pub halves: Vec<SampleComparison>,
}

impl CountComparison {
    /// Tells where the reference does not cover the recording; nothing where it covers none of it.
    pub fn of(
        rows: &[ReceivedSample],
        timeline: &SampleTimes,
        configuration: &Configuration,
        reference: &ReferenceAttitude,
        told: &mut FindingCollector,
    ) -> Option<CountComparison> {
        let last_s = *timeline.end_s.last()?;
        // A clock of its own starts with the reference.
        let zero_ns = if timeline.is_received { reference.start_ns } else { 0 };
        let offset_s = (i128::from(timeline.start_ns) - i128::from(zero_ns)) as f64 * 1e-9;
        let end_s = reference.truth.end_s();
        let covers = |row: usize| {
            timeline.start_s(row) + offset_s >= -COVERED_S && timeline.end_s[row] + offset_s <= end_s + COVERED_S
        };
        let span = format!(
            "the reference goes from {:.1} to {:.1} s, the recording from 0.0 to {last_s:.1} s",
            0.0 - offset_s,
            end_s - offset_s
        );
        let uncovered = (0..rows.len()).filter(|&row| !covers(row)).count();
        if uncovered == rows.len() {
            told.whole("reference-apart", None, format!("reference and recording have no time in common: {span}"));
            return None;
        }
        if uncovered > MOST_UNCOVERED {
            told.whole("reference-short", None, format!("{uncovered} samples have no reference: {span}"));
        }

        let calibrations = configuration.gyros.each_ref().map(|gyro| gyro.calibration);
        let matrix = misalignment_matrix(&calibrations);
        let reference_c = configuration.electronics.numbers.reference_c;
        let mut near = 0;
        let mut angle = |t_s: f64| Vector3::from(reference.truth.at(t_s + offset_s, &mut near).0);
        let halves = (0..rows.len()).filter(|&row| timeline.steps[row] != SequenceStep::Repeat).map(|row| {
            let sample = &rows[row].sample;
            let (start_s, end_s) = (timeline.start_s(row), timeline.end_s[row]);
            let inputs = matrix * (angle(end_s) - angle(start_s));
            let electronics_c = f64::from(sample.electronics_centi_c) * 0.01;
            let interval = Interval { start_s, end_s, electronics_excess_k: electronics_c - reference_c };
            let is_test = sample.unit_flags & const { unit_flag("self_test") } != 0;
            SampleComparison {
                row,
                predicted: std::array::from_fn(|gyro| {
                    let calibration = &calibrations[gyro];
                    (inputs[gyro] - calibration.drift_arcsec_per_half_s) / calibration.scale_factor
                }),
                measured: sample.increments.map(f64::from),
                is_used: Gyro::ALL.map(|gyro| {
                    let (valid, saturated) = (gyro.bit(), gyro.bit() << 4);
                    covers(row) && !is_test && sample.gyro_flags & (valid | saturated) == valid
                }),
                wiring: configuration.gyros.each_ref().map(|gyro| gyro.wiring.at(&interval)),
            }
        });
        let mut compared = CountComparison { halves: halves.collect() };
        compared.leave_out_outliers();
        Some(compared)
    }

    /// The samples in which a gyro can be compared.
    pub fn of_gyro(&self, gyro: usize) -> impl Iterator<Item = &SampleComparison> {
        self.halves.iter().filter(move |half| half.is_used[gyro])
    }

    fn leave_out_outliers(&mut self) {
        let largest = |largest: f64, count: &f64| largest.max(count.abs());
        let limit = OUTLIER_COUNTS + OUTLIER * self.halves.iter().flat_map(|half| &half.predicted).fold(0.0, largest);
        for gyro in 0..4 {
            let all = self.of_gyro(gyro).count();
            let outliers = self.of_gyro(gyro).filter(|half| half.measured[gyro].abs() > limit).count();
            if outliers as f64 <= FEW_OUTLIERS * all as f64 {
                self.halves.iter_mut().for_each(|half| half.is_used[gyro] &= half.measured[gyro].abs() <= limit);
            }
        }
    }
}
