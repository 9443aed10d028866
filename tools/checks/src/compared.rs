//! Measured counts and those predicted from the reference attitude and the configured calibration.

use geu_calibration::transfer::misalignment_matrix;
use geu_model::Configuration;
use geu_model::attitude::RecordedAttitude;
use geu_model::effect::WiringEffects;
use geu_protocol::Gyro;
use geu_protocol::continuity::SequenceStep;
use geu_protocol::field::unit_flag;
use geu_recording::{ReceivedSample, ReferenceAttitude};
use nalgebra::Vector3;

use super::findings::FindingCollector;
use super::timeline::SampleTimes;
use crate::median;

/// Tolerance between time stamps and the ends of a reference, s.
const TOLERANCE_S: f64 = 0.02;
/// Samples at the ends of a recording that may be outside of the reference without a finding.
const MAX_UNCOVERED: usize = 2;
/// Spacing of rows above which the motion between them is known only if it is steady, s: less is no longer than a few samples.
const SLOW_S: f64 = 2.0;
/// Largest change of the mean rate from row to row of a steady motion, arcsec/s: ordinary errors of a count are as large.
const STEADY_ARCSEC_S: f64 = 16.0;
/// Turn to the first of some wrong rows, beyond the motion before, arcsec: above the noise of a reference.
const GLITCH_ARCSEC: f64 = 50.0;
/// Minimum ratio of the jump to a wrong row of a reference to the jumps beside it, and to what is left of it after the last wrong row.
pub const LONE: f64 = 4.0;
/// Maximum number of wrong rows in succession.
pub const MAX_WRONG: usize = 8;
/// Spacings of rows beside a gap or such rows in which the spline through it is not the motion: the kink decays by 3.7 from row to row.
const BESIDE_GAP: f64 = 10.0;
/// Intervals beside each other that may overlap a sample.
const OVERLAPPING: usize = 32;
/// Limit of the counts, relative to the largest predicted count and absolute. Counts above it do not come from wiring if few.
const OUTLIER: f64 = 2.0;
const OUTLIER_COUNTS: f64 = 100.0;
const FEW_OUTLIERS: f64 = 0.01;

/// Counts of one sample, in the order of [`Gyro::ALL`].
#[derive(Debug, Clone)]
pub struct SampleComparison {
    /// Index of the row.
    pub row: usize,
    /// Predicted, not rounded, before the wiring.
    pub predicted: [f64; 4],
    /// Measured.
    pub measured: [f64; 4],
    /// True for each gyro that can be compared.
    pub is_used: [bool; 4],
    /// Configured wiring with the faults found.
    pub wiring: [WiringEffects; 4],
}

/// All samples without repeats.
#[derive(Debug, Clone)]
pub struct CountComparison {
    pub samples: Vec<SampleComparison>,
}

