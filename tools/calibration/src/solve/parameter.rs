//! The calibration parameters: four of each gyro.

use geu_model::package::{Axes, Calibration};
use geu_protocol::Gyro;

/// Unknowns of a gyro: scale factor, drift, two misalignments in the order of [`off_axes`].
pub const PER_GYRO: usize = 4;
pub const UNKNOWNS: usize = 4 * PER_GYRO;

/// What a launch leaves unknown of scale factor (relative), drift (arcsec per sample interval) and misalignment (arcsec): 2000 ppm,
/// 1.5°/h, an arcminute (Casteren table 1, §3.2, §3.4). Data that tell less tell nothing.
pub const BEFORE_LAUNCH: [f64; 3] = [2000e-6, 1.5 * 3600.0 / 7200.0, 60.0];

/// One parameter: gyro and index of [`PER_GYRO`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CalibrationParameter {
    pub gyro: Gyro,
    /// 0 scale factor, 1 drift, 2 and 3 misalignments.
    pub index: usize,
}

impl CalibrationParameter {
    /// All sixteen, in the order of the solution.
    pub fn all() -> impl Iterator<Item = CalibrationParameter> {
        Gyro::ALL.into_iter().flat_map(|gyro| (0..PER_GYRO).map(move |index| CalibrationParameter { gyro, index }))
    }

    pub fn of(self, calibration: &Calibration) -> f64 {
        match self.index {
            0 => calibration.scale_factor,
            1 => calibration.drift_arcsec_per_half_s,
            _ => {
                let axis = off_axes(self.gyro)[self.index - 2];
                [calibration.x_arcsec, calibration.y_arcsec, calibration.z_arcsec][axis]
            }
        }
    }

    pub fn of_mut(self, calibration: &mut Calibration) -> &mut f64 {
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

    pub fn key(self) -> &'static str {
        match self.index {
            0 => "scale_factor",
            1 => "drift_arcsec_per_half_s",
            _ => ["x_arcsec", "y_arcsec", "z_arcsec"][off_axes(self.gyro)[self.index - 2]],
        }
    }

    pub fn label(self) -> String {
        let what = match self.index {
            0 => "scale factor".to_owned(),
            1 => "drift".to_owned(),
            _ => format!("misalignment {}", ["x", "y", "z"][off_axes(self.gyro)[self.index - 2]]),
        };
        format!("{} {what}", self.gyro.name())
    }

    /// What a launch leaves unknown of it.
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
