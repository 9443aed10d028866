//! Plain CSV of any gyros: what its columns are is told in a description (TOML), and comes out as rates and defects.
//!
//! Stamps are never mended: a sample keeps the one it has, and the defects tell which are wrong. A step of time that is
//! taken back by its mirror image within [`GLITCH_ROWS`] rows is a glitch of the stamps between; otherwise a step is a gap
//! or a return. A stamp within half the nominal interval of the one before repeats it.
//!
//! ```
//! use geu_recording::{GyroCsvSpec, GyroCsv, GyroCsvDefectKind};
//! let description = GyroCsvSpec::parse(
//!     "mems.toml",
//!     r#"
//!     [time]
//!     column = "ms"
//!     unit = "ms"
//!     interval_s = 0.5
//!     [gyro.GX]
//!     column = "wx"
//!     axis = "-X"
//!     unit = "deg/s"
//!     counts_per_unit = 100.0
//!     "#,
//! )
//! .unwrap();
//! let read = GyroCsv::parse("mems.csv", "ms,wx\n0,50\n500,51\n2500,52\n", description).unwrap();
//! assert_eq!(read.samples[0].rates_arcsec_s, [-1800.0]);
//! assert_eq!(read.defects[0].line, 4);
//! assert_eq!(read.defects[0].kind, GyroCsvDefectKind::Gap { length_s: 2.0 });
//! ```

use std::collections::BTreeMap;
use std::fmt;
use std::io::Read;
use std::path::Path;

use geu_model::configuration::{ConfigText, ConfigurationError, Node};
use geu_model::number::{DefaultValue, ParameterSpec, ValueFormat, number};
use geu_model::units::{ARCSEC_PER_DEG, ARCSEC_PER_RAD};
use geu_protocol::excerpt::{MAX_QUOTED, excerpt};

use crate::text::{RowReader, open_rows};

