//! CCSDS Attitude Ephemeris Message (504.0-B), KVN: one segment of quaternions, as rows of a truth.
//!
//! - `ATTITUDE_TYPE` `QUATERNION`, or `QUATERNION/DERIVATIVE`; derivatives must be numbers and are not used:
//!   between the epochs a cubic spline of the accumulated rotation holds, as for every truth from a file
//!   ([`geu_model::attitude::Recorded`]), whatever `INTERPOLATION_METHOD` proposes.
//! - Issue 1.0 names `ATTITUDE_DIR` and `QUATERNION_TYPE`; 2.0 has neither: from A to B, the scalar last.
//! - `REF_FRAME_A` or `REF_FRAME_B` must be of the spacecraft, with the control axes, and the other inertial. A rotating frame
//!   is refused.
//! - `TIME_SYSTEM` is reported and not converted: only differences of epochs count. A message in UTC across a leap second is a
//!   second short; use TAI.
//! - Attitude is not interpolated between segments: a second segment is refused.
//!
//! A quaternion of CCSDS turns coordinates, frame A into frame B, by the Euler axis and angle that carry the axes of A
//! into the axes of B. With A inertial and B the spacecraft, those are the axis and angle of the quaternion control frame to
//! inertial that this project uses everywhere.

use std::io;

use geu_model::attitude::{AttitudeRow, RecordedAttitude};
use geu_protocol::calendar::days_since_1970;
use geu_protocol::excerpt::excerpt;
use nalgebra::{Quaternion, UnitQuaternion};

use crate::csv_table::TableError;
use crate::reference::{REFERENCE, ReferenceAttitude, turn_arcsec};

/// First keyword of every such message.
pub(crate) const FIRST_KEYWORD: &str = "CCSDS_AEM_VERS";

const TIME_SYSTEMS: [&str; 11] = ["UTC", "TAI", "TT", "GPS", "TDB", "TCB", "TDT", "UT1", "MET", "MRT", "SCLK"];
const INERTIAL: [&str; 9] = ["EME2000", "ICRF", "GCRF", "J2000", "B1950", "MCI", "TEME", "TOD", "MOD"];
/// Frames of the spacecraft, by what their names begin with.
const SPACECRAFT: [&str; 7] = ["SC_BODY", "SC BODY", "INSTRUMENT", "STARTRACKER", "STAR_TRACKER", "GYRO", "SENSOR"];
/// A unit quaternion with the digits of a file.
const NORM_TOLERANCE: f64 = 1e-3;

struct LinePosition<'a> {
    name: &'a str,
    line: u64,
}

impl LinePosition<'_> {
    fn wrong(&self, field: &str, expected: impl Into<String>, got: &str) -> TableError {
        TableError::Field {
            name: self.name.to_owned(),
            line: self.line,
            field: excerpt(field).into_owned(),
            expected: expected.into(),
            got: excerpt(got).into_owned(),
        }
    }

    fn choice<'c>(&self, field: &str, value: &str, valid: &[&'c str]) -> Result<&'c str, TableError> {
        let found = valid.iter().find(|valid| valid.eq_ignore_ascii_case(value));
        found.copied().ok_or_else(|| self.wrong(field, format!("one of {}", valid.join(", ")), value))
    }

    fn epoch(&self, field: &str, text: &str) -> Result<i64, TableError> {
        epoch_ns(text).ok_or_else(|| self.wrong(field, "an epoch, 2026-03-31T05:00:00.5 or 2026-090T05:00:00.5", text))
    }
}

#[derive(Clone, Copy, PartialEq)]
enum Part {
    Header,
    Meta,
    Ready,
    Data,
    Done,
}

/// Metadata of the segment, as far as it is needed.
#[derive(Default)]
struct Meta {
    frame_a: Option<String>,
    frame_b: Option<String>,
    a_to_b: Option<bool>,
    scalar_first: Option<bool>,
    time_system: Option<String>,
    start_ns: Option<i64>,
    stop_ns: Option<i64>,
    useable_start_ns: Option<i64>,
    useable_stop_ns: Option<i64>,
    numbers: Option<usize>,
}

/// Layout of the data from the metadata.
struct Layout {
    numbers: usize,
    scalar_first: bool,
    /// True if the inverse quaternion turns control frame to inertial.
    inverse: bool,
    within_ns: (i64, i64),
    useable_ns: (i64, i64),
    time_system: String,
}

