//! Solves the calibration parameters from the equations of any number of manoeuvres (Casteren §5, §6), by weighted least
//! squares.
//!
//! Equation 3 of one gyro over one manoeuvre is linear in that gyro's four unknowns,
//!
//! ```text
//! N·SF + n·D − G₁·Δφ₁ − G₂·Δφ₂ = Δφ_own
//! ```
//!
//! with the counts N over n samples and the inertial rotation Δφ about the control axes. The equations of the gyros
//! are solved jointly, because they share the errors of the rotation.
//!
//! D is the mean over the manoeuvres, which fits the accumulated angle best. The drift walks on from the start of the
//! recording, so that mean departs from the drift at the start; the sigmas hold for the latter, and so include the configured
//! walks.

mod covariance;
mod determined;
mod parameter;
mod redundancy;
mod solution;
mod trials;

use geu_model::package::{Calibration, dot};
use geu_model::units::ARCSEC_PER_RAD;
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

use crate::noise::{ErrorTerm, RandomWalks};
use covariance::covariances;
pub(crate) use covariance::shared_covariance;
pub use parameter::{BEFORE_LAUNCH, CalibrationParameter, PER_GYRO, UNKNOWNS, off_axes, own_axis, sensing_axis};
pub use redundancy::ParityOfHeads;
pub use solution::{Residual, Solution, TrialDrift, probability, values, values_of};
pub use trials::TrialsOfObservations;

/// Share of a prior sigma from which the sigma of a parameter shows that the data do not determine it.
const UNDETERMINED: f64 = 0.05;

/// Counts and rotation of one manoeuvre.
#[derive(Debug, Clone, PartialEq)]
pub struct Observation {
    pub name: String,
    /// Start, s since the start of the recording.
    pub start_s: f64,
    pub end_s: f64,
    /// On-board time in units of 0.5 s.
    pub samples: f64,
    /// Counts of each gyro; `None` if they are unusable.
    pub counts: Vec<Option<f64>>,
    /// Inertial rotation: the integrals of the rates about the control axes, arcsec.
    pub rotation_control_arcsec: [f64; 3],
    /// Change of this rotation with a time offset, arcsec/s, and with the frequency error of the unit's clock, arcsec; of a described
    /// unit alone.
    pub timing_control_arcsec: [[f64; 3]; 2],
    pub disturbances: Vec<ErrorTerm>,
}

#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SolveError {
    /// The undetermined parameters, as text.
    #[error("{}", .0.join("\n"))]
    Undetermined(Vec<String>),
    #[error("expected finite counts, rotations and noise, got others in {0}")]
    NotFinite(String),
}

/// Solves the equations of the default unit. `prior` serves to weigh errors, and for elements that are not solved.
///
/// # Errors
/// [`SolveError`]: the parameters that the manoeuvres do not determine.
pub fn solve(
    observations: &[Observation],
    walks: &[RandomWalks],
    prior: &[Calibration],
) -> Result<Solution, SolveError> {
    let equations = Equations::new(observations, walks, prior, CalibrationParameter::all().collect())?;
    equations.check_determined()?;
    equations.solve(prior, &[], &DMatrix::zeros(0, 0))
}

/// Solves the equations of a described unit together with its time offset and the frequency of its clock. Each parameter has a prior
/// sigma in `sizes`, and so have offset, s, and frequency, relative, at the end: what the data do not determine keeps it. `about` is the
/// solution of the pass before: a scale factor acts on the counts expected from it, since the noise of measured counts would make it smaller.
/// The drifts in further trials are solved too.
///
/// # Errors
/// [`SolveError`]: no usable data.
pub fn solve_described(
    observations: &[Observation],
    walks: &[RandomWalks],
    (prior, about): (&[Calibration], &[Calibration]),
    parameters: Vec<CalibrationParameter>,
    (sizes, trials): (&[f64], &TrialsOfObservations),
) -> Result<Solution, SolveError> {
    let mut equations = Equations::new(observations, walks, prior, parameters)?;
    equations.expect_counts(about);
    let further = trials.columns(&equations);
    let sizes: Vec<f64> = sizes.iter().copied().chain(further.column_iter().map(|_| trials.sigma)).collect();
    let mut solution = equations.solve(prior, &sizes, &further)?;
    solution.trial_drifts = trials.with_names(solution.trial_drifts);
    Ok(solution)
}

