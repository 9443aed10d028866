//! How far biases and scale can be told apart, and which spin would help.

use nalgebra::{DMatrix, DVector};

use crate::rates::fit::{Fit, cosine, inverse};
use crate::rates::model::Parameter;
use crate::rates::noise::Noise;
use crate::rates::windows::{Reference, Windows};

/// What the windows tell of the biases and the scale error, all free together.
#[derive(Debug, Clone, PartialEq)]
pub struct Observability {
    /// Every bias, and the scale error.
    pub parameters: Vec<Parameter>,
    /// One sigma of each with all the others known, arcsec/s or a fraction.
    pub sigmas_alone: Vec<f64>,
    /// One sigma of each with all free; infinite where the windows do not determine them.
    pub sigmas_free: Vec<f64>,
    /// Cosines of the signatures, whitened.
    pub cosines: DMatrix<f64>,
    /// Correlations of the values with all free; nothing where the windows do not determine them.
    pub correlations: Option<DMatrix<f64>>,
    /// Condition number of the signatures, each scaled to length 1.
    pub condition: f64,
    /// Manoeuvres added in simulation, that which helps most first.
    pub manoeuvres: Vec<CandidateSpin>,
}

/// A spin of its own group of windows, added to the data in simulation.
#[derive(Debug, Clone, PartialEq)]
pub struct CandidateSpin {
    /// The rate, arcsec/s about X, Y, Z.
    pub spin_arcsec_s: [f64; 3],
    /// How many windows.
    pub windows: usize,
    /// One sigma of each parameter with all free.
    pub sigmas_free: Vec<f64>,
    /// Cosines of the signatures.
    pub cosines: DMatrix<f64>,
    /// Condition number.
    pub condition: f64,
}

/// Signatures, their lengths and what follows.
struct Signatures {
    lengths: DVector<f64>,
    cosines: DMatrix<f64>,
    covariance: Option<DMatrix<f64>>,
    condition: f64,
}

fn signatures(windows: &Windows, noise: &Noise, parameters: &[Parameter], fitted: &Fit) -> Signatures {
    let (_, slope) = fitted.linearised(windows, parameters);
    let white = noise.whiten(windows, &slope);
    let products = white.tr_mul(&white);
    let lengths = products.diagonal().map(f64::sqrt);
    let count = parameters.len();
    let cosines = DMatrix::from_fn(count, count, |row, column| match row == column {
        true => 1.0,
        false => cosine(&white, row, column, &[]),
    });
    let eigen = cosines.clone().symmetric_eigen().eigenvalues;
    let (least, greatest) = (eigen.min(), eigen.max());
    let condition = if least > 1e-12 { (greatest / least).sqrt() } else { f64::INFINITY };
    Signatures { lengths, cosines, covariance: inverse(&products), condition }
}

impl Signatures {
    fn sigmas_free(&self) -> Vec<f64> {
        let of = |index: usize| self.covariance.as_ref().map_or(f64::INFINITY, |own| own[(index, index)].sqrt());
        (0..self.lengths.len()).map(of).collect()
    }
}

/// About a solution; nothing where a parameter has no signature at all.
pub(crate) fn apart(windows: &Windows, noise: &Noise, fitted: &Fit) -> Option<Observability> {
    let own = |parameter: &Parameter| matches!(parameter, Parameter::Bias(_) | Parameter::Scale);
    let parameters: Vec<Parameter> = windows.parameters().into_iter().filter(own).collect();
    let told = signatures(windows, noise, &parameters, fitted);
    if told.lengths.iter().any(|length| *length <= 0.0) {
        return None;
    }
    let correlations = told.covariance.as_ref().map(|covariance| {
        let size = covariance.diagonal().map(f64::sqrt);
        DMatrix::from_fn(size.len(), size.len(), |row, column| covariance[(row, column)] / (size[row] * size[column]))
    });
    let mut manoeuvres: Vec<CandidateSpin> = spins(windows)
        .into_iter()
        .map(|spin_arcsec_s| {
            let count = (windows.all().len() / windows.groups.len().max(1)).max(1);
            let with = with_spin(windows, spin_arcsec_s, count, fitted);
            let told = signatures(&with, noise, &parameters, fitted);
            let sigmas_free = told.sigmas_free();
            let Signatures { cosines, condition, .. } = told;
            CandidateSpin { spin_arcsec_s, windows: count, sigmas_free, cosines, condition }
        })
        .collect();
    // Each error counts alike, in its own sigma.
    let size = |manoeuvre: &CandidateSpin| manoeuvre.sigmas_free.iter().map(|sigma| sigma.ln()).sum::<f64>();
    manoeuvres.sort_by(|one, other| size(one).total_cmp(&size(other)));
    Some(Observability {
        sigmas_alone: told.lengths.iter().map(|length| length.recip()).collect(),
        sigmas_free: told.sigmas_free(),
        correlations,
        condition: told.condition,
        cosines: told.cosines,
        manoeuvres,
        parameters,
    })
}

/// Spins both ways about each axis, as fast as the middle window.
fn spins(windows: &Windows) -> Vec<[f64; 3]> {
    let mut speeds: Vec<f64> = windows
        .all()
        .iter()
        .map(|window| match window.reference {
            Reference::Magnitude(rate) => rate.abs(),
            Reference::Vector(rates) => rates.iter().map(|rate| rate * rate).sum::<f64>().sqrt(),
        })
        .collect();
    speeds.sort_unstable_by(f64::total_cmp);
    let Some(&speed) = speeds.get(speeds.len() / 2) else { return Vec::new() };
    let of = |axis: usize, sign: f64| std::array::from_fn(|other| if other == axis { sign * speed } else { 0.0 });
    (0..3).flat_map(|axis| [of(axis, 1.0), of(axis, -1.0)]).collect()
}

/// The windows and `count` of a spin, as gyros with these errors would read it.
fn with_spin(windows: &Windows, spin: [f64; 3], count: usize, fitted: &Fit) -> Windows {
    let mut with = windows.clone();
    with.groups.push("manoeuvre".to_owned());
    let scale = 1.0 + fitted.value(Parameter::Scale);
    let rates: Vec<f64> = windows
        .gyros
        .iter()
        .enumerate()
        .map(|(gyro, own)| spin[own.axis.min(2)] * scale + fitted.value(Parameter::Bias(gyro)))
        .collect();
    let reference = match windows.is_magnitude() {
        true => Reference::Magnitude(spin.iter().map(|rate| rate * rate).sum::<f64>().sqrt()),
        false => Reference::Vector(spin),
    };
    for _ in 0..count {
        // Rates like those of the data cannot be refused.
        let _ = with.push(windows.groups.len(), &rates, reference);
    }
    with
}
