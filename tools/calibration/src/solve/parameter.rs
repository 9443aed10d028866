//! The calibration parameters: four of each gyro.

use geu_model::device::{Device, Head};
use geu_model::package::{Calibration, dot};
use geu_model::parameter_spec::MISALIGNMENTS;
use geu_model::units::{ARCSEC_PER_RAD, SAMPLE_INTERVAL_S};
use geu_protocol::Gyro;

/// Unknowns of a gyro: scale factor, drift, and the projections of the input axis on two directions across it.
pub const PER_GYRO: usize = 4;
/// Unknowns of the default unit.
pub const UNKNOWNS: usize = 4 * PER_GYRO;

/// Uncertainty after launch of scale factor (relative), drift (arcsec per sample interval) and misalignment (arcsec): 2000
/// ppm, 1.5°/h, an arcminute (Casteren table 1, §3.2, §3.4). Less accurate data determine nothing.
pub const BEFORE_LAUNCH: [f64; 3] = [2000e-6, 1.5 * 3600.0 / 7200.0, 60.0];
/// Uncertainty of scale factor (relative) and misalignment (rad) of a described unit, and of its drift, as a share of its range.
const OF_DESCRIBED: [f64; 2] = [0.1, 0.01];

/// One parameter: gyro and index of [`PER_GYRO`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CalibrationParameter {
    pub gyro: Gyro,
    /// 0 scale factor, 1 drift, 2 and 3 misalignments.
    pub index: usize,
    /// Direction of a misalignment, a unit vector in the control frame; of scale factor and drift the input axis.
    pub axis: [f64; 3],
}

impl CalibrationParameter {
    /// All parameters of the default unit, in the order of the solution.
    pub fn all() -> impl Iterator<Item = CalibrationParameter> {
        CalibrationParameter::of_unit(&Device::iras()).into_iter()
    }

    /// All parameters of a unit, in the order of the solution.
    pub fn of_unit(device: &Device) -> Vec<CalibrationParameter> {
        let of_head = |head: &Head| {
            let (input, [first, second], gyro) = (head.axes.input_control, head.across(), head.gyro);
            let axes = [input, input, first, second].into_iter().enumerate();
            axes.map(move |(index, axis)| CalibrationParameter { gyro, index, axis })
        };
        device.heads.iter().flat_map(of_head).collect()
    }

    pub fn value(self, calibration: &Calibration) -> f64 {
        match self.index {
            0 => calibration.scale_factor,
            1 => calibration.drift_arcsec_per_half_s,
            _ => dot(self.axis, projections(calibration)),
        }
    }

    pub fn set(self, calibration: &mut Calibration, value: f64) {
        let before = self.value(calibration);
        match self.index {
            0 => calibration.scale_factor = value,
            1 => calibration.drift_arcsec_per_half_s = value,
            _ => {
                let Calibration { x_arcsec, y_arcsec, z_arcsec, .. } = calibration;
                for (own, part) in [x_arcsec, y_arcsec, z_arcsec].into_iter().zip(self.axis) {
                    *own = *own - part * before + part * value;
                }
            }
        }
    }

    /// Index among all parameters, in the order of the solution.
    pub fn position(self) -> usize {
        PER_GYRO * self.gyro.index() + self.index
    }

    /// Names of the numbers of a calibration that it changes.
    pub fn keys(self) -> Vec<&'static str> {
        match self.index {
            0 => vec!["scale_factor"],
            1 => vec!["drift_arcsec_per_half_s"],
            _ => {
                MISALIGNMENTS.into_iter().zip(self.axis).filter(|(_, part)| *part != 0.0).map(|(key, _)| key).collect()
            }
        }
    }

    pub fn label(self) -> String {
        let name = self.gyro.name();
        match (self.index, self.control_axis()) {
            (0, _) => format!("{name} scale factor"),
            (1, _) => format!("{name} drift"),
            (_, Some(axis)) => format!("{name} misalignment {}", ["x", "y", "z"][axis]),
            (_, None) => {
                let [x, y, z] = self.axis;
                format!("{name} misalignment ({x:.2} {y:.2} {z:.2})")
            }
        }
    }

    /// The control axis along its axis.
    pub(super) fn control_axis(self) -> Option<usize> {
        self.axis.iter().position(|part| part.abs() == 1.0)
    }

    /// Uncertainty after launch.
    pub(super) fn before_launch(self) -> f64 {
        BEFORE_LAUNCH[self.index.min(2)]
    }

    /// Uncertainty for a described unit with this range before the data, in the unit of the value.
    pub fn of_described(self, range_arcsec_s: f64) -> f64 {
        let [relative, of_range] = OF_DESCRIBED;
        match self.index {
            0 => relative,
            1 => of_range * range_arcsec_s * SAMPLE_INTERVAL_S,
            _ => relative * ARCSEC_PER_RAD,
        }
    }
}

/// Input axis in the control frame with the projections of a calibration: a row of M (eq 2).
pub fn sensing_axis(input_control: [f64; 3], calibration: &Calibration) -> [f64; 3] {
    let offset = projections(calibration);
    std::array::from_fn(|axis| input_control[axis] + offset[axis] / ARCSEC_PER_RAD)
}

fn projections(calibration: &Calibration) -> [f64; 3] {
    [calibration.x_arcsec, calibration.y_arcsec, calibration.z_arcsec]
}

/// The control axes that are not the gyro's own, of the default unit.
pub fn off_axes(gyro: Gyro) -> [usize; 2] {
    let own = own_axis(gyro);
    [usize::from(own == 0), if own == 2 { 1 } else { 2 }]
}

/// The gyro's own control axis, of the default unit.
pub fn own_axis(gyro: Gyro) -> usize {
    geu_model::package::Axes::of(gyro).input_control.iter().position(|&part| part != 0.0).unwrap_or(0)
}
