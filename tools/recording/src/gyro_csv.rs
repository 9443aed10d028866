//! CSV of any gyros: a description (TOML) defines the columns; the result is rates and defects.
//!
//! Time stamps are not corrected: a sample keeps its stamp, and defects report wrong ones. A step of time with its mirror image
//! within 600 rows is a glitch of the stamps between; any other step is a gap or a return. A stamp within half
//! the nominal interval of the one before repeats it.
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

mod defect;
mod spec;

use std::io::Read;
use std::path::Path;

use geu_protocol::excerpt::excerpt;

use self::defect::time_defects;
pub use self::defect::{GyroCsvDefect, GyroCsvDefectKind};
pub use self::spec::{GyroColumn, GyroCsvSpec, RateColumn, ReferenceTable};
use crate::text::{RowReader, open_rows};

/// A row with its time and all its gyros.
#[derive(Debug, Clone, PartialEq)]
pub struct RateSample {
    /// Line, from 1.
    pub line: u64,
    pub t_s: f64,
    /// Rates about the axes described, in the order of [`GyroCsvSpec::gyros`].
    pub rates_arcsec_s: Vec<f64>,
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
    /// Rows, in their order.
    pub samples: Vec<RateSample>,
    /// Defects, in the order of lines.
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

    /// Reads a text; errors call it `name`.
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
        defects.extend(time_defects(&samples, &rows, description.interval_s));
        defects.sort_by_key(|defect| defect.line);
        Ok(GyroCsv { description, samples, defects })
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
    fn every_defect_is_reported_with_its_line() {
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
    }

    #[test]
    fn jitter_within_half_an_interval_is_none() {
        assert_eq!(read(&stamped(&[0.0, 1.4, 2.0, 3.4, 4.0])).defects, []);
    }

    #[test]
    fn errors_of_a_description_name_its_line() {
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
