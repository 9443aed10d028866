//! Refines some of the calibration parameters from prior and data, if data alone would not determine them.

use geu_model::package::Calibration;
use geu_model::units::SAMPLE_INTERVAL_S;
use nalgebra::{DMatrix, DVector};

use crate::noise::RandomWalks;
use crate::solve::{
    CalibrationParameter, Equations, LeastSquaresFit, Observation, Residual, SolveError, fit, root, sensing_axes,
    shared_covariance, values,
};

/// Standard deviation of a configured parameter before the data.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Prior {
    pub parameter: CalibrationParameter,
    pub sigma: f64,
}

/// Some of the parameters, from prior and data.
#[derive(Debug, Clone, PartialEq)]
pub struct Refined {
    /// The values; those without a prior are as configured.
    pub calibrations: [Calibration; 4],
    /// Covariance in the order of the priors, with the drift taken as that at the end of the last observation.
    pub covariance: DMatrix<f64>,
    /// χ² of the equations and of the departures from the prior.
    pub chi2: f64,
    /// Number of equations.
    pub degrees_of_freedom: usize,
    pub residuals: Vec<Residual>,
    /// Covariance of the residuals: scans close in time share their drift's walk.
    pub residual_covariance: DMatrix<f64>,
}

/// Length of the last interval, whose mean drift is the drift at the end, s.
const END_S: f64 = 1.0;

/// Refines a calibration: the parameters of `priors` are solved, each with its prior as one more equation, so that
/// uninformative data change nothing; the others are held. Only gyros with such a parameter take part.
///
/// The drift is that at the end of the observations, after its walk, from which the next recording starts; its prior holds
/// for their start.
///
/// # Errors
/// [`SolveError::NotFinite`].
pub fn refine(
    observations: &[Observation],
    walks: &[RandomWalks],
    prior_values: &[Calibration; 4],
    priors: &[Prior],
) -> Result<Refined, SolveError> {
    let mut observations = observations.to_vec();
    for (gyro, counts) in observations.iter_mut().flat_map(|observation| observation.counts.iter_mut().enumerate()) {
        if priors.iter().all(|prior| prior.parameter.gyro.index() != gyro) {
            *counts = None;
        }
    }
    let parameters: Vec<_> = CalibrationParameter::all().collect();
    let axes = sensing_axes(&parameters, prior_values);
    let equations = Equations::new(&observations, walks, prior_values, parameters)?;
    let (rows, all) = (equations.rows.len(), equations.rows.len() + priors.len());
    let mut design = DMatrix::zeros(all, priors.len());
    let mut right = DVector::zeros(all);
    right
        .rows_mut(0, rows)
        .copy_from(&(&equations.right - &equations.design * DVector::from(values(prior_values).to_vec())));
    let mut covariance = DMatrix::zeros(all, all);
    covariance.view_mut((0, 0), (rows, rows)).copy_from(&shared_covariance(
        &observations,
        &equations.rows,
        &axes,
        prior_values,
    ));
    for (index, Prior { parameter, sigma }) in priors.iter().enumerate() {
        design.view_mut((0, index), (rows, 1)).copy_from(&equations.design.column(parameter.position()));
        design[(rows + index, index)] = 1.0;
        covariance[(rows + index, rows + index)] = sigma * sigma;
    }
    let end_s = observations.iter().map(|observation| observation.end_s).fold(0.0, f64::max);
    for (gyro, walk) in walks.iter().enumerate() {
        // Interval of each row, and how long a departure of the drift at the end from the walk acts on it. The prior is an
        // interval of length 0 at the start.
        let observed = equations.rows.iter().enumerate().filter(|(_, row)| row.1 == gyro).map(|(row, &(index, _))| {
            let interval = (observations[index].start_s, observations[index].end_s);
            (row, interval, interval.1 - interval.0)
        });
        let known = priors
            .iter()
            .enumerate()
            .filter(|(_, prior)| prior.parameter.gyro.index() == gyro && prior.parameter.index == 1);
        let own: Vec<_> =
            observed.chain(known.map(|(index, _)| (rows + index, (0.0, 0.0), SAMPLE_INTERVAL_S))).collect();
        let end = ((end_s - END_S).max(0.0), end_s);
        let with_end = walk.drift_covariance(end, end) / (END_S * END_S);
        let to_end: Vec<f64> = own.iter().map(|row| walk.drift_covariance(row.1, end) / END_S).collect();
        for (a, &(row, interval, length_s)) in own.iter().enumerate() {
            for (b, &(other, other_interval, other_length_s)) in own.iter().enumerate() {
                covariance[(row, other)] += walk.angle_covariance(interval, other_interval)
                    + walk.drift_covariance(interval, other_interval)
                    - length_s * to_end[b]
                    - other_length_s * to_end[a]
                    + length_s * other_length_s * with_end;
            }
        }
    }
    let root = root(&covariance)?;
    let LeastSquaresFit { solved, gain, left, chi2, .. } = fit(&design, &right, &root)?;
    let solved_covariance = &gain * &covariance * gain.transpose();
    let observed = design.rows(0, rows);
    let residual_covariance =
        covariance.view((0, 0), (rows, rows)) - observed * &solved_covariance * observed.transpose();
    let mut calibrations = *prior_values;
    for (Prior { parameter, .. }, change) in priors.iter().zip(solved.iter()) {
        let own = &mut calibrations[parameter.gyro.index()];
        parameter.set(own, parameter.value(own) + change);
    }
    Ok(Refined {
        calibrations,
        covariance: solved_covariance,
        chi2,
        degrees_of_freedom: rows,
        residuals: equations.residuals(&left, |row| residual_covariance[(row, row)]),
        residual_covariance,
    })
}