impl Meta {
    fn set(&mut self, place: &LinePosition, key: &str, value: &str) -> Result<(), TableError> {
        match key {
            "REF_FRAME_A" => self.frame_a = Some(value.to_ascii_uppercase()),
            "REF_FRAME_B" => self.frame_b = Some(value.to_ascii_uppercase()),
            "ATTITUDE_DIR" => self.a_to_b = Some(place.choice(key, value, &["A2B", "B2A"])? == "A2B"),
            "QUATERNION_TYPE" => self.scalar_first = Some(place.choice(key, value, &["FIRST", "LAST"])? == "FIRST"),
            "TIME_SYSTEM" => self.time_system = Some(place.choice(key, value, &TIME_SYSTEMS)?.to_owned()),
            "START_TIME" => self.start_ns = Some(place.epoch(key, value)?),
            "STOP_TIME" => self.stop_ns = Some(place.epoch(key, value)?),
            "USEABLE_START_TIME" => self.useable_start_ns = Some(place.epoch(key, value)?),
            "USEABLE_STOP_TIME" => self.useable_stop_ns = Some(place.epoch(key, value)?),
            "ATTITUDE_TYPE" => {
                let kind = place.choice(key, value, &["QUATERNION", "QUATERNION/DERIVATIVE"])?;
                self.numbers = Some(if kind == "QUATERNION" { 4 } else { 8 });
            }
            "OBJECT_NAME" | "OBJECT_ID" | "CENTER_NAME" | "INTERPOLATION_METHOD" | "INTERPOLATION_DEGREE" => {}
            _ => return Err(place.wrong(key, "a keyword of the metadata of an attitude ephemeris", value)),
        }
        Ok(())
    }

    /// `first_issue`: direction and place of the scalar must be named.
    fn layout(self, place: &LinePosition, first_issue: bool) -> Result<Layout, TableError> {
        let missing = |field: &str| place.wrong(field, format!("{field} in the metadata"), "none");
        let (a, b) =
            (self.frame_a.ok_or_else(|| missing("REF_FRAME_A"))?, self.frame_b.ok_or_else(|| missing("REF_FRAME_B"))?);
        let inertial = |frame: &str| INERTIAL.contains(&frame);
        let spacecraft = |frame: &str| SPACECRAFT.iter().any(|begins| frame.starts_with(begins));
        let from_inertial = match (inertial(&a) && spacecraft(&b), spacecraft(&a) && inertial(&b)) {
            (true, _) => true,
            (_, true) => false,
            _ => {
                let expected = format!(
                    "a frame of the spacecraft ({}…) and an inertial one ({})",
                    SPACECRAFT.join("…, "),
                    INERTIAL.join(", ")
                );
                return Err(place.wrong("REF_FRAME_A, REF_FRAME_B", expected, &format!("{a}, {b}")));
            }
        };
        let named = |value: Option<bool>, field: &str, default: bool| match value {
            None if first_issue => Err(missing(field)),
            value => Ok(value.unwrap_or(default)),
        };
        let a_to_b = named(self.a_to_b, "ATTITUDE_DIR", true)?;
        let (first, last) = (i64::MIN, i64::MAX);
        Ok(Layout {
            numbers: self.numbers.ok_or_else(|| missing("ATTITUDE_TYPE"))?,
            scalar_first: named(self.scalar_first, "QUATERNION_TYPE", false)?,
            inverse: from_inertial != a_to_b,
            within_ns: (self.start_ns.unwrap_or(first), self.stop_ns.unwrap_or(last)),
            useable_ns: (self.useable_start_ns.unwrap_or(first), self.useable_stop_ns.unwrap_or(last)),
            time_system: self.time_system.ok_or_else(|| missing("TIME_SYSTEM"))?,
        })
    }
}

