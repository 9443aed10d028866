//! The socket text of 42, NASA's spacecraft simulation: `TIME`, variables of all kinds, and `[ENDMSG]` or `[EOF]`.
//!
//! Versions differ: numbers are in brackets or not, and the attitude is `SC[0].B[0].qn` (of the main body),
//! `SC[0].qn`, or only `SC[0].AC.qbn` (estimated on board). The first of these in a message is used, everything else is
//! ignored. The quaternions of 42 have their real part last and rotate body to inertial, as ours; its rates are not used:
//! gyro rates are one step older than the attitude in the same message.

use super::json::unit;
use super::synchroniser::{MotionValue, TruthSample};

/// Names of the attitude in order of preference.
const ATTITUDES: [&str; 3] = ["SC[0].B[0].qn", "SC[0].qn", "SC[0].AC.qbn"];
/// Last line of a message, by version.
const ENDS: [&str; 2] = ["[ENDMSG]", "[EOF]"];

/// The part of a message that has been read.
#[derive(Debug, Default)]
pub(super) struct Message {
    t_s: Option<f64>,
    /// In the order of [`ATTITUDES`].
    attitudes: [Option<[f64; 4]>; ATTITUDES.len()],
    /// The first error in it.
    error: Option<String>,
}

impl Message {
    /// Adds a line; at the end of a message, returns its sample or error.
    pub fn line(&mut self, line: &str) -> Option<Result<TruthSample, String>> {
        let line = line.trim();
        if ENDS.contains(&line) {
            return Some(std::mem::take(self).end());
        }
        if let Some(stamp) = line.strip_prefix("TIME ") {
            self.t_s = seconds(stamp.trim());
            if self.t_s.is_none() {
                self.note(format!("TIME: expected year-day-hh:mm:ss, got {stamp:?}"));
            }
        } else if let Some((name, value)) = line.split_once('=')
            && let Some(rank) = ATTITUDES.iter().position(|attitude| *attitude == name.trim())
        {
            self.attitudes[rank] = quaternion(value);
            if self.attitudes[rank].is_none() {
                self.note(format!("{}: expected x y z w of length 1, got {value:?}", name.trim()));
            }
        }
        None
    }

    fn note(&mut self, error: String) {
        self.error.get_or_insert(error);
    }

    fn end(self) -> Result<TruthSample, String> {
        match (self.error, self.t_s, self.attitudes.into_iter().flatten().next()) {
            (Some(error), ..) => Err(error),
            (None, Some(t_s), Some(attitude)) => {
                Ok(TruthSample { t_s, motion: MotionValue::Attitude(attitude), sun: None })
            }
            (None, None, _) => Err("expected a message that begins with TIME, got one without".to_owned()),
            (None, _, None) => {
                Err(format!("expected a message with one of {}, got a message without", ATTITUDES.join(", ")))
            }
        }
    }
}

/// Four numbers, in brackets or not, the real part last.
fn quaternion(text: &str) -> Option<[f64; 4]> {
    let numbers = text.split(|c: char| c.is_whitespace() || "[],".contains(c)).filter(|part| !part.is_empty());
    let numbers: Vec<f64> = numbers.map(|part| part.parse().ok()).collect::<Option<_>>()?;
    let [x, y, z, w] = numbers.try_into().ok()?;
    unit([w, x, y, z])
}

