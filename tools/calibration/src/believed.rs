//! What is believed of a unit: its sixteen parameters, how well they are known, and the noise of its gyros. Either a
//! configuration says so, or what `geu calibrate --json` wrote (cli.md).

use geu_model::Configuration;
use geu_model::configuration::ConfigurationError;
use geu_model::number::Numbers;
use geu_model::package::{Axes, Calibration};
use geu_protocol::Gyro;
use serde_json::Value;

/// Noise of one gyro.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Noise {
    /// Growth of the angle's deviation with the root of time.
    pub angle_arcsec_per_sqrt_s: f64,
    /// Growth of the drift rate's deviation with the root of time.
    pub drift_arcsec_per_s_per_sqrt_s: f64,
    /// Correlation time of the drift rate; inf is a pure walk.
    pub correlation_time_s: f64,
}

/// A calibration with all that a monitor of it must know. In the order of [`Gyro::ALL`].
#[derive(Debug, Clone, PartialEq)]
pub struct Believed {
    /// The sixteen.
    pub calibrations: [Calibration; 4],
    /// Standard deviation of each of them; 0 where none is told.
    pub sigmas: [Calibration; 4],
    /// Noise of the gyros.
    pub noises: [Noise; 4],
}

/// Why a text is no calibration.
#[derive(Debug, thiserror::Error)]
pub enum BelievedError {
    /// It is no configuration.
    #[error(transparent)]
    Configuration(#[from] ConfigurationError),
    /// It is no JSON.
    #[error("{name}: {source}; expected JSON as `geu calibrate --json` writes it")]
    Json {
        /// The file.
        name: String,
        /// What is wrong, and where.
        source: serde_json::Error,
    },
    /// A number is not there, or out of its limits.
    #[error("{name}: {field}: expected {expected}, got {got}")]
    Field {
        /// The file.
        name: String,
        /// Path of the number.
        field: String,
        /// What should stand there.
        expected: String,
        /// What stands there.
        got: String,
    },
    /// Overrides are paths of a configuration.
    #[error("{name}: --set: expected a configuration, got the JSON of a calibration, which has nothing to override")]
    Overrides {
        /// The file.
        name: String,
    },
}

impl From<&Configuration> for Believed {
    fn from(configuration: &Configuration) -> Believed {
        let gyros = &configuration.gyros;
        Believed {
            calibrations: std::array::from_fn(|gyro| gyros[gyro].calibration),
            sigmas: [NO_SIGMA; 4],
            noises: std::array::from_fn(|gyro| {
                let effects = &gyros[gyro].effects.constant;
                Noise {
                    angle_arcsec_per_sqrt_s: effects.angle_random_walk.arcsec_per_sqrt_s,
                    drift_arcsec_per_s_per_sqrt_s: effects.drift_random_walk.arcsec_per_s_per_sqrt_s,
                    correlation_time_s: effects.drift_random_walk.correlation_time_s,
                }
            }),
        }
    }
}

const NO_SIGMA: Calibration =
    Calibration { scale_factor: 0.0, drift_arcsec_per_half_s: 0.0, x_arcsec: 0.0, y_arcsec: 0.0, z_arcsec: 0.0 };

impl Believed {
    /// Reads a configuration or the JSON of a calibration, whichever the text is: only JSON begins with a brace. JSON tells
    /// no noise; the reference unit's is taken, which is the paper's (model.md).
    ///
    /// # Errors
    /// The first thing wrong, with its place.
    pub fn parse(name: &str, text: &str, overrides: &[String]) -> Result<Believed, BelievedError> {
        if !text.trim_start().starts_with('{') {
            return Ok(Believed::from(&Configuration::parse(name, text, overrides)?));
        }
        if !overrides.is_empty() {
            return Err(BelievedError::Overrides { name: name.to_owned() });
        }
        let json: Value =
            serde_json::from_str(text).map_err(|source| BelievedError::Json { name: name.to_owned(), source })?;
        let mut believed = Believed::from(&Configuration::reference());
        for gyro in Gyro::ALL {
            let (calibration, sigma) = (&mut believed.calibrations[gyro as usize], &mut believed.sigmas[gyro as usize]);
            for (index, spec) in Calibration::default().specs().iter().enumerate() {
                if !Axes::of(gyro).has_number(spec.name) {
                    continue;
                }
                let path = format!("gyros.{}.{}", gyro.name(), path_in_json(spec.name));
                let field = path.split('.').try_fold(&json, |node, key| node.get(key));
                let number = |key: &str, least: f64, greatest: f64, expected: String| {
                    let found = field.and_then(|field| field.get(key));
                    found.and_then(Value::as_f64).filter(|number| (least..=greatest).contains(number)).ok_or_else(
                        || BelievedError::Field {
                            name: name.to_owned(),
                            field: format!("{path}.{key}"),
                            expected,
                            got: found.map_or_else(|| "nothing".to_owned(), Value::to_string),
                        },
                    )
                };
                *calibration.value_mut(index) = number("value", spec.least, spec.greatest, spec.limits())?;
                if field.is_some_and(|field| field.get("sigma").is_some()) {
                    *sigma.value_mut(index) = number("sigma", 0.0, f64::MAX, "0 or more".to_owned())?;
                }
            }
        }
        Ok(believed)
    }
}

/// Where the JSON of a calibration has the number that a configuration calls so.
fn path_in_json(name: &str) -> &str {
    match name {
        "x_arcsec" => "misalignment_arcsec.x",
        "y_arcsec" => "misalignment_arcsec.y",
        "z_arcsec" => "misalignment_arcsec.z",
        name => name,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn json() -> String {
        let gyro = |name: &str, axes: [&str; 2]| {
            let [a, b] = axes.map(|axis| format!(r#""{axis}": {{"value": 20.5, "sigma": 0.5}}"#));
            format!(
                r#""{name}": {{"scale_factor": {{"value": 1.001, "sigma": 2e-6}},
                "drift_arcsec_per_half_s": {{"value": -0.1}}, "misalignment_arcsec": {{{a}, {b}}}}}"#
            )
        };
        let [x, y] = [gyro("GYRX", ["y", "z"]), gyro("GYRY", ["x", "z"])];
        let [za, zb] = ["GYRZA", "GYRZB"].map(|name| gyro(name, ["x", "y"]));
        format!(r#"{{"gyros": {{{x}, {y}, {za}, {zb}}}, "chi2": {{"value": 7.0, "dof": 8}}}}"#)
    }

    #[test]
    fn a_configuration_and_the_json_of_a_calibration_are_told_by_their_content() {
        let believed = Believed::parse("unit.toml", Configuration::reference_text(), &[]).unwrap();
        assert_eq!(believed.calibrations[3].drift_arcsec_per_half_s, -0.305);
        assert_eq!(believed.sigmas, [NO_SIGMA; 4]);
        let believed = Believed::parse("solved.json", &json(), &[]).unwrap();
        let expected = Calibration { scale_factor: 1.001, drift_arcsec_per_half_s: -0.1, ..NO_SIGMA };
        assert_eq!(believed.calibrations[1], Calibration { x_arcsec: 20.5, z_arcsec: 20.5, ..expected });
        assert_eq!(believed.sigmas[1], Calibration { scale_factor: 2e-6, x_arcsec: 0.5, z_arcsec: 0.5, ..NO_SIGMA });
        assert_eq!(believed.noises[0].angle_arcsec_per_sqrt_s, 0.01);
    }

    #[test]
    fn what_is_wrong_is_told_with_its_place() {
        let told = |text: &str| Believed::parse("solved.json", text, &[]).unwrap_err().to_string();
        let without = json().replace("\"GYRZB\"", "\"GYRZC\"");
        let expected = "solved.json: gyros.GYRZB.scale_factor.value: expected a number within 0.5…2, got nothing";
        assert_eq!(told(&without), expected);
        assert!(told(&json().replacen("-0.1", "\"low\"", 1)).contains("got \"low\""));
        assert!(told("{\"gyros\": ").contains("line 1"));
        let overridden = Believed::parse("solved.json", &json(), &["seed=1".to_owned()]);
        assert!(matches!(overridden, Err(BelievedError::Overrides { .. })));
    }
}
