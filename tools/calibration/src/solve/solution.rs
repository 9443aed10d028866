//! The solved calibration parameters, with their covariance and the residuals.

use geu_model::package::Calibration;
use geu_protocol::Gyro;
use nalgebra::DMatrix;
use statrs::distribution::{ChiSquared, ContinuousCDF};

use super::{CalibrationParameter, ParityOfHeads, UNKNOWNS};

/// One equation after the fit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Residual {
    pub manoeuvre: usize,
    pub gyro: Gyro,
    /// Measured less fitted, arcsec.
    pub arcsec: f64,
    /// Standard deviation if the model is true, arcsec.
    pub sigma_arcsec: f64,
}

/// Drifts in a further trial beside those in the first one.
#[derive(Debug, Clone, PartialEq)]
pub struct TrialDrift {
    pub trial: String,
    /// Drift of each gyro and its sigma, arcsec/0.5 s; `None` if the data do not determine it.
    pub drifts: Vec<Option<(f64, f64)>>,
}

#[derive(Debug, Clone, PartialEq)]
pub struct Solution {
    /// The solved parameters.
    pub parameters: Vec<CalibrationParameter>,
    /// Calibration of each gyro.
    pub calibrations: Vec<Calibration>,
    /// True for each parameter that the motion of a described unit does not determine, then for time offset and clock; empty for the
    /// default unit.
    pub undetermined: Vec<bool>,
    /// Time offset, s, and frequency error of the clock, relative, of a described unit, each with its sigma.
    pub timing: Option<[(f64, f64); 2]>,
    /// Parity residuals of a described unit with redundant gyros.
    pub parity: Vec<ParityOfHeads>,
    /// Covariance of the parameters, in their order, with the drift taken as that at the start of the recording.
    pub covariance: DMatrix<f64>,
    pub chi2: f64,
    pub degrees_of_freedom: usize,
    /// Condition number of the whitened equations with columns scaled to one length.
    pub condition: f64,
    /// Leverage of each manoeuvre: the trace of its block of the projection, at most its number of equations.
    pub leverage: Vec<f64>,
    pub residuals: Vec<Residual>,
    pub trial_drifts: Vec<TrialDrift>,
}

impl Solution {
    pub fn sigmas(&self) -> Vec<f64> {
        let variances = self.covariance.diagonal();
        variances.iter().map(|variance| variance.max(0.0).sqrt()).collect()
    }

    /// The values in the order of the parameters.
    pub fn values(&self) -> Vec<f64> {
        values_of(&self.parameters, &self.calibrations)
    }

    /// True if the data determine a parameter.
    pub fn is_determined(&self, parameter: CalibrationParameter) -> bool {
        !self.undetermined.get(parameter.position()).copied().unwrap_or(false)
    }

    /// The parameters that the data determine.
    pub fn determined(&self) -> Vec<CalibrationParameter> {
        self.parameters.iter().copied().filter(|own| self.is_determined(*own)).collect()
    }

    /// The parameters that they do not determine.
    pub fn open(&self) -> Vec<CalibrationParameter> {
        self.parameters.iter().copied().filter(|own| !self.is_determined(*own)).collect()
    }

    /// Time offset, s, and relative frequency error of a described unit's clock, each with its sigma, if the data determine it.
    pub fn times(&self) -> [Option<(f64, f64)>; 2] {
        let first = self.parameters.len();
        let known = |index: usize| self.timing.map(|own| own[index]).filter(|_| !self.undetermined[first + index]);
        [known(0), known(1)]
    }

    /// True for a described unit.
    pub fn is_described(&self) -> bool {
        self.timing.is_some()
    }

    /// Probability of a χ² as large or larger if the model is true; 1 without spare equations.
    pub fn probability(&self) -> f64 {
        probability(self.chi2, self.degrees_of_freedom)
    }
}

/// Probability of a χ² as large or larger.
pub fn probability(chi2: f64, degrees_of_freedom: usize) -> f64 {
    ChiSquared::new(degrees_of_freedom as f64).map_or(1.0, |distribution| distribution.sf(chi2.max(0.0)))
}

/// Values of the calibrations of the default unit in the order of [`CalibrationParameter::all`].
pub fn values(calibrations: &[Calibration; 4]) -> [f64; UNKNOWNS] {
    let mut values = [0.0; UNKNOWNS];
    for parameter in CalibrationParameter::all() {
        values[parameter.position()] = parameter.value(&calibrations[parameter.gyro.index()]);
    }
    values
}

/// Values of these parameters.
pub fn values_of(parameters: &[CalibrationParameter], calibrations: &[Calibration]) -> Vec<f64> {
    parameters.iter().map(|own| own.value(&calibrations[own.gyro.index()])).collect()
}
