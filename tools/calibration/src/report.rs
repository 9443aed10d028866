//! A calibration as JSON (cli.md), as values for a configuration, and read back.

use geu_model::package::Calibration;
use geu_protocol::Gyro;
use nalgebra::DMatrix;
use serde_json::{Map, Value, json};

use crate::calibrate::Calibrated;
use crate::compare::{Comparison, PreviousCalibration};
use crate::solve::{CalibrationParameter, PER_GYRO, Solution, UNKNOWNS, off_axes};

const AXES: [&str; 3] = ["x", "y", "z"];

/// The JSON that `geu calibrate --json` writes.
pub fn json(calibrated: &Calibrated) -> Value {
    let Calibrated { solution, hand, observations, left_out, reference_sigma_arcsec, time_s, is_settled } = calibrated;
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
    json!({
        "time_s": time_s,
        "settled": is_settled,
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
        "parameters": CalibrationParameter::all().map(CalibrationParameter::label).collect::<Vec<_>>(),
        "covariance": covariance(solution),
    })
}

/// The comparison with earlier calibrations, which is added to that JSON as `comparison`.
pub fn comparison(earlier: &[PreviousCalibration], comparison: &Comparison) -> Value {
    let is_compatible = comparison.is_compatible();
    let parameters: Map<String, Value> = CalibrationParameter::all()
        .enumerate()
        .map(|(index, parameter)| {
            let value = json!({
                "change": comparison.change[index],
                "sigma": comparison.sigmas[index],
                "chi2": comparison.chi2[index],
                "dof": comparison.pairs,
                "probability": comparison.probability(index),
            });
            (parameter.label(), value)
        })
        .collect();
    json!({
        "earlier": earlier.iter().map(|one| json!({ "file": one.name, "time_s": one.time_s })).collect::<Vec<_>>(),
        "chi2": {
            "value": comparison.joint_chi2,
            "dof": UNKNOWNS * comparison.pairs,
            "probability": comparison.together_probability(),
        },
        "compatible": is_compatible,
        "moved": comparison.moved().into_iter().map(CalibrationParameter::label).collect::<Vec<_>>(),
        "parameters": parameters,
        "merged": is_compatible.then(|| json!({
            "gyros": gyros(&comparison.combined.calibrations, Some(&comparison.combined.sigmas())),
            "covariance": covariance(&comparison.combined),
        })),
    })
}

fn covariance(solution: &Solution) -> Vec<Vec<f64>> {
    (0..UNKNOWNS).map(|row| solution.covariance.row(row).iter().copied().collect()).collect()
}

fn named(values: &[f64]) -> Value {
    CalibrationParameter::all()
        .zip(values)
        .map(|(parameter, &value)| (parameter.label(), Value::from(value)))
        .collect::<Map<_, _>>()
        .into()
}

