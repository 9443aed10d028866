//! A calibration as JSON, as values for a configuration, and read back from JSON.

use geu_model::package::Calibration;
use geu_model::parameter_spec::ParameterSet;
use geu_protocol::Gyro;
use nalgebra::DMatrix;
use serde_json::{Map, Value, json};

use crate::calibrate::Calibrated;
use crate::compare::{Comparison, PreviousCalibration};
use crate::observe::ExcludedData;
use crate::solve::{
    CalibrationParameter, Observation, PER_GYRO, ParityOfHeads, Solution, TrialDrift, UNKNOWNS, off_axes, values_of,
};

const AXES: [&str; 3] = ["x", "y", "z"];

/// The JSON that `geu calibrate --json` writes.
pub fn json(calibrated: &Calibrated) -> Value {
    let Calibrated { solution, first_order, observations, left_out, reference_sigma_arcsec, time_s, is_settled, noise } =
        calibrated;
    let (sigmas, parameters) = (solution.sigmas(), &solution.parameters);
    // Not stated of what is not determined, as NaN, which is null in JSON.
    let mut stated = solution.covariance.clone();
    for index in solution.open().into_iter().map(CalibrationParameter::position) {
        stated.row_mut(index).fill(f64::NAN);
        stated.column_mut(index).fill(f64::NAN);
    }
    let by_parameter = |value: &dyn Fn(usize) -> Value| by_parameter(parameters, value);
    let first_order = match first_order {
        Ok(calibrations) => {
            let (first_order, full) = (values_of(parameters, calibrations), solution.values());
            let difference = |index: usize| json!((first_order[index] - full[index]) / sigmas[index]);
            json!({ "gyros": gyros(parameters, calibrations, None, &[]), "difference_sigmas": by_parameter(&difference) })
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
                .filter(|own| own.manoeuvre == index)
                .map(|own| (own.gyro.name().to_owned(), residual((own.arcsec, own.sigma_arcsec))))
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
    let mut json = json!({
        "time_s": time_s,
        "settled": is_settled,
        "gyros": gyros(parameters, &solution.calibrations, Some(&solution.covariance), &solution.undetermined),
        "chi2": {
            "value": solution.chi2,
            "dof": solution.degrees_of_freedom,
            "probability": solution.probability(),
        },
        "hand_method": first_order,
        "condition": solution.condition,
        "reference_sigma_arcsec": reference_sigma_arcsec.iter().all(|sigma| sigma.is_finite()).then_some(reference_sigma_arcsec),
        "manoeuvres": manoeuvres,
        "left_out": self::left_out("manoeuvre", left_out),
        "parameters": parameters.iter().map(|own| own.label()).collect::<Vec<_>>(),
        "covariance": rows(&stated),
    });
    if solution.is_described() {
        let scaled =
            |own: Option<(f64, f64)>, by: f64| own.map(|own| json!({ "value": own.0 * by, "sigma": own.1 * by }));
        let [offset, clock] = solution.times();
        json["undetermined"] = solution.open().into_iter().map(|own| Value::from(own.label())).collect();
        json["time_offset_s"] = scaled(offset, 1.0).into();
        json["clock_ppm"] = scaled(clock, 1e6).into();
        let noise = parameters.iter().step_by(PER_GYRO).zip(noise);
        json["angle_random_walk_arcsec_per_sqrt_s"] =
            noise.map(|(own, walk)| (own.gyro.name().to_owned(), json!(walk))).collect::<Map<_, _>>().into();
        let trial = |own: &TrialDrift| {
            let gyros = parameters.iter().step_by(PER_GYRO).zip(&own.drifts);
            let value = |own: Option<(f64, f64)>| own.map(|(value, sigma)| json!({ "value": value, "sigma": sigma }));
            let gyros: Map<_, _> =
                gyros.map(|(one, drift)| (one.gyro.name().to_owned(), value(*drift).into())).collect();
            json!({ "trial": own.trial, "drift_arcsec_per_half_s": gyros })
        };
        json["further_trials"] = solution.trial_drifts.iter().map(trial).collect();
        json["parity"] = solution.parity.iter().map(|own| parity(own, &observations[own.largest])).collect();
    }
    json
}

/// A parity residual.
fn parity(own: &ParityOfHeads, largest: &Observation) -> Value {
    let weights = own.weights.iter().map(|(gyro, weight)| (gyro.name().to_owned(), json!(weight)));
    json!({
        "weights": weights.collect::<Map<_, _>>(),
        "rms_arcsec": own.rms_arcsec,
        "sigma_arcsec": own.sigma_arcsec,
        "largest_sigmas": own.largest_sigmas,
        "largest_at_s": largest.start_s,
    })
}

/// The comparison with earlier calibrations, which is added to that JSON as `comparison`.
pub fn comparison(earlier: &[PreviousCalibration], comparison: &Comparison) -> Value {
    let combined = &comparison.combined;
    let is_compatible = comparison.is_compatible();
    json!({
        "earlier": earlier.iter().map(|one| json!({ "file": one.name, "time_s": one.time_s })).collect::<Vec<_>>(),
        "chi2": {
            "value": comparison.joint_chi2,
            "dof": UNKNOWNS * comparison.pairs,
            "probability": comparison.joint_probability(),
        },
        "compatible": is_compatible,
        "moved": comparison.moved().into_iter().map(CalibrationParameter::label).collect::<Vec<_>>(),
        "parameters": by_parameter(&combined.parameters, &|index| json!({
            "change": comparison.change[index],
            "sigma": comparison.sigmas[index],
            "chi2": comparison.chi2[index],
            "dof": comparison.pairs,
            "probability": comparison.probability(index),
        })),
        "merged": is_compatible.then(|| json!({
            "gyros": gyros(&combined.parameters, &combined.calibrations, Some(&combined.covariance), &[]),
            "covariance": rows(&combined.covariance),
        })),
    })
}

/// A residual and its standard deviation.
pub(crate) fn residual((arcsec, sigma_arcsec): (f64, f64)) -> Value {
    json!({ "arcsec": arcsec, "sigma_arcsec": sigma_arcsec })
}

/// Excluded data with the reasons; `name` is the key of their names.
pub(crate) fn left_out(name: &str, left_out: &[ExcludedData]) -> Vec<Value> {
    let value = |own: &ExcludedData| {
        let gyro = own.gyro.map(Gyro::name);
        json!({ (name): own.name, "start_s": own.start_s, "gyro": gyro, "why": own.why })
    };
    left_out.iter().map(value).collect()
}

/// The rows of a matrix.
pub(crate) fn rows(matrix: &DMatrix<f64>) -> Vec<Vec<f64>> {
    matrix.row_iter().map(|row| row.iter().copied().collect()).collect()
}

/// A value for each parameter, by its index.
fn by_parameter(parameters: &[CalibrationParameter], value: &dyn Fn(usize) -> Value) -> Value {
    let all = parameters.iter().map(|parameter| (parameter.label(), value(parameter.position())));
    all.collect::<Map<_, _>>().into()
}

/// Values of each gyro, with their sigmas if there is a covariance; null for undetermined ones.
pub(crate) fn gyros(
    parameters: &[CalibrationParameter],
    calibrations: &[Calibration],
    covariance: Option<&DMatrix<f64>>,
    undetermined: &[bool],
) -> Value {
    // A number with the parameters that make it up and their shares.
    let number = |value: f64, parts: &[(CalibrationParameter, f64)]| {
        let is_open = parts.iter().any(|(own, _)| undetermined.get(own.position()).copied().unwrap_or(false));
        let product = |covariance: &DMatrix<f64>, (one, share): &(CalibrationParameter, f64)| -> f64 {
            let of = |(other, by): &(CalibrationParameter, f64)| by * covariance[(one.position(), other.position())];
            share * parts.iter().map(of).sum::<f64>()
        };
        let sigma = covariance
            .map(|covariance| parts.iter().map(|part| product(covariance, part)).sum::<f64>().max(0.0).sqrt());
        match (is_open, sigma) {
            (true, _) => json!({ "value": null, "sigma": null }),
            (false, Some(sigma)) => json!({ "value": value, "sigma": sigma }),
            (false, None) => json!({ "value": value }),
        }
    };
    let gyros = parameters.chunks(PER_GYRO).map(|own| {
        let calibration = &calibrations[own[0].gyro.index()];
        let alone = |index: usize| number(own[index].value(calibration), &[(own[index], 1.0)]);
        let projections = [calibration.x_arcsec, calibration.y_arcsec, calibration.z_arcsec];
        let misalignments = (0..3).filter_map(|axis| {
            let parts: Vec<_> =
                own[2..].iter().filter(|one| one.axis[axis] != 0.0).map(|one| (*one, one.axis[axis])).collect();
            (!parts.is_empty()).then(|| (AXES[axis].to_owned(), number(projections[axis], &parts)))
        });
        let values = json!({
            "scale_factor": alone(0),
            "drift_arcsec_per_half_s": alone(1),
            "misalignment_arcsec": misalignments.collect::<Map<_, _>>(),
        });
        (own[0].gyro.name().to_owned(), values)
    });
    gyros.collect::<Map<_, _>>().into()
}

/// Values of the parameters as `PATH = VALUE` for a configuration, to a thousandth of the best sigma that data can give.
pub fn overrides(
    parameters: impl IntoIterator<Item = CalibrationParameter>,
    calibrations: &[Calibration],
) -> Vec<String> {
    let mut lines = Vec::new();
    for parameter in parameters {
        let (gyro, digits) = (parameter.gyro, [11, 8, 5][parameter.index.min(2)]);
        for key in parameter.keys() {
            let number = Calibration::NUMBERS.iter().position(|own| own.name == key).unwrap_or_default();
            let value = calibrations[gyro.index()].value(number);
            let line = format!("gyro.{}.calibration.{key} = {value:.digits$}", gyro.name());
            // Both misalignments of a skewed head change all projections.
            if !lines.contains(&line) {
                lines.push(line);
            }
        }
    }
    lines
}

pub const NO_SIGMAS: Calibration =
    Calibration { scale_factor: 0.0, drift_arcsec_per_half_s: 0.0, x_arcsec: 0.0, y_arcsec: 0.0, z_arcsec: 0.0 };

/// A defect in the JSON of a calibration.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{field}: expected {expected}, got {got}")]
pub struct FieldError {
    pub field: String,
    pub expected: String,
    pub got: String,
}

/// A number of the JSON at a path of keys and indices joined by dots, within its limits.
fn number(json: &Value, field: &str, min: f64, max: f64, expected: &str) -> Result<f64, FieldError> {
    let found = json.pointer(&format!("/{}", field.replace('.', "/")));
    found.and_then(Value::as_f64).filter(|number| (min..=max).contains(number)).ok_or_else(|| FieldError {
        field: field.to_owned(),
        expected: expected.to_owned(),
        got: found.map_or_else(|| "nothing".to_owned(), Value::to_string),
    })
}

/// The values in the JSON that [`json()`] writes and the standard deviation of each, 0 if none is given.
///
/// # Errors
/// A missing value, or one out of the limits of a configuration.
pub fn calibrations(json: &Value) -> Result<([Calibration; 4], [Calibration; 4]), FieldError> {
    let (mut calibrations, mut sigmas) = ([Calibration::default(); 4], [NO_SIGMAS; 4]);
    for parameter in CalibrationParameter::all() {
        let gyro = parameter.gyro;
        let key = parameter.keys()[0];
        let path = match parameter.index {
            0 | 1 => format!("gyros.{}.{key}", gyro.name()),
            index => {
                format!("gyros.{}.misalignment_arcsec.{}", gyro.name(), AXES[off_axes(gyro)[index - 2]])
            }
        };
        let limits = Calibration::NUMBERS.iter().find(|limits| limits.name == key);
        let (min, max, expected) = limits
            .map_or((f64::MIN, f64::MAX, "a number".to_owned()), |limits| (limits.min, limits.max, limits.limits()));
        let value = number(json, &format!("{path}.value"), min, max, &expected)?;
        parameter.set(&mut calibrations[gyro.index()], value);
        if json.pointer(&format!("/{}/sigma", path.replace('.', "/"))).is_some() {
            let sigma = number(json, &format!("{path}.sigma"), 0.0, f64::MAX, "0 or more")?;
            parameter.set(&mut sigmas[gyro.index()], sigma);
        }
    }
    Ok((calibrations, sigmas))
}

/// Reads the calibration back from the JSON that [`json()`] writes, with its covariance, to be compared.
///
/// # Errors
/// A missing field, as in a manually written calibration, or a field that is no number or no covariance.
pub fn earlier(name: &str, json: &Value) -> Result<PreviousCalibration, FieldError> {
    let any = |field: &str, min: f64| number(json, field, min, f64::MAX, "a number");
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
            let min = if row == column { f64::MIN_POSITIVE } else { f64::MIN };
            let expected = if row == column { "a number more than 0" } else { "a number" };
            covariance[(row, column)] = number(json, &format!("covariance.{row}.{column}"), min, f64::MAX, expected)?;
        }
    }
    let solution = Solution {
        parameters: CalibrationParameter::all().collect(),
        calibrations: calibrations(json)?.0.to_vec(),
        undetermined: Vec::new(),
        timing: None,
        parity: Vec::new(),
        covariance,
        chi2: any("chi2.value", 0.0)?,
        degrees_of_freedom: any("chi2.dof", 0.0)? as usize,
        condition: any("condition", 0.0)?,
        leverage: Vec::new(),
        residuals: Vec::new(),
        trial_drifts: Vec::new(),
    };
    Ok(PreviousCalibration { name: name.to_owned(), time_s: any("time_s", f64::MIN)?, solution })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checkout::{AttitudeSourceKind, Precautions, before_checkout, sequence, simulate};

    #[test]
    fn written_json_is_read_back() {
        let checkout =
            sequence(&geu_model::Configuration::reference(), Precautions { stabilisation: false, ..Precautions::ALL });
        let calibrated =
            simulate(&checkout).calibrate(&before_checkout(&checkout), AttitudeSourceKind::Reference).unwrap();
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
        let error = earlier("first.json", &json).unwrap_err().to_string();
        assert_eq!(error, "covariance.3.3: expected a number more than 0, got -1.0");
        json["covariance"] = Value::Null;
        assert!(earlier("first.json", &json).unwrap_err().to_string().starts_with("covariance: expected the 16 × 16"));
    }
}