pub(crate) struct Equations<'a> {
    observations: &'a [Observation],
    parameters: Vec<CalibrationParameter>,
    /// Manoeuvre and gyro of each row.
    pub(crate) rows: Vec<(usize, usize)>,
    pub(crate) design: DMatrix<f64>,
    pub(crate) right: DVector<f64>,
    /// Covariance of the rows that weighs them, with the walk about its mean over the manoeuvres.
    weighting: DMatrix<f64>,
    /// Covariance of the rows that gives the sigmas, with the walk since the start.
    reported: DMatrix<f64>,
}

impl<'a> Equations<'a> {
    pub(crate) fn new(
        observations: &'a [Observation],
        walks: &[RandomWalks],
        prior: &[Calibration],
        parameters: Vec<CalibrationParameter>,
    ) -> Result<Equations<'a>, SolveError> {
        let rows: Vec<(usize, usize)> = (0..observations.len())
            .flat_map(|index| (0..prior.len()).map(move |gyro| (index, gyro)))
            .filter(|&(index, gyro)| observations[index].counts[gyro].is_some())
            .collect();
        let mut design = DMatrix::zeros(rows.len(), parameters.len());
        let mut right = DVector::zeros(rows.len());
        for (row, &(index, gyro)) in rows.iter().enumerate() {
            let Observation { samples, counts, rotation_control_arcsec: turned, .. } = &observations[index];
            let own = &parameters[PER_GYRO * gyro..][..PER_GYRO];
            let [across, other] = [own[2].axis, own[3].axis].map(|axis| -dot(axis, *turned) / ARCSEC_PER_RAD);
            let unknowns = [counts[gyro].unwrap_or(0.0), *samples, across, other];
            for (index, value) in unknowns.into_iter().enumerate() {
                design[(row, PER_GYRO * gyro + index)] = value;
            }
            // A projection on the input axis itself is not solved.
            let sensed = dot(own[0].axis, sensing_axis(own[0].axis, &prior[gyro]));
            right[row] = dot(own[0].axis, *turned) * sensed;
        }
        let (weighting, reported) = covariances(observations, &rows, walks, &sensing_axes(&parameters, prior), prior);
        let finite = |matrix: &DMatrix<f64>| matrix.iter().all(|value| value.is_finite());
        if !finite(&design) || !finite(&reported) || !right.iter().all(|value| value.is_finite()) {
            let bad = |observation: &&Observation| {
                let numbers =
                    observation.rotation_control_arcsec.into_iter().chain(observation.counts.iter().copied().flatten());
                numbers.chain([observation.samples]).any(|number| !number.is_finite())
            };
            let name = observations.iter().find(bad).map_or("the noise", |observation| &observation.name);
            return Err(SolveError::NotFinite(name.to_owned()));
        }
        Ok(Equations { observations, parameters, rows, design, right, weighting, reported })
    }

    /// Solves the equations of the parameters, of the times of a described unit, and of further drifts with these columns.
    fn solve(&self, prior: &[Calibration], sizes: &[f64], further: &DMatrix<f64>) -> Result<Solution, SolveError> {
        let (unknowns, rows) = (self.parameters.len(), self.rows.len());
        let (design, right) = self.with_priors(prior, sizes, further);
        let [weighting, reported] = [&self.weighting, &self.reported].map(|own| with_variances(own, sizes));
        let root = root(&weighting)?;
        let LeastSquaresFit { solved, gain, squares, left, chi2 } = fit(&design, &right, &root)?;
        let all = &gain * &reported * gain.transpose();
        let mut calibrations = prior.to_vec();
        for (index, parameter) in self.parameters.iter().enumerate() {
            parameter.set(&mut calibrations[parameter.gyro.index()], solved[index]);
        }
        // Only the diagonals of the projection and of the residuals' covariance are needed.
        let weighed = &gain * &weighting * gain.transpose();
        let seen = &design * weighed;
        let mut leverage = vec![0.0; self.observations.len()];
        for (row, &(manoeuvre, _)) in self.rows.iter().enumerate() {
            leverage[manoeuvre] += (design.row(row) * gain.column(row))[0];
        }
        let covariance_left = |a: usize, b: usize| weighting[(a, b)] - seen.row(a).dot(&design.row(b));
        let sigma = |index: usize| all[(index, index)].max(0.0).sqrt();
        let is_open = |index: usize| sigma(index) > UNDETERMINED * sizes[index];
        let undetermined: Vec<bool> = (0..sizes.len()).map(is_open).collect();
        let open = undetermined.iter().filter(|is_open| **is_open).count();
        let is_described = !sizes.is_empty();
        Ok(Solution {
            parity: if is_described { self.parity(&calibrations, &left, covariance_left) } else { Vec::new() },
            parameters: self.parameters.clone(),
            calibrations,
            trial_drifts: self
                .trial_drifts(|index| (!undetermined[index]).then(|| (solved[index], sigma(index))), further),
            undetermined,
            timing: is_described.then(|| [unknowns, unknowns + 1].map(|index| (solved[index], sigma(index)))),
            covariance: all.view((0, 0), (unknowns, unknowns)).into_owned(),
            chi2,
            degrees_of_freedom: rows.saturating_sub(design.ncols() - open),
            condition: (squares.max() / squares.min().max(f64::MIN_POSITIVE)).sqrt(),
            leverage,
            residuals: self.residuals(&left, |row| covariance_left(row, row)),
        })
    }

    /// Lets a change of the scale factor act on the counts that calibrations expect, in place of the measured ones.
    fn expect_counts(&mut self, about: &[Calibration]) {
        let axes = sensing_axes(&self.parameters, about);
        for (row, &(index, gyro)) in self.rows.iter().enumerate() {
            let (Observation { samples, rotation_control_arcsec, .. }, own) = (&self.observations[index], &about[gyro]);
            let column = PER_GYRO * gyro;
            let turned = dot(axes[gyro], *rotation_control_arcsec);
            let expected = (turned - own.drift_arcsec_per_half_s * samples) / own.scale_factor;
            self.right[row] -= own.scale_factor * (self.design[(row, column)] - expected);
            self.design[(row, column)] = expected;
        }
    }

    /// The equations, and with `sizes` an equation for the prior of each unknown, the unknowns of the times, and further ones with these columns.
    fn with_priors(
        &self,
        prior: &[Calibration],
        sizes: &[f64],
        further: &DMatrix<f64>,
    ) -> (DMatrix<f64>, DVector<f64>) {
        let (unknowns, rows) = (self.parameters.len(), self.rows.len());
        let columns = if sizes.is_empty() { unknowns } else { sizes.len() };
        let mut design = self.design.clone().resize(rows + sizes.len(), columns, 0.0);
        let mut right = self.right.clone().resize_vertically(rows + sizes.len(), 0.0);
        if sizes.is_empty() {
            return (design, right);
        }
        let axes = sensing_axes(&self.parameters, prior);
        for (row, &(index, gyro)) in self.rows.iter().enumerate() {
            for (column, changed) in self.observations[index].timing_control_arcsec.into_iter().enumerate() {
                design[(row, unknowns + column)] = dot(axes[gyro], changed);
            }
        }
        design.view_mut((0, unknowns + 2), further.shape()).copy_from(further);
        let known = values_of(&self.parameters, prior).into_iter().chain(std::iter::repeat(0.0)).take(columns);
        for (index, value) in known.enumerate() {
            design[(rows + index, index)] = 1.0;
            right[rows + index] = value;
        }
        (design, right)
    }

    /// Further drifts of each trial, from the values of the unknowns.
    fn trial_drifts(&self, value: impl Fn(usize) -> Option<(f64, f64)>, further: &DMatrix<f64>) -> Vec<TrialDrift> {
        let heads = self.parameters.len() / PER_GYRO;
        let first = self.parameters.len() + 2;
        let drifts: Vec<_> = (first..first + further.ncols()).map(value).collect();
        drifts.chunks(heads).map(|own| TrialDrift { trial: String::new(), drifts: own.to_vec() }).collect()
    }

    /// Residuals of the rows with their variances.
    pub(crate) fn residuals(&self, left: &DVector<f64>, variance: impl Fn(usize) -> f64) -> Vec<Residual> {
        let residual = |(row, &(manoeuvre, gyro)): (usize, &(usize, usize))| Residual {
            manoeuvre,
            gyro: self.parameters[PER_GYRO * gyro].gyro,
            arcsec: left[row],
            sigma_arcsec: variance(row).max(0.0).sqrt(),
        };
        self.rows.iter().enumerate().map(residual).collect()
    }
}

