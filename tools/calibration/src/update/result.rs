//! The result of an update, and its JSON.

use geu_model::package::Calibration;
use nalgebra::{DMatrix, DVector};
use serde::Serialize;
use serde_json::{Value, json};

use super::{BEYOND_SIGMAS, FORTNIGHT_S, GYROS, MIN_SCAN_ARCSEC_S, SCALE_FACTOR_PER_HALF_HOUR};
use crate::observe::ExcludedData;
use crate::report;
use crate::solve::{CalibrationParameter, Observation, UNKNOWNS};

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ParameterUpdate {
    /// A scale factor, or a drift in arcsec per sample interval.
    pub parameter: CalibrationParameter,
    pub old: f64,
    /// Sigma of the calibration, grown by the stability figures up to the recording and by the configured walk over it.
    pub old_sigma: f64,
    /// Refined value, at the end of the recording.
    pub new: f64,
    pub new_sigma: f64,
    /// Change since the calibration that the stability figures allow.
    pub allowed: f64,
    /// Time until its uncertainty, growing by the stability figure, reaches that of a fortnight: s after the end of the
    /// recording; 0 if it has already.
    pub due_in_s: f64,
}

impl ParameterUpdate {
    pub fn change(&self) -> f64 {
        self.new - self.old
    }

    /// The change in sigmas of the prior, aged by the stability figures: the update's own standard deviation is the root of
    /// the decrease of the variance.
    pub fn beyond_stability(&self) -> f64 {
        self.change() / (self.old_sigma.powi(2) - self.new_sigma.powi(2)).max(f64::MIN_POSITIVE).sqrt()
    }

    /// True if the change exceeds the paper's stability: then the gyro is not the one that was calibrated.
    pub fn is_beyond_stability(&self) -> bool {
        self.beyond_stability().abs() > BEYOND_SIGMAS
    }

    /// True if the new value differs from the old by 3 of its sigmas.
    pub fn is_significant(&self) -> bool {
        self.change().abs() > 3.0 * self.new_sigma
    }

    /// True if the scans determine the parameter better than the prior: the variance fell below half.
    pub fn is_observable(&self) -> bool {
        self.new_sigma < self.old_sigma * std::f64::consts::FRAC_1_SQRT_2
    }
}

#[derive(Debug, Clone, PartialEq)]
pub struct ScanSegment {
    pub name: String,
    /// Start, s since the start of the recording.
    pub start_s: f64,
    pub end_s: f64,
    pub rate_z_arcsec_s: f64,
    /// Residual of each Z gyro and its standard deviation, arcsec; `None` if its counts are unusable.
    pub residuals: [Option<(f64, f64)>; 2],
}

impl From<&Observation> for ScanSegment {
    fn from(observation: &Observation) -> ScanSegment {
        let &Observation { start_s, end_s, rotation_control_arcsec, .. } = observation;
        let rate_z_arcsec_s = rotation_control_arcsec[2] / (end_s - start_s);
        ScanSegment { name: observation.name.clone(), start_s, end_s, rate_z_arcsec_s, residuals: [None; 2] }
    }
}

impl ScanSegment {
    /// True if the segment determines the scale factor.
    pub fn is_scan(&self) -> bool {
        self.rate_z_arcsec_s.abs() >= MIN_SCAN_ARCSEC_S
    }

    pub(super) fn turned_z_arcsec(&self) -> f64 {
        self.rate_z_arcsec_s * (self.end_s - self.start_s)
    }
}

/// Scale factors of successive scans against each other.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ShortTerm {
    /// Pairs of successive scans that begin within an hour.
    pub pairs: usize,
    pub rms: f64,
    pub expected_rms: f64,
}

impl ShortTerm {
    pub fn excess(&self) -> f64 {
        (self.rms.powi(2) - self.expected_rms.powi(2)).max(0.0).sqrt()
    }

    /// True if the excess is significant and more than table 1 allows.
    pub fn is_exceeded(&self) -> bool {
        let threshold = 1.0 + BEYOND_SIGMAS * (2.0 / self.pairs.max(1) as f64).sqrt();
        self.excess() > SCALE_FACTOR_PER_HALF_HOUR && self.rms.powi(2) > threshold * self.expected_rms.powi(2)
    }
}

