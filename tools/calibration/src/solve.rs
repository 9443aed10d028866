//! Sixteen parameters from the equations of any number of manoeuvres (Casteren §5, §6), by weighted least squares.
//!
//! Equation 3 of one gyro over one manoeuvre is linear in that gyro's four unknowns,
//!
//! ```text
//! N·SF + n·D − G₁·Δφ₁ − G₂·Δφ₂ = Δφ_own
//! ```
//!
//! with the counts N over n samples and the inertial rotation Δφ about the control axes. The equations of the gyros
//! are solved joint_chi2, because they share the errors of the rotation.
//!
//! D is the mean over the manoeuvres: with it the accumulated angle is best followed. The drift walks on from the start
//! of the recording, so that mean departs from the drift at the start; the sigmas hold for the latter, and so include
//! the configured walks.

mod parameter;

use geu_model::package::Calibration;
use geu_model::units::{ARCSEC_PER_DEG, ARCSEC_PER_RAD};
use geu_protocol::Gyro;
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};
use statrs::distribution::{ChiSquared, ContinuousCDF};

use crate::noise::{ErrorTerm, RandomWalks};
use crate::transfer::misalignment_matrix;
pub use parameter::{BEFORE_LAUNCH, CalibrationParameter, PER_GYRO, UNKNOWNS, off_axes, own_axis};

/// What was measured over one manoeuvre.
#[derive(Debug, Clone, PartialEq)]
pub struct Observation {
    pub name: String,
    /// Start, s since the start of the recording.
    pub start_s: f64,
    pub end_s: f64,
    pub samples: f64,
    /// Counts of each gyro; nothing where they cannot be trusted.
    pub counts: [Option<f64>; 4],
    /// Inertial rotation: the integrals of the rates about the control axes, arcsec.
    pub rotation_control_arcsec: [f64; 3],
    pub disturbances: Vec<ErrorTerm>,
}

#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SolveError {
    /// What the manoeuvres do not determine, in words.
    #[error("{}", .0.join("\n"))]
    Undetermined(Vec<String>),
    /// Numbers that are none.
    #[error("expected finite counts, rotations and noise, got others in {0}")]
    NotFinite(String),
}

/// One equation after the fit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Residual {
    pub manoeuvre: usize,
    pub gyro: Gyro,
    /// What is left: measured less fitted, arcsec.
    pub arcsec: f64,
    /// Its standard deviation were the model true, arcsec.
    pub sigma_arcsec: f64,
}

#[derive(Debug, Clone, PartialEq)]
pub struct Solution {
    pub calibrations: [Calibration; 4],
    /// Their covariance, in the order of [`CalibrationParameter::all`], with the drift taken as that at the start of the recording.
    pub covariance: DMatrix<f64>,
    pub chi2: f64,
    pub degrees_of_freedom: usize,
    /// Condition number of the whitened equations with columns scaled to one length.
    pub condition: f64,
    /// How much of its own equations each manoeuvre determines: the trace of its block of the projection, of as many as it
    /// has equations.
    pub leverage: Vec<f64>,
    pub residuals: Vec<Residual>,
}

impl Solution {
    pub fn sigmas(&self) -> [f64; UNKNOWNS] {
        std::array::from_fn(|index| self.covariance[(index, index)].max(0.0).sqrt())
    }

    /// The values in the order of [`CalibrationParameter::all`].
    pub fn values(&self) -> [f64; UNKNOWNS] {
        values(&self.calibrations)
    }

    /// Probability of a χ² as large or larger, were the model true; 1 without spare equations.
    pub fn probability(&self) -> f64 {
        probability(self.chi2, self.degrees_of_freedom)
    }
}

/// Probability of a χ² as large or larger.
pub fn probability(chi2: f64, degrees_of_freedom: usize) -> f64 {
    ChiSquared::new(degrees_of_freedom as f64).map_or(1.0, |distribution| distribution.sf(chi2.max(0.0)))
}

