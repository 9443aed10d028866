//! Estimates the noise of residuals: maximum restricted likelihood after the group means and the linearised errors are projected out.

use nalgebra::{DMatrix, DVector};

use crate::fit::Fit;
use crate::noise::{Noise, decorrelated, max_correlation};
use crate::windows::Windows;

/// Trial correlations of neighbours: from this one to the largest allowed, in equal steps.
const MIN_CORRELATION: f64 = -0.6;
const CORRELATION_STEPS: usize = 12;
/// Lower limit of sigma: rounding remains in data without noise.
const MIN_SIGMA_ARCSEC_S: f64 = 1e-6;
/// Share of a column that must remain after projecting out the columns before it.
const MIN_REMAINDER: f64 = 1e-6;

/// Estimates the noise of residuals near one solution.
pub(crate) struct Estimator {
    /// Windows of each group.
    groups: Vec<Vec<usize>>,
    trials: Vec<Trial>,
}

/// One correlation and the columns projected out, whitened with it.
struct Trial {
    correlation: f64,
    /// Orthonormal.
    basis: DMatrix<f64>,
    log_determinant: f64,
}

impl Estimator {
    /// With the errors linearised about a solution.
    pub(crate) fn new(windows: &Windows, about: &Fit) -> Estimator {
        let (_, slope) = about.linearised(windows, &windows.parameters());
        let (groups, max) = (windows.by_group(), max_correlation(windows));
        let rows = groups.concat();
        let offset = |group: usize| {
            let own = groups.iter().enumerate();
            own.flat_map(|(index, rows)| vec![f64::from(u8::from(index == group)); rows.len()]).collect::<Vec<_>>()
        };
        let error = |column: usize| rows.iter().map(|row| slope[(*row, column)]).collect();
        let mut columns: Vec<DVector<f64>> =
            (0..groups.len()).map(offset).chain((0..slope.ncols()).map(error)).map(DVector::from_vec).collect();
        let mut is_kept = orthonormal(&columns, MIN_REMAINDER).is_kept.into_iter();
        columns.retain(|_| is_kept.next() == Some(true));
        let trials = (0..=CORRELATION_STEPS).map(|step| {
            let share = step as f64 / CORRELATION_STEPS as f64;
            let correlation = MIN_CORRELATION + (max - MIN_CORRELATION) * share;
            let white: Vec<_> =
                columns.iter().map(|column| decorrelated_groups(&groups, column.as_slice(), correlation)).collect();
            let Orthonormal { basis, log_norms, .. } = orthonormal(&white, 0.0);
            let spread = (rows.len() - groups.len()) as f64 * (1.0 - correlation * correlation).ln();
            Trial { correlation, basis, log_determinant: spread + 2.0 * log_norms }
        });
        Estimator { trials: trials.collect(), groups }
    }

    /// The noise of maximum likelihood.
    pub(crate) fn estimate(&self, residual: &DVector<f64>) -> Noise {
        let values: Vec<f64> = self.groups.iter().flatten().map(|row| residual[*row]).collect();
        let noise = |trial: &Trial| {
            let white = decorrelated_groups(&self.groups, &values, trial.correlation);
            let spare = white.len().saturating_sub(trial.basis.ncols()).max(1) as f64;
            let left = white.norm_squared() - trial.basis.tr_mul(&white).norm_squared();
            let sigma_arcsec_s = (left.max(0.0) / spare).sqrt().max(MIN_SIGMA_ARCSEC_S);
            let deviance = 2.0 * spare * sigma_arcsec_s.ln() + trial.log_determinant;
            (deviance, Noise { sigma_arcsec_s, correlation: trial.correlation, between_arcsec_s: 0.0 })
        };
        let trials = self.trials.iter().map(noise);
        trials.min_by(|one, other| one.0.total_cmp(&other.0)).expect("thirteen correlations").1
    }
}

fn decorrelated_groups(groups: &[Vec<usize>], values: &[f64], correlation: f64) -> DVector<f64> {
    let (mut white, mut from) = (Vec::with_capacity(values.len()), 0);
    for rows in groups {
        white.extend(decorrelated(&values[from..from + rows.len()], correlation));
        from += rows.len();
    }
    DVector::from_vec(white)
}

struct Orthonormal {
    basis: DMatrix<f64>,
    /// Sum of the logarithms of the remainders.
    log_norms: f64,
    /// False for a column of which less than the required share remains: it depends linearly on those before.
    is_kept: Vec<bool>,
}

/// Gram-Schmidt orthonormalisation.
fn orthonormal(columns: &[DVector<f64>], min_remainder: f64) -> Orthonormal {
    let (mut basis, mut log_norms): (Vec<DVector<f64>>, f64) = (Vec::new(), 0.0);
    let mut is_kept = Vec::with_capacity(columns.len());
    for column in columns {
        let mut left = column.clone();
        // The second pass removes the rounding of the first.
        for other in basis.iter().chain(&basis) {
            left -= other * other.dot(&left);
        }
        let norm = left.norm();
        is_kept.push(norm > min_remainder * column.norm());
        if is_kept.last() == Some(&true) {
            log_norms += norm.ln();
            basis.push(left / norm);
        }
    }
    let rows = columns.first().map_or(0, |column| column.len());
    let basis = DMatrix::from_fn(rows, basis.len(), |row, column| basis[column][row]);
    Orthonormal { basis, log_norms, is_kept }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::noise::tests::windows;
    use geu_model::noise::NoiseStream;

    #[test]
    fn noise_within_groups_is_estimated_despite_offsets_of_groups() {
        let windows = windows(4, 200);
        let noise = Noise { sigma_arcsec_s: 3.0, correlation: 0.6, between_arcsec_s: 50.0 };
        let mut stream = NoiseStream::of_sensor(2, "test");
        let drawn = noise.draw(&windows, || stream.standard_normal());
        let found = Estimator::new(&windows, &Fit::none()).estimate(&drawn);
        assert!((found.sigma_arcsec_s - 3.0).abs() < 0.4, "{found:?}");
        assert!((found.correlation - 0.6).abs() < 0.11, "{found:?}");
    }
}
