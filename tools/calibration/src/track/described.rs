//! Attitude from the samples of a described unit, fitted to its heads.

use geu_model::Configuration;
use geu_model::units::SAMPLE_INTERVAL_S;
use geu_protocol::Gyros;
use geu_recording::DeviceSample;
use nalgebra::{DMatrix, DVector, Matrix3xX, MatrixXx3, UnitQuaternion};

use super::{Reason, Track, TrackerEvent, Turned};
use crate::counts::{BreakKind, HeadAngles, HeadReader};
use crate::transfer::sensing_matrix;

/// Minimum eigenvalue of the normal matrix of the heads in use: 1 with a head along each axis, 0.33 of three heads of a tetrad, the square of a
/// misalignment where a head is missing.
const MIN_EIGENVALUE: f64 = 0.01;
/// Heads that determine an attitude without redundancy.
const AXES: usize = 3;

/// Tracks the samples of a described unit in order.
#[derive(Debug, Clone)]
pub struct DeviceTracker {
    reader: HeadReader,
    /// Scale factor and drift, arcsec per sample, of each head.
    calibrations: Vec<(f64, f64)>,
    axes: MatrixXx3<f64>,
    /// The heads in use, and the rotation about the control axes from theirs.
    in_use: (Gyros, Matrix3xX<f64>),
    /// From angles of the heads to their residuals, if more heads measure than are needed.
    residual: Option<DMatrix<f64>>,
    residuals_arcsec: DVector<f64>,
    turned: Turned,
    without: u64,
    /// Number of rows of other trials than the first.
    pub of_other_trials: u64,
}

impl DeviceTracker {
    /// A tracker before the first sample, with the attitude at its start (control frame to inertial).
    ///
    /// # Errors
    /// The heads do not measure about three axes: the message.
    pub fn new(configuration: &Configuration, attitude: UnitQuaternion<f64>) -> Result<DeviceTracker, String> {
        let (device, axes) = (&configuration.device, sensing_matrix(configuration));
        let heads = device.all_gyros();
        let inverse = rotation_of_heads(&axes, heads).ok_or_else(|| {
            let (unit, got) = (&device.name, heads.names().join(", "));
            format!("{unit}: expected heads about three axes, which an attitude needs, got {got}")
        })?;
        let samples = device.interval_s / SAMPLE_INTERVAL_S;
        let own = configuration.gyros.iter().map(|gyro| &gyro.calibration);
        let is_redundant = heads.heads() > AXES;
        Ok(DeviceTracker {
            reader: HeadReader::new(device),
            calibrations: own.map(|own| (own.scale_factor, own.drift_arcsec_per_half_s * samples)).collect(),
            residual: is_redundant.then(|| DMatrix::identity(heads.heads(), heads.heads()) - &axes * &inverse),
            residuals_arcsec: DVector::zeros(heads.heads()),
            axes,
            in_use: (heads, inverse),
            turned: Turned::new(attitude),
            without: 0,
            of_other_trials: 0,
        })
    }

    /// Processes a sample; `None` if it is repeated or of another trial.
    pub fn push(&mut self, row: &DeviceSample) -> Option<Track> {
        if self.reader.is_of_other_trial(row) {
            self.of_other_trials += 1;
            return None;
        }
        let (from, to) = self.reader.place(row)?;
        let missing = (from - self.reader.end).round() as u64;
        self.reader.end = to;
        let HeadAngles { mut arcsec, invalid, saturated } = self.reader.angles(row);
        let length = self.reader.rate_length(to - from);
        let all = self.in_use.0.unit();
        let (mut reasons, mut events) = (vec![], vec![]);
        if missing > 0 {
            let (kind, gyros) = (BreakKind::Gap(missing), all);
            reasons.push(Reason { kind, gyros });
            events.push(TrackerEvent::Lost { kind, gyros, other: None });
            self.turned.lose(missing);
        }
        let unusable = [(BreakKind::Invalid, invalid), (BreakKind::Saturated, saturated)];
        let unusable = unusable.into_iter().filter(|(_, gyros)| !gyros.is_empty());
        reasons.extend(unusable.map(|(kind, gyros)| Reason { kind, gyros }));
        let measured = all.without(invalid).without(saturated);
        for (gyro, (arcsec, (scale_factor, drift))) in arcsec.iter_mut().zip(&self.calibrations).enumerate() {
            *arcsec = if measured[gyro] { (*arcsec * scale_factor + drift) * length } else { 0.0 };
        }
        let angles = DVector::from_vec(arcsec);
        let is_usable = self.uses(measured);
        let increment = is_usable.then(|| <[f64; AXES]>::from(&self.in_use.1 * &angles));
        match (increment, reasons.last()) {
            (Some(increment), _) => {
                let samples = std::mem::take(&mut self.without);
                events.extend((samples > 0).then_some(TrackerEvent::Again { samples }));
                self.turned.turn(increment);
            }
            (None, reason) => {
                let lost = reason.filter(|_| self.without == 0);
                events.extend(lost.map(|&Reason { kind, gyros }| TrackerEvent::Lost { kind, gyros, other: None }));
                self.without += 1;
                self.turned.lose(1);
            }
        }
        if let Some(residual) = self.residual.as_ref().filter(|_| measured.is_all()) {
            self.residuals_arcsec += residual * angles;
        }
        Some(Track {
            number: Some(row.number),
            heads: is_usable.then_some(measured),
            residual: self.residual.is_some().then(|| {
                let head = self.residuals_arcsec.iamax();
                (all.names()[head], self.residuals_arcsec[head])
            }),
            reasons,
            events,
            ..self.turned.track(Some(row.time_or_number(self.reader.interval_s)), increment)
        })
    }

    /// True if these heads determine the rotation; they are in use then.
    fn uses(&mut self, measured: Gyros) -> bool {
        if measured == self.in_use.0 {
            return true;
        }
        let inverse = rotation_of_heads(&self.axes, measured);
        inverse.map(|inverse| self.in_use = (measured, inverse)).is_some()
    }
}

/// The rotation about the control axes from those about the axes of these heads, fitted to them; `None` if they do not determine it, or only by
/// their misalignments.
pub fn rotation_of_heads(axes: &MatrixXx3<f64>, heads: Gyros) -> Option<Matrix3xX<f64>> {
    let mut used = axes.clone();
    (0..heads.heads()).filter(|&gyro| !heads[gyro]).for_each(|gyro| used.row_mut(gyro).fill(0.0));
    let square = used.transpose() * &used;
    let is_determined = square.symmetric_eigenvalues().min() > MIN_EIGENVALUE;
    square.try_inverse().filter(|_| is_determined).map(|inverse| inverse * used.transpose())
}
