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
            let projections = directions(head).map(ParameterKind::Projection);
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

/// Two directions perpendicular to the input axis of a head: control axes, if it is along a control axis.
fn directions(head: &Head) -> [[f64; 3]; 2] {
    let input = head.axes.input_control;
    let unit = |axis: usize| std::array::from_fn(|other| f64::from(u8::from(other == axis)));
    if let Some(own) = input.iter().position(|part| part.abs() == 1.0) {
        return [unit(usize::from(own == 0)), unit(if own == 2 { 1 } else { 2 })];
    }
    let farthest = (0..3).min_by(|&one, &other| input[one].abs().total_cmp(&input[other].abs())).unwrap_or(0);
    let part = input[farthest];
    let across: [f64; 3] = std::array::from_fn(|axis| unit(farthest)[axis] - part * input[axis]);
    let length = across.iter().map(|part| part * part).sum::<f64>().sqrt();
    let [x, y, z] = across.map(|part| part / length);
    let [a, b, c] = input;
    [[x, y, z], [b * z - c * y, c * x - a * z, a * y - b * x]]
}
