//! Observability of biases and scale, and the spin that would improve it.

use geu_model::package::dot;
use nalgebra::{DMatrix, DVector};

use crate::fit::{Fit, cosine, inverse};
use crate::model::Parameter;
use crate::noise::Noise;
use crate::windows::Windows;

/// Smallest eigenvalue of the cosines with which the condition number is finite.
const MIN_EIGENVALUE: f64 = 1e-12;

/// Information of the windows on the biases and the scale error, all free together.
#[derive(Debug, Clone, PartialEq)]
pub struct Observability {
    /// Every bias, and the scale error.
    pub parameters: Vec<Parameter>,
    /// Sigma of each with all others known, arcsec/s or a fraction.
    pub sigmas_alone: Vec<f64>,
    /// Sigma of each with all free; infinite if the windows do not determine them.
    pub sigmas_free: Vec<f64>,
    /// Cosines of the whitened signatures.
    pub cosines: DMatrix<f64>,
    /// Correlations of the values with all free; `None` if the windows do not determine them.
    pub correlations: Option<DMatrix<f64>>,
    /// Condition number of the signatures, each scaled to length 1.
    pub condition: f64,
    /// Manoeuvres added in simulation, the most helpful first.
    pub manoeuvres: Vec<CandidateSpin>,
}

/// A spin, added to the data in simulation as a group of windows.
#[derive(Debug, Clone, PartialEq)]
pub struct CandidateSpin {
    /// Rate about X, Y, Z, arcsec/s.
    pub spin_arcsec_s: [f64; 3],
    /// Number of windows.
    pub windows: usize,
    /// Sigma of each parameter with all free.
    pub sigmas_free: Vec<f64>,
    /// Cosines of the signatures.
    pub cosines: DMatrix<f64>,
    /// Condition number.
    pub condition: f64,
}

/// Evaluates the signatures about a solution, without manoeuvres.
fn signatures(windows: &Windows, noise: &Noise, parameters: &[Parameter], fitted: &Fit) -> Observability {
    let (_, slope) = fitted.linearised(windows, parameters);
    let white = noise.whiten(windows, &slope);
    let products = white.tr_mul(&white);
    let count = parameters.len();
    let cosines = DMatrix::from_fn(count, count, |row, column| match row == column {
        true => 1.0,
        false => cosine(&white, row, column, &[]),
    });
    let eigen = cosines.clone().symmetric_eigen().eigenvalues;
    let (min, max) = (eigen.min(), eigen.max());
    let covariance = inverse(&products);
    let sigmas: Option<DVector<f64>> = covariance.as_ref().map(|covariance| covariance.diagonal().map(f64::sqrt));
    let correlations = covariance.zip(sigmas.as_ref()).map(|(covariance, sigmas)| {
        DMatrix::from_fn(count, count, |row, column| covariance[(row, column)] / (sigmas[row] * sigmas[column]))
    });
    Observability {
        parameters: parameters.to_vec(),
        sigmas_alone: products.diagonal().iter().map(|square| square.sqrt().recip()).collect(),
        sigmas_free: sigmas.map_or_else(|| vec![f64::INFINITY; count], |sigmas| sigmas.as_slice().to_vec()),
        cosines,
        correlations,
        condition: if min > MIN_EIGENVALUE { (max / min).sqrt() } else { f64::INFINITY },
        manoeuvres: Vec::new(),
    }
}

/// Evaluates the observability about a solution; `None` if a parameter has no signature.
pub(crate) fn observability(windows: &Windows, noise: &Noise, fitted: &Fit) -> Option<Observability> {
    let is_common = |parameter: &Parameter| matches!(parameter, Parameter::Bias(_) | Parameter::Scale);
    let parameters: Vec<Parameter> = windows.parameters().into_iter().filter(is_common).collect();
    let now = signatures(windows, noise, &parameters, fitted);
    if now.sigmas_alone.iter().any(|sigma| sigma.is_infinite()) {
        return None;
    }
    let count = (windows.all().len() / windows.groups.len().max(1)).max(1);
    // As gyros with these errors measure it.
    let scale = 1.0 + fitted.value(Parameter::Scale);
    let simulated = |spin_arcsec_s| {
        let gyros = windows.gyros.iter().enumerate();
        let rates =
            gyros.map(|(gyro, own)| dot(own.input, spin_arcsec_s) * scale + fitted.value(Parameter::Bias(gyro)));
        let with = windows.with_spin(spin_arcsec_s, &rates.collect::<Vec<_>>(), count);
        let Observability { sigmas_free, cosines, condition, .. } = signatures(&with, noise, &parameters, fitted);
        CandidateSpin { spin_arcsec_s, windows: count, sigmas_free, cosines, condition }
    };
    let mut manoeuvres: Vec<CandidateSpin> = spins(windows).into_iter().map(simulated).collect();
    // Logarithms weight the parameters equally.
    let size = |manoeuvre: &CandidateSpin| manoeuvre.sigmas_free.iter().map(|sigma| sigma.ln()).sum::<f64>();
    manoeuvres.sort_by(|one, other| size(one).total_cmp(&size(other)));
    Some(Observability { manoeuvres, ..now })
}

/// Spins both ways about each axis, at the median rate of the windows.
fn spins(windows: &Windows) -> Vec<[f64; 3]> {
    let mut speeds: Vec<f64> = windows.all().iter().map(|window| window.magnitude_arcsec_s).collect();
    speeds.sort_unstable_by(f64::total_cmp);
    let Some(&speed) = speeds.get(speeds.len() / 2) else { return Vec::new() };
    let about = |axis: usize, sign: f64| std::array::from_fn(|other| if other == axis { sign * speed } else { 0.0 });
    (0..3).flat_map(|axis| [about(axis, 1.0), about(axis, -1.0)]).collect()
}
