//! The reference attitude as rows of a truth: tables of rates, turns or quaternions (docs/reference.md), or a CCSDS attitude
//! ephemeris.
//!
//! Between the rows a cubic spline of the accumulated rotation holds ([`Recorded`]).

mod columns;
mod magnitudes;
#[cfg(test)]
mod tests;

use std::io::Read;
use std::path::Path;
use std::sync::Arc;

use geu_model::attitude::{AttitudeRow, AttitudeRowsError, GAP_SPACINGS, RecordedAttitude, median_spacing_s};
use geu_model::device::Device;
use geu_model::units::{ARCSEC_PER_RAD, RAD_PER_DEG};
use nalgebra::{Quaternion, UnitQuaternion};

use self::columns::{COLUMNS, Columns, MotionKind, SIGMA_COLUMNS};
use self::magnitudes::MagnitudeColumns;
pub use self::magnitudes::MagnitudeRow;
use crate::aem;
use crate::csv_table::{CsvTable, TableError};
use crate::text::{RowReader, open_rows, timestamp};

/// Description of a reference attitude in errors.
pub const REFERENCE: &str = "a reference attitude, CSV, Parquet or CCSDS AEM";

/// Time between rows, s, that is none: times are rounded.
const TOUCHING_S: f64 = 1e-6;
/// Largest sigma, half a turn: an attitude that is less certain states nothing.
const MAX_SIGMA_ARCSEC: f64 = 648_000.0;

#[derive(Debug, Clone)]
pub struct ReferenceAttitude {
    /// Start of the first row's interval on the file's time scale, ns.
    pub start_ns: i64,
    /// The truth; its time 0 is `start_ns`.
    pub truth: Arc<RecordedAttitude>,
    /// Stated 1-sigma error of the attitude of each row of the truth, about each control axis; empty if the file states none.
    pub sigma_arcsec: Vec<[f64; 3]>,
    /// Time since `start_ns` and value of the temperatures of electronics and sensor, °C, where the file has them.
    pub celsius: [Vec<(f64, f64)>; 2],
    /// Time system of an attitude ephemeris, in which `start_ns` counts from 1970.
    pub time_system: Option<String>,
}

/// The rows of one trial of a reference; the attitude and the times of trials are independent.
#[derive(Debug, Clone)]
pub struct ReferenceTrial {
    /// Name in the column `trial` or `group`; empty without one.
    pub name: String,
    /// True for attitudes. Of rates and turns the turn over a gap is not known, and a sigma is that of the turn that ends at its row.
    pub is_attitude: bool,
    pub reference: ReferenceAttitude,
}

/// The reference of a diagnosis.
#[derive(Debug, Clone)]
pub enum Reference {
    Attitude(ReferenceAttitude),
    /// The magnitude of the rate alone.
    Magnitudes(Vec<MagnitudeRow>),
}

/// Gaps between rows that are accepted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Gaps {
    Refused,
    /// Gaps of attitudes, which state the turn over the gap.
    OfAttitudes,
    All,
}

/// A trial as it is read: rows with their lines, sigmas and starts, where there are any.
#[derive(Default)]
struct Trial {
    name: String,
    base_ns: Option<i64>,
    attitude: Option<UnitQuaternion<f64>>,
    rows: Vec<AttitudeRow>,
    lines: Vec<u64>,
    sigma_arcsec: Vec<[f64; 3]>,
    celsius: [Vec<(f64, f64)>; 2],
    starts_s: Vec<f64>,
}

impl ReferenceAttitude {
    /// A truth that begins at `start_ns`: the motion alone.
    pub fn of_truth(start_ns: i64, truth: impl Into<Arc<RecordedAttitude>>) -> ReferenceAttitude {
        let (sigma_arcsec, celsius, time_system) = Default::default();
        ReferenceAttitude { start_ns, truth: truth.into(), sigma_arcsec, celsius, time_system }
    }

