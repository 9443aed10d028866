//! Covariance of the equations, from shared error sources and random walks.

use geu_model::package::Calibration;
use nalgebra::{DMatrix, DVector};

use super::Observation;
use crate::noise::{ErrorSource, RandomWalks};

/// Covariances of the rows, with the drift walk about its mean over the manoeuvres and with the walk since the start.
pub(super) fn covariances(
    observations: &[Observation],
    rows: &[(usize, usize)],
    walks: &[RandomWalks],
    axes: &[[f64; 3]],
    prior: &[Calibration],
) -> (DMatrix<f64>, DMatrix<f64>) {
    let shared = shared_covariance(observations, rows, axes, prior);
    let (mut weighting, mut reported) = (shared.clone(), shared);
    for (gyro, walk) in walks.iter().enumerate() {
        let own: Vec<(usize, (f64, f64))> = rows
            .iter()
            .enumerate()
            .filter(|(_, row)| row.1 == gyro)
            .map(|(row, &(index, _))| (row, (observations[index].start_s, observations[index].end_s)))
            .collect();
        let drift = DMatrix::from_fn(own.len(), own.len(), |a, b| walk.drift_covariance(own[a].1, own[b].1));
        let lengths = DVector::from_iterator(own.len(), own.iter().map(|(_, interval)| interval.1 - interval.0));
        // The integral over each interval less its share of the mean over all.
        let of_mean = drift.column_sum() / lengths.sum().max(f64::MIN_POSITIVE);
        let mean_variance = of_mean.sum() / lengths.sum().max(f64::MIN_POSITIVE);
        let relative = |a: usize, b: usize| {
            drift[(a, b)] - lengths[a] * of_mean[b] - of_mean[a] * lengths[b] + lengths[a] * lengths[b] * mean_variance
        };
        for (a, &(row, interval)) in own.iter().enumerate() {
            for (b, &(other, other_interval)) in own.iter().enumerate() {
                let angle = walk.angle_covariance(interval, other_interval);
                weighting[(row, other)] += angle + relative(a, b);
                reported[(row, other)] += angle + drift[(a, b)];
            }
        }
    }
    (weighting, reported)
}

/// Covariance of the rows from all errors except the walks.
pub(crate) fn shared_covariance(
    observations: &[Observation],
    rows: &[(usize, usize)],
    axes: &[[f64; 3]],
    prior: &[Calibration],
) -> DMatrix<f64> {
    // Contribution of each source to each row.
    let mut sources: Vec<(ErrorSource, f64, usize, f64)> = Vec::new();
    for (row, &(index, gyro)) in rows.iter().enumerate() {
        for disturbance in &observations[index].disturbances {
            let turned: f64 = (0..3).map(|axis| axes[gyro][axis] * disturbance.rotation_control_arcsec[axis]).sum();
            let part = disturbance.counts[gyro] * prior[gyro].scale_factor - turned;
            if part != 0.0 {
                sources.push((disturbance.source, disturbance.variance, row, part));
            }
        }
    }
    sources.sort_by(|a, b| a.0.cmp(&b.0).then(a.2.cmp(&b.2)));
    let mut shared = DMatrix::zeros(rows.len(), rows.len());
    for group in sources.chunk_by(|a, b| a.0 == b.0) {
        let variance = group[0].1;
        debug_assert!(group.iter().all(|own| own.1 == variance), "one variance for {:?}", group[0].0);
        for &(_, _, row, part) in group {
            for &(_, _, other, other_part) in group {
                shared[(row, other)] += variance * part * other_part;
            }
        }
    }
    shared
}