/// Values of four calibrations in the order of [`CalibrationParameter::all`].
pub fn values(calibrations: &[Calibration; 4]) -> [f64; UNKNOWNS] {
    let mut all = CalibrationParameter::all();
    std::array::from_fn(|_| {
        all.next().map_or(f64::NAN, |parameter| parameter.of(&calibrations[parameter.gyro as usize]))
    })
}

/// Solves the equations. `believed` serves only to weigh errors, and for what a gyro's row does not have.
///
/// # Errors
/// [`SolveError`]: what the manoeuvres leave undetermined, in words.
pub fn solve(
    observations: &[Observation],
    walks: &[RandomWalks; 4],
    believed: &[Calibration; 4],
) -> Result<Solution, SolveError> {
    let equations = Equations::new(observations, walks, believed)?;
    equations.check_determined()?;
    equations.solve(believed)
}

pub(crate) struct Equations<'a> {
    observations: &'a [Observation],
    /// Manoeuvre and gyro of each row.
    pub(crate) rows: Vec<(usize, usize)>,
    pub(crate) design: DMatrix<f64>,
    pub(crate) right: DVector<f64>,
    /// Covariance of the rows with the walk about its mean over the manoeuvres, which weighs, and with the walk since the
    /// start, which tells.
    weighing: DMatrix<f64>,
    telling: DMatrix<f64>,
}

