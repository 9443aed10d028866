//! The reference attitude as rows of a truth: `reference.csv` (protocol/ICD.md), rates or quaternions, or a CCSDS
//! attitude ephemeris.
//!
//! Between the rows a cubic spline of the accumulated rotation holds ([`Recorded`]).

use std::io::Read;
use std::path::Path;
use std::sync::Arc;

use geu_model::attitude::{AttitudeRow, RecordedAttitude, median_spacing_s};
use geu_model::units::{ARCSEC_PER_RAD, RAD_PER_DEG};
use nalgebra::{Quaternion, UnitQuaternion};

use crate::aem;
use crate::csv_table::{CsvTable, TableError};
use crate::text::{RowReader, open_rows, timestamp};

const COLUMNS: &str = "t_s and either rate_x_arcsec_s, rate_y_arcsec_s, rate_z_arcsec_s or q_w, q_x, q_y, q_z";

/// Columns of which one kind may state the 1-sigma error of each attitude about the control axes.
const SIGMA_COLUMNS: &str = "q_w, q_x, q_y, q_z beside either sigma_arcsec or sigma_x_arcsec, sigma_y_arcsec, sigma_z_arcsec: a sigma is that of a row's attitude, and rates state none";
/// Largest sigma, half a turn: an attitude that is less certain states nothing.
const MAX_SIGMA_ARCSEC: f64 = 648_000.0;

/// Description of a reference attitude in errors.
pub const REFERENCE: &str = "a reference attitude, CSV or CCSDS AEM";

#[derive(Debug, Clone)]
pub struct ReferenceAttitude {
    /// Start of the first row's interval on the file's time scale, ns.
    pub start_ns: i64,
    /// The truth; its time 0 is `start_ns`.
    pub truth: Arc<RecordedAttitude>,
    /// Stated 1-sigma error of the attitude of each row of the truth, about each control axis; empty if the file states none.
    pub sigma_arcsec: Vec<[f64; 3]>,
    /// Time system of an attitude ephemeris, in which `start_ns` counts from 1970.
    pub time_system: Option<String>,
}

/// Positions of the columns of a reference.
struct Columns {
    t: usize,
    motion: Motion,
    theta_psi: Option<[usize; 2]>,
    sigma: Option<[usize; 3]>,
}

enum Motion {
    Rates([usize; 3]),
    Quaternions([usize; 4]),
}

impl Columns {
    /// Finds the columns; the error is the expected ones.
    fn find(table: &CsvTable<impl Read>) -> Result<Columns, &'static str> {
        let at = |title: &str| table.column(title);
        let rates = ["rate_x_arcsec_s", "rate_y_arcsec_s", "rate_z_arcsec_s"].map(at);
        let quaternions = ["q_w", "q_x", "q_y", "q_z"].map(at);
        let motion = match (rates, quaternions) {
            ([Some(x), Some(y), Some(z)], _) => Motion::Rates([x, y, z]),
            (_, [Some(w), Some(x), Some(y), Some(z)]) => Motion::Quaternions([w, x, y, z]),
            _ => return Err(COLUMNS),
        };
        let sigmas = ["sigma_arcsec", "sigma_x_arcsec", "sigma_y_arcsec", "sigma_z_arcsec"].map(at);
        let sigma = match (sigmas, &motion) {
            ([None, None, None, None], _) => None,
            ([Some(all), None, None, None], Motion::Quaternions(_)) => Some([all; 3]),
            ([None, Some(x), Some(y), Some(z)], Motion::Quaternions(_)) => Some([x, y, z]),
            _ => return Err(SIGMA_COLUMNS),
        };
        let theta_psi = at("theta_deg").zip(at("psi_deg")).map(|(theta, psi)| [theta, psi]);
        Ok(Columns { t: at("t_s").ok_or(COLUMNS)?, motion, theta_psi, sigma })
    }
}

impl ReferenceAttitude {
    /// Reads a file, which may be compressed.
    ///
    /// # Errors
    /// [`TableError`], with the line.
    pub fn read(name: &str) -> Result<ReferenceAttitude, TableError> {
        ReferenceAttitude::of_rows(name, open_rows(Path::new(name)).map_err(TableError::read(name, REFERENCE))?)
    }

