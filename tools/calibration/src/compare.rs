//! Compares and combines calibrations of one unit (Casteren §5: the checkout is made twice).
//!
//! They must be independent, each of a recording of its own. The test is whether the unit is unchanged; the change that the
//! paper allows is [`stability_per_day`].

use nalgebra::{Cholesky, DMatrix, DVector};

use crate::solve::{CalibrationParameter, Solution, SolveError, UNKNOWNS, probability};
use crate::update::{DRIFT_PER_FORTNIGHT, SCALE_FACTOR_PER_MONTH};

/// Calibrations whose difference is less probable than this are not merged.
pub const MIN_PROBABILITY: f64 = 1e-3;
const DAYS_PER_MONTH: f64 = 30.4375;

#[derive(Debug, Clone, PartialEq)]
pub struct PreviousCalibration {
    pub name: String,
    /// Unix time of its recording's start, s.
    pub time_s: f64,
    /// Parameters and their covariance; no residuals and no leverage.
    pub solution: Solution,
}

/// Calibrations of one unit compared, parameter by parameter, and combined.
#[derive(Debug, Clone, PartialEq)]
pub struct Comparison {
    /// The last less the mean of those before it, in the order of [`CalibrationParameter::all`].
    pub change: [f64; UNKNOWNS],
    pub sigmas: [f64; UNKNOWNS],
    /// χ² of each parameter's differences, as many degrees of freedom as `pairs`.
    pub chi2: [f64; UNKNOWNS],
    /// Joint χ² of all differences, with 16 × `pairs` degrees of freedom.
    pub joint_chi2: f64,
    pub pairs: usize,
    /// The weighted mean, with its covariance.
    pub combined: Solution,
}

impl Comparison {
    /// Probability of differences of one parameter as large or larger, had it not moved.
    pub fn probability(&self, index: usize) -> f64 {
        probability(self.chi2[index], self.pairs)
    }

    /// Joint probability of all parameters.
    pub fn joint_probability(&self) -> f64 {
        probability(self.joint_chi2, UNKNOWNS * self.pairs)
    }

    /// True if the calibrations agree.
    pub fn is_compatible(&self) -> bool {
        self.joint_probability() > MIN_PROBABILITY
    }

    /// Parameters that changed significantly, with the threshold corrected for their number.
    pub fn moved(&self) -> Vec<CalibrationParameter> {
        let threshold = MIN_PROBABILITY / UNKNOWNS as f64;
        CalibrationParameter::all()
            .enumerate()
            .filter(|(index, _)| self.probability(*index) < threshold)
            .map(|(_, one)| one)
            .collect()
    }
}

/// Stability of a parameter per day by the paper: the scale factor 0.004 % per month, the drift 6″/h in two weeks (Casteren
/// table 1); `None` for misalignments.
pub fn stability_per_day(parameter: CalibrationParameter) -> Option<f64> {
    match parameter.index {
        0 => Some(SCALE_FACTOR_PER_MONTH / DAYS_PER_MONTH),
        1 => Some(DRIFT_PER_FORTNIGHT / 14.0),
        _ => None,
    }
}

/// Compares and combines independent solutions in the order of time: each with the mean of those before it, so that the
/// parts of χ² are independent and their sum is that about the mean of all.
///
/// # Errors
/// Covariances that cannot be inverted.
pub fn compare(first: &Solution, later: &[&Solution]) -> Result<Option<Comparison>, SolveError> {
    let mut all: Option<Comparison> = None;
    for next in later {
        let mut step = combine(all.as_ref().map_or(first, |before| &before.combined), next)?;
        if let Some(before) = all {
            step.pairs += before.pairs;
            step.joint_chi2 += before.joint_chi2;
            step.chi2 = std::array::from_fn(|index| step.chi2[index] + before.chi2[index]);
        }
        all = Some(step);
    }
    Ok(all)
}

