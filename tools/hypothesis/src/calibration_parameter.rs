//! The calibration parameters of a unit: four of each gyro.

use geu_model::device::{Device, Head};
use geu_model::package::Calibration;
use geu_model::parameter_spec::MISALIGNMENTS;
use geu_protocol::Gyro;

/// Kind of a calibration parameter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ParameterKind {
    ScaleFactor,
    Drift,
    /// Projection of the input axis on a direction perpendicular to it.
    Projection([f64; 3]),
}

/// A calibration parameter of one gyro.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CalibrationParameter {
    pub gyro: Gyro,
    pub kind: ParameterKind,
}

impl CalibrationParameter {
    /// All of a unit, gyro after gyro.
    pub fn all(device: &Device) -> Vec<CalibrationParameter> {
        let of_head = |head: &Head| {
            let projections = head.across().map(ParameterKind::Projection);
            let kinds = [ParameterKind::ScaleFactor, ParameterKind::Drift].into_iter().chain(projections);
            kinds.map(|kind| CalibrationParameter { gyro: head.gyro, kind }).collect::<Vec<_>>()
        };
        device.heads.iter().flat_map(of_head).collect()
    }

    /// Selects a value by the kind.
    pub fn of_kind<T>(&self, [scale_factor, drift, projection]: [T; 3]) -> T {
        match self.kind {
            ParameterKind::ScaleFactor => scale_factor,
            ParameterKind::Drift => drift,
            ParameterKind::Projection(_) => projection,
        }
    }

    /// Adds to it in a calibration.
    pub fn add(&self, calibration: &mut Calibration, by: f64) {
        match self.kind {
            ParameterKind::ScaleFactor => calibration.scale_factor += by,
            ParameterKind::Drift => calibration.drift_arcsec_per_half_s += by,
            ParameterKind::Projection([x, y, z]) => {
                calibration.x_arcsec += x * by;
                calibration.y_arcsec += y * by;
                calibration.z_arcsec += z * by;
            }
        }
    }

    /// The numbers of a calibration that it changes, by their index among [`Calibration::NUMBERS`], with the change of each per unit.
    pub fn numbers(&self) -> Vec<(usize, f64)> {
        let place = |name: &str| Calibration::NUMBERS.iter().position(|number| number.name == name).unwrap_or_default();
        match self.kind {
            ParameterKind::ScaleFactor => vec![(place("scale_factor"), 1.0)],
            ParameterKind::Drift => vec![(place("drift_arcsec_per_half_s"), 1.0)],
            ParameterKind::Projection(direction) => {
                let all = MISALIGNMENTS.into_iter().zip(direction).filter(|(_, share)| *share != 0.0);
                all.map(|(name, share)| (place(name), share)).collect()
            }
        }
    }
}