    /// Reads a file of which the quaternions may leave gaps: they state the attitude after a gap, rates do not.
    ///
    /// # Errors
    /// [`TableError`], with the line.
    pub fn read_with_gaps(name: &str) -> Result<ReferenceAttitude, TableError> {
        let rows = open_rows(Path::new(name)).map_err(TableError::read(name, REFERENCE))?;
        ReferenceAttitude::of_table(name, rows, true)
    }

    /// Reads a text; errors call it `name`.
    ///
    /// # Errors
    /// [`TableError`], with the line.
    pub fn parse(name: &str, text: &str) -> Result<ReferenceAttitude, TableError> {
        ReferenceAttitude::of_rows(name, RowReader::new(text.as_bytes()))
    }

    /// Reads rows; `name` is what errors call them.
    ///
    /// # Errors
    /// [`TableError`], with the line.
    pub fn of_rows(name: &str, rows: RowReader<impl Read>) -> Result<ReferenceAttitude, TableError> {
        ReferenceAttitude::of_table(name, rows, false)
    }

    fn of_table(
        name: &str,
        mut rows: RowReader<impl Read>,
        allows_gaps: bool,
    ) -> Result<ReferenceAttitude, TableError> {
        let head = rows.first_lines().map_err(TableError::read(name, REFERENCE))?;
        let first = head.iter().map(|line| line.trim()).find(|line| !line.is_empty() && !line.starts_with("COMMENT"));
        if first.is_some_and(|line| line.starts_with(aem::FIRST_KEYWORD)) {
            return aem::parse(name, rows.lines());
        }
        let mut table = CsvTable::new(name, rows)?;
        let columns = Columns::find(&table).map_err(|expected| table.without_columns(expected))?;
        let (mut rows, mut lines, mut base_ns) = (Vec::new(), Vec::new(), None);
        let mut attitude: Option<UnitQuaternion<f64>> = None;
        let mut sigma_arcsec = Vec::new();
        while table.read()? {
            let number = |column: usize| table.number(column);
            let time = timestamp(table.text(columns.t), 1_000_000_000);
            let t_ns = time.ok_or_else(|| table.unexpected(columns.t, "a number"))?.t_ns;
            // Seconds since the first row, so that no digit of a Unix time is lost.
            let t_s = (t_ns - *base_ns.get_or_insert(t_ns)) as f64 * 1e-9;
            let angle_control_arcsec = match columns.motion {
                Motion::Rates(at) => [number(at[0])?, number(at[1])?, number(at[2])?],
                Motion::Quaternions(at) => {
                    let parts = Quaternion::new(number(at[0])?, number(at[1])?, number(at[2])?, number(at[3])?);
                    let now = UnitQuaternion::try_new(parts, 1e-6);
                    let now = now.ok_or_else(|| table.unexpected(at[0], "a unit quaternion"))?;
                    let before = attitude.replace(now).unwrap_or(now);
                    turn_arcsec(&before, &now)
                }
            };
            let theta_psi_rad = match columns.theta_psi {
                Some([theta, psi]) => Some((number(theta)? * RAD_PER_DEG, number(psi)? * RAD_PER_DEG)),
                None => None,
            };
            let sigma = |column: usize| {
                let sigma = Some(number(column)?).filter(|sigma| (0.0..=MAX_SIGMA_ARCSEC).contains(sigma));
                sigma.ok_or_else(|| table.unexpected(column, "a sigma from 0 to 648000"))
            };
            if let Some([x, y, z]) = columns.sigma {
                sigma_arcsec.push([sigma(x)?, sigma(y)?, sigma(z)?]);
            }
            rows.push(AttitudeRow { t_s, angle_control_arcsec, theta_psi_rad });
            lines.push(table.line());
        }
        if let Motion::Rates(_) = columns.motion
            && let Some(spacing_s) = median_spacing_s(&rows)
        {
            // Its first row ends an interval of the median spacing.
            rows.insert(0, AttitudeRow { t_s: rows[0].t_s - spacing_s, ..rows[0] });
            lines.insert(0, lines[0]);
            for row in 1..rows.len() {
                let length_s = rows[row].t_s - rows[row - 1].t_s;
                rows[row].angle_control_arcsec = rows[row].angle_control_arcsec.map(|rate| rate * length_s);
            }
        }
        let is_attitude = matches!(columns.motion, Motion::Quaternions(_));
        let allows_gaps = allows_gaps && is_attitude;
        let read = ReferenceAttitude::from_turns(name, base_ns.unwrap_or(0), &rows, &lines, None, allows_gaps)?;
        Ok(ReferenceAttitude { sigma_arcsec, ..read })
    }