impl Layout {
    /// Epoch and quaternion control frame to inertial of a line of data.
    fn read(&self, place: &LinePosition, text: &str) -> Result<(i64, UnitQuaternion<f64>), TableError> {
        let mut fields = text.split_ascii_whitespace();
        let epoch = fields.next().unwrap_or_default();
        let t_ns = place.epoch("epoch", epoch)?;
        if t_ns < self.within_ns.0 || t_ns > self.within_ns.1 {
            return Err(place.wrong("epoch", "an epoch from START_TIME to STOP_TIME", epoch));
        }
        let mut numbers = Vec::with_capacity(self.numbers);
        for field in fields {
            match field.parse::<f64>() {
                Ok(number) if number.is_finite() => numbers.push(number),
                _ => return Err(place.wrong("quaternion", "a number", field)),
            }
        }
        if numbers.len() != self.numbers {
            let expected = format!("{} numbers behind the epoch", self.numbers);
            return Err(place.wrong("quaternion", expected, &numbers.len().to_string()));
        }
        let parts = match self.scalar_first {
            true => Quaternion::new(numbers[0], numbers[1], numbers[2], numbers[3]),
            false => Quaternion::new(numbers[3], numbers[0], numbers[1], numbers[2]),
        };
        if (parts.norm() - 1.0).abs() > NORM_TOLERANCE {
            return Err(place.wrong("quaternion", "a quaternion of norm 1", &format!("norm {}", parts.norm())));
        }
        let unit = UnitQuaternion::new_normalize(parts);
        Ok((t_ns, if self.inverse { unit.inverse() } else { unit }))
    }
}

/// Reads the lines of a message; errors call it `name`.
pub(crate) fn parse(
    name: &str,
    all: impl Iterator<Item = io::Result<String>>,
) -> Result<ReferenceAttitude, TableError> {
    let (mut part, mut first_issue, mut meta, mut layout) = (Part::Header, true, Meta::default(), None);
    let (mut rows, mut lines, mut before) = (Vec::new(), Vec::new(), None);
    let mut start_ns = None;
    let mut place = LinePosition { name, line: 0 };
    for line in all {
        let line = line.map_err(TableError::read(name, REFERENCE))?;
        place.line += 1;
        let text = line.trim();
        if text.is_empty() || text == "COMMENT" || text.starts_with("COMMENT ") {
            continue;
        }
        let pair = text.split_once('=').map(|(key, value)| (key.trim(), value.trim()));
        match (part, text, pair) {
            (Part::Header, _, Some((FIRST_KEYWORD, value))) => {
                first_issue = place.choice(FIRST_KEYWORD, value, &["1.0", "2.0"])? == "1.0";
            }
            (Part::Header, _, Some(_)) => {}
            (Part::Header, "META_START", _) => part = Part::Meta,
            (Part::Meta, "META_STOP", _) => {
                layout = Some(std::mem::take(&mut meta).layout(&place, first_issue)?);
                part = Part::Ready;
            }
            (Part::Meta, _, Some((key, value))) => meta.set(&place, key, value)?,
            (Part::Ready, "DATA_START", _) => part = Part::Data,
            (Part::Data, "DATA_STOP", _) => part = Part::Done,
            (Part::Data, ..) => {
                let Some(layout) = &layout else { continue };
                let (t_ns, attitude) = layout.read(&place, text)?;
                if t_ns < layout.useable_ns.0 || t_ns > layout.useable_ns.1 {
                    continue;
                }
                let t_s = (t_ns - *start_ns.get_or_insert(t_ns)) as f64 * 1e-9;
                let angle_control_arcsec = turn_arcsec(&before.replace(attitude).unwrap_or(attitude), &attitude);
                rows.push(AttitudeRow { t_s, angle_control_arcsec, theta_psi_rad: None });
                lines.push(place.line);
            }
            (Part::Done, "META_START", _) => {
                let expected = "one segment (attitude is never made up between segments; give each its own file)";
                return Err(place.wrong("META_START", expected, "another segment"));
            }
            _ => {
                let expected = match part {
                    Part::Header => "KEYWORD = value or META_START",
                    Part::Meta => "KEYWORD = value or META_STOP",
                    Part::Ready => "DATA_START",
                    Part::Data | Part::Done => "the end of the message",
                };
                return Err(place.wrong("line", expected, text));
            }
        }
    }
    let Some(layout) = layout.filter(|_| part == Part::Done) else {
        place.line += 1;
        return Err(place.wrong("message", "a segment of data up to DATA_STOP", "the end of the file"));
    };
    let truth = RecordedAttitude::new(rows);
    let turns = ReferenceAttitude::from_turns(name, start_ns.unwrap_or(0), &lines, Some(layout.time_system), truth)?;
    Ok(ReferenceAttitude { is_attitude: true, ..turns })
}

