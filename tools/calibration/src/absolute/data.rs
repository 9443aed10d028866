//! Data of the absolute sensors, as `fss.csv` and `sse.csv` hold them.

use std::collections::BTreeMap;
use std::io::Read;
use std::path::Path;

use geu_model::sensor::SensorNumbers;
use geu_recording::{CsvTable, RowReader, TableError, open_rows};

/// A star through a slit: the slit, θ and ψ in degrees, random error of each angle in arcsec.
pub type Slit = (String, [f64; 2], f64);

/// A fix: one star through one or more slits at one instant.
#[derive(Debug, Clone, PartialEq)]
pub struct StarFix {
    /// The instant, ns on the time scale of the file.
    pub t_ns: i64,
    pub star: String,
    pub slits: Vec<Slit>,
}

#[derive(Debug, Clone, Default, PartialEq)]
pub struct AbsoluteData {
    /// Time, ns; sun angle in the XZ plane and out of it, arcsec.
    pub sun: Vec<(i64, [f64; 2])>,
    /// Fixes in order of time.
    pub fixes: Vec<StarFix>,
    pub numbers: SensorNumbers,
}

impl AbsoluteData {
    /// Reads `fss.csv` and `sse.csv`, which may be compressed.
    ///
    /// # Errors
    /// The first line that is no row.
    pub fn read(fss: &str, sse: &str, numbers: SensorNumbers) -> Result<AbsoluteData, TableError> {
        AbsoluteData::of_rows((fss, open(fss)?), (sse, open(sse)?), numbers)
    }

    /// Reads `sse.csv` alone.
    ///
    /// # Errors
    /// The first line that is no row.
    pub fn read_fixes(sse: &str, numbers: SensorNumbers) -> Result<AbsoluteData, TableError> {
        let no_sun = RowReader::new(&b"t_s,theta_arcsec,roll_arcsec\n"[..]);
        AbsoluteData::of_rows(("no sun sensor", no_sun), (sse, open(sse)?), numbers)
    }

    /// Reads texts, each with the name that errors call it by.
    ///
    /// # Errors
    /// As [`AbsoluteData::read`].
    pub fn parse(fss: (&str, &str), sse: (&str, &str), numbers: SensorNumbers) -> Result<AbsoluteData, TableError> {
        let (sun, stars) = (RowReader::new(fss.1.as_bytes()), RowReader::new(sse.1.as_bytes()));
        AbsoluteData::of_rows((fss.0, sun), (sse.0, stars), numbers)
    }

    fn of_rows(
        fss: (&str, RowReader<impl Read>),
        sse: (&str, RowReader<impl Read>),
        numbers: SensorNumbers,
    ) -> Result<AbsoluteData, TableError> {
        let (mut sun, mut table) = (Vec::<(i64, [f64; 2])>::new(), CsvTable::new(fss.0, fss.1)?);
        let [time, theta, roll] = table.columns(["t_s", "theta_arcsec", "roll_arcsec"])?;
        while table.read()? {
            let t_ns = nanoseconds(table.number(time)?);
            if sun.last().is_some_and(|last| last.0 >= t_ns) {
                return Err(table.unexpected(time, "time to rise"));
            }
            sun.push((t_ns, [table.number(theta)?, table.number(roll)?]));
        }
        let (mut fixes, mut table) = (BTreeMap::<i64, StarFix>::new(), CsvTable::new(sse.0, sse.1)?);
        let [time, theta, psi, sigma, star, slit] =
            table.columns(["t_s", "theta_deg", "psi_deg", "sigma_arcsec", "star", "slit"])?;
        while table.read()? {
            let sigma_arcsec = table.number(sigma)?;
            if sigma_arcsec <= 0.0 {
                return Err(table.unexpected(sigma, "more than 0"));
            }
            let t_ns = nanoseconds(table.number(time)?);
            let new = StarFix { t_ns, star: table.text(star).to_owned(), slits: Vec::new() };
            let angles_deg = [table.number(theta)?, table.number(psi)?];
            fixes.entry(t_ns).or_insert(new).slits.push((table.text(slit).to_owned(), angles_deg, sigma_arcsec));
        }
        Ok(AbsoluteData { sun, fixes: fixes.into_values().collect(), numbers })
    }
}

pub(super) fn nanoseconds(t_s: f64) -> i64 {
    (t_s * 1e9).round() as i64
}

fn open(name: &str) -> Result<RowReader<Box<dyn Read>>, TableError> {
    open_rows(Path::new(name)).map_err(TableError::read(name, "CSV of an absolute sensor"))
}
