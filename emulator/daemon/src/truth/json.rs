//! JSON lines: `{"t_s": 12.5, "q": [w, x, y, z], "sun": [x, y, z]}` or `{"t_s": 12.5, "rate_arcsec_s": [x, y, z]}`.
//!
//! Keys that are not known are ignored, so that a simulator may send what it has anyway. Where both are told the attitude
//! counts.

use serde_json::Value;

use super::synchroniser::{MotionValue, TruthSample};

/// A quaternion or a direction whose length is 1 by less than this was meant to be one; it is made so.
const LENGTH_TOLERANCE: f64 = 1e-3;
/// What a source can subscribe to.
const SAMPLES: &str = "samples";
/// Beyond so much it is no time, s.
const MOST_S: f64 = 1e12;

/// What a line tells.
#[derive(Debug)]
pub(super) struct Line {
    /// Nothing of a line that only asks.
    pub sample: Option<TruthSample>,
    /// It asks for reports of what left in each sample interval: `"subscribe": "samples"`.
    pub subscribes: bool,
}

/// Reads one line.
///
/// # Errors
/// What was expected, and what stands there.
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
    let t_s = json["t_s"].as_f64().filter(|t_s| t_s.abs() <= MOST_S);
    let t_s = t_s.ok_or_else(|| format!("t_s: expected seconds within ±{MOST_S:e}, got {}", json["t_s"]))?;
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

/// The same of unit length, where it is that but for rounding.
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
    fn a_line_may_ask_for_reports_with_a_sample_or_without() {
        let asks = |text: &str| {
            let line = line(text).expect(text);
            (line.subscribes, line.sample.is_some())
        };
        assert_eq!(asks(r#"{"subscribe": "samples"}"#), (true, false));
        assert_eq!(asks(r#"{"subscribe": "samples", "t_s": 1, "q": [1, 0, 0, 0]}"#), (true, true));
        assert_eq!(asks(r#"{"t_s": 1, "q": [1, 0, 0, 0]}"#), (false, true));
    }

    #[test]
    fn what_cannot_be_read_says_what_was_expected() {
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
