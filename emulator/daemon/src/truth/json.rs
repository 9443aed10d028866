//! JSON lines: `{"t_s": 12.5, "q": [w, x, y, z]}` or `{"t_s": 12.5, "rate_arcsec_s": [x, y, z]}`.
//!
//! Keys that are not known are ignored, so that a simulator may send what it has anyway. Where both are told the attitude
//! counts.

use serde_json::Value;

use super::follow::{Sample, Told};

/// A quaternion whose length is 1 by less than this was meant to be one; it is made so.
const LENGTH_TOLERANCE: f64 = 1e-3;
/// Beyond so much it is no time, s.
const MOST_S: f64 = 1e12;

/// Reads one line.
///
/// # Errors
/// What was expected, and what stands there.
pub(super) fn sample(line: &str) -> Result<Sample, String> {
    let json: Value = serde_json::from_str(line).map_err(|error| format!("expected JSON, got: {error}"))?;
    let t_s = json["t_s"].as_f64().filter(|t_s| t_s.abs() <= MOST_S);
    let t_s = t_s.ok_or_else(|| format!("t_s: expected seconds within ±{MOST_S:e}, got {}", json["t_s"]))?;
    let motion = match (&json["q"], &json["rate_arcsec_s"]) {
        (Value::Null, Value::Null) => return Err("expected q or rate_arcsec_s, got neither".to_owned()),
        (Value::Null, rate) => {
            let rate = numbers(rate).ok_or_else(|| format!("rate_arcsec_s: expected [x, y, z], got {rate}"))?;
            Told::Rate(rate)
        }
        (q, _) => {
            let unit = numbers(q).and_then(unit_quaternion);
            Told::Attitude(unit.ok_or_else(|| format!("q: expected [w, x, y, z] of length 1, got {q}"))?)
        }
    };
    Ok(Sample { t_s, motion })
}

fn numbers<const COUNT: usize>(json: &Value) -> Option<[f64; COUNT]> {
    let numbers: Vec<f64> = json.as_array()?.iter().map(Value::as_f64).collect::<Option<_>>()?;
    numbers.try_into().ok()
}

/// A quaternion of unit length, where it is one but for rounding.
pub(super) fn unit_quaternion(parts: [f64; 4]) -> Option<[f64; 4]> {
    let length = parts.iter().map(|part| part * part).sum::<f64>().sqrt();
    ((length - 1.0).abs() <= LENGTH_TOLERANCE).then(|| parts.map(|part| part / length))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn attitudes_and_rates_are_read_and_other_keys_ignored() {
        let read = |line: &str| sample(line).expect(line);
        let q = read(r#"{"t_s": 12.5, "q": [0.6, 0, 0.8, 0], "torque": {"x": 1}}"#);
        assert_eq!(q, Sample { t_s: 12.5, motion: Told::Attitude([0.6, 0.0, 0.8, 0.0]) });
        let rate = read(r#" {"rate_arcsec_s":[1,-2.5,3e1],"t_s":-1} "#);
        assert_eq!(rate, Sample { t_s: -1.0, motion: Told::Rate([1.0, -2.5, 30.0]) });
    }

    #[test]
    fn what_cannot_be_read_says_what_was_expected() {
        for (line, part) in [
            ("", "expected JSON"),
            ("\u{1}\u{2}", "expected JSON"),
            ("[1,2]", "t_s: expected seconds"),
            (r#"{"q":[1,0,0,0]}"#, "t_s: expected seconds within ±1e12, got null"),
            (r#"{"t_s":1e300,"q":[1,0,0,0]}"#, "t_s: expected seconds"),
            (r#"{"t_s":1}"#, "expected q or rate_arcsec_s, got neither"),
            (r#"{"t_s":1,"q":[1,0,0]}"#, "q: expected [w, x, y, z] of length 1, got [1,0,0]"),
            (r#"{"t_s":1,"q":[2,0,0,0]}"#, "of length 1"),
            (r#"{"t_s":1,"rate_arcsec_s":"fast"}"#, "rate_arcsec_s: expected [x, y, z], got \"fast\""),
            (r#"{"t_s":1,"rate_arcsec_s":[1,2,null]}"#, "rate_arcsec_s: expected"),
        ] {
            let message = sample(line).expect_err(line);
            assert!(message.contains(part), "{part} not in {message}");
        }
    }
}