/// The four refined values and the data they rest on.
#[derive(Debug, Clone, PartialEq)]
pub struct CalibrationUpdate {
    /// The four refined values, in the order of `correlation`.
    pub changes: [ParameterUpdate; 4],
    pub correlation: DMatrix<f64>,
    /// All calibration parameters, four of them refined.
    pub calibrations: [Calibration; 4],
    /// Sigmas of all calibration parameters, those of the prior except for the four.
    pub sigmas: [f64; UNKNOWNS],
    /// χ² of the equations and of the departures from the prior.
    pub chi2: f64,
    pub degrees_of_freedom: usize,
    pub used: Vec<ScanSegment>,
    pub left_out: Vec<ExcludedData>,
    /// Time of the prior calibration, s on the time scale of the capture.
    pub known_at_s: f64,
    /// Time for which the refined values hold, the end of the last segment.
    pub at_s: f64,
    /// Electronics over the scans above the calibration's reference, K.
    pub electronics_above_k: f64,
    pub short_term: [ShortTerm; 2],
}

impl CalibrationUpdate {
    /// Probability of a χ² as large or larger.
    pub fn probability(&self) -> f64 {
        crate::solve::probability(self.chi2, self.degrees_of_freedom)
    }

    /// When the first of the four is due, s after [`CalibrationUpdate::at_s`].
    pub fn due_in_s(&self) -> f64 {
        self.changes.iter().map(|change| change.due_in_s).fold(FORTNIGHT_S, f64::min)
    }

    /// True if a change exceeds the stability figures, which requires a checkout.
    pub fn needs_checkout(&self) -> bool {
        self.changes.iter().any(ParameterUpdate::is_beyond_stability)
            || self.short_term.iter().any(ShortTerm::is_exceeded)
    }

    /// The result as JSON. `gyros` has the form of a calibration, so that readers of one accept this: the four
    /// refined, the others from the configuration. `known_time_s` is the time of the configured values, `time_s` that of the
    /// new; `changes` has old and new value and sigma of each, `allowed` by the stability figures since, `beyond_stability`
    /// in sigmas, `due_in_s` after `time_s`; `short_term` compares successive scans (relative); `used` has each segment with
    /// its residuals, `left_out` the others with the reason.
    pub fn json(&self) -> Value {
        let by_gyro = |[za, zb]: [Value; 2]| json!({ GYROS[0].name(): za, GYROS[1].name(): zb });
        let changes = self.changes.iter().map(|change| {
            json!({
                "parameter": change.parameter.label(),
                "unit": if change.parameter.index == 0 { "" } else { "arcsec/half s" },
                "old": { "value": change.old, "sigma": change.old_sigma },
                "new": { "value": change.new, "sigma": change.new_sigma },
                "allowed": change.allowed,
                "beyond_stability": change.beyond_stability(),
                "significant": change.is_significant(),
                "observable": change.is_observable(),
                "due_in_s": change.due_in_s,
            })
        });
        let all: Vec<_> = CalibrationParameter::all().collect();
        let variances = DVector::from_iterator(UNKNOWNS, self.sigmas.iter().map(|sigma| sigma * sigma));
        let covariance = DMatrix::from_diagonal(&variances);
        json!({
            "gyros": report::gyros(&all, &self.calibrations, Some(&covariance), &[]),
            "chi2": { "value": self.chi2, "dof": self.degrees_of_freedom, "probability": self.probability() },
            "known_time_s": self.known_at_s,
            "time_s": self.at_s,
            "changes": changes.collect::<Vec<_>>(),
            "correlation": report::rows(&self.correlation),
            "electronics_above_reference_k": self.electronics_above_k,
            "short_term": by_gyro(self.short_term.map(|own| json!(own))),
            "due_in_s": self.due_in_s(),
            "checkout_due": self.needs_checkout(),
            "used": self.used.iter().map(|used| json!({
                "stretch": used.name,
                "start_s": used.start_s,
                "end_s": used.end_s,
                "rate_z_arcsec_s": used.rate_z_arcsec_s,
                "residuals": by_gyro(used.residuals.map(|residual| residual.map_or(Value::Null, report::residual))),
            })).collect::<Vec<_>>(),
            "left_out": report::left_out("stretch", &self.left_out),
        })
    }
}
