//! Data of the absolute sensors, as `fss.csv` and `sse.csv` hold them.

use std::collections::BTreeMap;
use std::io::Read;
use std::path::Path;

use geu_model::sensor::SensorNumbers;
use geu_recording::{CsvTable, TableError, open_rows};

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
    /// Reads `fss.csv`, if given, and `sse.csv`; both may be compressed.
    ///
    /// # Errors
    /// The first invalid line.
    pub fn read(fss: Option<&str>, sse: &str, numbers: SensorNumbers) -> Result<AbsoluteData, TableError> {
        Ok(AbsoluteData { sun: fss.map_or(Ok(Vec::new()), read_sun)?, fixes: read_fixes(sse)?, numbers })
    }

    /// Start and end of each interval between successive fixes, s on the time scale of the file.
    pub(crate) fn between_fixes(&self) -> impl Iterator<Item = [f64; 2]> {
        self.fixes.windows(2).map(|pair| [pair[0].t_ns as f64 * 1e-9, pair[1].t_ns as f64 * 1e-9])
    }
}

fn read_sun(name: &str) -> Result<Vec<(i64, [f64; 2])>, TableError> {
    let (mut sun, mut table) = (Vec::<(i64, [f64; 2])>::new(), open(name)?);
    let [time, theta, roll] = table.columns(["t_s", "theta_arcsec", "roll_arcsec"])?;
    while table.read()? {
        let t_ns = nanoseconds(table.number(time)?);
        if sun.last().is_some_and(|last| last.0 >= t_ns) {
            return Err(table.unexpected(time, "time to rise"));
        }
        sun.push((t_ns, [table.number(theta)?, table.number(roll)?]));
    }
    Ok(sun)
}

fn read_fixes(name: &str) -> Result<Vec<StarFix>, TableError> {
    let (mut fixes, mut table) = (BTreeMap::<i64, StarFix>::new(), open(name)?);
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
    Ok(fixes.into_values().collect())
}

fn nanoseconds(t_s: f64) -> i64 {
    (t_s * 1e9).round() as i64
}

fn open(name: &str) -> Result<CsvTable<Box<dyn Read>>, TableError> {
    CsvTable::new(name, open_rows(Path::new(name)).map_err(TableError::read(name, "CSV of an absolute sensor"))?)
}