impl CountComparison {
    /// Reports samples without a reference. `None` if the reference covers no sample.
    pub fn new(
        rows: &[ReceivedSample],
        timeline: &SampleTimes,
        configuration: &Configuration,
        reference: &ReferenceAttitude,
        findings: &mut FindingCollector,
    ) -> Option<CountComparison> {
        let last_s = *timeline.end_s.last()?;
        // The unit's clock starts with the reference.
        let zero_ns = if timeline.is_received { reference.start_ns } else { 0 };
        let offset_s = (i128::from(timeline.start_ns) - i128::from(zero_ns)) as f64 * 1e-9;
        let end_s = reference.truth.end_s();
        let covers = |row: usize| {
            timeline.start_s(row) + offset_s >= -TOLERANCE_S && timeline.end_s[row] + offset_s <= end_s + TOLERANCE_S
        };
        let span = format!(
            "the reference goes from {:.1} to {:.1} s, the recording from 0.0 to {last_s:.1} s",
            0.0 - offset_s,
            end_s - offset_s
        );
        let uncovered = (0..rows.len()).filter(|&row| !covers(row)).count();
        if uncovered == rows.len() {
            findings.whole("reference-apart", None, format!("reference and recording have no time in common: {span}"));
            return None;
        }
        if uncovered > MAX_UNCOVERED {
            findings.whole("reference-short", None, format!("{uncovered} samples have no reference: {span}"));
        }

        let calibrations = configuration.calibrations();
        let matrix = misalignment_matrix(&calibrations);
        let electronics = timeline.electronics(rows, configuration);
        for gap_s in reference.truth.gaps_s() {
            let [from_s, to_s] = gap_s.map(|t_s| t_s - offset_s);
            let text =
                format!("no row of the reference between {from_s:.1} and {to_s:.1} s: nothing is compared there");
            findings.whole("reference-gap", None, text);
        }
        let unsteady = unsteady(&reference.truth);
        let is_known = |row: usize| {
            let sample = [timeline.start_s(row), timeline.end_s[row]].map(|t_s| t_s + offset_s);
            let begun = unsteady.partition_point(|interval| interval[0] < sample[1]);
            // Intervals overlap, but none is within another by more than these.
            unsteady[begun.saturating_sub(OVERLAPPING)..begun].iter().all(|interval| interval[1] <= sample[0])
        };
        let mut near = 0;
        let mut angle = |t_s: f64| Vector3::from(reference.truth.at(t_s + offset_s, &mut near).0);
        let samples = (0..rows.len()).filter(|&row| timeline.steps[row] != SequenceStep::Repeat).map(|row| {
            let sample = &rows[row].sample;
            let (start_s, end_s) = (timeline.start_s(row), timeline.end_s[row]);
            let inputs = matrix * (angle(end_s) - angle(start_s));
            let interval = electronics.interval(start_s, end_s);
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
                    covers(row) && is_known(row) && !is_test && sample.gyro_flags & (valid | saturated) == valid
                }),
                wiring: std::array::from_fn(|gyro| configuration.gyros[gyro].wiring.at(&interval)),
            }
        });
        let mut compared = CountComparison { samples: samples.collect() };
        compared.exclude_outliers();
        Some(compared)
    }

    /// Samples in which a gyro can be compared.
    pub fn on_gyro(&self, gyro: usize) -> impl Iterator<Item = &SampleComparison> {
        self.samples.iter().filter(move |sample| sample.is_used[gyro])
    }

    fn exclude_outliers(&mut self) {
        let largest = |largest: f64, count: &f64| largest.max(count.abs());
        let limit =
            OUTLIER_COUNTS + OUTLIER * self.samples.iter().flat_map(|sample| &sample.predicted).fold(0.0, largest);
        for gyro in 0..4 {
            let all = self.on_gyro(gyro).count();
            let outliers = self.on_gyro(gyro).filter(|sample| sample.measured[gyro].abs() > limit).count();
            if outliers as f64 <= FEW_OUTLIERS * all as f64 {
                self.samples.iter_mut().for_each(|sample| sample.is_used[gyro] &= sample.measured[gyro].abs() <= limit);
            }
        }
    }
}

/// Intervals in which the motion is not known, in order of time: gaps, wrong rows, and the rows of a slow reference beside
/// which the mean rate changes.
fn unsteady(reference: &RecordedAttitude) -> Vec<[f64; 2]> {
    let rows: Vec<(f64, Vector3<f64>)> = reference.rows().map(|(t_s, angle)| (t_s, angle.into())).collect();
    let rate = |from: usize| (rows[from + 1].1 - rows[from].1) / (rows[from + 1].0 - rows[from].0);
    let mut spacings: Vec<f64> = rows.windows(2).map(|pair| pair[1].0 - pair[0].0).collect();
    let spacing_s = median(&mut spacings);
    let beside_s = BESIDE_GAP * spacing_s;
    let mut unknown = reference.gaps_s();
    let last = rows.len().saturating_sub(1);
    // Wrong rows turn there and back.
    let wrong = |from: usize| {
        let before = rate(from - 1);
        let turn_arcsec = (rate(from) - before).amax() * spacing_s;
        let is_small = |other: Vector3<f64>| LONE * other.amax() <= turn_arcsec;
        let is_back = |to: &usize| {
            let (after, turned) = (rate(*to), rows[*to].1 - rows[from].1);
            is_small((after - rate(to + 1)) * spacing_s)
                && is_small(turned - 0.5 * (before + after) * (rows[*to].0 - rows[from].0))
        };
        let is_lone = turn_arcsec > GLITCH_ARCSEC && is_small((before - rate(from - 2)) * spacing_s);
        let to = (from + 2..=from + 1 + MAX_WRONG).take_while(|to| is_lone && to + 1 < last).find(is_back)?;
        Some([rows[from + 1].0, rows[to - 1].0])
    };
    unknown.extend((2..last).filter_map(wrong));
    unknown.iter_mut().for_each(|gap_s| *gap_s = [gap_s[0] - beside_s, gap_s[1] + beside_s]);
    if spacing_s > SLOW_S {
        let changes =
            (1..rows.len().saturating_sub(1)).filter(|&row| (rate(row) - rate(row - 1)).amax() > STEADY_ARCSEC_S);
        unknown.extend(changes.map(|row| [rows[row - 1].0, rows[row + 1].0]));
    }
    unknown.sort_by(|one, other| one[0].total_cmp(&other[0]));
    unknown
}
