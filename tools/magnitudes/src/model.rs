//! Rates of gyros with errors, and the residual of their magnitude.

use nalgebra::{DMatrix, DVector};

use crate::windows::Windows;

/// An error of the gyros; its value is a rate in arcsec/s or a fraction.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Parameter {
    /// Output of the gyro at rest, arcsec/s.
    Bias(usize),
    /// Scale error common to all gyros.
    Scale,
    /// Scale error of one gyro.
    OwnScale(usize),
}

impl Parameter {
    /// Code in the model: `drift`, `scale-factor`.
    pub fn code(self) -> &'static str {
        match self {
            Parameter::Bias(_) => "drift",
            Parameter::Scale | Parameter::OwnScale(_) => "scale-factor",
        }
    }

    /// Unit in the model, arcsec/h or ppm, and the factor from this value to it.
    pub fn unit(self) -> (&'static str, f64) {
        match self {
            Parameter::Bias(_) => ("arcsec_per_h", 3600.0),
            Parameter::Scale | Parameter::OwnScale(_) => ("ppm", 1e6),
        }
    }

    /// Indices of the gyros with this error.
    pub fn gyros(self, windows: &Windows) -> Vec<usize> {
        match self {
            Parameter::Bias(gyro) | Parameter::OwnScale(gyro) => vec![gyro],
            Parameter::Scale => (0..windows.gyros.len()).collect(),
        }
    }

    /// In words: `bias of X`, `scale error`.
    pub fn words(self, windows: &Windows) -> String {
        let name = |gyro: usize| windows.gyros.get(gyro).map_or("?", |gyro| gyro.name.as_str());
        match self {
            Parameter::Bias(gyro) => format!("bias of {}", name(gyro)),
            Parameter::Scale => "scale error".to_owned(),
            Parameter::OwnScale(gyro) => format!("scale error of {} alone", name(gyro)),
        }
    }

    /// Largest accepted value: the largest measured rate for a bias, a half for a scale error.
    pub(crate) fn limit(self, windows: &Windows) -> f64 {
        match self {
            Parameter::Bias(_) => windows.max_arcsec_s(),
            Parameter::Scale | Parameter::OwnScale(_) => 0.5,
        }
    }
}

impl Windows {
    /// The errors that are searched.
    pub fn parameters(&self) -> Vec<Parameter> {
        let gyros = 0..self.gyros.len();
        gyros.clone().map(Parameter::Bias).chain([Parameter::Scale]).chain(gyros.map(Parameter::OwnScale)).collect()
    }
}

/// Magnitude of the corrected rates minus the reference, and the derivative by each error of `set`.
pub(crate) fn residual(windows: &Windows, set: &[Parameter], values: &[f64]) -> (DVector<f64>, DMatrix<f64>) {
    let gyros = windows.gyros.len();
    let (mut bias, mut factor, mut common) = (vec![0.0; gyros], vec![1.0; gyros], 1.0);
    for (parameter, value) in set.iter().zip(values) {
        match *parameter {
            Parameter::Bias(gyro) => bias[gyro] = *value,
            Parameter::OwnScale(gyro) => factor[gyro] = 1.0 + value,
            Parameter::Scale => common = 1.0 + value,
        }
    }
    let mut residual = DVector::zeros(windows.all().len());
    let mut slope = DMatrix::zeros(residual.len(), set.len());
    for (index, window) in windows.all().iter().enumerate() {
        let measured = window.rates_arcsec_s.iter().zip(&bias).zip(&factor);
        let rates: Vec<f64> = measured.map(|((rate, bias), factor)| (rate - bias) / (factor * common)).collect();
        // Derivative of a gyro's corrected rate.
        let rate_slope = |gyro: usize, parameter: Parameter| match parameter {
            Parameter::Bias(of) if of == gyro => -1.0 / (factor[gyro] * common),
            Parameter::OwnScale(of) if of == gyro => -rates[gyro] / factor[gyro],
            Parameter::Scale => -rates[gyro] / common,
            _ => 0.0,
        };
        // At rest the direction is undefined and the derivative by it 0.
        let magnitude = norm(&rates);
        let along = |gyro: usize| if magnitude > 0.0 { rates[gyro] / magnitude } else { 0.0 };
        residual[index] = magnitude - window.magnitude_arcsec_s;
        for (column, parameter) in set.iter().enumerate() {
            slope[(index, column)] = (0..gyros).map(|gyro| along(gyro) * rate_slope(gyro, *parameter)).sum();
        }
    }
    (residual, slope)
}

/// Length of a rate vector.
pub(crate) fn norm(rates: &[f64]) -> f64 {
    rates.iter().map(|rate| rate * rate).sum::<f64>().sqrt()
}