/// Units of time, with their length in s.
const TIME_UNITS: [(&str, f64); 4] = [("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9)];
/// Units of a gyro, in arcsec or arcsec/s, and whether it is an angle since the row before instead of a rate.
const GYRO_UNITS: [(&str, f64, bool); 8] = [
    ("deg/s", ARCSEC_PER_DEG, false),
    ("rad/s", ARCSEC_PER_RAD, false),
    ("mrad/s", ARCSEC_PER_RAD * 1e-3, false),
    ("arcsec/s", 1.0, false),
    ("deg/h", 1.0, false),
    ("arcsec", 1.0, true),
    ("deg", ARCSEC_PER_DEG, true),
    ("rad", ARCSEC_PER_RAD, true),
];
const AXES: [(&str, usize, f64); 9] = [
    ("X", 0, 1.0),
    ("Y", 1, 1.0),
    ("Z", 2, 1.0),
    ("+X", 0, 1.0),
    ("+Y", 1, 1.0),
    ("+Z", 2, 1.0),
    ("-X", 0, -1.0),
    ("-Y", 1, -1.0),
    ("-Z", 2, -1.0),
];
/// A step of time is looked for its mirror image over so many rows.
pub const GLITCH_ROWS: usize = 600;

const INTERVAL: ParameterSpec =
    number("interval_s", ValueFormat::Real, DefaultValue::Required, 1e-6, 1e6, "nominal interval of the rows");
const COUNTS: ParameterSpec = number(
    "counts_per_unit",
    ValueFormat::Real,
    DefaultValue::Value(1.0),
    1e-12,
    1e12,
    "counts in one unit (LSB per unit) where the column holds counts",
);

/// One gyro's column.
#[derive(Debug, Clone, PartialEq)]
pub struct GyroColumn {
    pub name: String,
    pub column: String,
    /// Axis it stands for: 0 X, 1 Y, 2 Z. Its sign is in the rates already.
    pub axis: usize,
    /// What one in the column is, arcsec/s.
    pub scale_arcsec_s: f64,
}

#[derive(Debug, Clone, PartialEq)]
pub struct GyroCsvSpec {
    pub time_column: String,
    /// Its unit, s.
    pub time_scale_s: f64,
    pub interval_s: f64,
    pub delimiter: u8,
    /// Gyros, in the order in which they are described.
    pub gyros: Vec<GyroColumn>,
    /// The table of windows to which they are compared, where it is described.
    pub reference: Option<ReferenceTable>,
}

#[derive(Debug, Clone, PartialEq)]
pub struct RateColumn {
    pub column: String,
    /// What one in it is, arcsec/s.
    pub scale_arcsec_s: f64,
}

/// A table of windows: mean rates of the gyros and an independent rate.
#[derive(Debug, Clone, PartialEq)]
pub struct ReferenceTable {
    /// Column that tells which windows belong together, such as a day.
    pub group: Option<String>,
    /// The independent rate: its magnitude, or about X, Y and Z.
    pub rates: Vec<RateColumn>,
    /// Mean rate of each gyro about its axis, in the order of [`GyroCsvSpec::gyros`].
    pub gyros: Vec<RateColumn>,
    /// What is to be said of it wherever it is used.
    pub caveat: Option<String>,
}

impl GyroCsvSpec {
    /// Reads a description; `name` is what errors call it.
    ///
    /// # Errors
    /// What is wrong with it, with its line: unknown keys and units, missing columns, no gyro.
    pub fn parse(name: &str, text: &str) -> Result<GyroCsvSpec, ConfigurationError> {
        let source = ConfigText::parse(name, text)?;
        let root = source.root();
        root.only(&["time", "gyro", "delimiter", "reference"])?;
        let delimiter = match root.keys().contains(&"delimiter") {
            true => root.choice("delimiter", &[",", ";", "\t", "|", " "])?.as_bytes()[0],
            false => b',',
        };
        let missing = |table: &str| root.error(table, format!("expected a table [{table}], got none"));
        let time = root.table("time")?.ok_or_else(|| missing("time"))?;
        time.only(&["column", "unit", INTERVAL.name])?;
        let units = TIME_UNITS.map(|(unit, _)| unit);
        let unit = time.choice("unit", &units)?;
        let interval_s = time.number(&INTERVAL)?;
        let gyro = root.table("gyro")?.ok_or_else(|| missing("gyro.NAME"))?;
        if let Some(name) = gyro.keys().into_iter().find(|name| name.len() > MAX_QUOTED) {
            return Err(gyro.error(name, format!("expected a name of at most {MAX_QUOTED} bytes, got {}", name.len())));
        }
        let gyros = gyro.keys().into_iter().map(|name| read_gyro(&gyro, name, interval_s));
        let gyros = gyros.collect::<Result<Vec<_>, _>>()?;
        if gyros.is_empty() {
            return Err(missing("gyro.NAME"));
        }
        Ok(GyroCsvSpec {
            time_column: column(&time, "column")?,
            time_scale_s: TIME_UNITS.into_iter().find(|(name, _)| *name == unit).map_or(1.0, |(_, scale)| scale),
            interval_s,
            delimiter,
            reference: match root.table("reference")? {
                Some(node) => Some(read_reference(&node, &gyros)?),
                None => None,
            },
            gyros,
        })
    }
}

fn read_reference(node: &Node, gyros: &[GyroColumn]) -> Result<ReferenceTable, ConfigurationError> {
    node.only(&["group", "caveat", "rate", "rate_x", "rate_y", "rate_z", "gyro"])?;
    let has = |key: &str| node.keys().contains(&key);
    let has_vector = node.keys().iter().any(|key| key.starts_with("rate_"));
    if has_vector && node.keys().contains(&"rate") {
        return Err(node.error("rate", "expected `rate`, or `rate_x`, `rate_y` and `rate_z`, got both".to_owned()));
    }
    let names: &[&str] = if has_vector { &["rate_x", "rate_y", "rate_z"] } else { &["rate"] };
    let of_gyro = node.table("gyro")?;
    let of_gyro = of_gyro.ok_or_else(|| node.error("gyro", "expected tables gyro.NAME, got none".to_owned()))?;
    of_gyro.only(&gyros.iter().map(|gyro| gyro.name.as_str()).collect::<Vec<_>>())?;
    Ok(ReferenceTable {
        group: has("group").then(|| column(node, "group")).transpose()?,
        caveat: has("caveat").then(|| node.text("caveat").map(str::to_owned)).transpose()?,
        rates: names.iter().map(|name| read_rate(node, name)).collect::<Result<_, _>>()?,
        gyros: gyros.iter().map(|gyro| read_rate(&of_gyro, &gyro.name)).collect::<Result<_, _>>()?,
    })
}

/// The name of a column, short enough that messages quote it.
fn column(node: &Node, key: &str) -> Result<String, ConfigurationError> {
    match node.text(key)? {
        name if name.len() <= MAX_QUOTED => Ok(name.to_owned()),
        _ => Err(node.unexpected(key, &format!("a name of at most {MAX_QUOTED} bytes"))),
    }
}

fn read_rate(parent: &Node, key: &str) -> Result<RateColumn, ConfigurationError> {
    let path = parent.path_of(key);
    let missing = || parent.error(key, format!("expected `{path}`, {{ column = TEXT, unit = UNIT }}, got none"));
    let node = parent.table(key)?.ok_or_else(missing)?;
    node.only(&["column", "unit"])?;
    let rates = GYRO_UNITS.iter().filter(|(.., is_angle)| !is_angle);
    let unit = node.choice("unit", &rates.clone().map(|(unit, ..)| *unit).collect::<Vec<_>>())?;
    let scale_arcsec_s = rates.clone().find(|(name, ..)| *name == unit).map_or(1.0, |(_, size, _)| *size);
    Ok(RateColumn { column: column(&node, "column")?, scale_arcsec_s })
}

fn read_gyro(all: &Node, name: &str, interval_s: f64) -> Result<GyroColumn, ConfigurationError> {
    let missing = || all.error(name, format!("expected a table [gyro.{name}]"));
    let node = all.table(name)?.ok_or_else(missing)?;
    node.only(&["column", "axis", "unit", COUNTS.name])?;
    let unit = node.choice("unit", &GYRO_UNITS.map(|(unit, ..)| unit))?;
    let axis = node.choice("axis", &AXES.map(|(axis, ..)| axis))?;
    let (_, size, is_angle) = *GYRO_UNITS.iter().find(|(name, ..)| *name == unit).unwrap_or(&GYRO_UNITS[0]);
    let (_, axis, sign) = *AXES.iter().find(|(name, ..)| *name == axis).unwrap_or(&AXES[0]);
    let per_second = if is_angle { 1.0 / interval_s } else { 1.0 };
    let scale_arcsec_s = sign * size * per_second / node.number(&COUNTS)?;
    Ok(GyroColumn { name: name.to_owned(), column: column(&node, "column")?, axis, scale_arcsec_s })
}

/// A row with its time and all its gyros.
#[derive(Debug, Clone, PartialEq)]
pub struct RateSample {
    /// Line, from 1.
    pub line: u64,
    pub t_s: f64,
    /// Rates about the axes described, in the order of [`GyroCsvSpec::gyros`].
    pub rates_arcsec_s: Vec<f64>,
}

#[derive(Debug, Clone, PartialEq)]
pub struct GyroCsvDefect {
    /// Line, from 1.
    pub line: u64,
    pub kind: GyroCsvDefectKind,
}

/// What is wrong. [`fmt::Display`] tells it in words, with what was expected and got.
#[derive(Debug, Clone, PartialEq)]
pub enum GyroCsvDefectKind {
    /// A field that is no number; the row is no sample.
    NotANumber {
        column: String,
        got: String,
    },
    /// A row with more or fewer fields than the header; no sample.
    Fields {
        expected: usize,
        got: usize,
    },
    Gap {
        /// Since the row before.
        length_s: f64,
    },
    /// The stamp of the row before, again.
    Repeat,
    Backwards {
        by_s: f64,
    },
    /// This row and those after it are stamped beside the time.
    Glitch {
        rows: usize,
        offset_s: f64,
    },
}

impl GyroCsvDefectKind {
    pub fn name(&self) -> &'static str {
        match self {
            GyroCsvDefectKind::NotANumber { .. } => "not-a-number",
            GyroCsvDefectKind::Fields { .. } => "fields",
            GyroCsvDefectKind::Gap { .. } => "gap",
            GyroCsvDefectKind::Repeat => "repeated-stamp",
            GyroCsvDefectKind::Backwards { .. } => "time-backwards",
            GyroCsvDefectKind::Glitch { .. } => "time-glitch",
        }
    }
}

impl fmt::Display for GyroCsvDefectKind {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            GyroCsvDefectKind::NotANumber { column, got } => write!(f, "{column}: expected a number, got {got:?}"),
            GyroCsvDefectKind::Fields { expected, got } => write!(f, "expected {expected} fields, got {got}"),
            GyroCsvDefectKind::Gap { length_s } => {
                write!(f, "expected the next row at the interval, got a gap of {length_s} s")
            }
            GyroCsvDefectKind::Repeat => write!(f, "expected a new time, got the one before again"),
            GyroCsvDefectKind::Backwards { by_s } => write!(f, "expected time to rise, got {by_s} s back"),
            GyroCsvDefectKind::Glitch { rows, offset_s } => {
                write!(f, "expected time to go on, got {rows} rows stamped {offset_s:+} s beside it")
            }
        }
    }
}