/// Input axis of each gyro in the control frame, with its projections.
pub(crate) fn sensing_axes(parameters: &[CalibrationParameter], prior: &[Calibration]) -> Vec<[f64; 3]> {
    let first = parameters.iter().step_by(PER_GYRO);
    first.zip(prior).map(|(own, calibration)| sensing_axis(own.axis, calibration)).collect()
}

/// A covariance with further, independent variances.
fn with_variances(covariance: &DMatrix<f64>, sigmas: &[f64]) -> DMatrix<f64> {
    let (rows, all) = (covariance.nrows(), covariance.nrows() + sigmas.len());
    let mut covariance = covariance.clone().resize(all, all, 0.0);
    for (index, sigma) in sigmas.iter().enumerate() {
        covariance[(rows + index, rows + index)] = sigma * sigma;
    }
    covariance
}

pub(crate) fn noise_not_finite() -> SolveError {
    SolveError::NotFinite("the noise".to_owned())
}

pub(crate) fn root(covariance: &DMatrix<f64>) -> Result<Cholesky<f64, Dyn>, SolveError> {
    Cholesky::new(covariance.clone()).ok_or_else(noise_not_finite)
}

pub(crate) struct LeastSquaresFit {
    pub(crate) solved: DVector<f64>,
    /// Maps the right side to the unknowns.
    pub(crate) gain: DMatrix<f64>,
    /// Eigenvalues of the normal matrix with columns scaled to one length, for the condition number; QR solves.
    squares: DVector<f64>,
    /// Residuals.
    pub(crate) left: DVector<f64>,
    pub(crate) chi2: f64,
}