impl<'a> Equations<'a> {
    pub(crate) fn new(
        observations: &'a [Observation],
        walks: &[RandomWalks; 4],
        believed: &[Calibration; 4],
    ) -> Result<Equations<'a>, SolveError> {
        let rows: Vec<(usize, usize)> = (0..observations.len())
            .flat_map(|index| (0..4).map(move |gyro| (index, gyro)))
            .filter(|&(index, gyro)| observations[index].counts[gyro].is_some())
            .collect();
        let mut design = DMatrix::zeros(rows.len(), UNKNOWNS);
        let mut right = DVector::zeros(rows.len());
        for (row, &(index, gyro)) in rows.iter().enumerate() {
            let Observation { samples, counts, rotation_control_arcsec: turned, .. } = &observations[index];
            let off = off_axes(Gyro::ALL[gyro]);
            let unknowns = [
                counts[gyro].unwrap_or(0.0),
                *samples,
                -turned[off[0]] / ARCSEC_PER_RAD,
                -turned[off[1]] / ARCSEC_PER_RAD,
            ];
            for (index, value) in unknowns.into_iter().enumerate() {
                design[(row, PER_GYRO * gyro + index)] = value;
            }
            right[row] = turned[own_axis(Gyro::ALL[gyro])];
        }
        let (weighing, telling) = covariances(observations, &rows, walks, believed);
        let finite = |matrix: &DMatrix<f64>| matrix.iter().all(|value| value.is_finite());
        if !finite(&design) || !finite(&telling) || !right.iter().all(|value| value.is_finite()) {
            let bad = |observation: &&Observation| {
                let numbers =
                    observation.rotation_control_arcsec.into_iter().chain(observation.counts.into_iter().flatten());
                numbers.chain([observation.samples]).any(|number| !number.is_finite())
            };
            let name = observations.iter().find(bad).map_or("the noise", |observation| &observation.name);
            return Err(SolveError::NotFinite(name.to_owned()));
        }
        Ok(Equations { observations, rows, design, right, weighing, telling })
    }

    /// Refuses what the data tell less of than was known before launch, naming the direction.
    fn check_determined(&self) -> Result<(), SolveError> {
        let mut words = Vec::new();
        if self.observations.is_empty() {
            return Err(SolveError::Undetermined(vec!["no manoeuvre could be used".to_owned()]));
        }
        for gyro in Gyro::ALL {
            let own: Vec<usize> = (0..self.rows.len()).filter(|&row| self.rows[row].1 == gyro as usize).collect();
            if own.is_empty() {
                words.push(format!("{}: no manoeuvre has counts of it that can be trusted", gyro.name()));
                continue;
            }
            // In units of what is known before launch and of the noise, so that an eigenvalue below 1 is ignorance.
            let scaled = DMatrix::from_fn(own.len(), PER_GYRO, |row, index| {
                let size = CalibrationParameter { gyro, index }.before_launch();
                let row = own[row];
                self.design[(row, PER_GYRO * gyro as usize + index)] * size / self.weighing[(row, row)].sqrt()
            });
            let directions = (scaled.transpose() * scaled).symmetric_eigen();
            for (index, &square) in directions.eigenvalues.iter().enumerate() {
                if square < 1.0 {
                    words.push(self.in_words(gyro, directions.eigenvectors.column(index).iter().copied().collect()));
                }
            }
        }
        if words.is_empty() { Ok(()) } else { Err(SolveError::Undetermined(words)) }
    }

    /// A direction that the data leave open.
    fn in_words(&self, gyro: Gyro, direction: Vec<f64>) -> String {
        let largest_deg = |axis: usize| {
            let turned = self.observations.iter().filter(|observation| observation.counts[gyro as usize].is_some());
            turned.map(|observation| observation.rotation_control_arcsec[axis].abs()).fold(0.0, f64::max)
                / ARCSEC_PER_DEG
        };
        let parameter = |index: usize| CalibrationParameter { gyro, index };
        let mut parts: Vec<usize> = (0..PER_GYRO).filter(|&index| direction[index].abs() > 0.3).collect();
        parts.sort_by(|&a, &b| direction[b].abs().total_cmp(&direction[a].abs()));
        let axis_of = |index: usize| match index {
            0 => Some(own_axis(gyro)),
            1 => None,
            _ => Some(off_axes(gyro)[index - 2]),
        };
        let names: Vec<String> = parts.iter().map(|&index| parameter(index).label()).collect();
        match (parts.as_slice(), parts.first().and_then(|&index| axis_of(index))) {
            ([_], Some(axis)) => format!(
                "{}: no manoeuvre turns about {} (at most {:.3} deg)",
                names[0],
                ["X", "Y", "Z"][axis],
                largest_deg(axis)
            ),
            ([_], None) => {
                let longest_s = self.observations.iter().map(|found| found.end_s - found.start_s).fold(0.0, f64::max);
                format!("{}: no manoeuvre is long enough (at most {longest_s:.1} s)", names[0])
            }
            _ => format!(
                "{} cannot be told apart: {} manoeuvre{} with counts of {} {} few, or they turn about these axes only together",
                names.join(" and "),
                self.rows.iter().filter(|row| row.1 == gyro as usize).count(),
                if self.observations.len() == 1 { "" } else { "s" },
                gyro.name(),
                if self.observations.len() == 1 { "is too" } else { "are too" },
            ),
        }
    }

    fn solve(&self, believed: &[Calibration; 4]) -> Result<Solution, SolveError> {
        let root = root(&self.weighing)?;
        let LeastSquaresFit { solved, gain, squares } = fit(&self.design, &self.right, &root)?;
        let covariance = &gain * &self.telling * gain.transpose();
        let mut calibrations = *believed;
        for (index, parameter) in CalibrationParameter::all().enumerate() {
            *parameter.of_mut(&mut calibrations[parameter.gyro as usize]) = solved[index];
        }
        let left = &self.design * &solved - &self.right;
        // Of the projection and of the residuals' covariance only the diagonals are told.
        let weighed = &gain * &self.weighing * gain.transpose();
        let seen = &self.design * weighed;
        let whitened_left = root.l_dirty().solve_lower_triangular(&left).ok_or_else(noise_not_finite)?;
        let mut leverage = vec![0.0; self.observations.len()];
        for (row, &(manoeuvre, _)) in self.rows.iter().enumerate() {
            leverage[manoeuvre] += (self.design.row(row) * gain.column(row))[0];
        }
        let residuals = self.rows.iter().enumerate().map(|(row, &(manoeuvre, gyro))| Residual {
            manoeuvre,
            gyro: Gyro::ALL[gyro],
            arcsec: left[row],
            sigma_arcsec: (self.weighing[(row, row)] - seen.row(row).dot(&self.design.row(row))).max(0.0).sqrt(),
        });
        Ok(Solution {
            calibrations,
            covariance,
            chi2: whitened_left.norm_squared(),
            degrees_of_freedom: self.rows.len().saturating_sub(UNKNOWNS),
            condition: (squares.max() / squares.min().max(f64::MIN_POSITIVE)).sqrt(),
            leverage,
            residuals: residuals.collect(),
        })
    }
}