/// Why a file cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum GyroCsvError {
    /// It cannot be opened or read.
    #[error("{name}: cannot be read: {source}; expected a CSV of gyros")]
    Read { name: String, source: std::io::Error },
    /// Columns described that it does not have.
    #[error("{name}: line 1: expected the columns {expected}, got {got}")]
    Columns { name: String, expected: String, got: String },
    /// Text that is no CSV.
    #[error("{name}: {source}")]
    Csv { name: String, source: csv::Error },
}

#[derive(Debug, Clone, PartialEq)]
pub struct GyroCsv {
    pub description: GyroCsvSpec,
    /// Its rows, in their order.
    pub samples: Vec<RateSample>,
    /// What is wrong with it, in the order of lines.
    pub defects: Vec<GyroCsvDefect>,
}

impl GyroCsv {
    /// Reads a file, which may be compressed.
    ///
    /// # Errors
    /// A file that cannot be read, or does not have the columns described.
    pub fn read(name: &str, description: GyroCsvSpec) -> Result<GyroCsv, GyroCsvError> {
        let failed = |source| GyroCsvError::Read { name: name.to_owned(), source };
        GyroCsv::of_rows(name, open_rows(Path::new(name)).map_err(failed)?, description)
    }

    /// Reads a text; `name` is what errors call it.
    ///
    /// # Errors
    /// Text that does not have the columns described.
    pub fn parse(name: &str, text: &str, description: GyroCsvSpec) -> Result<GyroCsv, GyroCsvError> {
        GyroCsv::of_rows(name, RowReader::new(text.as_bytes()), description)
    }

