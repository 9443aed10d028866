//! Some of the sixteen parameters refined from what was known of them and from data, where data alone would not do.

use geu_model::package::Calibration;
use geu_model::units::SAMPLE_INTERVAL_S;
use geu_protocol::Gyro;
use nalgebra::{DMatrix, DVector};

use crate::noise::RandomWalks;
use crate::solve::{
    CalibrationParameter, Equations, LeastSquaresFit, Observation, PER_GYRO, Residual, SolveError, fit,
    noise_not_finite, root, shared_covariance, values,
};

/// What was known of a parameter before the data: its believed value, so well.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Prior {
    pub parameter: CalibrationParameter,
    /// How well, 1 sigma.
    pub sigma: f64,
}

/// Some of the parameters, from what was known and from data.
#[derive(Debug, Clone, PartialEq)]
pub struct Refined {
    /// The values; those without a prior are as believed.
    pub calibrations: [Calibration; 4],
    /// Covariance in the order of the priors, with the drift taken as that at the end of the last observation.
    pub covariance: DMatrix<f64>,
    /// χ² of the equations and of the departures from what was known.
    pub chi2: f64,
    /// As many as there are equations.
    pub degrees_of_freedom: usize,
    pub residuals: Vec<Residual>,
    /// Covariance of the residuals: scans close in time share their drift's walk.
    pub residual_covariance: DMatrix<f64>,
}

/// The last stretch over which a drift's walk is averaged to tell the drift at the end, s.
const END_S: f64 = 1.0;

/// Refines what is believed: the parameters of `priors` are solved for, each with what was known of it as one more equation,
/// so that data which tell nothing change nothing; the others are held. Only gyros of which a parameter is asked take part.
///
/// The drift is that at the end of the observations, where the walk has taken it, since what follows starts from there;
/// what was known of it holds for their start.
///
/// # Errors
/// [`SolveError::NotFinite`].
pub fn refine(
    observations: &[Observation],
    walks: &[RandomWalks; 4],
    believed: &[Calibration; 4],
    priors: &[Prior],
) -> Result<Refined, SolveError> {
    let mut observations = observations.to_vec();
    for (gyro, counts) in observations.iter_mut().flat_map(|observation| observation.counts.iter_mut().enumerate()) {
        if priors.iter().all(|prior| prior.parameter.gyro as usize != gyro) {
            *counts = None;
        }
    }
    let equations = Equations::new(&observations, walks, believed)?;
    let (rows, all) = (equations.rows.len(), equations.rows.len() + priors.len());
    let mut design = DMatrix::zeros(all, priors.len());
    let mut right = DVector::zeros(all);
    right
        .rows_mut(0, rows)
        .copy_from(&(&equations.right - &equations.design * DVector::from(values(believed).to_vec())));
    let mut covariance = DMatrix::zeros(all, all);
    covariance.view_mut((0, 0), (rows, rows)).copy_from(&shared_covariance(&observations, &equations.rows, believed));
    for (index, Prior { parameter, sigma }) in priors.iter().enumerate() {
        let column = PER_GYRO * parameter.gyro as usize + parameter.index;
        design.view_mut((0, index), (rows, 1)).copy_from(&equations.design.column(column));
        design[(rows + index, index)] = 1.0;
        covariance[(rows + index, rows + index)] = sigma * sigma;
    }
    let end_s = observations.iter().map(|observation| observation.end_s).fold(0.0, f64::max);
    for (gyro, walk) in walks.iter().enumerate() {
        // Each row's stretch, and how long a departure of the drift at the end from the walk acts on it. What was known is
        // a stretch of nothing at the start.
        let observed = equations.rows.iter().enumerate().filter(|(_, row)| row.1 == gyro).map(|(row, &(index, _))| {
            let stretch = (observations[index].start_s, observations[index].end_s);
            (row, stretch, stretch.1 - stretch.0)
        });
        let known = priors
            .iter()
            .enumerate()
            .filter(|(_, prior)| prior.parameter.gyro as usize == gyro && prior.parameter.index == 1);
        let own: Vec<_> =
            observed.chain(known.map(|(index, _)| (rows + index, (0.0, 0.0), SAMPLE_INTERVAL_S))).collect();
        let end = ((end_s - END_S).max(0.0), end_s);
        let with_end = walk.drift_covariance(end, end) / (END_S * END_S);
        let to_end: Vec<f64> = own.iter().map(|row| walk.drift_covariance(row.1, end) / END_S).collect();
        for (a, &(row, stretch, length_s)) in own.iter().enumerate() {
            for (b, &(other, other_stretch, other_length_s)) in own.iter().enumerate() {
                covariance[(row, other)] += walk.angle_covariance(stretch, other_stretch)
                    + walk.drift_covariance(stretch, other_stretch)
                    - length_s * to_end[b]
                    - other_length_s * to_end[a]
                    + length_s * other_length_s * with_end;
            }
        }
    }
    let root = root(&covariance)?;
    let LeastSquaresFit { solved, gain, .. } = fit(&design, &right, &root)?;
    let solved_covariance = &gain * &covariance * gain.transpose();
    let left = &design * &solved - &right;
    let whitened_left = root.l_dirty().solve_lower_triangular(&left).ok_or_else(noise_not_finite)?;
    let observed = design.rows(0, rows);
    let residual_covariance =
        covariance.view((0, 0), (rows, rows)) - observed * &solved_covariance * observed.transpose();
    let residuals = equations.rows.iter().enumerate().map(|(row, &(manoeuvre, gyro))| Residual {
        manoeuvre,
        gyro: Gyro::ALL[gyro],
        arcsec: left[row],
        sigma_arcsec: residual_covariance[(row, row)].max(0.0).sqrt(),
    });
    let mut calibrations = *believed;
    for (Prior { parameter, .. }, change) in priors.iter().zip(solved.iter()) {
        *parameter.of_mut(&mut calibrations[parameter.gyro as usize]) += change;
    }
    Ok(Refined {
        calibrations,
        covariance: solved_covariance,
        chi2: whitened_left.norm_squared(),
        degrees_of_freedom: rows,
        residuals: residuals.collect(),
        residual_covariance,
    })
}
