//! The calibration parameters: four of each gyro.

use geu_model::package::{Axes, Calibration};
use geu_protocol::Gyro;

/// Unknowns of a gyro: scale factor, drift, two misalignments in the order of [`off_axes`].
pub const PER_GYRO: usize = 4;
pub const UNKNOWNS: usize = 4 * PER_GYRO;

/// Uncertainty after launch of scale factor (relative), drift (arcsec per sample interval) and misalignment (arcsec): 2000
/// ppm, 1.5°/h, an arcminute (Casteren table 1, §3.2, §3.4). Less accurate data determine nothing.
pub const BEFORE_LAUNCH: [f64; 3] = [2000e-6, 1.5 * 3600.0 / 7200.0, 60.0];

/// One parameter: gyro and index of [`PER_GYRO`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CalibrationParameter {
    pub gyro: Gyro,
    /// 0 scale factor, 1 drift, 2 and 3 misalignments.
    pub index: usize,
}

impl CalibrationParameter {
    /// All parameters, in the order of the solution.
    pub fn all() -> impl Iterator<Item = CalibrationParameter> {
        Gyro::ALL.into_iter().flat_map(|gyro| (0..PER_GYRO).map(move |index| CalibrationParameter { gyro, index }))
    }

    pub fn value(self, calibration: &Calibration) -> f64 {
        let mut own = *calibration;
        *self.value_mut(&mut own)
    }

    pub fn value_mut(self, calibration: &mut Calibration) -> &mut f64 {
        match self.index {
            0 => &mut calibration.scale_factor,
            1 => &mut calibration.drift_arcsec_per_half_s,
            _ => match off_axes(self.gyro)[self.index - 2] {
                0 => &mut calibration.x_arcsec,
                1 => &mut calibration.y_arcsec,
                _ => &mut calibration.z_arcsec,
            },
        }
    }

    /// Index among all parameters, in the order of the solution.
    pub fn position(self) -> usize {
        PER_GYRO * self.gyro.index() + self.index
    }

    pub fn key(self) -> &'static str {
        match self.index {
            0 => "scale_factor",
            1 => "drift_arcsec_per_half_s",
            _ => ["x_arcsec", "y_arcsec", "z_arcsec"][off_axes(self.gyro)[self.index - 2]],
        }
    }

    pub fn label(self) -> String {
        let name = self.gyro.name();
        match self.index {
            0 => format!("{name} scale factor"),
            1 => format!("{name} drift"),
            index => format!("{name} misalignment {}", ["x", "y", "z"][off_axes(self.gyro)[index - 2]]),
        }
    }

    /// Uncertainty after launch.
    pub(super) fn before_launch(self) -> f64 {
        BEFORE_LAUNCH[self.index.min(2)]
    }
}

/// The control axes that are not the gyro's own.
pub fn off_axes(gyro: Gyro) -> [usize; 2] {
    let own = own_axis(gyro);
    [usize::from(own == 0), if own == 2 { 1 } else { 2 }]
}

/// The gyro's own control axis.
pub fn own_axis(gyro: Gyro) -> usize {
    Axes::of(gyro).input_control.iter().position(|&part| part != 0.0).unwrap_or(0)
}