    fn of_rows(name: &str, rows: RowReader<impl Read>, description: GyroCsvSpec) -> Result<GyroCsv, GyroCsvError> {
        let failed = |source| GyroCsvError::Csv { name: name.to_owned(), source };
        let mut builder = csv::ReaderBuilder::new();
        builder.delimiter(description.delimiter).flexible(true).trim(csv::Trim::All);
        let mut table = rows.table(&builder);
        let header = table.header().map_err(failed)?;
        let wanted: Vec<&str> = std::iter::once(description.time_column.as_str())
            .chain(description.gyros.iter().map(|gyro| gyro.column.as_str()))
            .collect();
        let places: Option<Vec<usize>> =
            wanted.iter().map(|wanted| header.iter().position(|column| column == *wanted)).collect();
        let places = places.ok_or_else(|| GyroCsvError::Columns {
            name: name.to_owned(),
            expected: wanted.join(", "),
            got: excerpt(&header.iter().collect::<Vec<_>>().join(", ")).into_owned(),
        })?;
        let (mut samples, mut defects, mut rows, mut row) = (Vec::new(), Vec::new(), Vec::new(), 0);
        let mut record = csv::StringRecord::new();
        while table.read(&mut record).map_err(failed)? {
            let line = record.position().map_or(0, csv::Position::line);
            row += 1;
            if record.len() != header.len() {
                let kind = GyroCsvDefectKind::Fields { expected: header.len(), got: record.len() };
                defects.push(GyroCsvDefect { line, kind });
                continue;
            }
            let number = |place: usize| record[place].parse::<f64>().ok().filter(|number| number.is_finite());
            let numbers: Result<Vec<f64>, usize> = places.iter().map(|&place| number(place).ok_or(place)).collect();
            match numbers {
                Err(place) => {
                    let (column, got) = (header[place].to_owned(), excerpt(&record[place]).into_owned());
                    defects.push(GyroCsvDefect { line, kind: GyroCsvDefectKind::NotANumber { column, got } });
                }
                Ok(numbers) => {
                    let rates = description.gyros.iter().zip(&numbers[1..]).map(|(gyro, n)| n * gyro.scale_arcsec_s);
                    rows.push(row);
                    let t_s = numbers[0] * description.time_scale_s;
                    samples.push(RateSample { line, t_s, rates_arcsec_s: rates.collect() });
                }
            }
        }
        defects.extend(defects_of_time(&samples, &rows, description.interval_s));
        defects.sort_by_key(|defect| defect.line);
        Ok(GyroCsv { description, samples, defects })
    }

