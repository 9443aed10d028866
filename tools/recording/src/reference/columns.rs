//! The columns of a reference, by their names.

use std::io::Read;

use geu_model::units::{ANGLE_UNITS, NamedUnits, RATE_UNITS, TIME_UNITS};

use crate::csv_table::{CsvTable, TableError};
use crate::text::timestamp;

pub const COLUMNS: &str = "t_s (or time_, timestamp_; _ms, _us, _ns) or start_s and end_s; and either rates rate_x_deg_s, rate_y_deg_s, rate_z_deg_s \
    (or wx_, w_x_, omega_x_; _rad_s, _mrad_s, _arcsec_s, _deg_h); or between start and end turns angle_x_deg, angle_y_deg, angle_z_deg (or _rad, \
    _mrad, _arcsec); or quaternions, scalar last q1, q2, q3, q4, scalar first q0, q1, q2, q3, or qw, qx, qy, qz, or q_w, q_x, q_y, q_z";
/// Columns of which one kind may state the 1-sigma error of each row about the control axes.
pub const SIGMA_COLUMNS: &str = "q_w, q_x, q_y, q_z beside either sigma_arcsec or sigma_x_arcsec, sigma_y_arcsec, sigma_z_arcsec (or _deg, _rad, \
    _mrad): a sigma is that of a row's attitude, and rates state none, except for a diagnosis of a described unit, sigma_deg_s and so on";
const ONCE: &str = "of the time and of the motion once each";
const TIMES: &[&str] = &["t_", "time_", "timestamp_"];
const RATES: &[&str] = &["rate_", "w", "w_", "omega_"];
const MAGNITUDES: &[&str] = &["rate_"];
const TURNS: &[&str] = &["angle_"];
const SIGMAS: &[&str] = &["sigma_"];
/// Temperatures of electronics and sensor.
const CELSIUS: [&str; 2] = ["electronics_c", "sensor_c"];
const ACCELERATIONS: &[&str] = &["acceleration_", "accel_", "a", "a_"];
const ACCELERATION_UNITS: NamedUnits = &[("m_s2", 1.0), ("g", STANDARD_GRAVITY_M_S2)];
const STANDARD_GRAVITY_M_S2: f64 = 9.80665;
const TRIALS: [&str; 2] = ["trial", "group"];
const AXES: [&str; 3] = ["x_", "y_", "z_"];
/// The scalar part is first in this list; q1 to q4 have it last.
const QUATERNIONS: [[&str; 4]; 4] =
    [["q_w", "q_x", "q_y", "q_z"], ["qw", "qx", "qy", "qz"], ["q0", "q1", "q2", "q3"], ["q4", "q1", "q2", "q3"]];

/// Content of a row.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MotionKind {
    Attitude,
    Rate,
    Turn,
    /// Magnitude of the rate.
    Magnitude,
}

/// Places of the columns of a reference.
pub struct Columns {
    /// Time of the row, or the end of its interval, and its unit, ns.
    pub time: (usize, i64),
    pub start: Option<(usize, i64)>,
    pub kind: MotionKind,
    /// Rates or turns about the axes, the magnitude, or the quaternion, scalar part first.
    pub motion: Vec<usize>,
    /// Unit of the motion, arcsec or arcsec/s; 1 for a quaternion.
    pub size: f64,
    pub theta_psi: Option<[usize; 2]>,
    /// Sigma about each axis, and its unit, arcsec or arcsec/s.
    pub sigma: Option<([usize; 3], f64)>,
    pub celsius: [Option<usize>; 2],
    /// Accelerations along the axes, and their unit, m/s².
    pub acceleration: Option<([usize; 3], f64)>,
    pub trial: Option<usize>,
}

impl Columns {
    /// Finds the columns; the error is the expected ones.
    pub fn find(table: &CsvTable<impl Read>) -> Result<Columns, &'static str> {
        let at = |title: &str| table.column(title);
        let time = |stems: &[&str]| find(at, stems, [""], TIME_UNITS).map(|([at], s)| (at, (s * 1e9).round() as i64));
        let (row, interval) = (time(TIMES), time(&["start_"]).zip(time(&["end_"])));
        let turns = if interval.is_some() { TURNS } else { &[] };
        let motions = [(MotionKind::Rate, RATES, RATE_UNITS), (MotionKind::Turn, turns, ANGLE_UNITS)].into_iter();
        let motions = motions.filter_map(|(kind, stems, units)| {
            find(at, stems, AXES, units).map(|(places, size)| (kind, places.to_vec(), size, units))
        });
        let quaternions = QUATERNIONS.iter().filter_map(|titles| titles.iter().map(|title| at(title)).collect());
        let quaternions = quaternions.map(|places| (MotionKind::Attitude, places, 1.0, ANGLE_UNITS));
        let magnitude = find(at, MAGNITUDES, [""], RATE_UNITS);
        let magnitude = magnitude.map(|(places, size)| (MotionKind::Magnitude, places.to_vec(), size, RATE_UNITS));
        let (kind, motion, size, units) = motions.chain(quaternions).chain(magnitude).next().ok_or(COLUMNS)?;
        // An attitude is that of an instant.
        let interval = interval.filter(|_| kind != MotionKind::Attitude || row.is_none());
        let sigma = find(at, SIGMAS, [""; 3], units).or_else(|| find(at, SIGMAS, AXES, units));
        let is_repeated = |place: usize| table.titles().filter(|title| Some(place) == at(title)).count() > 1;
        let times = [row, interval.map(|(start, _)| start), interval.map(|(_, end)| end)];
        if times.into_iter().flatten().map(|(place, _)| place).chain(motion.iter().copied()).any(is_repeated) {
            return Err(ONCE);
        }
        let used = sigma.map_or(0, |([x, y, _], _)| if x == y { 1 } else { 3 });
        if table.titles().filter(|title| title.starts_with(SIGMAS[0])).count() != used {
            return Err(SIGMA_COLUMNS);
        }
        Ok(Columns {
            time: interval.map(|(_, end)| end).or(row).ok_or(COLUMNS)?,
            start: interval.map(|(start, _)| start).filter(|_| kind != MotionKind::Attitude),
            kind,
            motion,
            size,
            theta_psi: at("theta_deg").zip(at("psi_deg")).map(|(theta, psi)| [theta, psi]),
            sigma,
            celsius: CELSIUS.map(at),
            acceleration: find(at, ACCELERATIONS, AXES, ACCELERATION_UNITS),
            trial: TRIALS.into_iter().find_map(at),
        })
    }
}

/// Places of the columns `STEM PART UNIT` and the size of the unit, for the first stem and unit that has all parts.
fn find<const N: usize>(
    at: impl Fn(&str) -> Option<usize>,
    stems: &[&str],
    parts: [&str; N],
    units: NamedUnits,
) -> Option<([usize; N], f64)> {
    let mut pairs = stems.iter().flat_map(|stem| units.iter().map(move |unit| (stem, unit)));
    pairs.find_map(|(stem, (unit, size))| {
        let places = parts.map(|part| at(&format!("{stem}{part}{}", unit.replace('/', "_"))));
        places.iter().all(Option::is_some).then(|| (places.map(Option::unwrap_or_default), *size))
    })
}

/// The time in a column of this unit, ns.
pub fn time_ns(table: &CsvTable<impl Read>, (column, unit_ns): (usize, i64)) -> Result<i64, TableError> {
    let time = timestamp(table.text(column), unit_ns).map(|time| time.t_ns);
    time.ok_or_else(|| table.unexpected(column, "a number"))
}
