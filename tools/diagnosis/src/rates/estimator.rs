//! The noise of residuals: that of greatest restricted likelihood once the mean of every group and every error, linearised, are taken off.

use nalgebra::{DMatrix, DVector, DVectorView};

use crate::rates::fit::Fit;
use crate::rates::noise::{ChannelNoise, Noise, decorrelated, greatest_correlation, segments};
use crate::rates::windows::Windows;

/// Correlations of neighbours that are tried: from this in so many steps to the greatest.
const LEAST_CORRELATION: f64 = -0.6;
const CORRELATION_STEPS: usize = 12;
/// Rates are never taken as known better: data without noise have rounding alone.
const LEAST_SIGMA_ARCSEC_S: f64 = 1e-6;
/// Share of a column that must be left beside those before it.
const LEAST_LEFT: f64 = 1e-6;

/// Estimates the noise of residuals that lie near one solution.
pub(crate) struct Estimator {
    channels: Vec<ChannelEstimator>,
}

struct ChannelEstimator {
    /// Rows, group after group.
    groups: Vec<Vec<usize>>,
    trials: Vec<Trial>,
}

/// One correlation, and what it makes of the columns that are taken off.
struct Trial {
    correlation: f64,
    /// Orthonormal.
    basis: DMatrix<f64>,
    log_determinant: f64,
}

impl Estimator {
    /// About a solution: the errors are linearised there.
    pub(crate) fn new(windows: &Windows, about: &Fit) -> Estimator {
        let (_, slope) = about.linearised(windows, &windows.parameters());
        let of_channel = |channel: usize| {
            let groups: Vec<Vec<usize>> = segments(windows)
                .into_iter()
                .filter(|segment| segment.channel == channel)
                .map(|segment| segment.rows)
                .collect();
            let rows = groups.concat();
            let mut columns: Vec<Vec<f64>> = (0..groups.len())
                .map(|group| {
                    let own = groups.iter().enumerate();
                    own.flat_map(|(index, rows)| vec![f64::from(u8::from(index == group)); rows.len()]).collect()
                })
                .collect();
            columns.extend(slope.column_iter().map(|column| rows.iter().map(|row| column[*row]).collect::<Vec<f64>>()));
            let raw = columns.iter().map(|column| DVector::from_column_slice(column)).collect::<Vec<_>>();
            let told = orthonormal(&raw, None).kept;
            let greatest = greatest_correlation(windows);
            let trials = (0..=CORRELATION_STEPS).map(|step| {
                let share = step as f64 / CORRELATION_STEPS as f64;
                let correlation = LEAST_CORRELATION + (greatest - LEAST_CORRELATION) * share;
                let white: Vec<DVector<f64>> =
                    columns.iter().map(|column| decorrelated_groups(&groups, column, correlation)).collect();
                let Orthonormal { basis, log_norms, .. } = orthonormal(&white, Some(&told));
                let spread = (rows.len() - groups.len()) as f64 * (1.0 - correlation * correlation).ln();
                Trial { correlation, basis, log_determinant: spread + 2.0 * log_norms }
            });
            ChannelEstimator { trials: trials.collect(), groups }
        };
        Estimator { channels: (0..windows.channels()).map(of_channel).collect() }
    }

    /// The noise of a residual that is likeliest.
    pub(crate) fn estimate(&self, residual: &DVector<f64>) -> Noise {
        let likeliest = |trials: Vec<Tried>| {
            let best = trials.into_iter().min_by(|one, other| one.deviance.total_cmp(&other.deviance));
            best.map_or(SILENT, |best| best.noise)
        };
        Noise { channels: self.channels.iter().map(|channel| likeliest(channel.tried(residual))).collect() }
    }
}

/// The noise of one correlation.
struct Tried {
    deviance: f64,
    noise: ChannelNoise,
}

const SILENT: ChannelNoise =
    ChannelNoise { sigma_arcsec_s: LEAST_SIGMA_ARCSEC_S, correlation: 0.0, between_arcsec_s: 0.0 };

impl ChannelEstimator {
    fn tried(&self, residual: &DVector<f64>) -> Vec<Tried> {
        let values: Vec<f64> = self.groups.iter().flatten().map(|row| residual[*row]).collect();
        let of = |trial: &Trial| {
            let white = decorrelated_groups(&self.groups, &values, trial.correlation);
            let spare = white.len().saturating_sub(trial.basis.ncols()).max(1) as f64;
            let left = white.norm_squared() - trial.basis.tr_mul(&white).norm_squared();
            let sigma_arcsec_s = (left.max(0.0) / spare).sqrt().max(LEAST_SIGMA_ARCSEC_S);
            let deviance = 2.0 * spare * sigma_arcsec_s.ln() + trial.log_determinant;
            Tried { deviance, noise: ChannelNoise { sigma_arcsec_s, correlation: trial.correlation, ..SILENT } }
        };
        self.trials.iter().map(of).collect()
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
    /// Sum of the logarithms of what was left of each column.
    log_norms: f64,
    /// Columns that are no sum of those before them.
    kept: Vec<usize>,
}

/// Orthonormal columns that span `columns`, or those of them that are `told`.
fn orthonormal(columns: &[DVector<f64>], told: Option<&[usize]>) -> Orthonormal {
    let (mut basis, mut log_norms, mut kept): (Vec<DVector<f64>>, f64, Vec<usize>) = (Vec::new(), 0.0, Vec::new());
    for (index, column) in columns.iter().enumerate() {
        if told.is_some_and(|told| !told.contains(&index)) {
            continue;
        }
        let remove = |mut left: DVector<f64>, basis: &[DVector<f64>]| {
            basis.iter().for_each(|other| left -= other * other.dot(&left));
            left
        };
        // Twice is enough for orthogonality to rounding.
        let left = remove(remove(column.clone(), &basis), &basis);
        let norm = left.norm();
        if norm > LEAST_LEFT * column.norm() || (told.is_some() && norm > 0.0) {
            log_norms += norm.ln();
            basis.push(left / norm);
            kept.push(index);
        }
    }
    let views: Vec<DVectorView<f64>> = basis.iter().map(|column| column.as_view()).collect();
    let rows = columns.first().map_or(0, |column| column.len());
    let basis = DMatrix::from_fn(rows, views.len(), |row, column| views[column][row]);
    Orthonormal { basis, log_norms, kept }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rates::noise::tests::windows;
    use geu_model::noise::NoiseStream;

    #[test]
    fn noise_within_groups_is_found_beside_offsets_of_groups() {
        let windows = windows(4, 200);
        let noise =
            Noise { channels: vec![ChannelNoise { sigma_arcsec_s: 3.0, correlation: 0.6, between_arcsec_s: 50.0 }] };
        let mut stream = NoiseStream::of_sensor(2, "test");
        let drawn = noise.draw(&windows, || stream.standard_normal());
        let found = Estimator::new(&windows, &Fit::none()).estimate(&drawn).channels[0];
        assert!((found.sigma_arcsec_s - 3.0).abs() < 0.4, "{found:?}");
        assert!((found.correlation - 0.6).abs() < 0.11, "{found:?}");
    }
}
