//! Parity residuals of redundant gyros: sums of their rotations that no motion changes.

use geu_model::package::{Calibration, dot};
use geu_protocol::Gyro;
use nalgebra::{DMatrix, DVector};

use super::{Equations, sensing_axes};

/// Eigenvalue of M Mᵀ below which a sum of rotations does not depend on the motion.
const REDUNDANT: f64 = 1e-3;

/// A sum of the rotations about the input axes that no motion changes, over each manoeuvre.
#[derive(Debug, Clone, PartialEq)]
pub struct ParityOfHeads {
    /// Weight of each gyro; the sum of their squares is 1.
    pub weights: Vec<(Gyro, f64)>,
    /// Root mean square over the manoeuvres, and that by the noise, arcsec.
    pub rms_arcsec: f64,
    pub sigma_arcsec: f64,
    /// Largest residual in its sigmas, and its manoeuvre.
    pub largest_sigmas: f64,
    pub largest: usize,
}

impl Equations<'_> {
    /// Parity residuals over the manoeuvres, from the residuals of the fit and their covariance: the reference drops out of the sums.
    pub(super) fn parity(
        &self,
        calibrations: &[Calibration],
        left: &DVector<f64>,
        covariance: impl Fn(usize, usize) -> f64,
    ) -> Vec<ParityOfHeads> {
        let axes = sensing_axes(&self.parameters, calibrations);
        let gram = DMatrix::from_fn(axes.len(), axes.len(), |a, b| dot(axes[a], axes[b]));
        let gyros: Vec<Gyro> = self.parameters.iter().step_by(super::PER_GYRO).map(|own| own.gyro).collect();
        let eigen = gram.symmetric_eigen();
        let redundant = eigen.eigenvectors.column_iter().zip(&eigen.eigenvalues).filter(|own| *own.1 < REDUNDANT);
        let whole: Vec<&[(usize, usize)]> =
            self.rows.chunk_by(|a, b| a.0 == b.0).filter(|rows| rows.len() == gyros.len()).collect();
        let parity = |weights: Vec<f64>| {
            let first = |rows: &[(usize, usize)]| self.rows.partition_point(|row| row.0 < rows[0].0);
            let sum = |rows: &&[(usize, usize)]| {
                let from = first(rows);
                let arcsec: f64 = weights.iter().enumerate().map(|(gyro, weight)| weight * left[from + gyro]).sum();
                let pair = |(a, one): (usize, &f64), b: usize| one * weights[b] * covariance(from + a, from + b);
                let variance: f64 =
                    (0..weights.len()).flat_map(|b| weights.iter().enumerate().map(move |a| pair(a, b))).sum();
                (rows[0].0, arcsec, variance.max(f64::MIN_POSITIVE))
            };
            let sums: Vec<(usize, f64, f64)> = whole.iter().map(sum).collect();
            let mean = |of: fn(&(usize, f64, f64)) -> f64| sums.iter().map(of).sum::<f64>() / sums.len() as f64;
            let sigmas = |own: &(usize, f64, f64)| own.1.abs() / own.2.sqrt();
            let largest = sums.iter().max_by(|a, b| sigmas(a).total_cmp(&sigmas(b)))?;
            Some(ParityOfHeads {
                weights: gyros.iter().copied().zip(weights).collect(),
                rms_arcsec: mean(|own| own.1 * own.1).sqrt(),
                sigma_arcsec: mean(|own| own.2).sqrt(),
                largest_sigmas: sigmas(largest),
                largest: largest.0,
            })
        };
        let directions = redundant.map(|(direction, _)| {
            let sign = direction.iter().find(|part| part.abs() > 1e-6).map_or(1.0, |part| part.signum());
            direction.iter().map(|part| sign * part).collect::<Vec<f64>>()
        });
        directions.filter_map(parity).collect()
    }
}