    /// The truth from rows with times since `base_ns`; the motion starts at the first.
    pub(crate) fn from_turns(
        name: &str,
        base_ns: i64,
        rows: &[AttitudeRow],
        lines: &[u64],
        time_system: Option<String>,
        allows_gaps: bool,
    ) -> Result<ReferenceAttitude, TableError> {
        let read = if allows_gaps { RecordedAttitude::with_gaps } else { RecordedAttitude::new };
        let truth = read(rows).map_err(|source| {
            let line = source.index().and_then(|index| lines.get(index).copied()).unwrap_or(1);
            TableError::Rows { name: name.to_owned(), line, source }
        })?;
        let start_ns = base_ns + (truth.start_s() * 1e9).round() as i64;
        Ok(ReferenceAttitude {
            start_ns,
            truth: Arc::new(truth.starting_at_zero()),
            sigma_arcsec: Vec::new(),
            time_system,
        })
    }
}

/// The turn, about the control axes and by the shorter way, from one attitude (control frame to inertial) to the next.
pub(crate) fn turn_arcsec(before: &UnitQuaternion<f64>, now: &UnitQuaternion<f64>) -> [f64; 3] {
    ((before.inverse() * now).scaled_axis() * ARCSEC_PER_RAD).into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_and_quaternions_of_one_turn_agree() {
        // 100″/s about Z.
        let rates: String = (1..=10).map(|row| format!("{}.{},0,0,100\n", row / 2, row % 2 * 5)).collect();
        let quaternions: String = (0..=10)
            .map(|row| {
                let half = f64::from(row) * 0.5 * 100.0 / ARCSEC_PER_RAD / 2.0;
                format!("{}.{},{},0,0,{}\n", row / 2, row % 2 * 5, half.cos(), half.sin())
            })
            .collect();
        let rates =
            ReferenceAttitude::parse("r", &format!("t_s,rate_x_arcsec_s,rate_y_arcsec_s,rate_z_arcsec_s\n{rates}"));
        let quaternions = ReferenceAttitude::parse("q", &format!("t_s,q_w,q_x,q_y,q_z\n{quaternions}"));
        for reference in [rates, quaternions] {
            let reference = reference.expect("a reference");
            assert_eq!(reference.start_ns, 0);
            let turned = reference.truth.at(5.0, &mut 0).0[2] - reference.truth.at(0.0, &mut 0).0[2];
            assert!((turned - 500.0).abs() < 1e-6, "{turned}");
        }
    }

    #[test]
    fn a_quaternion_tells_the_sun_from_its_first_row_on() {
        let row = |row: u32| format!("{}.{},1,0,0,0,{},0\n", row / 2, row % 2 * 5, 90 + row);
        let text: String = (0..=10).map(row).collect();
        let reference = ReferenceAttitude::parse("q", &format!("t_s,q_w,q_x,q_y,q_z,theta_deg,psi_deg\n{text}"));
        let (_, start) = reference.expect("a reference").truth.at(0.0, &mut 0);
        assert!((start.theta_rad / RAD_PER_DEG - 90.0).abs() < 1e-9);
    }

    #[test]
    fn a_sigma_column_states_the_error_of_each_attitude() {
        let parse = |titles: &str, values: [&str; 4]| {
            let rows = values.iter().enumerate().map(|(row, values)| format!("{row},1,0,0,0,{values}\n"));
            ReferenceAttitude::parse("f.csv", &format!("t_s,q_w,q_x,q_y,q_z,{titles}\n{}", rows.collect::<String>()))
        };
        let one = parse("sigma_arcsec", ["3", "30", "0", "3"]).expect("a reference");
        assert_eq!(one.sigma_arcsec, [[3.0; 3], [30.0; 3], [0.0; 3], [3.0; 3]]);
        let axes = "sigma_x_arcsec,sigma_y_arcsec,sigma_z_arcsec";
        let three = parse(axes, ["1,2,30"; 4]).expect("a reference");
        assert_eq!(three.sigma_arcsec, [[1.0, 2.0, 30.0]; 4]);
        assert!(parse("theta_deg", ["90"; 4]).expect("a reference").sigma_arcsec.is_empty());
        for (titles, values, part) in [
            ("sigma_arcsec", "-1", "line 3: sigma_arcsec: expected a sigma from 0 to 648000, got \"-1\""),
            ("sigma_arcsec", "1e6", "line 3: sigma_arcsec: expected a sigma from 0 to 648000, got \"1e6\""),
            ("sigma_arcsec", "", "line 3: sigma_arcsec: expected a number, got \"\""),
            ("sigma_arcsec", "inf", "line 3: sigma_arcsec: expected a number, got \"inf\""),
            (axes, "1,1,-2", "line 3: sigma_z_arcsec: expected a sigma from 0 to 648000, got \"-2\""),
            (
                "sigma_x_arcsec",
                "1",
                "line 1: header: expected the columns q_w, q_x, q_y, q_z beside either sigma_arcsec",
            ),
            ("sigma_arcsec,sigma_x_arcsec", "1,1", "line 1: header: expected the columns q_w, q_x, q_y, q_z beside"),
        ] {
            // A good value in place of the bad one.
            let good = values.replace(['-', 'e'], "").replace("inf", "");
            let good = if good.is_empty() { "1" } else { good.as_str() };
            let message = parse(titles, [good, values, good, good]).expect_err(values).to_string();
            assert!(message.contains(part), "{part} not in {message}");
        }
        let rates = "t_s,rate_x_arcsec_s,rate_y_arcsec_s,rate_z_arcsec_s,sigma_arcsec\n1,0,0,0,1\n";
        let message = ReferenceAttitude::parse("f.csv", rates).expect_err("rates").to_string();
        assert!(message.contains("line 1: header: expected the columns q_w") && message.contains("rates state none"));
    }

    #[test]
    fn errors_name_their_line() {
        let header = "t_s,rate_x_arcsec_s,rate_y_arcsec_s,rate_z_arcsec_s\n";
        let good = "1.0,0,0,0\n1.5,0,0,0\n2.0,0,0,0\n2.5,0,0,0\n";
        for (text, part) in [
            ("a,b\n1,2\n".to_owned(), "line 1: header: expected the columns t_s"),
            (String::new(), "q_w, q_x, q_y, q_z, got none"),
            (format!("{header}{good}x,0,0,0\n"), "line 6: t_s: expected a number, got \"x\""),
            (format!("{header}{good}3.0,0,,0\n"), "line 6: rate_y_arcsec_s: expected a number"),
            (format!("{header}{good}3.0,0\n"), "line: 6"),
            (format!("{header}{good}3.0,nan,0,0\n"), "line 6: rate_x_arcsec_s: expected a number, got \"nan\""),
            (format!("{header}{good}3.0,0,1e300,0\n"), "line 6: expected finite numbers, turns within 1e9 arcsec"),
            (format!("{header}{good}2.5,0,0,0\n"), "line 6: expected time to rise"),
            (format!("{header}{good}9.5,0,0,0\n"), "line 6: expected rows every 0.5 s or so, got a gap of 7 s"),
            (header.to_owned(), "expected at least 3 rows after the first, got 0"),
        ] {
            let message = ReferenceAttitude::parse("f.csv", &text).expect_err(&text).to_string();
            assert!(message.contains(part), "{part} not in {message}");
        }
    }
}
