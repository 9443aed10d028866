//! The reference attitude as rows of a truth: tables of rates, turns or quaternions (docs/reference.md), or a CCSDS attitude
//! ephemeris.
//!
//! Between the rows a cubic spline of the accumulated rotation holds ([`Recorded`]).

mod columns;
mod magnitudes;
mod parts;
mod rate_jumps;
#[cfg(test)]
mod tests;
mod trial_rows;
mod trial_table;

use std::io::Read;
use std::path::Path;
use std::sync::Arc;

use geu_model::attitude::{AttitudeRowsError, RecordedAttitude, median_spacing_s};
use geu_model::device::Device;
use geu_model::units::ARCSEC_PER_RAD;
use nalgebra::UnitQuaternion;

use self::columns::{COLUMNS, Columns};
use self::magnitudes::MagnitudeColumns;
pub use self::magnitudes::MagnitudeRow;
pub use self::parts::ReferenceParts;
use self::trial_table::TrialTable;
use crate::aem;
use crate::csv_table::{CsvTable, TableError};
use crate::text::{RowReader, open_rows};

/// Description of a reference attitude in errors.
pub const REFERENCE: &str = "a reference attitude, CSV, Parquet or CCSDS AEM";

#[derive(Debug, Clone)]
pub struct ReferenceAttitude {
    /// Start of the first row's interval on the file's time scale, ns.
    pub start_ns: i64,
    /// The truth; its time 0 is `start_ns`.
    pub truth: Arc<RecordedAttitude>,
    /// True for attitudes: the rotation from row to row is a turn about one axis. Of rates and turns the turn over a gap is not known, and a
    /// sigma is that of the turn that ends at its row.
    pub is_attitude: bool,
    /// Stated 1-sigma error of the attitude of each row of the truth, about each control axis; empty if the file states none.
    pub sigma_arcsec: Vec<[f64; 3]>,
    /// Time since `start_ns` and value of the temperatures of electronics and sensor, °C, where the file has them.
    pub celsius: [Vec<(f64, f64)>; 2],
    /// Time since `start_ns` and accelerations along the control axes, m/s², where the file has them.
    pub acceleration_m_s2: Vec<(f64, [f64; 3])>,
    /// Time system of an attitude ephemeris, in which `start_ns` counts from 1970.
    pub time_system: Option<String>,
    /// In order of time; empty without a column `trial` or `group`.
    pub trials: Vec<Trial>,
    /// Stated 1-sigma error of the turn of each row of the truth about each control axis, of rates and turns; empty if the file states none.
    pub turn_sigma_arcsec: Vec<[f64; 3]>,
}

/// A trial of a recording: attitude and drifts are independent of other trials.
#[derive(Debug, Clone, PartialEq)]
pub struct Trial {
    pub name: String,
    /// First and last row, s since the start of the reference.
    pub from_s: f64,
    pub to_s: f64,
    /// Added to the times of the trial, ns: trials with independent times follow one another.
    pub moved_ns: i64,
}

/// Time between trials with times of their own, s, and time beside one for which its samples are used: twice the lag that is searched for.
const BETWEEN_TRIALS_S: f64 = 10.0;
const BESIDE_TRIALS_S: f64 = 4.0;

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
    /// All, and further trials, which may have times of their own.
    All {
        has_own_times: bool,
    },
}

impl Trial {
    /// Shift of a time of the trial, ns; `None` if the reference, which starts at `start_ns`, is far from it.
    pub fn moved_ns(&self, start_ns: i64, t_ns: i64) -> Option<i64> {
        let since_s = (t_ns.saturating_add(self.moved_ns).saturating_sub(start_ns)) as f64 * 1e-9;
        (self.from_s - BESIDE_TRIALS_S..=self.to_s + BESIDE_TRIALS_S).contains(&since_s).then_some(self.moved_ns)
    }
}

impl ReferenceAttitude {
    /// A truth that begins at `start_ns`: the motion alone.
    pub fn of_truth(start_ns: i64, truth: impl Into<Arc<RecordedAttitude>>) -> ReferenceAttitude {
        ReferenceAttitude {
            start_ns,
            truth: truth.into(),
            is_attitude: false,
            sigma_arcsec: Vec::new(),
            turn_sigma_arcsec: Vec::new(),
            celsius: Default::default(),
            acceleration_m_s2: Vec::new(),
            time_system: None,
            trials: Vec::new(),
        }
    }

    /// Number of the trial at an instant; 0 before the second one.
    pub fn trial_at(&self, t_s: f64) -> usize {
        self.trials.partition_point(|trial| trial.from_s <= t_s).saturating_sub(1)
    }

    /// Median length of the rows, s, of rates and turns: the motion within a row is not known. 0 for attitudes.
    pub fn row_s(&self) -> f64 {
        if self.is_attitude { 0.0 } else { median_spacing_s(self.truth.rows().map(|row| row.0)).unwrap_or_default() }
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
        attitude(name, rows, Gaps::OfAttitudes)
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
        attitude(name, rows, Gaps::Refused)
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
    /// Reads a file of which quaternions may leave gaps; of a described unit all rows may, of any number of trials, and magnitudes are read too,
    /// in the windows of its description or with times.
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
                // Frames of a link have one time scale.
                let is_table = device.serial.is_none() && device.can.is_none();
                let has_own_times = is_table && device.table.as_ref().is_some_and(|table| table.group.is_some());
                TrialTable::new(name, table, Gaps::All { has_own_times })?.read().map(Reference::Attitude)
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

/// Reads an attitude from rows or an ephemeris.
fn attitude(name: &str, mut rows: RowReader<impl Read>, gaps: Gaps) -> Result<ReferenceAttitude, TableError> {
    match is_ephemeris(name, &mut rows)? {
        true => aem::parse(name, rows.lines()),
        false => TrialTable::new(name, CsvTable::new(name, rows)?, gaps)?.read(),
    }
}

/// The turn, about the control axes and by the shorter way, from one attitude (control frame to inertial) to the next.
pub(crate) fn turn_arcsec(before: &UnitQuaternion<f64>, now: &UnitQuaternion<f64>) -> [f64; 3] {
    ((before.inverse() * now).scaled_axis() * ARCSEC_PER_RAD).into()
}
