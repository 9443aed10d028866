//! Reference rates for gyros, as CSV: rows with times, or a table of windows as described.
//!
//! Rows with times have `t_s` and `rate_arcsec_s` (the magnitude) or `rate_x_arcsec_s`, `rate_y_arcsec_s`,
//! `rate_z_arcsec_s`; each is the mean over an interval of the median spacing that ends at its time. A table of windows
//! ([`ReferenceTable`]) has the gyros' mean rates beside the independent one, and needs no time.

use std::io::Read;
use std::path::Path;

use crate::csv_table::{CsvTable, TableError};
use crate::gyro_csv::{RateColumn, ReferenceTable};
use crate::text::{RowReader, open_rows};

const TIME: &str = "t_s";
const MAGNITUDE: &str = "rate_arcsec_s";
const VECTOR: [&str; 3] = ["rate_x_arcsec_s", "rate_y_arcsec_s", "rate_z_arcsec_s"];

#[derive(Debug, Clone, PartialEq)]
pub struct RateRow {
    /// Line, from 1.
    pub line: u64,
    /// End of the interval; `None` in a table of windows.
    pub t_s: Option<f64>,
    /// Group, if the table has groups.
    pub group: Option<String>,
    /// Mean rates of the gyros; empty if samples have them.
    pub gyros_arcsec_s: Vec<f64>,
    /// The independent rate: its magnitude, or about X, Y and Z.
    pub rates_arcsec_s: Vec<f64>,
}

#[derive(Debug, Clone, PartialEq)]
pub struct RateTable {
    /// Rows, in their order.
    pub rows: Vec<RateRow>,
}

struct Columns {
    time: Option<usize>,
    group: Option<usize>,
    gyros: Vec<(usize, f64)>,
    rates: Vec<(usize, f64)>,
}

impl Columns {
    /// Finds the columns. The error is the list of expected ones.
    fn find(table: &CsvTable<impl Read>, described: Option<&ReferenceTable>) -> Result<Columns, String> {
        let place = |name: &str| table.column(name);
        let known = |names: &[&str]| names.iter().map(|name| Some((place(name)?, 1.0))).collect::<Option<Vec<_>>>();
        let of = |columns: &[RateColumn]| {
            columns.iter().map(|own| Some((place(&own.column)?, own.scale_arcsec_s))).collect::<Option<Vec<_>>>()
        };
        if let Some(time) = place(TIME)
            && let Some(rates) = known(&VECTOR).or_else(|| known(&[MAGNITUDE]))
        {
            return Ok(Columns { time: Some(time), group: None, gyros: Vec::new(), rates });
        }
        let plain = format!("{TIME} and {MAGNITUDE} or {}", VECTOR.join(", "));
        let Some(table) = described else { return Err(format!("{plain}, or those of a table [reference]")) };
        let names = table.group.iter().chain(table.gyros.iter().chain(&table.rates).map(|column| &column.column));
        let expected = || format!("{}; or {plain}", names.map(String::as_str).collect::<Vec<_>>().join(", "));
        let group = table.group.as_ref().map(|group| place(group));
        match (of(&table.gyros), of(&table.rates), group) {
            (Some(gyros), Some(rates), None | Some(Some(_))) => {
                Ok(Columns { time: None, group: group.flatten(), gyros, rates })
            }
            _ => Err(expected()),
        }
    }
}

impl RateTable {
    /// Reads a file, which may be compressed.
    ///
    /// # Errors
    /// [`TableError`], with the line.
    pub fn read(name: &str, described: Option<&ReferenceTable>) -> Result<RateTable, TableError> {
        RateTable::of_rows(
            name,
            open_rows(Path::new(name)).map_err(TableError::read(name, "a CSV of rates"))?,
            described,
        )
    }

    /// Reads a text; errors call it `name`.
    ///
    /// # Errors
    /// [`TableError`], with the line.
    pub fn parse(name: &str, text: &str, described: Option<&ReferenceTable>) -> Result<RateTable, TableError> {
        RateTable::of_rows(name, RowReader::new(text.as_bytes()), described)
    }

