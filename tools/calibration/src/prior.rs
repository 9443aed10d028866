//! The prior calibration of a unit: its parameters, their sigmas, and the noise of its gyros, from a configuration or from
//! the JSON of `geu calibrate --json`.

use geu_model::Configuration;
use geu_model::configuration::ConfigurationError;
use geu_model::device::Device;
use geu_model::package::Calibration;
use serde_json::Value;

use crate::noise::RandomWalks;
use crate::report::{self, FieldError, NO_SIGMAS};

/// A calibration with sigmas and noise. In the order of [`geu_protocol::Gyro::ALL`].
#[derive(Debug, Clone, PartialEq)]
pub struct PriorCalibration {
    pub calibrations: [Calibration; 4],
    /// Standard deviation of each of them; 0 if none is given.
    pub sigmas: [Calibration; 4],
    pub walks: [RandomWalks; 4],
}

/// Why a text is no calibration.
#[derive(Debug, thiserror::Error)]
pub enum PriorError {
    #[error(transparent)]
    Configuration(#[from] ConfigurationError),
    #[error("{name}: {source}; expected JSON as `geu calibrate --json` writes it")]
    Json { name: String, source: serde_json::Error },
    /// A number is missing or out of its limits.
    #[error("{name}: {source}")]
    Field { name: String, source: FieldError },
    /// Overrides apply to a configuration only.
    #[error("{name}: --set: expected a configuration, got the JSON of a calibration, which has nothing to override")]
    Overrides { name: String },
}

impl From<&Configuration> for PriorCalibration {
    fn from(configuration: &Configuration) -> PriorCalibration {
        PriorCalibration {
            calibrations: configuration.calibrations(),
            sigmas: [NO_SIGMAS; 4],
            walks: RandomWalks::configured(configuration),
        }
    }
}

impl PriorCalibration {
    /// Reads a configuration or the JSON of a calibration, by the text: only JSON begins with a brace. JSON has no
    /// noise, so that of the reference unit is used, which is the paper's.
    ///
    /// # Errors
    /// The first defect, with its location.
    pub fn parse(name: &str, text: &str, overrides: &[String]) -> Result<PriorCalibration, PriorError> {
        if !text.trim_start().starts_with('{') {
            return Ok(PriorCalibration::from(&Configuration::parse_for(
                Some(&Device::iras()),
                name,
                text,
                overrides,
            )?));
        }
        if !overrides.is_empty() {
            return Err(PriorError::Overrides { name: name.to_owned() });
        }
        let json: Value =
            serde_json::from_str(text).map_err(|source| PriorError::Json { name: name.to_owned(), source })?;
        let (calibrations, sigmas) =
            report::calibrations(&json).map_err(|source| PriorError::Field { name: name.to_owned(), source })?;
        Ok(PriorCalibration { calibrations, sigmas, walks: RandomWalks::configured(&Configuration::reference()) })
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
    fn a_configuration_and_the_json_of_a_calibration_are_distinguished_by_content() {
        let prior = PriorCalibration::parse("unit.toml", Configuration::reference_text(), &[]).unwrap();
        assert_eq!(prior.calibrations[3].drift_arcsec_per_half_s, -0.305);
        assert_eq!(prior.sigmas, [NO_SIGMAS; 4]);
        let prior = PriorCalibration::parse("solved.json", &json(), &[]).unwrap();
        let expected = Calibration { scale_factor: 1.001, drift_arcsec_per_half_s: -0.1, ..NO_SIGMAS };
        assert_eq!(prior.calibrations[1], Calibration { x_arcsec: 20.5, z_arcsec: 20.5, ..expected });
        assert_eq!(prior.sigmas[1], Calibration { scale_factor: 2e-6, x_arcsec: 0.5, z_arcsec: 0.5, ..NO_SIGMAS });
        assert_eq!(prior.walks[0].angle_arcsec_per_sqrt_s, 0.01);
    }

    #[test]
    fn a_defect_is_reported_with_its_location() {
        let error = |text: &str| PriorCalibration::parse("solved.json", text, &[]).unwrap_err().to_string();
        let without = json().replace("\"GYRZB\"", "\"GYRZC\"");
        let expected = "solved.json: gyros.GYRZB.scale_factor.value: expected a number within 0.5…2, got nothing";
        assert_eq!(error(&without), expected);
        assert!(error(&json().replacen("-0.1", "\"low\"", 1)).contains("got \"low\""));
        assert!(error("{\"gyros\": ").contains("line 1"));
        let overridden = PriorCalibration::parse("solved.json", &json(), &["seed=1".to_owned()]);
        assert!(matches!(overridden, Err(PriorError::Overrides { .. })));
    }
}