    /// Moves the motion later by a lag.
    #[must_use]
    pub fn later(&self, lag_s: f64) -> ReferenceAttitude {
        ReferenceAttitude { start_ns: self.start_ns.saturating_add((lag_s * 1e9).round() as i64), ..self.clone() }
    }

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
        Ok(trials(name, rows, Gaps::OfAttitudes)?.swap_remove(0).reference)
    }

    /// Reads a file of any number of trials, with gaps.
    ///
    /// # Errors
    /// [`TableError`], with the line.
    pub fn read_trials(name: &str) -> Result<Vec<ReferenceTrial>, TableError> {
        trials(name, open_rows(Path::new(name)).map_err(TableError::read(name, REFERENCE))?, Gaps::All)
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
        Ok(trials(name, rows, Gaps::Refused)?.swap_remove(0).reference)
    }

    /// The truth from rows with times since `base_ns`; the motion starts at the first.
    pub(crate) fn from_turns(
        name: &str,
        base_ns: i64,
        lines: &[u64],
        time_system: Option<String>,
        truth: Result<RecordedAttitude, AttitudeRowsError>,
    ) -> Result<ReferenceAttitude, TableError> {
        let truth = truth.map_err(|source| {
            let line = source.index().and_then(|index| lines.get(index).copied()).unwrap_or(1);
            TableError::Rows { name: name.to_owned(), line, source }
        })?;
        let start_ns = base_ns.saturating_add((truth.start_s() * 1e9).round() as i64);
        Ok(ReferenceAttitude { time_system, ..ReferenceAttitude::of_truth(start_ns, truth.starting_at(0.0)) })
    }
}

impl Reference {
    /// Reads a file of which quaternions may leave gaps; of a described unit also magnitudes, in the windows of its description
    /// or with times.
    ///
    /// # Errors
    /// [`TableError`], with the line.
    pub fn read(name: &str, device: &Device) -> Result<Reference, TableError> {
        if device.is_iras() {
            return ReferenceAttitude::read_with_gaps(name).map(Reference::Attitude);
        }
        let described = device.table.as_ref().and_then(|table| table.reference.as_ref());
        let mut rows = open_rows(Path::new(name)).map_err(TableError::read(name, REFERENCE))?;
        if is_ephemeris(name, &mut rows)? {
            return Ok(Reference::Attitude(aem::parse(name, rows.lines())?));
        }
        let table = CsvTable::new(name, rows)?;
        match (MagnitudeColumns::find(&table, described), Columns::find(&table)) {
            (Some(columns), _) => Ok(Reference::Magnitudes(columns.rows(table)?)),
            (None, Err(COLUMNS)) => {
                let windows = described.map_or(String::new(), |own| {
                    format!("{}; or ", own.titles().map(String::as_str).collect::<Vec<_>>().join(", "))
                });
                Err(table.without_columns(&format!("{windows}a time and a magnitude, rate_deg_s; or {COLUMNS}")))
            }
            _ => {
                let trial = trials_of(name, table, Gaps::OfAttitudes)?.swap_remove(0);
                Ok(Reference::Attitude(trial.reference))
            }
        }
    }
}

/// True for an attitude ephemeris, by its first line.
fn is_ephemeris(name: &str, rows: &mut RowReader<impl Read>) -> Result<bool, TableError> {
    let head = rows.first_lines().map_err(TableError::read(name, REFERENCE))?;
    let first = head.iter().map(|line| line.trim()).find(|line| !line.is_empty() && !line.starts_with("COMMENT"));
    Ok(first.is_some_and(|line| line.starts_with(aem::FIRST_KEYWORD)))
}

/// Reads the trials of a file, one or, with all gaps, several.
fn trials(name: &str, mut rows: RowReader<impl Read>, gaps: Gaps) -> Result<Vec<ReferenceTrial>, TableError> {
    if is_ephemeris(name, &mut rows)? {
        let reference = aem::parse(name, rows.lines())?;
        return Ok(vec![ReferenceTrial { name: String::new(), is_attitude: true, reference }]);
    }
    trials_of(name, CsvTable::new(name, rows)?, gaps)
}

