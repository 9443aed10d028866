//! A calibration as JSON (cli.md), as values for a configuration, and read back.

use geu_model::package::Calibration;
use geu_protocol::Gyro;
use serde_json::{Map, Value, json};

use crate::calibrate::Calibrated;
use crate::solve::{PER_GYRO, Parameter, UNKNOWNS, off_axes};

/// Keys of the misalignments.
const AXES: [&str; 3] = ["x", "y", "z"];

/// The JSON that `geu calibrate --json` writes.
pub fn json(calibrated: &Calibrated) -> Value {
    let Calibrated { solution, hand, observations, left_out, reference_sigma_arcsec } = calibrated;
    let sigmas = solution.sigmas();
    let hand = match hand {
        Ok(calibrations) => {
            let differences: Vec<f64> = crate::solve::values(calibrations)
                .into_iter()
                .zip(solution.values())
                .zip(sigmas)
                .map(|((hand, full), sigma)| (hand - full) / sigma)
                .collect();
            json!({ "gyros": gyros(calibrations, None), "difference_sigmas": named(&differences) })
        }
        Err(why) => json!({ "gyros": null, "why": why }),
    };
    let manoeuvres: Vec<Value> = observations
        .iter()
        .enumerate()
        .map(|(index, observation)| {
            let residuals: Map<String, Value> = solution
                .residuals
                .iter()
                .filter(|residual| residual.manoeuvre == index)
                .map(|residual| {
                    let value = json!({ "arcsec": residual.arcsec, "sigma_arcsec": residual.sigma_arcsec });
                    (residual.gyro.name().to_owned(), value)
                })
                .collect();
            json!({
                "manoeuvre": observation.name,
                "start_s": observation.start_s,
                "end_s": observation.end_s,
                "rotation_control_arcsec": observation.rotation_control_arcsec,
                "leverage": solution.leverage[index],
                "residuals": residuals,
            })
        })
        .collect();
    let covariance: Vec<Vec<f64>> =
        (0..UNKNOWNS).map(|row| (0..UNKNOWNS).map(|column| solution.covariance[(row, column)]).collect()).collect();
    json!({
        "gyros": gyros(&solution.calibrations, Some(&sigmas)),
        "chi2": {
            "value": solution.chi2,
            "dof": solution.degrees_of_freedom,
            "probability": solution.probability(),
        },
        "hand_method": hand,
        "condition": solution.condition,
        "reference_sigma_arcsec": reference_sigma_arcsec.iter().all(|sigma| sigma.is_finite()).then_some(reference_sigma_arcsec),
        "manoeuvres": manoeuvres,
        "left_out": left_out.iter().map(|left_out| json!({
            "manoeuvre": left_out.name,
            "start_s": left_out.start_s,
            "gyro": left_out.gyro.map(Gyro::name),
            "why": left_out.why,
        })).collect::<Vec<_>>(),
        "parameters": Parameter::all().map(Parameter::words).collect::<Vec<_>>(),
        "covariance": covariance,
    })
}

fn named(values: &[f64]) -> Value {
    Parameter::all()
        .zip(values)
        .map(|(parameter, &value)| (parameter.words(), Value::from(value)))
        .collect::<Map<_, _>>()
        .into()
}

/// Values of each gyro in the form of cli.md, with their sigmas where there are any.
fn gyros(calibrations: &[Calibration; 4], sigmas: Option<&[f64; UNKNOWNS]>) -> Value {
    let value = |gyro: Gyro, index: usize| {
        let value = Parameter { gyro, index }.of(&calibrations[gyro as usize]);
        match sigmas {
            Some(sigmas) => json!({ "value": value, "sigma": sigmas[PER_GYRO * gyro as usize + index] }),
            None => json!({ "value": value }),
        }
    };
    let gyros = Gyro::ALL.into_iter().map(|gyro| {
        let [first, second] = off_axes(gyro).map(|axis| AXES[axis]);
        let own = json!({
            "scale_factor": value(gyro, 0),
            "drift_arcsec_per_half_s": value(gyro, 1),
            "misalignment_arcsec": { first: value(gyro, 2), second: value(gyro, 3) },
        });
        (gyro.name().to_owned(), own)
    });
    gyros.collect::<Map<_, _>>().into()
}

/// The solved values as `PATH = VALUE` for a configuration, to a thousandth of the best sigma that data can give.
pub fn overrides(calibrations: &[Calibration; 4]) -> Vec<String> {
    Parameter::all()
        .map(|parameter| {
            let value = parameter.of(&calibrations[parameter.gyro as usize]);
            let digits = [11, 8, 5][parameter.index.min(2)];
            format!("gyro.{}.calibration.{} = {value:.digits$}", parameter.gyro.name(), parameter.key())
        })
        .collect()
}

/// No standard deviation.
pub const NO_SIGMA: Calibration =
    Calibration { scale_factor: 0.0, drift_arcsec_per_half_s: 0.0, x_arcsec: 0.0, y_arcsec: 0.0, z_arcsec: 0.0 };

/// What is wrong in the JSON of a calibration.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{field}: expected {expected}, got {got}")]
pub struct FieldError {
    /// Path of the number.
    pub field: String,
    /// What should stand there.
    pub expected: String,
    /// What stands there.
    pub got: String,
}

/// A number of the JSON at a path of keys and indices joined by dots, within its limits.
fn number(json: &Value, field: &str, least: f64, greatest: f64, expected: &str) -> Result<f64, FieldError> {
    let found = json.pointer(&format!("/{}", field.replace('.', "/")));
    found.and_then(Value::as_f64).filter(|number| (least..=greatest).contains(number)).ok_or_else(|| FieldError {
        field: field.to_owned(),
        expected: expected.to_owned(),
        got: found.map_or_else(|| "nothing".to_owned(), Value::to_string),
    })
}

/// The values in the JSON that [`json`] writes and the standard deviation of each, 0 where none is told.
///
/// # Errors
/// A value that is not there, or out of the limits that a configuration has.
pub fn calibrations(json: &Value) -> Result<([Calibration; 4], [Calibration; 4]), FieldError> {
    let (mut calibrations, mut sigmas) = ([Calibration::default(); 4], [NO_SIGMA; 4]);
    for parameter in Parameter::all() {
        let gyro = parameter.gyro;
        let path = match parameter.index {
            0 | 1 => format!("gyros.{}.{}", gyro.name(), parameter.key()),
            index => {
                format!("gyros.{}.misalignment_arcsec.{}", gyro.name(), AXES[off_axes(gyro)[index - 2]])
            }
        };
        let limits = Calibration::NUMBERS.iter().find(|limits| limits.name == parameter.key());
        let (least, greatest, expected) = limits.map_or((f64::MIN, f64::MAX, "a number".to_owned()), |limits| {
            (limits.least, limits.greatest, limits.limits())
        });
        *parameter.of_mut(&mut calibrations[gyro as usize]) =
            number(json, &format!("{path}.value"), least, greatest, &expected)?;
        if json.pointer(&format!("/{}/sigma", path.replace('.', "/"))).is_some() {
            *parameter.of_mut(&mut sigmas[gyro as usize]) =
                number(json, &format!("{path}.sigma"), 0.0, f64::MAX, "0 or more")?;
        }
    }
    Ok((calibrations, sigmas))
}