    fn of_rows(
        name: &str,
        rows: RowReader<impl Read>,
        described: Option<&ReferenceTable>,
    ) -> Result<RateTable, TableError> {
        let mut table = CsvTable::new(name, rows)?;
        let columns = Columns::find(&table, described).map_err(|expected| table.without_columns(&expected))?;
        let mut rows = Vec::new();
        while table.read()? {
            let number = |place: usize| table.number(place);
            let rates = |columns: &[(usize, f64)]| -> Result<Vec<f64>, TableError> {
                columns.iter().map(|(place, scale)| Ok(number(*place)? * scale)).collect()
            };
            rows.push(RateRow {
                line: table.line(),
                t_s: columns.time.map(number).transpose()?,
                group: columns.group.map(|place| table.text(place).to_owned()),
                gyros_arcsec_s: rates(&columns.gyros)?,
                rates_arcsec_s: rates(&columns.rates)?,
            });
        }
        Ok(RateTable { rows })
    }

    /// Median of the steps of time; `None` with fewer than two times.
    pub fn spacing_s(&self) -> Option<f64> {
        let times: Vec<f64> = self.rows.iter().filter_map(|row| row.t_s).collect();
        let mut steps: Vec<f64> = times.windows(2).map(|pair| pair[1] - pair[0]).filter(|step| *step > 0.0).collect();
        steps.sort_unstable_by(f64::total_cmp);
        steps.get(steps.len() / 2).copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::GyroCsvSpec;

    const DESCRIPTION: &str = "[time]\ncolumn = \"t\"\nunit = \"s\"\ninterval_s = 1.0\n[gyro.GX]\ncolumn = \"wx\"\naxis = \"X\"\nunit = \"deg/s\"\n[reference]\ngroup = \"day\"\nrate = { column = \"m\", unit = \"deg/s\" }\ngyro.GX = { column = \"wx\", unit = \"arcsec/s\" }\n";

    #[test]
    fn a_table_of_windows_is_read_as_described() {
        let description = GyroCsvSpec::parse("d.toml", DESCRIPTION).unwrap_or_else(|error| panic!("{error}"));
        let read = RateTable::parse("r.csv", "day,wx,m\nfirst,5,2\n", description.reference.as_ref()).expect("a table");
        let (group, gyros_arcsec_s, rates_arcsec_s) = (Some("first".to_owned()), vec![5.0], vec![7200.0]);
        assert_eq!(read.rows, [RateRow { line: 2, t_s: None, group, gyros_arcsec_s, rates_arcsec_s }]);
        let read = RateTable::parse("r.csv", "t_s,rate_arcsec_s\n0,1\n10,2\n20,3\n", None).expect("rows");
        assert_eq!((read.rows.len(), read.rows[2].t_s, read.spacing_s()), (3, Some(20.0), Some(10.0)));
    }

    #[test]
    fn errors_name_their_position() {
        for (from, to, part) in [
            ("group", "groups", "unknown key `groups` in reference; did you mean `group`?"),
            ("unit = \"deg/s\" }", "unit = \"deg\" }", "expected one of deg/s, rad/s"),
            ("gyro.GX = {", "gyro.GY = {", "expected one of: GX"),
            ("rate = {", "rate_x = {", "expected `reference.rate_y`"),
        ] {
            let error = GyroCsvSpec::parse("d.toml", &DESCRIPTION.replace(from, to)).expect_err(to).to_string();
            assert!(error.contains(part) && error.contains("d.toml:"), "{part} not in {error}");
        }
        let description = GyroCsvSpec::parse("d.toml", DESCRIPTION).expect("a description");
        let parse =
            |text: &str| RateTable::parse("r.csv", text, description.reference.as_ref()).expect_err(text).to_string();
        assert!(
            parse("day,wx\n").starts_with("r.csv: line 1: header: expected the columns day, wx, m; or t_s and"),
            "{}",
            parse("day,wx\n")
        );
        assert_eq!(parse("day,wx,m\na,b,1\n"), "r.csv: line 2: wx: expected a number, got \"b\"");
    }
}