pub(crate) fn noise_not_finite() -> SolveError {
    SolveError::NotFinite("the noise".to_owned())
}

pub(crate) fn root(covariance: &DMatrix<f64>) -> Result<Cholesky<f64, Dyn>, SolveError> {
    Cholesky::new(covariance.clone()).ok_or_else(noise_not_finite)
}

pub(crate) struct LeastSquaresFit {
    pub(crate) solved: DVector<f64>,
    /// What maps a row to an unknown.
    pub(crate) gain: DMatrix<f64>,
    /// Eigenvalues of the normal matrix, columns scaled to one length: they tell the condition, QR solves.
    pub(crate) squares: DVector<f64>,
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
    let right = root.l_dirty().solve_lower_triangular(right).ok_or_else(noise_not_finite)?;
    let squares = (scaled.transpose() * &scaled).symmetric_eigenvalues();
    let (q, r) = scaled.qr().unpack();
    let mut inverse = r.solve_upper_triangular(&q.transpose()).ok_or_else(noise_not_finite)?;
    for (mut row, length) in inverse.row_iter_mut().zip(&lengths) {
        row /= *length;
    }
    let solved = &inverse * right;
    let gain = root.l_dirty().tr_solve_lower_triangular(&inverse.transpose()).ok_or_else(noise_not_finite)?;
    Ok(LeastSquaresFit { solved, gain: gain.transpose(), squares })
}

/// Covariance of the rows, with the drift walk about its mean over the manoeuvres and with it since the start.
fn covariances(
    observations: &[Observation],
    rows: &[(usize, usize)],
    walks: &[RandomWalks; 4],
    believed: &[Calibration; 4],
) -> (DMatrix<f64>, DMatrix<f64>) {
    let shared = shared_covariance(observations, rows, believed);
    let (mut weighing, mut telling) = (shared.clone(), shared);
    for (gyro, walk) in walks.iter().enumerate() {
        let own: Vec<(usize, (f64, f64))> = rows
            .iter()
            .enumerate()
            .filter(|(_, row)| row.1 == gyro)
            .map(|(row, &(index, _))| (row, (observations[index].start_s, observations[index].end_s)))
            .collect();
        let drift = DMatrix::from_fn(own.len(), own.len(), |a, b| walk.drift_covariance(own[a].1, own[b].1));
        let lengths = DVector::from_iterator(own.len(), own.iter().map(|(_, stretch)| stretch.1 - stretch.0));
        // The integral over each stretch less its share of the mean over all.
        let of_mean = drift.column_sum() / lengths.sum().max(f64::MIN_POSITIVE);
        let mean_variance = of_mean.sum() / lengths.sum().max(f64::MIN_POSITIVE);
        let relative = |a: usize, b: usize| {
            drift[(a, b)] - lengths[a] * of_mean[b] - of_mean[a] * lengths[b] + lengths[a] * lengths[b] * mean_variance
        };
        for (a, &(row, stretch)) in own.iter().enumerate() {
            for (b, &(other, other_stretch)) in own.iter().enumerate() {
                let angle = walk.angle_covariance(stretch, other_stretch);
                weighing[(row, other)] += angle + relative(a, b);
                telling[(row, other)] += angle + drift[(a, b)];
            }
        }
    }
    (weighing, telling)
}