    /// Where everything went, and what the gyros say.
    pub fn account(&self) -> GyroCsvSummary<'_> {
        GyroCsvSummary(self)
    }
}

/// Steps of time that are not the interval, within half of it; `rows` are the rows of the samples, counted with those that
/// were refused.
fn defects_of_time(samples: &[RateSample], rows: &[u64], interval_s: f64) -> Vec<GyroCsvDefect> {
    // Each step with what it is beside the interval.
    let stamps = samples.windows(2).map(|pair| pair[1].t_s - pair[0].t_s);
    let steps: Vec<(f64, f64)> = stamps
        .zip(rows.windows(2))
        .map(|(step_s, rows)| (step_s, step_s - interval_s * (rows[1] - rows[0]) as f64))
        .collect();
    let small = |time_s: f64| time_s.abs() <= 0.5 * interval_s;
    let mut returned = vec![false; steps.len()];
    let mut defects = Vec::new();
    for (index, &(step_s, beside_s)) in steps.iter().enumerate() {
        if returned[index] || small(beside_s) {
            continue;
        }
        // Forth by so much beside the interval, and back again.
        let back = (index + 1..steps.len()).take(GLITCH_ROWS).find(|&later| {
            let (back_s, back_beside_s) = steps[later];
            !returned[later] && !small(step_s) && !small(back_s) && small(beside_s + back_beside_s)
        });
        let kind = match back {
            Some(later) => {
                returned[later] = true;
                GyroCsvDefectKind::Glitch { rows: later - index, offset_s: beside_s }
            }
            None if small(step_s) => GyroCsvDefectKind::Repeat,
            None if step_s < 0.0 => GyroCsvDefectKind::Backwards { by_s: -step_s },
            // Rows that were refused took no time.
            None if beside_s < 0.0 => continue,
            None => GyroCsvDefectKind::Gap { length_s: step_s },
        };
        defects.push(GyroCsvDefect { line: samples[index + 1].line, kind });
    }
    defects
}