/// Seconds since the year 2000 of `2026-130-12:00:00.000000000`: year, day of the year, time of day.
fn seconds(stamp: &str) -> Option<f64> {
    let mut parts = stamp.splitn(3, '-');
    let year: i64 = parts.next()?.parse().ok().filter(|year| (1..=9999).contains(year))?;
    let day: i64 = parts.next()?.parse().ok().filter(|day| (1..=366).contains(day))?;
    let mut clock = parts.next()?.splitn(3, ':');
    let hour: i64 = clock.next()?.parse().ok().filter(|hour| (0..24).contains(hour))?;
    let minute: i64 = clock.next()?.parse().ok().filter(|minute| (0..60).contains(minute))?;
    // Rounding may yield 60 s.
    let second: f64 = clock.next()?.parse().ok().filter(|second| (0.0..62.0).contains(second))?;
    let leap_days = |year: i64| (year - 1) / 4 - (year - 1) / 100 + (year - 1) / 400;
    let days = (year - 2000) * 365 + leap_days(year) - leap_days(2000) + day - 1;
    Some((((days * 24) + hour) * 60 + minute) as f64 * 60.0 + second)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn last(text: &str) -> Option<Result<TruthSample, String>> {
        let mut message = Message::default();
        text.lines().filter_map(|line| message.line(line)).last()
    }

    #[test]
    fn all_layouts_give_the_same_attitude() {
        let plain = "TIME 2026-130-12:00:00.000000000\nOrb[0].PosN =  6.7e+06 0 0\nSC[0].AC.qbn = 1 0 0 0\nSC[0].B[0].wn =  1.0e-03 2.0e-03 3.0e-03\nSC[0].B[0].qn =  0.000000000000e+00  6.000000000000e-01  0.000000000000e+00  8.000000000000e-01\nSC[0].B[1].qn = 1 0 0 0\n[ENDMSG]\n";
        let bracketed = "TIME 2026-130-12:00:00.000000000\r\nSC[0].svb = [1 0 0]\r\nSC[0].qn = [ 0.0e+00  6.0e-01  0.0e+00  8.0e-01]\r\nSC[1].qn = [1 0 0 0]\r\n[ENDMSG]\r\n";
        let estimated = "TIME 2026-130-12:00:00.0\nSC[0].AC.wbn = 0 0 0\nSC[0].AC.qbn = 0 0.6 0 0.8\n[EOF]\n\n";
        let expected = Some(Ok(TruthSample {
            t_s: 831_729_600.0,
            motion: MotionValue::Attitude([0.8, 0.0, 0.6, 0.0]),
            sun: None,
        }));
        for text in [plain, bracketed, estimated] {
            assert_eq!(last(text), expected, "{text}");
        }
    }

    #[test]
    fn time_is_continuous_over_days_and_years() {
        let between = |from: &str, to: &str| seconds(to).expect(to) - seconds(from).expect(from);
        assert_eq!(between("2027-365-23:59:59.5", "2028-001-00:00:00.0"), 0.5);
        assert_eq!(between("2028-366-23:59:59.0", "2029-001-00:00:01.0"), 2.0);
        assert_eq!(between("2000-001-00:00:00", "2001-001-00:00:00"), 366.0 * 86_400.0);
    }

    #[test]
    fn invalid_messages_are_errors_and_the_next_is_read() {
        for (text, part) in [
            ("SC[0].qn = [0 0 0 1]\n[ENDMSG]", "begins with TIME"),
            ("TIME 2026-130-12:00:00\nSC[1].qn = [0 0 0 1]\n[ENDMSG]", "one of SC[0].B[0].qn, SC[0].qn"),
            ("TIME yesterday\nSC[0].qn = [0 0 0 1]\n[ENDMSG]", "TIME: expected year-day"),
            ("TIME 2026-130-12:00:00\nSC[0].qn = [nan 0 0 1]\n[ENDMSG]", "SC[0].qn: expected x y z w"),
            ("TIME 2026-130-12:00:00\nSC[0].qn = [0 0 1]\n[ENDMSG]", "SC[0].qn: expected x y z w"),
            ("TIME 9223372036854775807-1-1:1:1\nSC[0].qn =\n[ENDMSG]", "TIME: expected"),
        ] {
            let message = last(text).expect("an end").expect_err(text);
            assert!(message.contains(part), "{part} not in {message}");
            let next = format!("{text}\nTIME 2026-130-12:00:01\nSC[0].qn = [0 0 0 1]\n[ENDMSG]");
            assert!(last(&next).expect("an end").is_ok());
        }
        assert_eq!(last("TIME 2026-130-12:00:00\nSC[0].qn = [0 0 0 1]\n"), None);
    }
}