/// Covariance of the rows from everything but the walks.
pub(crate) fn shared_covariance(
    observations: &[Observation],
    rows: &[(usize, usize)],
    believed: &[Calibration; 4],
) -> DMatrix<f64> {
    let matrix = misalignment_matrix(believed);
    // What each source adds to each row.
    let mut sources: Vec<(crate::noise::ErrorSource, f64, usize, f64)> = Vec::new();
    for (row, &(index, gyro)) in rows.iter().enumerate() {
        for disturbance in &observations[index].disturbances {
            let turned: f64 = (0..3).map(|axis| matrix[(gyro, axis)] * disturbance.rotation_control_arcsec[axis]).sum();
            let part = disturbance.counts[gyro] * believed[gyro].scale_factor - turned;
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

#[cfg(test)]
mod tests {
    use super::*;

    const QUIET: RandomWalks = RandomWalks {
        angle_arcsec_per_sqrt_s: 0.0,
        drift_arcsec_per_s_per_sqrt_s: 0.0,
        correlation_time_s: f64::INFINITY,
    };

    /// A manoeuvre of a perfect unit that turns so many degrees about each axis.
    fn manoeuvre(index: usize, turned_deg: [f64; 3]) -> Observation {
        let turned = turned_deg.map(|angle| angle * ARCSEC_PER_DEG);
        let start_s = 1000.0 * index as f64;
        Observation {
            name: format!("manoeuvre {index}"),
            start_s,
            end_s: start_s + 600.0,
            samples: 1200.0,
            counts: Gyro::ALL.map(|gyro| Some(turned[own_axis(gyro)])),
            rotation_control_arcsec: turned,
            disturbances: (0..4)
                .map(|gyro| {
                    let mut counts = [0.0; 4];
                    counts[gyro] = 1.0;
                    let source = crate::noise::ErrorSource::Rounding { gyro, node: index };
                    ErrorTerm { source, variance: 1.0 / 6.0, counts, rotation_control_arcsec: [0.0; 3] }
                })
                .collect(),
        }
    }

    fn refused(observations: &[Observation]) -> String {
        match solve(observations, &[QUIET; 4], &Default::default()) {
            Err(error) => error.to_string(),
            Ok(solution) => panic!("solved, with {:?}", solution.sigmas()),
        }
    }

    #[test]
    fn manoeuvres_that_turn_about_every_axis_and_none_determine_everything() {
        let manoeuvres = [[0.0; 3], [60.0, 0.0, 0.0], [0.0, 60.0, 0.0], [0.0, 0.0, 60.0], [0.0, -60.0, 0.0]];
        let observations: Vec<Observation> =
            manoeuvres.into_iter().enumerate().map(|(index, turned)| manoeuvre(index, turned)).collect();
        let solution = solve(&observations, &[QUIET; 4], &Default::default()).expect("determined");
        for (parameter, value) in CalibrationParameter::all().zip(solution.values()) {
            let expected = if parameter.index == 0 { 1.0 } else { 0.0 };
            assert!((value - expected).abs() < 1e-9, "{}: {value}", parameter.label());
        }
        assert_eq!((solution.degrees_of_freedom, observations.len()), (4, 5));
        // As many as there are unknowns: the projection's trace.
        assert!((solution.leverage.iter().sum::<f64>() - 16.0).abs() < 1e-9);
    }

    #[test]
    fn what_no_manoeuvre_determines_is_named() {
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
        assert!(words.contains("GYRY misalignment x and GYRY misalignment z cannot be told apart"), "{words}");
        let mut dead = observations.clone();
        dead.iter_mut().for_each(|observation| observation.counts[1] = None);
        assert!(refused(&dead).contains("GYRY: no manoeuvre has counts of it that can be trusted"));
        assert_eq!(refused(&[]), "no manoeuvre could be used");
        let mut infinite = observations;
        infinite[0].samples = f64::NAN;
        assert!(refused(&infinite).contains("manoeuvre 0"));
    }
}
