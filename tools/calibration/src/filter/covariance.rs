//! The eighteen errors: covariance forward, its adjoint backward.
//!
//! Order and units: attitude about inertial axes (arcsec), drift of each gyro in use (arcsec per sample interval), scale factor
//! of each (ppm), two misalignments of each (arcsec), systematic errors of the star sensor (arcsec), thermal turn (arcsec per
//! degree of θ).

use geu_model::units::{ARCSEC_PER_RAD, SAMPLE_INTERVAL_S};
use nalgebra::{Matrix3, Matrix4, SMatrix, SVector, UnitQuaternion, Vector3};

use super::noise::FilterNoise;

pub(super) const GYROS: usize = 3;
/// Drifts, scale factors and misalignments: what adds to the attitude error in time.
const PARAMETERS: usize = 4 * GYROS;
pub(super) const ATTITUDE: usize = 0;
pub(super) const DRIFT: usize = ATTITUDE + 3;
pub(super) const SCALE_FACTOR: usize = DRIFT + GYROS;
pub(super) const MISALIGNMENT: usize = SCALE_FACTOR + GYROS;
pub(super) const SYSTEMATIC: usize = MISALIGNMENT + 2 * GYROS;
pub(super) const THERMAL: usize = SYSTEMATIC + 2;
const STATES: usize = THERMAL + 1;
/// Indices of the errors with a smoothed covariance: attitude and thermal turn, then drifts and scale factors.
const REPORTED: [usize; 4 + 2 * GYROS] = [0, 1, 2, THERMAL, 3, 4, 5, 6, 7, 8];

pub(super) type Vector = SVector<f64, STATES>;
type Matrix = SMatrix<f64, STATES, STATES>;

/// Propagation of errors over a sample interval: `attitude += growth · parameters`, and noise.
#[derive(Debug, Clone, Copy)]
pub(super) struct Step {
    growth: SMatrix<f64, 3, PARAMETERS>,
    attitude_noise: Matrix3<f64>,
    drift_noise: f64,
    scale_factor_noise: f64,
}

impl Step {
    /// `to_inertial`: M⁻¹ and the attitude, from rotations about the input axes of the gyros in use to those about inertial
    /// axes. `counts` of each; `off_axis_rad`, the rotation about the two other axes of each.
    #[inline]
    pub fn new(to_inertial: &Matrix3<f64>, counts: [f64; 3], off_axis_rad: [[f64; 2]; 3], noise: &FilterNoise) -> Step {
        let mut growth = SMatrix::zeros();
        for gyro in 0..GYROS {
            for axis in 0..3 {
                let along = to_inertial[(axis, gyro)];
                growth[(axis, gyro)] = along;
                growth[(axis, GYROS + gyro)] = along * counts[gyro] * 1e-6;
                growth[(axis, 2 * GYROS + 2 * gyro)] = -along * off_axis_rad[gyro][0];
                growth[(axis, 2 * GYROS + 2 * gyro + 1)] = -along * off_axis_rad[gyro][1];
            }
        }
        let angle = noise.angle_random_walk_arcsec_per_sqrt_s.powi(2) * SAMPLE_INTERVAL_S;
        let drift = noise.drift_random_walk_arcsec_per_s_per_sqrt_s * SAMPLE_INTERVAL_S;
        Step {
            growth,
            attitude_noise: to_inertial * to_inertial.transpose() * angle,
            drift_noise: drift * drift * SAMPLE_INTERVAL_S,
            scale_factor_noise: noise.scale_factor_random_walk_ppm_per_sqrt_s.powi(2) * SAMPLE_INTERVAL_S,
        }
    }

    /// Adds the variance of a lost rotation about an inertial direction.
    pub fn lose(&mut self, direction: &Vector3<f64>, variance_arcsec2: f64) {
        self.attitude_noise += direction * direction.transpose() * variance_arcsec2;
    }
}

/// One component of a fix that was put in.
#[derive(Debug, Clone, Copy)]
pub(super) struct Gain {
    row: Vector,
    pub gain: Vector,
    residual: f64,
    pub variance: f64,
}