fn trials_of(name: &str, mut table: CsvTable<impl Read>, gaps: Gaps) -> Result<Vec<ReferenceTrial>, TableError> {
    let columns = Columns::find(&table).and_then(|columns| match columns.kind {
        MotionKind::Magnitude => Err(COLUMNS),
        _ => Ok(columns),
    });
    let columns = columns.map_err(|expected| table.without_columns(expected))?;
    if gaps != Gaps::All && columns.kind != MotionKind::Attitude && columns.sigma.is_some() {
        return Err(table.without_columns(SIGMA_COLUMNS));
    }
    let mut trials: Vec<Trial> = Vec::new();
    while table.read()? {
        let own = columns.trial.map_or("", |trial| table.text(trial));
        let place = trials.iter().rposition(|trial| trial.name == own).unwrap_or(trials.len());
        if place == trials.len() {
            if place > 0 && gaps != Gaps::All {
                return Err(table.unexpected(columns.trial.unwrap_or(0), "a single trial"));
            }
            trials.push(Trial { name: own.to_owned(), ..Trial::default() });
        }
        trials[place].push(&columns, &table, gaps)?;
    }
    if trials.is_empty() {
        trials.push(Trial::default());
    }
    trials.into_iter().map(|trial| trial.finish(name, &columns, gaps)).collect()
}

impl Trial {
    /// Adds a row, unless it is a dropout.
    fn push(&mut self, columns: &Columns, table: &CsvTable<impl Read>, gaps: Gaps) -> Result<(), TableError> {
        let number = |column: usize| table.number(column);
        // Seconds since the first row, so that no digit of a Unix time is lost.
        let t_ns = time_ns(table, columns.time)?;
        let base_ns = *self.base_ns.get_or_insert(t_ns);
        let since_s = |t_ns: i64| t_ns.saturating_sub(base_ns) as f64 * 1e-9;
        let (t_s, is_attitude) = (since_s(t_ns), columns.kind == MotionKind::Attitude);
        if (is_attitude || gaps == Gaps::All) && columns.motion.iter().any(|&place| table.is_missing(place)) {
            return Ok(());
        }
        let mut parts = [0.0; 4];
        for (part, &place) in parts.iter_mut().zip(&columns.motion) {
            *part = number(place)? * columns.size;
        }
        let [w, x, y, z] = parts;
        for (celsius, &column) in self.celsius.iter_mut().zip(&columns.celsius) {
            if let Some(column) = column.filter(|&column| !table.is_missing(column)) {
                celsius.push((t_s, number(column)?));
            }
        }
        let mut angle_control_arcsec = [w, x, y];
        if is_attitude {
            let now = UnitQuaternion::try_new(Quaternion::new(w, x, y, z), 1e-6);
            let now = now.ok_or_else(|| table.unexpected(columns.motion[0], "a unit quaternion"))?;
            angle_control_arcsec = turn_arcsec(&self.attitude.replace(now).unwrap_or(now), &now);
        }
        let theta_psi_rad = match columns.theta_psi {
            Some([theta, psi]) => Some((number(theta)? * RAD_PER_DEG, number(psi)? * RAD_PER_DEG)),
            None => None,
        };
        if let Some(([x, y, z], size)) = columns.sigma {
            let most = MAX_SIGMA_ARCSEC / size;
            let sigma = |column: usize| match number(column)? {
                sigma if (0.0..=most).contains(&sigma) => Ok(sigma * size),
                _ => Err(table.unexpected(column, &format!("a sigma from 0 to {most}"))),
            };
            self.sigma_arcsec.push([sigma(x)?, sigma(y)?, sigma(z)?]);
        }
        if let Some(start) = columns.start {
            let start_s = Some(since_s(time_ns(table, start)?)).filter(|start_s| *start_s < t_s);
            self.starts_s.push(start_s.ok_or_else(|| table.unexpected(start.0, "a start before the end"))?);
        }
        self.rows.push(AttitudeRow { t_s, angle_control_arcsec, theta_psi_rad });
        self.lines.push(table.line());
        Ok(())
    }