pub(crate) fn fit(
    design: &DMatrix<f64>,
    right: &DVector<f64>,
    root: &Cholesky<f64, Dyn>,
) -> Result<LeastSquaresFit, SolveError> {
    let mut scaled = root.l_dirty().solve_lower_triangular(design).ok_or_else(noise_not_finite)?;
    let lengths: Vec<f64> = scaled.column_iter().map(|column| column.norm().max(f64::MIN_POSITIVE)).collect();
    for (mut column, length) in scaled.column_iter_mut().zip(&lengths) {
        column /= *length;
    }
    let whitened_right = root.l_dirty().solve_lower_triangular(right).ok_or_else(noise_not_finite)?;
    let squares = (scaled.transpose() * &scaled).symmetric_eigenvalues();
    let (q, r) = scaled.qr().unpack();
    let mut inverse = r.solve_upper_triangular(&q.transpose()).ok_or_else(noise_not_finite)?;
    for (mut row, length) in inverse.row_iter_mut().zip(&lengths) {
        row /= *length;
    }
    let solved = &inverse * whitened_right;
    let gain = root.l_dirty().tr_solve_lower_triangular(&inverse.transpose()).ok_or_else(noise_not_finite)?;
    let left = design * &solved - right;
    let whitened_left = root.l_dirty().solve_lower_triangular(&left).ok_or_else(noise_not_finite)?;
    Ok(LeastSquaresFit { solved, gain: gain.transpose(), squares, left, chi2: whitened_left.norm_squared() })
}

#[cfg(test)]
mod tests {
    use geu_model::units::ARCSEC_PER_DEG;
    use geu_protocol::Gyro;

    use super::*;
    use crate::noise::ErrorSource;

    const QUIET: RandomWalks = RandomWalks {
        angle_arcsec_per_sqrt_s: 0.0,
        drift_arcsec_per_s_per_sqrt_s: 0.0,
        correlation_time_s: f64::INFINITY,
    };