/// An account of a file; [`fmt::Display`] writes it.
pub struct GyroCsvSummary<'a>(&'a GyroCsv);

impl fmt::Display for GyroCsvSummary<'_> {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let GyroCsv { description, samples, defects } = self.0;
        let refused = |kind: &GyroCsvDefectKind| {
            matches!(kind, GyroCsvDefectKind::NotANumber { .. } | GyroCsvDefectKind::Fields { .. })
        };
        let refused = defects.iter().filter(|defect| refused(&defect.kind)).count();
        writeln!(f, "rows         {}: {} samples, {refused} refused", samples.len() + refused, samples.len())?;
        if let (Some(first), Some(last)) = (samples.first(), samples.last()) {
            writeln!(f, "time         {} s to {} s, interval {} s", first.t_s, last.t_s, description.interval_s)?;
        }
        for (index, gyro) in description.gyros.iter().enumerate() {
            let rates = samples.iter().map(|sample| sample.rates_arcsec_s[index]);
            let (mut least, mut greatest, mut sum) = (f64::INFINITY, f64::NEG_INFINITY, 0.0);
            for rate in rates {
                (least, greatest, sum) = (least.min(rate), greatest.max(rate), sum + rate);
            }
            if !samples.is_empty() {
                let (axis, mean) = (["X", "Y", "Z"][gyro.axis], sum / samples.len() as f64);
                writeln!(f, "{:<12} about {axis}: {mean:.3} arcsec/s, {least:.3} to {greatest:.3}", gyro.name)?;
            }
        }
        let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
        defects.iter().for_each(|defect| *counts.entry(defect.kind.name()).or_default() += 1);
        writeln!(f, "defects      {}", defects.len())?;
        counts.iter().try_for_each(|(kind, count)| writeln!(f, "  {kind:<14} {count}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DESCRIPTION: &str = "[time]\ncolumn = \"t\"\nunit = \"s\"\ninterval_s = 1.0\n[gyro.GX]\ncolumn = \"wx\"\naxis = \"X\"\nunit = \"deg/s\"\n[gyro.GZ]\ncolumn = \"nz\"\naxis = \"-Z\"\nunit = \"rad/s\"\ncounts_per_unit = 1000\n";

    fn read(rows: &str) -> GyroCsv {
        let description = GyroCsvSpec::parse("d.toml", DESCRIPTION).unwrap_or_else(|error| panic!("{error}"));
        GyroCsv::parse("f.csv", &format!("t,wx,other,nz\n{rows}"), description).expect("a file")
    }

    fn stamped(stamps: &[f64]) -> String {
        stamps.iter().map(|t_s| format!("{t_s},1,text,2\n")).collect()
    }

    fn kinds(read: &GyroCsv) -> Vec<(u64, GyroCsvDefectKind)> {
        read.defects.iter().map(|defect| (defect.line, defect.kind.clone())).collect()
    }

    #[test]
    fn units_counts_and_signs_are_as_described() {
        let read = read("0,1,a,2\n1,-0.5,b,-4\n");
        assert_eq!(read.defects, []);
        assert_eq!(read.samples[0].rates_arcsec_s[0], 3600.0);
        assert_eq!(read.samples[1].rates_arcsec_s[0], -1800.0);
        // 0.002 rad/s about −Z; 206 264.806″ in a radian.
        assert!((read.samples[0].rates_arcsec_s[1] + 412.529_612).abs() < 1e-5);
        // An angle of 3″ in 0.5 s.
        let angle = DESCRIPTION.replace("deg/s", "arcsec").replace("interval_s = 1.0", "interval_s = 0.5");
        let angle = GyroCsvSpec::parse("d.toml", &angle).expect("a description");
        assert_eq!(angle.gyros[0].scale_arcsec_s, 2.0);
    }

    #[test]
    fn every_fault_is_told_with_its_line() {
        let repeat = read(&stamped(&[0.0, 1.0, 1.0, 2.0, 3.0]));
        assert_eq!(kinds(&repeat), [(4, GyroCsvDefectKind::Repeat)]);
        let gap = read(&stamped(&[0.0, 1.0, 29.0, 30.0]));
        assert_eq!(kinds(&gap), [(4, GyroCsvDefectKind::Gap { length_s: 28.0 })]);
        let glitch = read(&stamped(&[0.0, 1.0, 102.0, 103.0, 4.0, 5.0, -94.0, 7.0]));
        let expected = [
            (4, GyroCsvDefectKind::Glitch { rows: 2, offset_s: 100.0 }),
            (8, GyroCsvDefectKind::Glitch { rows: 1, offset_s: -100.0 }),
        ];
        assert_eq!(kinds(&glitch), expected);
        let back = read(&stamped(&[0.0, 1.0, -50.0, -49.0]));
        assert_eq!(kinds(&back), [(4, GyroCsvDefectKind::Backwards { by_s: 51.0 })]);
        // A gap within a glitch is one of its own.
        let both = read(&stamped(&[0.0, 1.0, 102.0, 108.0, 9.0]));
        let expected = [
            (4, GyroCsvDefectKind::Glitch { rows: 2, offset_s: 100.0 }),
            (5, GyroCsvDefectKind::Gap { length_s: 6.0 }),
        ];
        assert_eq!(kinds(&both), expected);
        let broken = read("0,1,a,2\n1,x,a,2\n1,nan,a,2\n1,1,a\n1,1,a,2\n");
        let not = |got: &str| GyroCsvDefectKind::NotANumber { column: "wx".to_owned(), got: got.to_owned() };
        let expected = [(3, not("x")), (4, not("nan")), (5, GyroCsvDefectKind::Fields { expected: 4, got: 3 })];
        assert_eq!(kinds(&broken), expected);
        assert_eq!(broken.samples.len(), 2);
        let account = broken.account().to_string();
        assert!(account.contains("5: 2 samples, 3 refused") && account.contains("not-a-number   2"), "{account}");
    }

    #[test]
    fn jitter_within_half_an_interval_is_none() {
        assert_eq!(read(&stamped(&[0.0, 1.4, 2.0, 3.4, 4.0])).defects, []);
    }

    #[test]
    fn what_a_description_lacks_is_pointed_at() {
        for (from, to, part) in [
            ("deg/s", "furlong", "expected one of deg/s, rad/s"),
            ("axis = \"X\"\n", "", "expected one of X, Y, Z"),
            ("unit = \"s\"\n", "", "expected one of s, ms, us, ns"),
            ("interval_s = 1.0\n", "", "expected `time.interval_s`"),
            ("column = \"wx\"", "colum = \"wx\"", "did you mean `column`?"),
            ("[time]", "[tim]", "unknown key `tim`"),
            ("counts_per_unit = 1000", "counts_per_unit = 0", "a number within"),
            ("column = \"wx\"", &format!("column = \"{}\"", "x".repeat(300)), "a name of at most 200 bytes"),
        ] {
            let error = GyroCsvSpec::parse("d.toml", &DESCRIPTION.replace(from, to)).expect_err(to).to_string();
            assert!(error.contains(part) && error.contains("d.toml:"), "{part} not in {error}");
        }
        let description = GyroCsvSpec::parse("d.toml", DESCRIPTION).expect("a description");
        let error = GyroCsv::parse("f.csv", "t,wx\n", description).expect_err("no column nz").to_string();
        assert_eq!(error, "f.csv: line 1: expected the columns t, wx, nz, got t, wx");
    }
}