/// Compares and combines two independent solutions.
///
/// # Errors
/// Covariances that cannot be inverted.
pub fn combine(first: &Solution, second: &Solution) -> Result<Comparison, SolveError> {
    let singular = || SolveError::NotFinite("the covariances".to_owned());
    let values = [first, second].map(|solution| DVector::from_column_slice(&solution.values()));
    let difference = &values[1] - &values[0];
    let total = &first.covariance + &second.covariance;
    // Scaled to unit diagonal, so that relative errors of 10⁻⁶ and arcseconds do not meet in one inverse.
    let scale: Vec<f64> = (0..UNKNOWNS).map(|index| total[(index, index)].sqrt()).collect();
    let scaled =
        |matrix: &DMatrix<f64>| DMatrix::from_fn(UNKNOWNS, UNKNOWNS, |a, b| matrix[(a, b)] / scale[a] / scale[b]);
    let root = Cholesky::new(scaled(&total)).ok_or_else(singular)?;
    let unit = DVector::from_fn(UNKNOWNS, |index, _| difference[index] / scale[index]);
    // The mean is first + C₁(C₁ + C₂)⁻¹(second − first), its covariance C₁ − C₁(C₁ + C₂)⁻¹C₁.
    let own = scaled(&first.covariance);
    let step = &own * root.solve(&unit);
    let covariance = &own - &own * root.solve(&own);
    let mut combined = second.clone();
    for (index, parameter) in CalibrationParameter::all().enumerate() {
        let value = values[0][index] + step[index] * scale[index];
        parameter.set(&mut combined.calibrations[parameter.gyro.index()], value);
    }
    combined.covariance = DMatrix::from_fn(UNKNOWNS, UNKNOWNS, |a, b| covariance[(a, b)] * scale[a] * scale[b]);
    let joint_chi2 = unit.dot(&root.solve(&unit));
    combined.chi2 = first.chi2 + second.chi2 + joint_chi2;
    combined.degrees_of_freedom = first.degrees_of_freedom + second.degrees_of_freedom + UNKNOWNS;
    combined.residuals = Vec::new();
    combined.leverage = Vec::new();
    let chi2 = std::array::from_fn(|index| unit[index] * unit[index]);
    let change = std::array::from_fn(|index| difference[index]);
    let sigmas = std::array::from_fn(|index| scale[index]);
    Ok(Comparison { change, sigmas, chi2, joint_chi2, pairs: 1, combined })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn solution(values: [f64; UNKNOWNS], sigma: f64) -> Solution {
        let mut calibrations: [geu_model::package::Calibration; 4] = Default::default();
        for (parameter, value) in CalibrationParameter::all().zip(values) {
            parameter.set(&mut calibrations[parameter.gyro.index()], value);
        }
        Solution {
            parameters: CalibrationParameter::all().collect(),
            calibrations: calibrations.to_vec(),
            undetermined: Vec::new(),
            timing: None,
            parity: Vec::new(),
            covariance: DMatrix::identity(UNKNOWNS, UNKNOWNS) * sigma * sigma,
            chi2: 8.0,
            degrees_of_freedom: 8,
            condition: 1.0,
            leverage: Vec::new(),
            residuals: Vec::new(),
            trial_drifts: Vec::new(),
        }
    }

    #[test]
    fn three_are_combined_as_their_weighted_mean_and_scatter_about_it() {
        let at = |value: f64| {
            let mut values = [1.0; UNKNOWNS];
            values[5] = value;
            values
        };
        let [a, b, c] = [(1.0, 1.0), (3.0, 2.0), (0.0, 2.0)].map(|(value, sigma)| solution(at(value), sigma));
        let compared = compare(&a, &[&b, &c]).unwrap().unwrap();
        // Weights 1, 1/4, 1/4: the mean is 1.75/1.5, its variance 1/1.5.
        let mean = 1.75 / 1.5;
        assert!((compared.combined.values()[5] - mean).abs() < 1e-12);
        assert!((compared.combined.covariance[(5, 5)] - 1.0 / 1.5).abs() < 1e-12);
        let about_mean = (1.0 - mean) * (1.0 - mean) + (3.0 - mean).powi(2) / 4.0 + mean * mean / 4.0;
        assert!((compared.chi2[5] - about_mean).abs() < 1e-12 && (compared.joint_chi2 - about_mean).abs() < 1e-12);
        assert_eq!((compared.pairs, compared.combined.degrees_of_freedom), (2, 24 + 32));
        assert!(compared.is_compatible() && compared.moved().is_empty());
        assert_eq!(compare(&a, &[]).unwrap(), None);
    }

    #[test]
    fn changed_parameters_are_named() {
        let mut values = [1.0; UNKNOWNS];
        let before = solution(values, 0.01);
        values[8] += 0.1;
        let compared = compare(&before, &[&solution(values, 0.01)]).unwrap().unwrap();
        assert!(!compared.is_compatible());
        let moved: Vec<String> = compared.moved().into_iter().map(CalibrationParameter::label).collect();
        assert_eq!(moved, ["GYRZA scale factor"]);
    }
}
