//! The transfer function: from counts to increments about the control axes, as on board (Casteren §4, eqs 1–3).

use geu_model::Configuration;
use geu_model::package::{Axes, Calibration};
use geu_protocol::Gyro;
use nalgebra::{Matrix3x4, Matrix4x3, MatrixXx3, RowVector3, Vector3, Vector4};

use crate::solve::sensing_axis;

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum GyroSet {
    /// X, Y and ZA: M is inverted.
    #[default]
    WithZa,
    WithZb,
    All,
}

impl GyroSet {
    /// True for each gyro in the set, in the order of [`Gyro::ALL`].
    pub const fn gyros(self) -> [bool; 4] {
        match self {
            GyroSet::WithZa => [true, true, true, false],
            GyroSet::WithZb => [true, true, false, true],
            GyroSet::All => [true; 4],
        }
    }
}

/// M of eq 2: a row per gyro, columns X, Y, Z; 1 on the own axis by definition.
pub fn misalignment_matrix(calibrations: &[Calibration]) -> Matrix4x3<f64> {
    Matrix4x3::from_fn(|gyro, axis| sensing_axis(Axes::of(Gyro::ALL[gyro]).input_control, &calibrations[gyro])[axis])
}

/// M of eq 2 of any unit: a row per head, its input axis and the configured projections.
pub fn sensing_matrix(configuration: &Configuration) -> MatrixXx3<f64> {
    let heads = configuration.device.heads.iter().zip(&configuration.gyros);
    let row = heads.map(|(head, own)| RowVector3::from(sensing_axis(head.axes.input_control, &own.calibration)));
    MatrixXx3::from_rows(&row.collect::<Vec<_>>())
}

/// Equation 3 with a calibration put in.
#[derive(Debug, Clone, Copy)]
pub struct Transfer {
    scale_factor: Vector4<f64>,
    drift_arcsec_per_half_s: Vector4<f64>,
    matrix: Matrix4x3<f64>,
    /// M⁻¹: from rotations about the input axes to those about the control axes.
    pub(crate) inverse: Matrix3x4<f64>,
}

impl Transfer {
    /// The transfer function of a calibration. Misalignments within their limits leave M well conditioned.
    pub fn new(calibrations: &[Calibration], in_use: GyroSet) -> Transfer {
        let matrix = misalignment_matrix(calibrations);
        let mut used = matrix;
        for (gyro, is_used) in in_use.gyros().into_iter().enumerate() {
            if !is_used {
                used.row_mut(gyro).fill(0.0);
            }
        }
        // (MᵀM)⁻¹Mᵀ is M⁻¹ for three gyros; rows lie within a degree of the axes, so the square is harmless.
        let square = used.transpose() * used;
        let inverse = square.try_inverse().map_or_else(Matrix3x4::zeros, |inverse| inverse * used.transpose());
        Transfer {
            scale_factor: Vector4::from_fn(|gyro, _| calibrations[gyro].scale_factor),
            drift_arcsec_per_half_s: Vector4::from_fn(|gyro, _| calibrations[gyro].drift_arcsec_per_half_s),
            matrix,
            inverse,
        }
    }

    /// Rotation about the input axes, arcsec, from counts over a number of on-board samples (eq 1).
    pub fn about_inputs_arcsec(&self, counts: [f64; 4], samples: f64) -> [f64; 4] {
        let counts = Vector4::from(counts);
        (counts.component_mul(&self.scale_factor) + self.drift_arcsec_per_half_s * samples).into()
    }

    /// Rotation about the control axes, arcsec, from counts over a number of on-board samples (eq 3).
    pub fn about_control_arcsec(&self, counts: [f64; 4], samples: f64) -> [f64; 3] {
        (self.inverse * Vector4::from(self.about_inputs_arcsec(counts, samples))).into()
    }

    /// Parity residual, arcsec: rotation about Z by GYRZA less that by GYRZB, both corrected for the misalignments; 0 without
    /// errors.
    pub fn redundancy_arcsec(&self, counts: [f64; 4], samples: f64) -> f64 {
        let inputs = self.about_inputs_arcsec(counts, samples);
        let control = Vector3::from(self.about_control_arcsec(counts, samples));
        let residual = Vector4::from(inputs) - self.matrix * control;
        residual[Gyro::ZA.index()] - residual[Gyro::ZB.index()]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equation_3_inverts_equations_1_and_2() {
        let calibrations = Configuration::reference().calibrations();
        let turned = Vector3::new(100.0, -2000.0, 30_000.0);
        let inputs = misalignment_matrix(&calibrations) * turned;
        let counts: [f64; 4] = std::array::from_fn(|gyro| {
            let Calibration { scale_factor, drift_arcsec_per_half_s, .. } = calibrations[gyro];
            (inputs[gyro] - 7.0 * drift_arcsec_per_half_s) / scale_factor
        });
        for in_use in [GyroSet::WithZa, GyroSet::WithZb, GyroSet::All] {
            let transfer = Transfer::new(&calibrations, in_use);
            let back = Vector3::from(transfer.about_control_arcsec(counts, 7.0));
            assert!((back - turned).norm() < 1e-9, "{in_use:?}: {back}");
            assert!(transfer.redundancy_arcsec(counts, 7.0).abs() < 1e-9);
        }
        let mut wrong = counts;
        wrong[3] -= 10.0;
        let difference = Transfer::new(&calibrations, GyroSet::WithZa).redundancy_arcsec(wrong, 7.0);
        assert!((difference - 10.0 * 0.9992).abs() < 1e-9, "{difference}");
    }
}
