//! A calibration as JSON (cli.md), as values for a configuration, and read back.

use geu_model::package::Calibration;
use geu_protocol::Gyro;
use serde_json::{Map, Value, json};

use crate::calibrate::Calibrated;
use crate::solve::{PER_GYRO, Parameter, UNKNOWNS, off_axes};

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
        let [first, second] = off_axes(gyro).map(|axis| ["x", "y", "z"][axis]);
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

/// Reads the values and sigmas back from the JSON that [`json`] writes.
///
/// # Errors
/// The path of what is missing or no number.
pub fn parse(value: &Value) -> Result<([Calibration; 4], [f64; UNKNOWNS]), String> {
    let mut calibrations: [Calibration; 4] = Default::default();
    let mut sigmas = [0.0; UNKNOWNS];
    for (index, parameter) in Parameter::all().enumerate() {
        let gyro = parameter.gyro.name();
        let path = match parameter.index {
            0 | 1 => format!("/gyros/{gyro}/{}", parameter.key()),
            _ => {
                let axis = ["x", "y", "z"][off_axes(parameter.gyro)[parameter.index - 2]];
                format!("/gyros/{gyro}/misalignment_arcsec/{axis}")
            }
        };
        let number = |name: &str| {
            let number = value.pointer(&format!("{path}/{name}")).and_then(Value::as_f64);
            number.ok_or_else(|| format!("{path}/{name}: expected a number"))
        };
        *parameter.of_mut(&mut calibrations[parameter.gyro as usize]) = number("value")?;
        sigmas[index] = number("sigma")?;
    }
    Ok((calibrations, sigmas))
}
