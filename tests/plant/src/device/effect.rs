//! Injected effects of a described unit, by the codes of the model's page, and some of its wiring and link.

/// Codes with their parameters; the unit's own ones have no head.
const CODES: [(&str, &[&str]); 16] = [
    ("drift-step", &["arcsec_per_h", "time_s"]),
    ("drift-temperature", &["arcsec_per_h_per_k"]),
    ("scale-factor", &["ppm"]),
    ("scale-factor-step", &["ppm", "time_s"]),
    ("scale-factor-asymmetry", &["ppm"]),
    // The input axis turned by an angle; the azimuth is that of its shift about the nominal axis.
    ("misalignment", &["arcsec", "azimuth_deg"]),
    ("sensor-lag", &["time_constant_s"]),
    ("clock-frequency", &["ppm"]),
    ("time-offset", &["seconds"]),
    // Repeats the number before.
    ("stuck-output", &["time_s", "duration_s"]),
    // Sends no motion and no noise.
    ("dead-output", &["time_s", "duration_s"]),
    ("sign-inversion", &["on"]),
    // Two heads.
    ("axis-swap", &["on"]),
    ("unit-factor", &["factor"]),
    ("clipping", &["arcsec_s"]),
    ("lost-samples", &["share"]),
];

/// An effect: a code and its numbers by name.
#[derive(Debug, Clone, PartialEq)]
pub struct DeviceEffect {
    /// Name of the effect.
    pub code: String,
    /// Index of each affected head; empty for all.
    pub heads: Vec<usize>,
    /// Numbers.
    pub parameters: Vec<(String, f64)>,
}

impl DeviceEffect {
    /// # Errors
    /// The code or parameter that does not exist.
    pub fn new(code: &str, heads: &[usize], parameters: &[(&str, f64)]) -> Result<DeviceEffect, String> {
        let known = CODES.iter().find(|(known, _)| *known == code).ok_or_else(|| format!("{code}: no such effect"))?;
        if let Some((name, _)) = parameters.iter().find(|(name, _)| !known.1.contains(name)) {
            return Err(format!("{code}: no parameter {name}, expected {}", known.1.join(", ")));
        }
        let parameters = parameters.iter().map(|(name, value)| ((*name).to_owned(), *value)).collect();
        Ok(DeviceEffect { code: code.to_owned(), heads: heads.to_vec(), parameters })
    }

    fn value(&self, name: &str) -> f64 {
        self.parameters.iter().find(|(own, _)| own == name).map_or(0.0, |(_, value)| *value)
    }
}

/// Value of a parameter on a head, 0 without the effect.
pub fn value(effects: &[DeviceEffect], head: usize, code: &str, parameter: &str) -> f64 {
    let own = effects.iter().filter(|effect| effect.code == code);
    own.filter(|effect| effect.heads.is_empty() || effect.heads.contains(&head))
        .map(|effect| effect.value(parameter))
        .sum()
}