#[derive(Debug, Clone, Copy)]
pub(super) struct Covariance(Matrix);

impl Covariance {
    /// Before the first fix.
    pub fn start(noise: &FilterNoise, attitude: &UnitQuaternion<f64>) -> Covariance {
        let mut covariance = Covariance(Matrix::zeros());
        let drift = noise.start_drift_arcsec_per_half_s();
        for gyro in 0..GYROS {
            covariance.0[(DRIFT + gyro, DRIFT + gyro)] = drift * drift;
            covariance.0[(SCALE_FACTOR + gyro, SCALE_FACTOR + gyro)] = noise.start_scale_factor_ppm.powi(2);
        }
        for index in MISALIGNMENT..SYSTEMATIC {
            covariance.0[(index, index)] = noise.start_misalignment_arcsec.powi(2);
        }
        for index in SYSTEMATIC..THERMAL {
            covariance.0[(index, index)] = noise.systematic_arcsec.powi(2);
        }
        covariance.0[(THERMAL, THERMAL)] = noise.thermal_arcsec_per_deg.powi(2);
        covariance.restart(noise, attitude);
        covariance
    }

    /// Takes the attitude as new, with the start's uncertainty, and unrelated to all else.
    pub fn restart(&mut self, noise: &FilterNoise, attitude: &UnitQuaternion<f64>) {
        self.0.fixed_rows_mut::<3>(ATTITUDE).fill(0.0);
        self.0.fixed_columns_mut::<3>(ATTITUDE).fill(0.0);
        let sigma = Vector3::from(noise.start_attitude_control_arcsec);
        let rotation = attitude.to_rotation_matrix();
        let own =
            rotation.matrix() * Matrix3::from_diagonal(&sigma.component_mul(&sigma)) * rotation.matrix().transpose();
        self.0.fixed_view_mut::<3, 3>(ATTITUDE, ATTITUDE).copy_from(&own);
    }

    /// Covariance of the attitude about inertial axes.
    pub fn attitude(&self) -> Matrix3<f64> {
        self.0.fixed_view::<3, 3>(ATTITUDE, ATTITUDE).into_owned()
    }

    /// Covariance of the attitude and the thermal turn, and variances of drifts and scale factors.
    pub fn reported(&self) -> (Matrix4<f64>, [f64; 2 * GYROS]) {
        let covariance = |row: usize, column: usize| self.0[(REPORTED[row], REPORTED[column])];
        (Matrix4::from_fn(covariance), std::array::from_fn(|index| covariance(4 + index, 4 + index)))
    }

    /// P ← Φ P Φᵀ + Q, where Φ is the identity but for `growth`.
    #[inline]
    pub fn advance(&mut self, step: &Step) {
        let growth = &step.growth;
        let added: SMatrix<f64, 3, STATES> = growth * self.0.fixed_rows::<PARAMETERS>(DRIFT);
        let related = self.0.fixed_view::<3, PARAMETERS>(ATTITUDE, DRIFT) + added.fixed_columns::<PARAMETERS>(DRIFT);
        let own = added.fixed_columns::<3>(ATTITUDE) + related * growth.transpose() + step.attitude_noise;
        let mut attitude = self.0.fixed_view_mut::<3, 3>(ATTITUDE, ATTITUDE);
        attitude += own;
        for column in DRIFT..STATES {
            for row in 0..3 {
                self.0[(row, column)] += added[(row, column)];
                self.0[(column, row)] = self.0[(row, column)];
            }
        }
        for gyro in 0..GYROS {
            self.0[(DRIFT + gyro, DRIFT + gyro)] += step.drift_noise;
            self.0[(SCALE_FACTOR + gyro, SCALE_FACTOR + gyro)] += step.scale_factor_noise;
        }
    }

    /// Puts one component in, in Joseph's form: P ← (I − K h) P (I − K h)ᵀ + K r Kᵀ.
    pub fn update(&mut self, row: Vector, residual: f64, noise_variance: f64) -> Gain {
        let along = self.0 * row;
        let variance = row.dot(&along) + noise_variance;
        let gain = along / variance;
        let kept = Matrix::identity() - gain * row.transpose();
        let joseph = kept * self.0 * kept.transpose() + gain * gain.transpose() * noise_variance;
        self.0 = (joseph + joseph.transpose()) * 0.5;
        Gain { row, gain, residual, variance }
    }
}

