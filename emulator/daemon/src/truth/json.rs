//! JSON lines: `{"t_s": 12.5, "q": [w, x, y, z], "sun": [x, y, z]}` or `{"t_s": 12.5, "rate_arcsec_s": [x, y, z]}`.
//!
//! Unknown keys are ignored, so that a simulator can send its own lines. If a line has both, the attitude is used.

use serde_json::Value;

use super::synchroniser::{MotionValue, TruthSample};

/// Tolerance of the length of quaternions and directions; within it they are normalised.
const LENGTH_TOLERANCE: f64 = 1e-3;
/// Value of `subscribe`.
const SAMPLES: &str = "samples";
/// Maximum absolute time, s.
const MAX_TIME_S: f64 = 1e12;

/// Content of a line.
#[derive(Debug)]
pub(super) struct Line {
    /// `None` in a line that only subscribes.
    pub sample: Option<TruthSample>,
    /// Requests a report of each sample interval: `"subscribe": "samples"`.
    pub subscribes: bool,
}

/// Reads one line.
///
/// # Errors
/// The expected and the given value.
pub(super) fn line(text: &str) -> Result<Line, String> {
    let json: Value = serde_json::from_str(text).map_err(|error| format!("expected JSON, got: {error}"))?;
    let subscribes = match &json["subscribe"] {
        Value::Null => false,
        Value::String(what) if what == SAMPLES => true,
        other => return Err(format!("subscribe: expected {SAMPLES:?}, got {other}")),
    };
    let sample = if subscribes && json["t_s"].is_null() { None } else { Some(sample(&json)?) };
    Ok(Line { sample, subscribes })
}

fn sample(json: &Value) -> Result<TruthSample, String> {
    let t_s = json["t_s"].as_f64().filter(|t_s| t_s.abs() <= MAX_TIME_S);
    let t_s = t_s.ok_or_else(|| format!("t_s: expected seconds within ±{MAX_TIME_S:e}, got {}", json["t_s"]))?;
    let motion = match (&json["q"], &json["rate_arcsec_s"]) {
        (Value::Null, Value::Null) => return Err("expected q or rate_arcsec_s, got neither".to_owned()),
        (Value::Null, rate) => {
            let rate = numbers(rate).ok_or_else(|| format!("rate_arcsec_s: expected [x, y, z], got {rate}"))?;
            MotionValue::Rate(rate)
        }
        (q, _) => {
            let unit = numbers(q).and_then(unit);
            MotionValue::Attitude(unit.ok_or_else(|| format!("q: expected [w, x, y, z] of length 1, got {q}"))?)
        }
    };
    let sun = match (&json["sun"], motion) {
        (Value::Null, _) => None,
        (sun, MotionValue::Rate(_)) => return Err(format!("sun: expected q beside it, got sun {sun} without")),
        (sun, MotionValue::Attitude(_)) => {
            let direction = numbers(sun).and_then(unit);
            Some(direction.ok_or_else(|| format!("sun: expected [x, y, z] of length 1, got {sun}"))?)
        }
    };
    Ok(TruthSample { t_s, motion, sun })
}

fn numbers<const COUNT: usize>(json: &Value) -> Option<[f64; COUNT]> {
    let numbers: Vec<f64> = json.as_array()?.iter().map(Value::as_f64).collect::<Option<_>>()?;
    numbers.try_into().ok()
}

/// Normalises a vector of unit length within [`LENGTH_TOLERANCE`]; `None` for others.
pub(super) fn unit<const COUNT: usize>(parts: [f64; COUNT]) -> Option<[f64; COUNT]> {
    let length = parts.iter().map(|part| part * part).sum::<f64>().sqrt();
    ((length - 1.0).abs() <= LENGTH_TOLERANCE).then(|| parts.map(|part| part / length))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn attitudes_and_rates_are_read_and_other_keys_ignored() {
        let read = |text: &str| line(text).expect(text).sample.expect(text);
        let q = read(r#"{"t_s": 12.5, "q": [0.6, 0, 0.8, 0], "torque": {"x": 1}}"#);
        assert_eq!(q, TruthSample { t_s: 12.5, motion: MotionValue::Attitude([0.6, 0.0, 0.8, 0.0]), sun: None });
        let sun = read(r#"{"t_s": 12.5, "q": [1, 0, 0, 0], "sun": [0, 0.6, 0.8001]}"#).sun.expect("a sun");
        assert!((sun[1] - 0.6).abs() < 1e-4 && (sun[1] * sun[1] + sun[2] * sun[2] - 1.0).abs() < 1e-12, "{sun:?}");
        let rate = read(r#" {"rate_arcsec_s":[1,-2.5,3e1],"t_s":-1} "#);
        assert_eq!(rate, TruthSample { t_s: -1.0, motion: MotionValue::Rate([1.0, -2.5, 30.0]), sun: None });
    }

    #[test]
    fn a_line_subscribes_with_or_without_a_sample() {
        let parsed = |text: &str| {
            let line = line(text).expect(text);
            (line.subscribes, line.sample.is_some())
        };
        assert_eq!(parsed(r#"{"subscribe": "samples"}"#), (true, false));
        assert_eq!(parsed(r#"{"subscribe": "samples", "t_s": 1, "q": [1, 0, 0, 0]}"#), (true, true));
        assert_eq!(parsed(r#"{"t_s": 1, "q": [1, 0, 0, 0]}"#), (false, true));
    }

    #[test]
    fn errors_state_the_expected_value() {
        for (text, part) in [
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
            (r#"{"subscribe":"all"}"#, "subscribe: expected \"samples\", got \"all\""),
            (r#"{"t_s":1,"q":[1,0,0,0],"sun":[1,1,0]}"#, "sun: expected [x, y, z] of length 1, got [1,1,0]"),
            (r#"{"t_s":1,"q":[1,0,0,0],"sun":[1,0]}"#, "sun: expected [x, y, z] of length 1, got [1,0]"),
            (r#"{"t_s":1,"q":[1,0,0,0],"sun":[1e999,0,0]}"#, "expected JSON, got"),
            (r#"{"t_s":1,"rate_arcsec_s":[0,0,0],"sun":[1,0,0]}"#, "sun: expected q beside it"),
        ] {
            let message = line(text).expect_err(text);
            assert!(message.contains(part), "{part} not in {message}");
        }
    }
}