    /// The trial with a point at the start of each row that does not begin where the row before ends, and the rows after gaps.
    fn divided(self, is_rate: bool, gaps: Gaps) -> (Trial, Vec<usize>) {
        let spacing_s = median_spacing_s(&self.rows).unwrap_or_default();
        let (mut points, mut unknown) =
            (Trial { name: self.name, base_ns: self.base_ns, celsius: self.celsius, ..Trial::default() }, vec![]);
        for (number, (row, line)) in self.rows.into_iter().zip(self.lines).enumerate() {
            let before_s = points.rows.last().map(|last| last.t_s);
            // Without a start a row begins where the row before ends, after a gap at the median spacing.
            let is_next = |before_s: &f64| gaps != Gaps::All || row.t_s - before_s <= GAP_SPACINGS * spacing_s;
            let usual_s = before_s.filter(is_next).unwrap_or(row.t_s - spacing_s);
            let start_s = self.starts_s.get(number).copied().unwrap_or(usual_s);
            let sigma = self.sigma_arcsec.get(number).copied();
            // A start before the end of the row before is refused with the times of the truth.
            if before_s.is_none_or(|before_s| (start_s - before_s).abs() > TOUCHING_S) {
                unknown.extend(before_s.map(|_| points.rows.len()));
                points.rows.push(AttitudeRow { t_s: start_s, angle_control_arcsec: [0.0; 3], ..row });
                points.lines.push(line);
                points.sigma_arcsec.extend(sigma.map(|_| [0.0; 3]));
            }
            let factor = if is_rate { row.t_s - points.rows.last().map_or(start_s, |last| last.t_s) } else { 1.0 };
            let angle_control_arcsec = row.angle_control_arcsec.map(|part| part * factor);
            points.rows.push(AttitudeRow { angle_control_arcsec, ..row });
            points.lines.push(line);
            points.sigma_arcsec.extend(sigma.map(|sigma| sigma.map(|part| part * factor)));
        }
        (points, unknown)
    }

    /// The truth of the rows, in which dropouts are gaps.
    fn finish(self, file: &str, columns: &Columns, gaps: Gaps) -> Result<ReferenceTrial, TableError> {
        let is_attitude = columns.kind == MotionKind::Attitude;
        let is_accepted = gaps == Gaps::All || is_attitude && gaps == Gaps::OfAttitudes;
        let (own, unknown) =
            if is_attitude { (self, vec![]) } else { self.divided(columns.kind == MotionKind::Rate, gaps) };
        let truth = match columns.start.is_none() && unknown.is_empty() {
            true => RecordedAttitude::with_gaps(&own.rows),
            false => RecordedAttitude::with_known_gaps(&own.rows, unknown),
        };
        let truth = truth.and_then(|truth| if is_accepted { Ok(truth) } else { truth.without_gaps(&own.rows) });
        let (start_s, mut celsius) = (truth.as_ref().map_or(0.0, RecordedAttitude::start_s), own.celsius);
        celsius.iter_mut().flatten().for_each(|(t_s, _)| *t_s -= start_s);
        let reference = ReferenceAttitude::from_turns(file, own.base_ns.unwrap_or(0), &own.lines, None, truth)?;
        let reference = ReferenceAttitude { sigma_arcsec: own.sigma_arcsec, celsius, ..reference };
        Ok(ReferenceTrial { name: own.name, is_attitude, reference })
    }
}

/// The time in a column of this unit, ns.
fn time_ns(table: &CsvTable<impl Read>, (column, unit_ns): (usize, i64)) -> Result<i64, TableError> {
    let time = timestamp(table.text(column), unit_ns).map(|time| time.t_ns);
    time.ok_or_else(|| table.unexpected(column, "a number"))
}

/// The turn, about the control axes and by the shorter way, from one attitude (control frame to inertial) to the next.
pub(crate) fn turn_arcsec(before: &UnitQuaternion<f64>, now: &UnitQuaternion<f64>) -> [f64; 3] {
    ((before.inverse() * now).scaled_axis() * ARCSEC_PER_RAD).into()
}