    /// A manoeuvre of a perfect unit that turns by `turned_deg` about each axis.
    fn manoeuvre(index: usize, turned_deg: [f64; 3]) -> Observation {
        let turned = turned_deg.map(|angle| angle * ARCSEC_PER_DEG);
        let start_s = 1000.0 * index as f64;
        Observation {
            name: format!("manoeuvre {index}"),
            start_s,
            end_s: start_s + 600.0,
            samples: 1200.0,
            counts: Gyro::ALL.map(|gyro| Some(turned[own_axis(gyro)])).to_vec(),
            rotation_control_arcsec: turned,
            timing_control_arcsec: Default::default(),
            disturbances: (0..4)
                .map(|gyro| ErrorTerm::of_count(ErrorSource::Rounding { gyro, node: index }, 1.0 / 6.0, gyro, 1.0))
                .collect(),
        }
    }

    fn refused(observations: &[Observation]) -> String {
        match solve(observations, &[QUIET; 4], &[Calibration::default(); 4]) {
            Err(error) => error.to_string(),
            Ok(solution) => panic!("solved, with {:?}", solution.sigmas()),
        }
    }

    #[test]
    fn manoeuvres_about_every_axis_and_a_pointing_determine_all_parameters() {
        let manoeuvres = [[0.0; 3], [60.0, 0.0, 0.0], [0.0, 60.0, 0.0], [0.0, 0.0, 60.0], [0.0, -60.0, 0.0]];
        let observations: Vec<Observation> =
            manoeuvres.into_iter().enumerate().map(|(index, turned)| manoeuvre(index, turned)).collect();
        let solution = solve(&observations, &[QUIET; 4], &[Calibration::default(); 4]).expect("determined");
        for (parameter, value) in CalibrationParameter::all().zip(solution.values()) {
            let expected = if parameter.index == 0 { 1.0 } else { 0.0 };
            assert!((value - expected).abs() < 1e-9, "{}: {value}", parameter.label());
        }
        assert_eq!((solution.degrees_of_freedom, observations.len()), (4, 5));
        // As many as there are unknowns: the projection's trace.
        assert!((solution.leverage.iter().sum::<f64>() - 16.0).abs() < 1e-9);
    }

    #[test]
    fn undetermined_parameters_are_named() {
        let without_z = [[0.0; 3], [60.0, 0.0, 0.0], [0.0, 60.0, 0.0], [0.0, -60.0, 0.0], [-60.0, 0.0, 0.0]];
        let observations: Vec<Observation> =
            without_z.into_iter().enumerate().map(|(index, turned)| manoeuvre(index, turned)).collect();
        let words = refused(&observations);
        let expected = "GYRX misalignment z: no manoeuvre turns about Z (at most 0.000 deg)\n\
             GYRY misalignment z: no manoeuvre turns about Z (at most 0.000 deg)\n\
             GYRZA scale factor: no manoeuvre turns about Z (at most 0.000 deg)\n\
             GYRZB scale factor: no manoeuvre turns about Z (at most 0.000 deg)";
        assert_eq!(words, expected);
        // X and Z only together, as in an X-scan without a Z-scan.
        let together = [[0.0; 3], [60.0, 0.0, 104.0], [0.0, 60.0, 0.0], [0.0, -60.0, 0.0], [-60.0, 0.0, -104.0]];
        let observations: Vec<Observation> =
            together.into_iter().enumerate().map(|(index, turned)| manoeuvre(index, turned)).collect();
        let words = refused(&observations);
        assert!(words.contains("GYRY misalignment x and GYRY misalignment z cannot be distinguished"), "{words}");
        let mut dead = observations.clone();
        dead.iter_mut().for_each(|observation| observation.counts[1] = None);
        assert!(refused(&dead).contains("GYRY: no manoeuvre has usable counts of it"));
        assert_eq!(refused(&[]), "no manoeuvre could be used");
        let mut infinite = observations;
        infinite[0].samples = f64::NAN;
        assert!(refused(&infinite).contains("manoeuvre 0"));
    }
}
