//! Constants and conversions. Angles arcsec, time s, temperature °C, relative errors ppm.

use std::f64::consts::PI;

pub const ARCSEC_PER_RAD: f64 = 648_000.0 / PI;
pub const ARCSEC_PER_DEG: f64 = 3600.0;
pub const RAD_PER_DEG: f64 = PI / 180.0;
pub const S_PER_DAY: f64 = 86_400.0;
pub const S_PER_H: f64 = 3600.0;
/// Nominal length of a sample, on-board time.
pub const SAMPLE_INTERVAL_S: f64 = 0.5;
/// In ns.
pub const SAMPLE_INTERVAL_NS: i64 = 500_000_000;
/// Full scale of the rate: 12 arcmin/s (Casteren §5).
pub const FULL_SCALE_ARCSEC_S: f64 = 720.0;
/// A relative error of 1 ppm.
pub const PPM: f64 = 1e-6;
/// Rate of the sun as seen from the earth, rad/s: 360° per 365.25 d, constant (Casteren §6).
pub const SUN_RATE_RAD_S: f64 = 2.0 * PI / (365.25 * S_PER_DAY);
/// One orbit, s; ψ' at orbital speed is 360° in this time.
pub const ORBIT_S: f64 = 6180.0;

/// Names of units, with the size of one.
pub type NamedUnits = &'static [(&'static str, f64)];
/// Units of rates, arcsec/s.
pub const RATE_UNITS: NamedUnits = &[
    ("deg/s", ARCSEC_PER_DEG),
    ("rad/s", ARCSEC_PER_RAD),
    ("mrad/s", ARCSEC_PER_RAD * 1e-3),
    ("arcsec/s", 1.0),
    ("deg/h", ARCSEC_PER_DEG / S_PER_H),
];
/// Units of angles, arcsec.
pub const ANGLE_UNITS: NamedUnits =
    &[("arcsec", 1.0), ("deg", ARCSEC_PER_DEG), ("rad", ARCSEC_PER_RAD), ("mrad", ARCSEC_PER_RAD * 1e-3)];

/// The unit of angles in results, and with it of rates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AngleUnit {
    pub name: &'static str,
    /// Size of one, arcsec.
    pub arcsec: f64,
}

impl AngleUnit {
    /// The unit of this name; arcsec if none has it.
    pub fn from_name(name: &str) -> AngleUnit {
        let (name, arcsec) = ANGLE_UNITS.iter().find(|(own, _)| *own == name).unwrap_or(&ANGLE_UNITS[0]);
        AngleUnit { name, arcsec: *arcsec }
    }

    /// A unit such as `arcsec/h` with this angle in place of arcsec, and its size; other units, and ratios of angles, as they are.
    pub fn converted(self, unit: &str) -> (f64, String) {
        match unit.strip_prefix("arcsec").filter(|rest| !rest.contains("arcsec") && !rest.contains('°')) {
            Some(rest) => (self.arcsec, format!("{}{rest}", self.name)),
            None => (1.0, unit.to_owned()),
        }
    }

    /// A number of arcsec in this unit, rounded no coarser than to these decimals of an arcsec.
    pub fn fixed(self, arcsec: f64, decimals: usize) -> String {
        format!("{:.1$}", arcsec / self.arcsec, self.decimals(decimals))
    }

    /// Decimals of this unit for decimals of an arcsec.
    pub fn decimals(self, of_arcsec: usize) -> usize {
        of_arcsec + self.arcsec.log10().ceil() as usize
    }
}

/// Units of time, s.
pub const TIME_UNITS: NamedUnits = &[("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9)];

/// On-board time at which a sample begins, since the start of the first, s.
pub fn on_board_s(sample: u64) -> f64 {
    sample as f64 * SAMPLE_INTERVAL_S
}

/// Suffixes of a duration, with their length in s; a number without one is seconds.
const DURATION_UNITS: [(char, f64); 4] = [('s', 1.0), ('m', 60.0), ('h', 3600.0), ('d', S_PER_DAY)];

/// A duration as a person writes it, s: `90`, `90s`, `10m`, `2h`, `1.5d`.
///
/// # Errors
/// An invalid duration, or one outside `min`…`max` seconds.
///
/// ```
/// use geu_model::units::duration_s;
/// assert_eq!(duration_s("10m", 0.0, 1e10), Ok(600.0));
/// assert_eq!(duration_s("90", 0.0, 60.0), Err("expected a duration of 0 to 60 seconds (90, 90s, 10m, 2h, 1d), got 90".to_owned()));
/// ```
pub fn duration_s(text: &str, min: f64, max: f64) -> Result<f64, String> {
    let unit = DURATION_UNITS.into_iter().find(|(suffix, _)| text.ends_with(*suffix));
    let (digits, unit_s) = unit.map_or((text, 1.0), |(suffix, unit_s)| (text.trim_end_matches(suffix), unit_s));
    // Not `inf`, not `nan`, and not `1ss`.
    let is_number =
        text.len() - digits.len() <= 1 && digits.ends_with(|last: char| last.is_ascii_digit() || last == '.');
    let seconds = digits.parse::<f64>().ok().filter(|_| is_number).map(|number| number * unit_s);
    seconds
        .filter(|seconds| (min..=max).contains(seconds))
        .ok_or_else(|| format!("expected a duration of {min} to {max} seconds (90, 90s, 10m, 2h, 1d), got {text}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_unit_of_angles_replaces_arcsec() {
        let deg = AngleUnit::from_name("deg");
        assert_eq!(deg.converted("arcsec/h"), (3600.0, "deg/h".to_owned()));
        for unit in ["ppm", "", "arcsec/(arcsec/s)^2", "arcsec/°"] {
            assert_eq!(deg.converted(unit), (1.0, unit.to_owned()));
        }
        assert_eq!(deg.fixed(1800.0, 2), "0.500000");
        assert_eq!(AngleUnit::from_name("arcsec").fixed(-1.0, 2), "-1.00");
    }

    #[test]
    fn a_duration_is_seconds_or_has_its_unit() {
        for (text, seconds) in [
            ("90", 90.0),
            ("90s", 90.0),
            ("10m", 600.0),
            ("2h", 7200.0),
            ("1d", 86_400.0),
            ("0.5", 0.5),
            ("1e3s", 1e3),
            ("1.5h", 5400.0),
        ] {
            assert_eq!(duration_s(text, 0.0, 1e10), Ok(seconds), "{text}");
        }
        for wrong in ["", "s", "m10", "10 m", "1ss", "1hm", "inf", "nan", "-1", "1e11", "1e9d", "ten", "1e400", "h"] {
            assert!(duration_s(wrong, 0.0, 1e10).is_err(), "{wrong}");
        }
    }
}