/// Information of later fixes on the errors at a node: the smoothed error is −P·λ, its covariance P − P·Λ·P (Bierman,
/// Factorization Methods, 1977, ch. X).
#[derive(Debug, Clone, Copy)]
pub(super) struct Adjoint {
    vector: Vector,
    matrix: Matrix,
}

impl Adjoint {
    pub fn zero() -> Adjoint {
        Adjoint { vector: Vector::zeros(), matrix: Matrix::zeros() }
    }

    /// From the end of a sample interval to its start: λ ← Φᵀ λ, Λ ← Φᵀ Λ Φ.
    #[inline]
    pub fn pass_back(&mut self, step: &Step) {
        let growth = &step.growth;
        let own = growth.transpose() * self.vector.fixed_rows::<3>(ATTITUDE);
        let mut parameters = self.vector.fixed_rows_mut::<PARAMETERS>(DRIFT);
        parameters += own;
        let added: SMatrix<f64, PARAMETERS, STATES> = growth.transpose() * self.matrix.fixed_rows::<3>(ATTITUDE);
        let related = self.matrix.fixed_view::<PARAMETERS, 3>(DRIFT, ATTITUDE) + added.fixed_columns::<3>(ATTITUDE);
        let own = added.fixed_columns::<PARAMETERS>(DRIFT) + related * growth;
        let mut block = self.matrix.fixed_view_mut::<PARAMETERS, PARAMETERS>(DRIFT, DRIFT);
        block += own;
        for column in (0..DRIFT).chain(SYSTEMATIC..STATES) {
            for row in DRIFT..SYSTEMATIC {
                self.matrix[(row, column)] += added[(row - DRIFT, column)];
                self.matrix[(column, row)] = self.matrix[(row, column)];
            }
        }
    }

    /// From after a fix's component to before it.
    pub fn undo(&mut self, gain: &Gain) {
        let kept = Matrix::identity() - gain.gain * gain.row.transpose();
        self.vector = kept.transpose() * self.vector - gain.row * (gain.residual / gain.variance);
        let matrix = kept.transpose() * self.matrix * kept + gain.row * gain.row.transpose() / gain.variance;
        self.matrix = (matrix + matrix.transpose()) * 0.5;
    }

    /// Removes the information on the attitude, before a restart.
    pub fn forget_attitude(&mut self) {
        self.vector.fixed_rows_mut::<3>(ATTITUDE).fill(0.0);
        self.matrix.fixed_rows_mut::<3>(ATTITUDE).fill(0.0);
        self.matrix.fixed_columns_mut::<3>(ATTITUDE).fill(0.0);
    }

    /// Correction of the filter's estimate by the smoother.
    #[inline]
    pub fn correction(&self, covariance: &Covariance) -> Vector {
        -(covariance.0 * self.vector)
    }

    /// Smoothed covariance of the attitude and the thermal turn, and variances of drifts and scale factors.
    #[inline]
    pub fn smoothed(&self, covariance: &Covariance) -> (Matrix4<f64>, [f64; 2 * GYROS]) {
        let reported: SMatrix<f64, STATES, { REPORTED.len() }> =
            SMatrix::from_fn(|row, column| covariance.0[(row, REPORTED[column])]);
        let half = self.matrix * reported;
        let reduced = |row: usize, column: usize| {
            reported[(REPORTED[row], column)] - reported.column(row).dot(&half.column(column))
        };
        (Matrix4::from_fn(reduced), std::array::from_fn(|index| reduced(4 + index, 4 + index)))
    }
}

/// An angle small enough to be a vector, arcsec, from the attitude `from` to `to`, about the axes of the frame turned.
pub(super) fn turn_arcsec(from: &UnitQuaternion<f64>, to: &UnitQuaternion<f64>) -> Vector3<f64> {
    (from.inverse() * to).scaled_axis() * ARCSEC_PER_RAD
}