/// An epoch, calendar or day of year, as ns since 1970 in its own time system.
pub(crate) fn epoch_ns(text: &str) -> Option<i64> {
    let (date, time) = text.strip_suffix('Z').unwrap_or(text).split_once('T')?;
    let number = |text: &str, length: usize, min: i64, max: i64| {
        let all_digits = text.len() == length && text.bytes().all(|byte| byte.is_ascii_digit());
        text.parse::<i64>().ok().filter(|number| all_digits && (min..=max).contains(number))
    };
    let (year, rest) = date.split_once('-')?;
    let year = number(year, 4, 1583, 9999)?;
    let leap = year % 4 == 0 && (year % 100 != 0 || year % 400 == 0);
    let lengths = [31, 28 + i64::from(leap), 31, 30, 31, 30, 31, 31, 30, 31, 30, 31];
    let day_of_year = match rest.split_once('-') {
        Some((month, day)) => {
            let month = number(month, 2, 1, 12)? as usize;
            lengths[..month - 1].iter().sum::<i64>() + number(day, 2, 1, lengths[month - 1])?
        }
        None => number(rest, 3, 1, 365 + i64::from(leap))?,
    };
    let mut parts = time.splitn(3, ':');
    let (hour, minute) = (number(parts.next()?, 2, 0, 23)?, number(parts.next()?, 2, 0, 59)?);
    let (second, fraction) = parts.next().map(|text| text.split_once('.').unwrap_or((text, "")))?;
    if !fraction.bytes().all(|byte| byte.is_ascii_digit()) {
        return None;
    }
    let fraction: String = fraction.chars().chain(std::iter::repeat('0')).take(9).collect();
    let days = days_since_1970(year, 1, 1) + day_of_year - 1;
    let seconds = days * 86_400 + hour * 3600 + minute * 60 + number(second, 2, 0, 59)?;
    seconds.checked_mul(1_000_000_000)?.checked_add(fraction.parse().ok()?)
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEADER: &str =
        "CCSDS_AEM_VERS = 1.0\nCREATION_DATE = 2026-03-31T05:00:00\nORIGINATOR = TEST\nCOMMENT of a test\n";
    const META: &str = "META_START\nOBJECT_NAME = GEU\nOBJECT_ID = 1983-004A\nCENTER_NAME = EARTH\nREF_FRAME_A = EME2000\nREF_FRAME_B = SC_BODY_1\nATTITUDE_DIR = A2B\nTIME_SYSTEM = TAI\nSTART_TIME = 2026-03-31T00:00:00\nSTOP_TIME = 2026-04-01T00:00:00\nATTITUDE_TYPE = QUATERNION\nQUATERNION_TYPE = LAST\nMETA_STOP\n";

    /// Rows each sample of a turn by 100″/s about +Z.
    fn data(write: impl Fn(f64, f64) -> String) -> String {
        let rows: String = (0..=10)
            .map(|row| {
                let half = f64::from(row) * 0.5 * 100.0 / 206_264.806_247_096_36 / 2.0;
                format!("2026-090T05:00:{:02}.{} {}\n", row / 2, row % 2 * 5, write(half.sin(), half.cos()))
            })
            .collect();
        format!("DATA_START\n{rows}DATA_STOP\n")
    }

    fn plain() -> String {
        data(|sin, cos| format!("0 0 {sin} {cos}"))
    }

    fn turned_z(text: &str) -> f64 {
        let reference = ReferenceAttitude::parse("m.aem", text).unwrap_or_else(|error| panic!("{error}\n{text}"));
        let truth = reference.truth;
        truth.at(5.0, &mut 0).0[2] - truth.at(0.0, &mut 0).0[2]
    }

    #[test]
    fn direction_frames_and_the_scalars_place_are_as_the_message_says() {
        let expect = |meta: &str, data: &str, arcsec: f64| {
            let turned = turned_z(&format!("{HEADER}{meta}{data}"));
            assert!((turned - arcsec).abs() < 1e-6, "{turned} {meta}");
        };
        expect(META, &plain(), 500.0);
        let first = META.replace("LAST", "FIRST");
        expect(&first, &data(|sin, cos| format!("{cos} 0 0 {sin}")), 500.0);
        // The quaternion of the other direction is the conjugate.
        expect(&META.replace("A2B", "B2A"), &plain(), -500.0);
        let swapped = META.replace("FRAME_A = EME2000", "FRAME_A = X").replace("SC_BODY_1", "EME2000");
        let swapped = swapped.replace("FRAME_A = X", "FRAME_A = SC_BODY_1");
        expect(&swapped, &plain(), -500.0);
        expect(&swapped.replace("A2B", "B2A"), &plain(), 500.0);
        let derivative = META.replace("= QUATERNION\n", "= QUATERNION/DERIVATIVE\n");
        expect(&derivative, &data(|sin, cos| format!("0 0 {sin} {cos} 0 0 0 0")), 500.0);
    }

    #[test]
    fn the_second_issue_names_neither_direction_nor_place() {
        let header = HEADER.replace("1.0", "2.0");
        let meta = META.replace("ATTITUDE_DIR = A2B\n", "").replace("QUATERNION_TYPE = LAST\n", "");
        assert!((turned_z(&format!("{header}{meta}{}", plain())) - 500.0).abs() < 1e-6);
    }

    #[test]
    fn only_useable_epochs_are_read_and_the_time_system_is_reported() {
        let meta = META.replace("STOP_TIME", "USEABLE_START_TIME = 2026-03-31T05:00:01\nSTOP_TIME");
        let reference = ReferenceAttitude::parse("m.aem", &format!("{HEADER}{meta}{}", plain())).expect("a message");
        // date -u -d 2026-03-31T05:00:01 +%s
        assert_eq!(reference.start_ns, 1_774_933_201_000_000_000);
        assert_eq!(reference.time_system.as_deref(), Some("TAI"));
        assert_eq!((reference.truth.start_s(), reference.truth.end_s()), (0.0, 4.0));
        for (text, ns) in [
            ("1970-01-01T00:00:00", Some(0)),
            ("2000-060T00:00:00.000000001Z", Some(951_782_400_000_000_001)),
            ("2000-02-29T00:00:00", Some(951_782_400_000_000_000)),
            ("2001-02-29T00:00:00", None),
            ("2001-366T00:00:00", None),
            ("2001-01-01T00:00:60", None),
            ("2001-01-01T00:00", None),
            ("2001-1-01T00:00:00", None),
        ] {
            assert_eq!(epoch_ns(text), ns, "{text}");
        }
    }

    #[test]
    fn errors_name_their_line() {
        let good = format!("{HEADER}{META}{}", plain());
        // Metadata end on line 17; rows stand on 19…29.
        for (text, part) in [
            (good.replace("1.0\n", "3.0\n"), "line 1: CCSDS_AEM_VERS: expected one of 1.0, 2.0, got 3.0"),
            (
                good.replace("= EME2000", "= LVLH"),
                "line 17: REF_FRAME_A, REF_FRAME_B: expected a frame of the spacecraft",
            ),
            (
                good.replace("= QUATERNION\n", "= EULER_ANGLE\n"),
                "line 15: ATTITUDE_TYPE: expected one of QUATERNION, QUATERNION/DERIVATIVE, got EULER_ANGLE",
            ),
            (good.replace("ATTITUDE_DIR = A2B\n", ""), "ATTITUDE_DIR: expected ATTITUDE_DIR in the metadata, got none"),
            (good.replace("TIME_SYSTEM", "TIME_SISTEM"), "line 12: TIME_SISTEM: expected a keyword"),
            (good.replace("T05:00:02.0", "T05:00:02,0"), "line 23: epoch: expected an epoch"),
            (good.replace("T05:00:02.0", "T05:00:01.5"), "line 23: expected time to rise"),
            (good.replace("T05:00:05.0", "T05:00:09.0"), "line 29: expected rows every 0.5 s or so, got a gap"),
            (
                good.replace("2026-090T05:00:02.0", "2027-090T05:00:02.0"),
                "line 23: epoch: expected an epoch from START_TIME",
            ),
            (good.replace("T05:00:02.0 0", "T05:00:02.0 x"), "line 23: quaternion: expected a number, got x"),
            (
                good.replace("T05:00:02.0 0", "T05:00:02.0 0 0"),
                "line 23: quaternion: expected 4 numbers behind the epoch, got 5",
            ),
            (good.replace("T05:00:02.0 0", "T05:00:02.0 1"), "line 23: quaternion: expected a quaternion of norm 1"),
            (good.replace("DATA_STOP\n", ""), "line 30: message: expected a segment of data up to DATA_STOP"),
            (format!("{good}{META}{}", plain()), "line 31: META_START: expected one segment"),
        ] {
            let message = ReferenceAttitude::parse("m.aem", &text).expect_err(part).to_string();
            assert!(message.contains(part), "{part} not in {message}");
        }
    }
}