/// Values of each gyro in the form of cli.md, with their sigmas where there are any.
pub(crate) fn gyros(calibrations: &[Calibration; 4], sigmas: Option<&[f64; UNKNOWNS]>) -> Value {
    let value = |gyro: Gyro, index: usize| {
        let value = CalibrationParameter { gyro, index }.of(&calibrations[gyro as usize]);
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
    overrides_of(CalibrationParameter::all(), calibrations)
}

/// As [`overrides`], of some of the parameters.
pub fn overrides_of(
    parameters: impl IntoIterator<Item = CalibrationParameter>,
    calibrations: &[Calibration; 4],
) -> Vec<String> {
    parameters
        .into_iter()
        .map(|parameter| {
            let value = parameter.of(&calibrations[parameter.gyro as usize]);
            let digits = [11, 8, 5][parameter.index.min(2)];
            format!("gyro.{}.calibration.{} = {value:.digits$}", parameter.gyro.name(), parameter.key())
        })
        .collect()
}

pub const NO_SIGMA: Calibration =
    Calibration { scale_factor: 0.0, drift_arcsec_per_half_s: 0.0, x_arcsec: 0.0, y_arcsec: 0.0, z_arcsec: 0.0 };

/// What is wrong in the JSON of a calibration.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{field}: expected {expected}, got {got}")]
pub struct FieldError {
    pub field: String,
    pub expected: String,
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

/// The values in the JSON that [`json()`] writes and the standard deviation of each, 0 where none is told.
///
/// # Errors
/// A value that is not there, or out of the limits that a configuration has.
pub fn calibrations(json: &Value) -> Result<([Calibration; 4], [Calibration; 4]), FieldError> {
    let (mut calibrations, mut sigmas) = ([Calibration::default(); 4], [NO_SIGMA; 4]);
    for parameter in CalibrationParameter::all() {
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

/// Reads the calibration back from the JSON that [`json()`] writes, with its covariance, to be compared.
///
/// # Errors
/// What is not there, as in a calibration that others wrote by hand, or is no number, or is no covariance.
pub fn earlier(name: &str, json: &Value) -> Result<PreviousCalibration, FieldError> {
    let any = |field: &str, least: f64| number(json, field, least, f64::MAX, "a number");
    if !json["covariance"].is_array() {
        return Err(FieldError {
            field: "covariance".to_owned(),
            expected:
                "the 16 × 16 covariance that `geu calibrate --json` writes, without which nothing can be compared"
                    .to_owned(),
            got: json.get("covariance").map_or_else(|| "nothing".to_owned(), Value::to_string),
        });
    }
    let mut covariance = DMatrix::zeros(UNKNOWNS, UNKNOWNS);
    for row in 0..UNKNOWNS {
        for column in 0..UNKNOWNS {
            let least = if row == column { f64::MIN_POSITIVE } else { f64::MIN };
            let expected = if row == column { "a number more than 0" } else { "a number" };
            covariance[(row, column)] = number(json, &format!("covariance.{row}.{column}"), least, f64::MAX, expected)?;
        }
    }
    let solution = Solution {
        calibrations: calibrations(json)?.0,
        covariance,
        chi2: any("chi2.value", 0.0)?,
        degrees_of_freedom: any("chi2.dof", 0.0)? as usize,
        condition: any("condition", 0.0)?,
        leverage: Vec::new(),
        residuals: Vec::new(),
    };
    Ok(PreviousCalibration { name: name.to_owned(), time_s: any("time_s", f64::MIN)?, solution })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checkout::{AttitudeSourceKind, Precautions, believed_before, fly, sequence};

    #[test]
    fn what_was_written_is_read_back() {
        let flown =
            sequence(&geu_model::Configuration::reference(), Precautions { stabilisation: false, ..Precautions::ALL });
        let calibrated = fly(&flown).calibrate(&believed_before(&flown), AttitudeSourceKind::Reference).unwrap();
        let mut json: Value = serde_json::from_str(&json(&calibrated).to_string()).unwrap();
        let read = earlier("first.json", &json).unwrap();
        // JSON gives numbers back to the last bit or the one before.
        let same = |a: f64, b: f64| (a - b).abs() <= 4.0 * f64::EPSILON * b.abs();
        let pairs = read.solution.values().into_iter().zip(calibrated.solution.values());
        assert!(pairs.into_iter().all(|(a, b)| same(a, b)));
        let covariances = read.solution.covariance.iter().zip(&calibrated.solution.covariance);
        assert!(covariances.into_iter().all(|(&a, &b)| same(a, b)));
        assert_eq!(read.time_s, calibrated.time_s);
        json["covariance"][3][3] = Value::from(-1.0);
        let told = earlier("first.json", &json).unwrap_err().to_string();
        assert_eq!(told, "covariance.3.3: expected a number more than 0, got -1.0");
        json["covariance"] = Value::Null;
        assert!(earlier("first.json", &json).unwrap_err().to_string().starts_with("covariance: expected the 16 × 16"));
    }
}
